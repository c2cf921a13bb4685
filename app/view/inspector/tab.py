"""Tab "Inspector": its controls and their effects."""

from __future__ import annotations

import html
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import viser
from numpy.typing import NDArray

import vf
from app.scene.moment import Moment
from app.scene.picking import pick
from app.scene.scene import Scene
from app.view import camera
from app.view.context import PageContext
from app.view.inspector import descriptions, figures
from app.view.inspector.drawing import NearDrawing
from app.view.inspector.inspection import Inspection, Inspector, Request, Subject
from app.view.inspector.probe import Probe, case_pose, case_view
from app.view.inspector.subject import at_tool, hit
from app.view.part import Clients, Part
from app.view.units import VIEW_SCALE, pose_from_view
from app.view.worker import Worker

FloatArray = NDArray[np.float64]

REQUEST_PERIOD = 0.08  # shortest time between two requests [s]
HERE = "this anatomy"
BACK, MAIN, ON = "◀", "Main", "▶"
RULES = ("paper", "certified", "all")  # for the planes at the probe
MAX_PROBE_DISTANCE = 2.0  # reject probe positions farther than this from the base [m]

_NOTE = "margin:0 .75em .4em;font-size:11.5px;line-height:1.3;color:var(--vf-soft)"
_INTRO = (
    f"<div style='{_NOTE}'>Colours every triangle in the motion sphere by the condition of "
    "the paper that it meets. Click one on the anatomy, or step through them.</div>"
)
_MOVING = (
    f"<div style='{_NOTE}'>Structures move: what is explained is a tick, with the anatomy where "
    "the guard believed it when the tick ended. Pause (key P) to look at one.</div>"
)


class InspectorTab(Part):
    """The tab and its drawings, shared by all clients.

    Callbacks on the event loop only set attributes, which the view thread reads. Orders to the
    session go through `client_input`.
    """

    def __init__(self, context: PageContext) -> None:
        self._context = context
        self._scene = context.session.scene
        self._worker: Worker[Request, Inspection] = Worker("inspector", Inspector().inspect)
        self._near = NearDrawing(context.server.scene, context.labels)
        self._probe = Probe(context.server.scene, context.labels)
        self._on = False
        self._drawn: tuple[Inspection, int] | None = None
        self._requested_at = 0.0  # monotonic time [s]
        self._request: Request | None = None
        self._step: vf.Step | None = None  # of the shown tick
        self._chosen: int | None = None  # None: the main triangle of the inspection
        self._of: int | None = None  # number of the structure that the chosen triangle is of
        self._region = False
        self._comparing = False
        self._exploring = False
        self._probing = False  # the probe is drawn; used by the view thread only
        self._resume = False  # the loop, after the exploring
        self._case: figures.Case | None = None
        self._surface = self._scene.surface  # under the probe
        self._probe_at = np.zeros(3)  # replaced as a whole
        self._rule = RULES[0]
        with context.left.add_tab("Inspector"):
            self._controls(context.server.gui)

    def set_scene(self, scene: Scene) -> None:
        self._scene = scene
        self._chosen = None
        if self._exploring:
            self._stop_exploring()
        self._surface = scene.surface
        self._near.hide()
        self._drawn = self._step = None

    def frame(self, shown: Moment, clients: Clients) -> None:
        telemetry = shown.telemetry
        self._step = telemetry.step
        fixture = self._context.fixture
        fixture.inspected = self._on
        fixture.suppressed = self._on and self._exploring
        self._context.proxy.suppressed = fixture.suppressed
        if self._probing and not self._exploring:
            self._probe.hide()
        self._probing = self._exploring
        if not self._on:
            if self._drawn is not None:
                self._drawn = None
                self._near.hide()
            return
        now = time.monotonic()
        # The thread uses at most a quarter of a core.
        if now >= self._requested_at + max(REQUEST_PERIOD, 4.0 * self._worker.duration):
            subject = self._subject(shown)
            if subject is not None:
                request = Request(subject, self._region, self._comparing)
                answer = self._worker.latest()
                settled = answer is None or answer.settled
                if not (settled and request.same(self._request)):
                    self._requested_at, self._request = now, request
                    self._worker.request(request)
        inspection = self._newest()
        if inspection is None:
            return
        chosen = self._chosen_in(inspection)
        if self._drawn is not None and self._drawn[0] is inspection and self._drawn[1] == chosen:
            return
        self._drawn = inspection, chosen
        self._near.draw(inspection, chosen)
        if self._exploring:
            self._probe.draw(inspection)

    def read_out(self, shown: Moment) -> None:
        self._freeze.value = self._exploring
        self._freeze.disabled = self._cases.disabled = not self._context.source.live
        self._intro.content = _MOVING if self._scene.moves else _INTRO
        self._cases.value = HERE if self._case is None else self._case.name
        self._rule_choice.visible = self._exploring
        self._intro.visible = not self._on or (self._scene.moves and not self._exploring)
        inspection = self._newest() if self._on else None
        if inspection is None:
            for page in (self._report, self._list, self._solid, self._rules):
                page.content = ""
            return
        chosen = self._chosen_in(inspection)
        self._report.content = descriptions.structure(inspection) + descriptions.triangle(
            inspection, chosen
        )
        self._list.content = descriptions.nearest(inspection, chosen) + descriptions.parts(
            inspection
        )
        self._solid.content = descriptions.region(inspection) if self._region else ""
        self._rules.content = (
            descriptions.comparison(inspection.forecasts)
            if inspection.forecasts is not None and self._comparing
            else ""
        )

    def _newest(self) -> Inspection | None:
        """The newest result, unless it is of another scene or mode."""
        inspection = self._worker.latest()
        if inspection is None:
            return None
        subject = inspection.subject
        if (
            subject.scene.version != self._scene.version
            or (subject.step is None) != self._exploring
        ):
            return None
        if self._exploring and subject.surface is not self._surface:
            return None
        return inspection

    def _subject(self, shown: Moment) -> Subject | None:
        options, scene, step = shown.options, self._scene, shown.telemetry.step
        if not self._exploring:
            chosen = None if self._chosen is None else self._of
            return at_tool(shown, chosen) if shown.scene.version == scene.version else None
        if step is None or shown.telemetry.scene != scene.version:
            return None
        if self._case is None:
            return Subject(self._surface, self._probe_at, step.radius, options, self._rule, scene)
        return Subject(
            self._surface, self._probe_at, figures.RADIUS, options, self._rule, scene,
            names=tuple(figures.NAMES.values()),
        )  # fmt: skip

    def _chosen_in(self, inspection: Inspection) -> int:
        chosen = self._chosen
        surface = inspection.subject.surface
        stale = not self._exploring and self._of != inspection.subject.number
        if chosen is None or stale or chosen >= len(surface.faces):
            return inspection.main_triangle()
        return chosen

    def _controls(self, gui: viser.GuiApi) -> None:
        self._inspect: Any = gui.add_checkbox(
            "Inspect", False, hint="Off, the inspector costs nothing and draws nothing."
        )
        self._intro = gui.add_html(_INTRO)
        self._freeze: Any = gui.add_checkbox(
            "Freeze and explore",
            False,
            hint="Pauses the loop. Drag the yellow probe and watch the conditions change.",
        )
        self._cases: Any = gui.add_dropdown(
            "Explore",
            (HERE, *figures.CASES),
            initial_value=HERE,
            hint="The cases of the paper’s Figures 4 and 5, two triangles each.",
        )
        self._expect = gui.add_html("")
        self._rule_choice = gui.add_dropdown(
            "Planes of",
            RULES,
            initial_value=self._rule,
            hint="Whose planes the probe shows.",
            visible=False,
        )
        steps = gui.add_button_group(
            "Triangle",
            (BACK, MAIN, ON),
            hint="By distance; main is the one whose plane blocks the tool, or else the nearest.",
        )
        self._report = gui.add_html("")
        self._list = gui.add_html("")
        region = gui.add_checkbox(
            "Allowed region", False, hint="The sphere cut by the planes in force, as a solid."
        )
        self._solid = gui.add_html("")
        compare = gui.add_checkbox(
            "Compare rules",
            False,
            hint="What every rule would do from the pose after one tick. Pause (key P) to hold it.",
        )
        self._rules = gui.add_html("")

        self._bind(self._inspect, lambda client, value: self._switch(client, bool(value)))
        self._bind(region, lambda _client, value: self._set(region=bool(value)))
        self._bind(compare, lambda _client, value: self._set(comparing=bool(value)))
        self._bind(self._freeze, lambda client, value: self._explore(client, bool(value)))
        self._bind(self._cases, lambda client, value: self._set_case(client, str(value)))
        self._bind(self._rule_choice, lambda _client, value: self._set_rule(str(value)))

        @steps.on_click
        async def _step(event: viser.GuiEvent[Any]) -> None:
            self._advance(str(event.target.value))

        @self._probe.gizmo.on_update
        async def _moved(event: viser.TransformControlsEvent) -> None:
            self._move_probe(np.array(event.target.wxyz), np.array(event.target.position))

    def _bind(self, control: Any, take: Callable[[viser.ClientHandle, Any], None]) -> None:
        """Call `take` on the input worker when a client sets the control."""

        @control.on_update
        async def _updated(event: viser.GuiEvent[Any]) -> None:
            if event.client is not None:  # None: set by this program
                self._context.client_input.submit(take, event.client, event.target.value)

    def _set(self, region: bool | None = None, comparing: bool | None = None) -> None:
        self._region = self._region if region is None else region
        self._comparing = self._comparing if comparing is None else comparing

    def _switch(self, client: viser.ClientHandle, on: bool) -> None:
        scene = self._context.server.scene
        if on == self._on:
            return
        if on:
            scene.on_click()(self._clicked)  # type: ignore[arg-type]
        else:
            scene.remove_click_callback(self._clicked)
            if self._exploring:
                self._explore(client, False)
        self._on = on

    async def _clicked(self, event: viser.SceneClickEvent) -> None:
        self._context.client_input.submit(self._pick, event.ray_origin, event.ray_direction)

    def _pick(self, origin: tuple[float, ...], direction: tuple[float, ...]) -> None:
        eye = np.asarray(origin) / VIEW_SCALE
        try:
            if self._exploring:
                triangle = pick(self._surface, eye, direction)
                self._chosen = triangle if triangle >= 0 else self._chosen
                return
            met = hit(self._context.source.shown, eye, np.asarray(direction))
        except ValueError:
            return  # no browser sends that
        if met is not None:
            self._of, self._chosen = met

    def _advance(self, where: str) -> None:
        inspection = self._newest()
        if inspection is None or where == MAIN or not len(inspection.explanation):
            self._chosen = None
            return
        explanation = inspection.explanation
        self._of = inspection.subject.number
        row = explanation.row(self._chosen_in(inspection))
        row += 1 if where == ON else -1
        self._chosen = int(explanation.triangles[min(max(row, 0), len(explanation) - 1)])

    def _set_rule(self, rule: str) -> None:
        if rule in RULES:
            self._rule = rule

    def _explore(self, client: viser.ClientHandle, on: bool) -> None:
        if on == self._exploring:
            return
        if not on:
            self._stop_exploring()
            if self._step is not None:
                camera.move(client, camera.tool_view(self._step))
            return
        self._start_exploring(client)
        self._explore_anatomy(client)

    def _set_case(self, client: viser.ClientHandle, name: str) -> None:
        if name != HERE and name not in figures.CASES:
            return
        if not self._exploring:
            if name == HERE:
                return
            self._start_exploring(client)
        if name == HERE:
            self._explore_anatomy(client)
            return
        case = figures.CASES[name]
        R, origin = case_pose(self._scene)
        self._surface, x = figures.place(case, R, origin)
        self._case, self._chosen = case, None
        self._probe.show_case(case, R, origin)
        self._place_probe(x)
        self._expect.content = (
            f"<div class='vf-expect' style='{_NOTE}'><b>{name}.</b> {html.escape(case.expect)} "
            "Drag the probe and see.</div>"
        )
        camera.move(client, case_view(R, origin))

    def _start_exploring(self, client: viser.ClientHandle) -> None:
        session = self._context.session
        self._resume = not session.latest().paused
        session.pause()
        self._switch(client, True)
        self._inspect.value = True
        self._exploring = True

    def _explore_anatomy(self, client: viser.ClientHandle) -> None:
        """Place the probe beside the tool, above the anatomy."""
        scene, step = self._scene, self._step
        tip = scene.T_base_start if step is None else step.tip
        radius = 5e-3 if step is None else step.radius
        self._case, self._chosen = None, None
        shown = self._context.source.now()
        subject = at_tool(shown, self._of)
        one = shown.structures[0 if subject is None else subject.number]
        self._surface = one.frozen()
        of = html.escape(f"the surface of {one.own.name}" if scene.structures else "the surface")
        self._probe.show_case(None, np.eye(3), np.zeros(3))
        self._expect.content = (
            f"<div class='vf-expect' style='{_NOTE}'>The loop is paused. Drag the yellow probe "
            f"over {of}: over a face Condition 1 holds, over a ridge 2, in a valley 3.</div>"
        )
        x = beside_tool(self._surface, np.array(tip.translation), radius)
        self._place_probe(x)
        away = camera.DIRECTION * 2.2 * radius / np.sin(camera.FIELD_OF_VIEW / 2.0)
        camera.move(client, camera.View(x + away, x))

    def _stop_exploring(self) -> None:
        self._exploring, self._case, self._chosen = False, None, None
        self._surface = self._scene.surface
        self._expect.content = ""
        if self._resume:
            self._context.client_input.submit(self._context.session.resume)

    def _place_probe(self, x: FloatArray) -> None:
        self._probe_at = x
        self._probe.put(x)

    def _move_probe(self, wxyz: FloatArray, position: FloatArray) -> None:
        try:
            x = pose_from_view(wxyz, position).translation
        except ValueError:
            return
        if self._exploring and float(np.linalg.norm(x)) < MAX_PROBE_DISTANCE:
            self._probe_at = np.array(x)


def beside_tool(surface: vf.Surface, p_tip: FloatArray, radius: float) -> FloatArray:
    """A point (3,) about 1.5 radii beside p_tip (3,), a third of a radius above the surface."""
    side = np.cross([0.0, 0.0, 1.0], camera.DIRECTION)
    spot = p_tip + 1.5 * radius * side / np.linalg.norm(side)
    distance, triangle, point = surface.nearest(spot)
    out = (spot - point) / distance if distance > 1e-9 else surface.normals[triangle]
    if surface.inside(spot):
        out = -out
    return np.asarray(point + radius / 3.0 * out)

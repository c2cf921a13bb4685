"""The right-hand panel: all settings. The session checks their values."""

from __future__ import annotations

import html
import math
import threading
import time
from collections.abc import Callable
from functools import partial
from typing import Any

import viser

import meshes
import robots
import vf
from app.scene.library import Library
from app.scene.moment import Moment
from app.session import Session
from app.settings import DECLARED, Options, number
from app.view import palette, style
from app.view.clients.client_input import ClientInput, Notify
from app.view.clients.escape import EscapeKey
from app.view.controls.fields import NumberField, bind, show
from app.view.controls.help import Help
from app.view.controls.keys import STEPS
from app.view.part import Part
from app.view.source import Source

RADII: dict[str, float | None] = {
    "auto": None,
    "0.5 mm": 0.5e-3,
    "1 mm": 1e-3,
    "2 mm": 2e-3,
    "5 mm (paper)": 5e-3,
}
CUSTOM = "other"

# Order of the first lines of the panel; all other controls follow in the order of creation.
_TITLE_LINE, CLIENTS, BANNER, MARGINS, RESTART, DEVICES, _HELP_LINE = (
    -4.0, -3.0, -2.0, -1.9, -1.75, -1.5, -1.0,
)  # fmt: skip

_TITLE = (
    "<div class='vf-title' style='margin:0 .75em .4em;font-size:12.5px;line-height:1.35;"
    "color:var(--vf-ink)'>Drag the tool, or the gizmo (the proxy), into the bone: the tool follows "
    "until the fixture’s planes stop it.</div>"
)
_NOTE = "margin:0 .75em .3em;font-size:11.5px;line-height:1.3;color:var(--vf-faint)"


class Panel(Part):
    """The right-hand panel; `sync` shows the values in force."""

    def __init__(
        self,
        server: viser.ViserServer,
        session: Session,
        client_input: ClientInput,
        notify: Notify,
        escape: EscapeKey,
        views: Callable[[], object],
        source: Source,
        library: Library,
    ) -> None:
        """`views` adds the folder "View"; it is called when that is next in the panel."""
        self._gui = server.gui
        self._server = server
        self._session = session
        self._input = client_input
        self._notify = notify
        self._source = source
        self._library = library
        self._settings: list[Any] = []  # controls of options, disabled during a replay
        self._groups: list[Any] = []  # button groups, hidden then: viser cannot disable them
        self._fields: list[NumberField] = []
        self._note: str | None = None  # as shown; None: something else is
        self._autopilot_asked = 0.0  # monotonic time [s]
        self._gui.add_html(style.sheet() + _TITLE, order=_TITLE_LINE)
        Help(server, client_input, escape, _HELP_LINE)
        self._drive_controls()
        self._fixture_controls()
        self._scene_controls()
        views()
        self._teleop_controls()
        self.sync()

    def read_out(self, shown: Moment) -> None:
        self.sync()

    def sync(self) -> None:
        """Update every control that differs from the value in force; disable them in a replay."""
        live, shown = self._source.live, self._shown()
        options, telemetry = shown.options, shown.telemetry
        building = self._session.work.going
        for control in self._settings:
            control.disabled = not live or (building and control in (self._mesh, self._robot))
        for group in self._groups:
            group.visible = live
        show(self._rule, options.rule)
        self._rule_help.content = _note(palette.RULE_HELP[options.rule], lines=2)
        show(self._radius_preset, _preset(options.radius))
        show(self._guard, options.guard)
        self._guard.disabled = options.rule != "certified" or not live
        self._guard_help.content = _note(guard_help(options), lines=1)
        self._radius.disabled = options.radius is None or not live
        for field in self._fields:
            field.sync()
        if time.monotonic() > self._autopilot_asked + 0.5:  # else the loop may not have seen it
            show(self._autopilot, telemetry.autopilot)
        show(self._clutch, shown.clutched)
        show(self._lock, options.lock_orientation)
        if building:
            return
        scene = shown.scene
        if live:
            self._library.note(self._session.options)
        known = dict.fromkeys([*meshes.catalogue(), *self._library.names(), scene.mesh_name])
        if tuple(known) != tuple(self._mesh.options):
            self._mesh.options = tuple(known)
        show(self._mesh, scene.mesh_name)
        show(self._robot, scene.robot)
        note = _note(" ".join((_about(scene.mesh_name), *scene.notes)).strip(), lines=3)
        if note != self._note:
            self._note = note
            self._scene_note.content = note

    def _shown(self) -> Moment:
        """The newest state of the session, or the replay's moment that was drawn last."""
        return self._source.now() if self._source.live else self._source.shown

    def _drive_controls(self) -> None:
        session = self._session
        self._buttons(
            "Loop",
            "Key P pauses and runs.",
            {"Run": session.resume, "Pause": session.pause},
        )
        self._buttons(
            "Step, ticks",
            "Pauses and does so many ticks. Key N does one, with Shift 10, with Alt 100.",
            {str(n): partial(session.single_step, n) for n in STEPS.values()},
        )
        self._buttons(
            "Proxy",
            "Recall puts the gizmo back onto the tool; reset also puts the tool to its start.",
            {"Recall to tool": session.recall, "Reset": session.reset},
        )
        self._autopilot = self._gui.add_checkbox(
            "Autopilot",
            False,
            hint="A scripted proxy pushes into the surface of the mesh and slides over it. Grab "
            "the gizmo to take over.",
        )
        self._bind(self._autopilot, self._take_autopilot)

    def _fixture_controls(self) -> None:
        session = self._session
        with self._gui.add_folder("Fixture"):
            self._rule = self._gui.add_dropdown(
                "Rule",
                tuple(vf.RULES),
                initial_value=session.options.rule,
                hint=DECLARED["rule"].about,
            )
            self._rule_help = self._gui.add_html("")
            self._guard = self._gui.add_dropdown(
                "Guard",
                vf.GUARDS,
                initial_value=session.options.guard,
                hint=DECLARED["guard"].about,
            )
            self._guard_help = self._gui.add_html("")
            self._radius_preset = self._gui.add_dropdown(
                "Motion sphere",
                (*RADII, CUSTOM),
                initial_value=_preset(session.options.radius),
                hint="How far one tick may move the tool; triangles beyond it are not asked. "
                "Auto: the arm's highest tip speed times the tick.",
            )
            self._radius = self._number("Radius", "radius", 0.05)
            self._number("Tip radius", "tip_radius", 0.1)
            self._number("Standoff", "standoff", 5.0)
            self._number("Approach limit", "approach", 5.0)
            self._number("Trocar zone", "trocar", 1.0)
        self._bind(self._rule, lambda value: session.set(rule=str(value)))
        self._bind(self._guard, lambda value: session.set(guard=str(value)))
        self._bind(self._radius_preset, self._take_preset)

    def _scene_controls(self) -> None:
        scene = self._session.scene
        known = tuple(meshes.catalogue())
        if scene.mesh_name not in known:
            known = (*known, scene.mesh_name)
        with self._gui.add_folder("Scene"):
            self._mesh = self._gui.add_dropdown("Mesh", known, initial_value=scene.mesh_name)
            self._robot = self._gui.add_dropdown(
                "Robot", tuple(robots.names()), initial_value=scene.robot
            )
            self._scene_note = self._gui.add_html("")
        self._settings += [self._mesh, self._robot]

        # The value is read here, since `sync` may reset the control before the change has begun.
        @self._mesh.on_update
        async def _mesh(event: viser.GuiEvent[Any]) -> None:
            if event.client is not None:
                name = str(event.target.value)
                self._begin_change(event.client, self._library.settings(name) or {"mesh": name})

        @self._robot.on_update
        async def _robot(event: viser.GuiEvent[Any]) -> None:
            if event.client is not None:
                self._begin_change(event.client, {"robot": str(event.target.value)})

    def _teleop_controls(self) -> None:
        session = self._session
        with self._gui.add_folder("Teleoperation", expand_by_default=False):
            self._number("Scale", "scale", 0.05)
            self._clutch = self._gui.add_checkbox(
                "Clutch", False, hint="Pressed: the handle moves alone, the tool holds."
            )
            self._lock = self._gui.add_checkbox(
                "Lock orientation",
                session.options.lock_orientation,
                hint=DECLARED["lock_orientation"].about,
            )
            self._number("Speed", "tip_speed", 5.0)
            self._number("Stiffness", "force_gain", 10.0)
        self._bind(self._clutch, lambda value: session.clutch(bool(value)))
        self._bind(self._lock, lambda value: session.set(lock_orientation=bool(value)))

    def _buttons(self, label: str, hint: str, orders: dict[str, Callable[[], None]]) -> None:
        group = self._gui.add_button_group(label, tuple(orders), hint=hint)
        self._groups.append(group)

        @group.on_click
        async def _clicked(event: viser.GuiEvent[Any]) -> None:
            order = orders.get(str(event.target.value))
            if order is not None:
                self._input.submit(lambda _client: order(), event.client)

    def _number(self, label: str, name: str, step: float) -> viser.GuiNumberHandle[float]:
        """A field for a number option; `step` in the unit on the page."""
        kind = number(name)

        def shown() -> float | None:
            value = getattr(self._shown().options, name)
            return None if value is None else value * kind.shown

        value = shown()
        limits = (kind.low * kind.shown, kind.high * kind.shown)
        control = self._gui.add_number(
            f"{label} [{kind.unit}]" if kind.unit else label,
            float(5e-3 * kind.shown if value is None else value),
            min=limits[0],
            max=limits[1],
            step=step,
            hint=DECLARED[name].about,
        )
        self._settings.append(control)
        self._fields.append(
            NumberField(
                control,
                limits,
                self._input,
                self._notify,
                lambda typed: self._session.set(**{name: typed / kind.shown}),
                shown,
            )
        )
        return control

    def _bind(self, control: Any, take: Callable[[Any], object]) -> None:
        """Pass a control's new value to `take`, then show the value in force."""
        self._settings.append(control)
        bind(control, self._input, self._notify, take, self.sync)

    def _take_autopilot(self, value: object) -> None:
        self._autopilot_asked = time.monotonic()
        self._session.set_autopilot(bool(value))

    def _take_preset(self, value: object) -> None:
        if value in RADII:
            self._session.set(radius=RADII[str(value)])
        elif value != CUSTOM:
            raise ValueError(f"no such preset: {value!r}; choose one of {', '.join(RADII)}")
        elif self._session.options.radius is None:
            self._session.set(radius=float(self._radius.value) * 1e-3)

    def _begin_change(self, client: viser.ClientHandle, wanted: dict[str, Any]) -> None:
        """Change mesh or robot on a thread of its own."""
        threading.Thread(
            target=self._change, args=(client, wanted), name="change", daemon=True
        ).start()

    def _change(self, client: viser.ClientHandle, wanted: dict[str, Any]) -> None:
        try:
            with self._session.work.begin() as stop:
                self._mesh.disabled = self._robot.disabled = True
                self._note = None
                self._session.change(**wanted, progress=self._progress, stop=stop)
        except Exception as error:
            # The reader of a user's file may raise anything; the old scene stays.
            self._notify(client, f"Not changed: {error}")
        finally:
            try:
                self.sync()
            except RuntimeError:
                if not self._server.get_event_loop().is_closed():
                    raise  # otherwise: the page is closed

    def _progress(self, text: str) -> None:
        self._scene_note.content = (
            f"<div style='{_NOTE};height:3.9em;color:{palette.css(palette.BLUE)}'>"
            f"{html.escape(text)} …</div>"
        )


def guard_help(options: Options) -> str:
    """What is guarded, in one sentence."""
    if options.rule == "off":
        return palette.NO_GUARD
    return palette.GUARD_HELP[options.guard] if options.rule == "certified" else palette.TIP_ALONE


def _preset(radius: float | None) -> str:
    for name, value in RADII.items():
        if radius == value or (radius and value and math.isclose(radius, value, rel_tol=1e-6)):
            return name
    return CUSTOM


def _note(text: str, lines: int) -> str:
    """A text in a box of fixed height, so that the controls below keep their place."""
    height = f"height:{1.3 * lines:g}em;overflow-y:auto"
    return f"<div style='{_NOTE};{height}'>{html.escape(text)}</div>"


def _about(mesh_name: str) -> str:
    entry = meshes.catalogue().get(mesh_name)
    return entry.about if entry is not None else ""

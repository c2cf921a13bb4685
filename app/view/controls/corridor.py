"""Folder "Corridor": the planned path, the walls along it, and their distance."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin
import viser
from numpy.typing import NDArray

from app.control.plant import corridor
from app.scene.moment import Moment, placed, seen_from
from app.scene.scene import DEFAULT_WIDTH, Scene
from app.settings import number
from app.view import palette
from app.view.context import PageContext
from app.view.controls.fields import NumberField, show
from app.view.drawing.nodes import place
from app.view.part import Clients, Part
from app.view.units import to_buffer, to_view

HALF_HEIGHT = 5e-3  # of the drawn walls [m]; the corridor itself is unbounded
BEYOND = 3e-3  # length of the drawn walls beyond the path's ends [m]


class CorridorControl(Part):
    """Switch and width of the corridor; hidden in scenes without a planned path."""

    def __init__(self, context: PageContext) -> None:
        self._session, self._input, self._notify = (
            context.session,
            context.client_input,
            context.notify,
        )
        self._source = context.source
        self._api = context.server.scene
        self._root = context.server.scene.add_frame("/corridor", show_axes=False)
        self._drawn: tuple[int, float | None] | None = None
        self._name = context.labels.add("/corridor/name", "planned cut", anchor="top-left")
        self._end = 0  # end of the path with the label
        kind = number("corridor")
        low, high = kind.low * kind.shown, kind.high * kind.shown
        with context.server.gui.add_folder("Corridor", expand_by_default=False) as self._folder:
            self._on = context.server.gui.add_checkbox(
                "Stay by the path", False, hint="The tool may leave the planned path only so far."
            )
            self._width = context.server.gui.add_number(
                "Width ± [mm]", DEFAULT_WIDTH * 1e3, min=low, max=high, step=0.1
            )
        self._field = NumberField(
            self._width, (low, high), self._input, self._notify, self._take, self._in_force
        )
        self._on.on_update(self._switched)

    def set_scene(self, scene: Scene) -> None:
        self._folder.visible = scene.planned_path is not None
        self._drawn = None
        self._name.visible = False
        place(self._root, None)

    def frame(self, shown: Moment, clients: Clients) -> None:
        scene, width = shown.scene, shown.options.corridor
        self._draw_name(scene, shown.tip.translation, shown.pose(0))
        if shown.moves:
            place(self._root, shown.pose(0))  # it lies on the mesh
        if self._drawn == (scene.version, width):
            return
        self._drawn = (scene.version, width)
        path = scene.planned_path
        lines = np.zeros((1, 2, 3)) if path is None else np.stack([path[:-1], path[1:]], axis=1)
        self._api.add_line_segments(
            "/corridor/path",
            points=to_buffer(lines),
            colors=palette.CORRIDOR,
            thickness=3.0,
            thickness_units="screen",
            visible=path is not None,
        )
        walls = None
        if path is not None and width is not None:
            walls = corridor(scene.surface, path, width).ribbons(HALF_HEIGHT, BEYOND)
        for side, name in enumerate(("left", "right")):
            self._draw_wall(f"/corridor/{name}", None if walls is None else walls[side])

    def read_out(self, shown: Moment) -> None:
        live = self._source.live
        self._on.disabled = self._width.disabled = not live
        show(self._on, shown.options.corridor is not None)
        self._field.sync()

    def _in_force(self) -> float | None:
        width = self._source.shown.options.corridor
        return None if width is None else width * 1e3

    async def _switched(self, event: viser.GuiEvent[Any]) -> None:
        if event.client is not None:  # None: set by this program
            self._input.submit(self._switch, event.client, bool(event.target.value))

    def _switch(self, client: viser.ClientHandle, on: bool) -> None:
        try:
            self._session.set(corridor=float(self._width.value) * 1e-3 if on else None)
        except ValueError as error:
            self._notify(client, f"{error}")

    def _take(self, width: float) -> None:
        """Set the width [mm], if the corridor is on."""
        if self._session.options.corridor is not None:
            self._session.set(corridor=width * 1e-3)

    def _draw_name(self, scene: Scene, p_tip: NDArray[np.float64], pose: pin.SE3 | None) -> None:
        """Place the label at the end of the path farther from the tip and its labels."""
        path = scene.planned_path
        self._name.visible = path is not None
        if path is not None:
            ends = path[[0, -1]]
            self._end = far_end(ends, seen_from(pose, p_tip), self._end)
            self._name.position = to_view(placed(pose, ends[self._end]))

    def _draw_wall(self, name: str, corners: NDArray[np.float64] | None) -> None:
        visible = corners is not None
        quads = np.zeros((1, 4, 3)) if corners is None else corners
        halves = np.array([[0, 1, 2], [0, 2, 3]], dtype=np.uint32)
        faces = (4 * np.arange(len(quads), dtype=np.uint32)[:, None, None] + halves).reshape(-1, 3)
        self._api.add_mesh_simple(
            name,
            vertices=to_buffer(quads.reshape(-1, 3)),
            faces=faces,
            color=palette.CORRIDOR,
            opacity=0.25,
            side="double",
            cast_shadow=False,
            receive_shadow=False,
            visible=visible,
        )


def far_end(ends: NDArray[np.float64], p_tip: NDArray[np.float64], last: int) -> int:
    """Index of the end (2, 3) farther from the tip (3,): another than `last` if farther by 20 %."""
    first, second = np.linalg.norm(ends - p_tip, axis=1)
    return int(second > 1.2 * first) if last == 0 else int(first <= 1.2 * second)

"""Layer: the motion sphere, the planes of a tick, and the triangles that gave them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pinocchio as pin
import viser
from numpy.typing import NDArray

import vf
from app.scene.moment import Moment, placed
from app.view import palette
from app.view.drawing import nodes
from app.view.drawing.labels import Labels
from app.view.part import Clients, Part
from app.view.units import to_buffer, to_view, turn_z_to
from robots import Capsule

FloatArray = NDArray[np.float64]
Triangles = tuple[FloatArray, NDArray[np.uint32]]  # vertices (n, 3), faces (m, 3)

MAX_PLANES = 128  # drawn; rule "all" can make a thousand
MAX_DISCS = 12  # only the nearest planes have a disc and an arrow, the others a rim
# Opacity of the discs, and while the inspector draws below them.
IDLE_OPACITY = (0.3, 0.1)
ACTIVE_OPACITY = (0.65, 0.3)
BLOCKING_LENGTH = 0.5  # of the arrow of the plane that pushes most, in radii of its disc
CONTACT = (0.0015, 0.008)  # smallest and largest radius of the disc at a part of the tool [m]
MAX_PARTS = 8  # names at the planes of so many parts
MIN_PUSH = 1e-7  # a plane is active if it pushed the tip back by more in this tick [m]


class FixtureDrawing(Part):
    """Draws planes as discs, coloured by rule: those of the tip inside the motion sphere, those of
    another part of the instrument where they touch its capsule, with the part's name.

    The saturation of an active plane shows its share of the push; the plane that pushes most has a
    thick ring. All planes are instances of four batches of constant length, as the browser rebuilds
    a batch whose length or opacity changes; an unused instance has scale 0.
    """

    def __init__(self, api: viser.SceneApi, labels: Labels, root: str = "/fixture") -> None:
        """Make the nodes under `root`, invisible until the first `update`."""
        self._sphere = api.add_icosphere(
            f"{root}/sphere",
            radius=1.0,
            color=palette.SPHERE,
            subdivisions=10,
            opacity=0.2,
            # Translucent meshes write depth, so the near half would hide the discs.
            side="back",
            cast_shadow=False,
            receive_shadow=False,
            visible=False,
        )
        disc, rim = _disc(), _rim()
        self._idle_discs = _batch(api, f"{root}/discs", disc, opacity=IDLE_OPACITY[0])
        self._active_discs = _batch(api, f"{root}/discs_active", disc, opacity=ACTIVE_OPACITY[0])
        self._rims = _batch(api, f"{root}/rims", rim)
        self._normals = _batch(api, f"{root}/normals", _arrow())
        # Of the plane that pushes most: a thick ring, a large arrow, a label.
        self._blocking = [
            nodes.mesh(
                api, f"{root}/blocking_{name}", palette.BLOCKING, vertices=shape[0], faces=shape[1]
            )
            for name, shape in (
                ("ring", _rim(inner=0.93)),
                ("arrow", _arrow(BLOCKING_LENGTH, thickness=2.2)),
            )
        ]
        self._blocks = labels.add(f"{root}/blocks", anchor="bottom-left")
        self._names = [
            labels.add(f"{root}/part{k}", anchor="center-right") for k in range(MAX_PARTS)
        ]
        self._triangles = {
            rule: nodes.mesh(api, f"{root}/triangles_{rule.name.lower()}", look.color)
            for rule, look in palette.LOOKS.items()
        }
        # The triangles are shaded; their unshaded edges have the legend's colours.
        self._edges = nodes.lines(api, f"{root}/edges", 2.5, count=3 * MAX_PLANES)
        self.show_sphere = True
        self.show_planes = True
        self.show_normals = True
        self.show_triangles = True
        self.suppressed = False
        """Draw nothing: the inspector's probe is shown instead."""
        self.inspected = False
        """The inspector draws the triangles: draw none, and paler discs."""

    def frame(self, shown: Moment, clients: Clients) -> None:
        step = shown.telemetry.step
        if step is not None:
            p_tip = np.asarray(step.tip.translation)
            scene = shown.scene
            around = shown.guarded
            self.draw(
                p_tip, step.radius, step.planes, step.multipliers,
                [one.guards for one in around], scene.arm.capsules,
                [str(one.own.name) for one in around] if scene.structures else (),
                [one.believed for one in around],
            )  # fmt: skip

    def draw(
        self,
        p_tip: FloatArray,
        radius: float,
        planes: vf.Planes,
        multipliers: FloatArray,
        surfaces: Sequence[vf.Surface],
        capsules: Sequence[Capsule] = (),
        names: Sequence[str] = (),
        poses: Sequence[pin.SE3 | None] = (),
    ) -> None:
        """Draw planes around p_tip (3,), which they pushed back by multipliers (m,) [m].

        Args:
            surfaces: those that the planes are of, by fixture.
            capsules: those of the arm; without them all planes are the tip's.
            names: of the surfaces, if there are several.
            poses: of the surfaces, as the guard believes; None: it rests. Empty: all do.
        """
        self._sphere.visible = self.show_sphere and not self.suppressed
        if self._sphere.visible:
            self._sphere.position = to_view(p_tip)
            self._sphere.scale = float(to_view(radius))
        chosen = chosen_planes(planes, p_tip, radius)
        self._draw_planes(p_tip, radius, planes, multipliers, chosen, capsules, names)
        self._draw_triangles(radius, planes, surfaces, chosen, poses)

    def hide(self) -> None:
        """Hide everything until the next `draw`."""
        for batch in (self._idle_discs, self._active_discs, self._rims, self._normals):
            batch.visible = False
        for node in (self._edges, self._sphere, *self._blocking, *self._triangles.values()):
            node.visible = False
        for label in (self._blocks, *self._names):
            label.visible = False

    def _draw_planes(
        self,
        p_tip: FloatArray,
        radius: float,
        planes: vf.Planes,
        multipliers: FloatArray,
        chosen: NDArray[np.intp],
        capsules: Sequence[Capsule],
        names: Sequence[str],
    ) -> None:
        for label in self._names:
            label.visible = False
        any_plane = len(chosen) > 0 and not self.suppressed
        for batch in (self._idle_discs, self._active_discs, self._rims):
            batch.visible = self.show_planes and any_plane
        self._normals.visible = self.show_normals and any_plane
        strongest = float(multipliers[chosen].max(initial=0.0))
        blocks = self.show_planes and any_plane and strongest > MIN_PUSH
        self._blocks.visible = blocks
        for node in self._blocking:
            node.visible = blocks
        if not any_plane:
            return
        for batch, opacities in (
            (self._idle_discs, IDLE_OPACITY),
            (self._active_discs, ACTIVE_OPACITY),
        ):
            if batch.opacity != opacities[self.inspected]:
                batch.opacity = opacities[self.inspected]
        normals = planes.normals[chosen]
        centres, radii = discs(normals, planes.offsets[chosen], p_tip, radius)
        parts = _touch(planes, chosen, capsules, centres, radii)
        pushes = multipliers[chosen]
        active = pushes > MIN_PUSH
        rank = np.argsort(np.argsort(np.abs(planes.slack(p_tip)[chosen]), kind="stable"))
        near = (rank < MAX_DISCS) | active | (parts >= 0)
        wxyzs, positions = _padded(turn_z_to(normals)), _padded(to_view(centres))
        # Off the centre of the disc, where the tool would hide the arrow.
        feet = _padded(to_view(centres + 0.8 * radii[:, None] * nodes.towards_viewer(normals)))
        looks = [palette.LOOKS[vf.Rule(rule)].color for rule in planes.rules[chosen]]
        if strongest > MIN_PUSH:
            looks = [
                palette.tinted(color, push / strongest) if pushes_back else color
                for color, push, pushes_back in zip(looks, pushes, active, strict=True)
            ]
        colors = palette.linear(_padded(np.array(looks)).astype(np.uint8))
        scales = to_view(radii)
        for batch, place, scale in (
            (self._idle_discs, positions, np.where(near & ~active, scales, 0.0)),
            (self._active_discs, positions, np.where(active, scales, 0.0)),
            (self._rims, positions, scales),
            (self._normals, feet, np.where(near, to_view(radius), 0.0)),
        ):
            batch.batched_wxyzs = wxyzs
            batch.batched_positions = place
            batch.batched_scales = _padded(scale)
            batch.batched_colors = colors
        if blocks:
            most = int(pushes.argmax())
            # Slightly above the plane's own rim; the arrow clear of the tool.
            ring = centres[most] + 0.015 * radius * normals[most]
            foot = ring + 0.8 * radii[most] * nodes.towards_viewer(normals[most][None])[0]
            for node, place in zip(self._blocking, (ring, foot), strict=True):
                node.wxyz = wxyzs[most]
                node.position = to_view(place)
                node.scale = float(scales[most])
            self._blocks.position = to_view(foot + BLOCKING_LENGTH * radii[most] * normals[most])
            who = capsules[parts[most]].name + " " if parts[most] >= 0 else ""
            fixture = fixture_of(planes, int(chosen[most]))
            at = f" at {names[fixture]}" if fixture < len(names) else ""
            self._blocks.text = f"{who}blocks{at}: takes {1e3 * strongest:.2g} mm off each step"
        if self.show_planes:
            self._name_parts(capsules, parts, pushes, centres)

    def _name_parts(
        self,
        capsules: Sequence[Capsule],
        parts: NDArray[np.int64],
        pushes: FloatArray,
        centres: FloatArray,
    ) -> None:
        """The name of each part at the one of its planes that pushes most."""
        for label, k in zip(self._names, np.unique(parts[parts >= 0]).tolist(), strict=False):
            mine = np.flatnonzero(parts == k)
            label.text = capsules[k].name
            label.position = to_view(centres[mine[pushes[mine].argmax()]])
            label.visible = True

    def _draw_triangles(
        self,
        radius: float,
        planes: vf.Planes,
        surfaces: Sequence[vf.Surface],
        chosen: NDArray[np.intp],
        poses: Sequence[pin.SE3 | None],
    ) -> None:
        chosen, corners = _triangles(planes, surfaces, chosen, poses)
        shown = self.show_triangles and not (self.suppressed or self.inspected)
        lift = 0.01 * radius  # along the normals, clear of the mesh's own triangles [m]
        normals = planes.normals[chosen][:, None, :]
        for rule, node in self._triangles.items():
            mine = planes.rules[chosen] == rule
            visible = shown and bool(mine.any())
            if visible:
                lifted = corners[mine] + lift * normals[mine]
                node.vertices = to_buffer(lifted.reshape(-1, 3))
                node.faces = np.arange(3 * len(lifted), dtype=np.uint32).reshape(-1, 3)
            node.visible = visible
        self._edges.visible = shown and len(chosen) > 0
        if self._edges.visible:
            lifted = corners + 1.5 * lift * normals
            ends = np.stack([lifted, np.roll(lifted, -1, axis=1)], axis=2).reshape(-1, 2, 3)
            unused = np.tile(ends[-1:, :1], (3 * MAX_PLANES - len(ends), 2, 1))  # of zero length
            self._edges.points = to_buffer(np.concatenate([ends, unused]))
            looks = [palette.LOOKS[vf.Rule(rule)].color for rule in planes.rules[chosen]]
            colors = np.zeros((3 * MAX_PLANES, 2, 3), dtype=np.uint8)
            colors[: len(ends)] = np.repeat(np.array(looks, dtype=np.uint8), 3, axis=0)[:, None, :]
            self._edges.colors = palette.linear(colors)


def fixture_of(planes: vf.Planes, k: int) -> int:
    """Number of the fixture that a plane is of."""
    return 0 if planes.fixtures is None else int(planes.fixtures[k])


def _triangles(
    planes: vf.Planes,
    surfaces: Sequence[vf.Surface],
    chosen: NDArray[np.intp],
    poses: Sequence[pin.SE3 | None] = (),
) -> tuple[NDArray[np.intp], FloatArray]:
    """Those of the chosen planes that are of triangles, and their corners (k, 3, 3).

    The planes may be of the tick before a structure was switched on or off.
    """
    rows, corners = [], []
    for k in chosen:
        fixture, triangle = fixture_of(planes, k), int(planes.triangles[k])
        if fixture < len(surfaces) and 0 <= triangle < len(surfaces[fixture].faces):
            rows.append(k)
            shape = surfaces[fixture].vertices[surfaces[fixture].faces[triangle]]
            corners.append(placed(poses[fixture] if poses else None, shape))
    return np.array(rows, dtype=np.intp), np.array(corners).reshape(-1, 3, 3)


def chosen_planes(planes: vf.Planes, p_tip: FloatArray, radius: float) -> NDArray[np.intp]:
    """Indices of the planes to draw: the nearest `MAX_PLANES` that cut the sphere.

    And all those of other parts of the instrument than the tip, as if they were the nearest.
    """
    slack = planes.slack(p_tip)
    if planes.of_axis is not None:
        slack = np.where(planes.of_axis, 0.0, slack)
    order = np.argsort(np.abs(slack), kind="stable")
    return np.sort(order[np.abs(slack[order]) < radius][:MAX_PLANES])


def discs(
    normals: FloatArray, offsets: FloatArray, centre: FloatArray, radius: float
) -> tuple[FloatArray, FloatArray]:
    """Discs of planes n·y = o (m of them) in a ball: centres (m, 3) and radii (m,) [m]."""
    height = offsets - normals @ centre
    centres = centre + height[:, None] * normals
    return centres, np.sqrt(np.maximum(radius**2 - height**2, 0.0))


def _touch(
    planes: vf.Planes,
    chosen: NDArray[np.intp],
    capsules: Sequence[Capsule],
    centres: FloatArray,
    radii: FloatArray,
) -> NDArray[np.int64]:
    """The part that each plane holds (k,), −1: the tip; moves the discs of parts to their capsules.

    A plane holds the axis, at a distance of the capsule's radius from what can be touched.
    """
    parts = np.full(len(chosen), -1)
    if planes.of_axis is None or planes.capsules is None or not len(capsules):
        return parts
    for row, k in enumerate(chosen):
        if planes.of_axis[k]:
            part = int(planes.capsules[k])
            thickness, normal, foot = capsules[part].radius, planes.normals[k], planes.points[k]
            parts[row] = part
            centres[row] = foot + (planes.offsets[k] - thickness - normal @ foot) * normal
            radii[row] = min(max(thickness, CONTACT[0]), CONTACT[1])
    return parts


def _padded(rows: NDArray[Any]) -> NDArray[np.float32]:
    """Rows padded with zeros to `MAX_PLANES`."""
    out = np.zeros((MAX_PLANES, *rows.shape[1:]), dtype=np.float32)
    out[: len(rows)] = rows
    return out


def _batch(
    api: viser.SceneApi, name: str, shape: Triangles, opacity: float | None = None
) -> viser.BatchedMeshHandle:
    return api.add_batched_meshes_simple(
        name,
        *shape,
        batched_wxyzs=np.tile([1.0, 0.0, 0.0, 0.0], (MAX_PLANES, 1)),
        batched_positions=np.zeros((MAX_PLANES, 3)),
        batched_scales=np.zeros(MAX_PLANES, dtype=np.float32),
        batched_colors=np.zeros((MAX_PLANES, 3), dtype=np.uint8),
        opacity=opacity,
        side="double",
        lod="off",
        cast_shadow=False,
        receive_shadow=False,
        visible=False,
    )


def _circle(segments: int) -> FloatArray:
    angle = np.linspace(0.0, 2.0 * np.pi, segments, endpoint=False)
    return np.stack([np.cos(angle), np.sin(angle), np.zeros(segments)], axis=1)


def _disc(segments: int = 40) -> Triangles:
    """A unit disc in the plane z = 0."""
    vertices = np.vstack([np.zeros((1, 3)), _circle(segments)])
    k = np.arange(segments)
    faces = np.stack([np.zeros_like(k), 1 + k, 1 + (k + 1) % segments], axis=1)
    return vertices, faces.astype(np.uint32)


def _rim(segments: int = 40, inner: float = 0.975) -> Triangles:
    """The rim of the unit disc, from the radius `inner` outwards."""
    vertices = np.vstack([_circle(segments), inner * _circle(segments)])
    k = np.arange(segments)
    following = (k + 1) % segments
    out = np.stack([k, following, k + segments], axis=1)
    back = np.stack([following, following + segments, k + segments], axis=1)
    return vertices, np.vstack([out, back]).astype(np.uint32)


def _arrow(length: float = 0.3, segments: int = 12, thickness: float = 1.0) -> Triangles:
    """An arrow along +z from the origin, for a motion sphere of radius 1."""
    around = _circle(segments)
    up = np.array([0.0, 0.0, 1.0])
    shaft, head, waist = 0.01 * thickness, 0.035 * thickness, 0.7 * length
    vertices = np.vstack(
        [shaft * around, shaft * around + waist * up, head * around + waist * up, [length * up]]
    )
    k = np.arange(segments)
    following = (k + 1) % segments
    sides = [
        np.stack([k, following, k + segments], axis=1),
        np.stack([following, following + segments, k + segments], axis=1),
        np.stack([k + segments, following + segments, k + 2 * segments], axis=1),
        np.stack([following + segments, following + 2 * segments, k + 2 * segments], axis=1),
        np.stack(
            [k + 2 * segments, following + 2 * segments, np.full_like(k, 3 * segments)], axis=1
        ),
    ]
    return vertices, np.vstack(sides).astype(np.uint32)

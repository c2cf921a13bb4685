"""Layer: the motion sphere, the planes that guard the tool, and the triangles they came from."""

from __future__ import annotations

from typing import Any

import numpy as np
import viser
from numpy.typing import NDArray

import vf
from app.view import palette
from app.view.units import to_buffer, to_view, turn_z_to

FloatArray = NDArray[np.float64]

MOST_PLANES = 200  # drawn at once; rule "all" can make a thousand
SLOTS = 16  # the batches grow by this many planes, so that their size seldom changes
LEANING = 1e-7  # a plane that pushed the tip back by more in this tick holds the tool [m]


class FixtureDrawing:
    """Planes are drawn as their discs inside the motion sphere, coloured by the rule."""

    def __init__(self, api: viser.SceneApi) -> None:
        none = np.zeros((SLOTS, 3))
        still = np.tile([1.0, 0.0, 0.0, 0.0], (SLOTS, 1))
        self._sphere = api.add_icosphere(
            "/fixture/sphere",
            radius=1.0,
            color=palette.SPHERE,
            subdivisions=4,
            opacity=0.22,
            cast_shadow=False,
            receive_shadow=False,
        )
        disc_vertices, disc_faces = _disc()
        ring_vertices, ring_faces = _ring()
        self._discs = api.add_batched_meshes_simple(
            "/fixture/discs",
            disc_vertices,
            disc_faces,
            batched_wxyzs=still,
            batched_positions=none,
            batched_scales=np.zeros(SLOTS, dtype=np.float32),
            batched_colors=np.zeros((SLOTS, 3), dtype=np.uint8),
            batched_opacities=np.ones(SLOTS, dtype=np.float32),
            opacity=0.55,
            side="double",
            lod="off",
            cast_shadow=False,
            receive_shadow=False,
            visible=False,
        )
        self._rings = api.add_batched_meshes_simple(
            "/fixture/rings",
            ring_vertices,
            ring_faces,
            batched_wxyzs=still,
            batched_positions=none,
            batched_scales=np.zeros(SLOTS, dtype=np.float32),
            batched_colors=np.zeros((SLOTS, 3), dtype=np.uint8),
            side="double",
            lod="off",
            cast_shadow=False,
            receive_shadow=False,
            visible=False,
        )
        self._normals = api.add_arrows(
            "/fixture/normals",
            points=np.zeros((1, 2, 3), dtype=np.float32),
            colors=np.zeros((1, 3), dtype=np.uint8),
            visible=False,
        )
        self._triangles = {
            rule: api.add_mesh_simple(
                f"/fixture/triangles_{rule.name.lower()}",
                vertices=np.zeros((3, 3), dtype=np.float32),
                faces=np.array([[0, 1, 2]], dtype=np.uint32),
                color=look.color,
                side="double",
                cast_shadow=False,
                receive_shadow=False,
                visible=False,
            )
            for rule, look in palette.LOOKS.items()
        }
        self.show_sphere = True
        self.show_planes = True
        self.show_normals = True
        self.show_triangles = True

    def update(self, step: vf.Step, surface: vf.Surface) -> None:
        """Draw what one tick was constrained by."""
        p_tip = np.asarray(step.tip.translation)
        self._sphere.visible = self.show_sphere
        if self.show_sphere:
            self._sphere.position = to_view(p_tip)
            self._sphere.scale = float(to_view(step.radius))
        chosen = chosen_planes(step, p_tip)
        self._draw_planes(step, p_tip, chosen)
        self._draw_triangles(step, surface, chosen)

    def _draw_planes(self, step: vf.Step, p_tip: FloatArray, chosen: NDArray[np.intp]) -> None:
        planes = step.planes
        normals = planes.normals[chosen]
        centres, radii = discs(normals, planes.offsets[chosen], p_tip, step.radius)
        colors = np.array(
            [palette.LOOKS[vf.Rule(r)].color for r in planes.rules[chosen]], dtype=np.uint8
        ).reshape(-1, 3)
        leaning = step.multipliers[chosen] > LEANING
        any_plane = len(chosen) > 0
        self._discs.visible = self._rings.visible = self.show_planes and any_plane
        self._normals.visible = self.show_normals and any_plane
        if not any_plane:
            return
        if self.show_planes:
            n = -(-len(chosen) // SLOTS) * SLOTS
            wxyzs = _padded(turn_z_to(normals), n)
            positions = _padded(to_view(centres), n)
            scales = _padded(to_view(radii), n)
            for batch in (self._discs, self._rings):
                batch.batched_wxyzs = wxyzs
                batch.batched_positions = positions
                batch.batched_scales = scales
                batch.batched_colors = _padded(colors, n).astype(np.uint8)
            # The planes that hold the tool back stand out.
            self._discs.batched_opacities = _padded(np.where(leaning, 1.0, 0.4), n)
        if self.show_normals:
            thickness = float(to_view(step.radius)) * 0.012
            ends = np.stack([centres, centres + 0.3 * step.radius * normals], axis=1)
            self._normals.shaft_radius = thickness
            self._normals.head_radius = 3.0 * thickness
            self._normals.head_length = 7.0 * thickness
            self._normals.points = to_buffer(ends)
            self._normals.colors = colors

    def _draw_triangles(self, step: vf.Step, surface: vf.Surface, chosen: NDArray[np.intp]) -> None:
        planes = step.planes
        chosen = chosen[planes.triangles[chosen] >= 0]
        lift = 0.01 * step.radius  # towards the tool, clear of the mesh's own triangles [m]
        for rule, node in self._triangles.items():
            mine = chosen[planes.rules[chosen] == rule]
            visible = self.show_triangles and len(mine) > 0
            if visible:
                corners = surface.vertices[surface.faces[planes.triangles[mine]]]  # (k, 3, 3)
                corners = corners + lift * planes.normals[mine][:, None, :]
                node.vertices = to_buffer(corners.reshape(-1, 3))
                node.faces = np.arange(3 * len(mine), dtype=np.uint32).reshape(-1, 3)
            node.visible = visible


def chosen_planes(step: vf.Step, p_tip: FloatArray) -> NDArray[np.intp]:
    """Which planes to draw: those that cut the sphere, the nearest ones if there are too many."""
    slack = step.planes.slack(p_tip)
    order = np.argsort(np.abs(slack), kind="stable")
    return np.sort(order[np.abs(slack[order]) < step.radius][:MOST_PLANES])


def discs(
    normals: FloatArray, offsets: FloatArray, centre: FloatArray, radius: float
) -> tuple[FloatArray, FloatArray]:
    """Where planes n·y = o (m of them) cut a ball: disc centres (m, 3) and radii (m,) [m]."""
    height = offsets - normals @ centre
    centres = centre + height[:, None] * normals
    return centres, np.sqrt(np.maximum(radius**2 - height**2, 0.0))


def _padded(rows: NDArray[Any], n: int) -> NDArray[np.float32]:
    """Rows filled up with zeros to n of them; zero scale hides the instances they stand for."""
    out = np.zeros((n, *rows.shape[1:]), dtype=np.float32)
    out[: len(rows)] = rows
    return out


def _circle(segments: int) -> FloatArray:
    angle = np.linspace(0.0, 2.0 * np.pi, segments, endpoint=False)
    return np.stack([np.cos(angle), np.sin(angle), np.zeros(segments)], axis=1)


def _disc(segments: int = 48) -> tuple[FloatArray, NDArray[np.uint32]]:
    """A unit disc in the plane z = 0."""
    vertices = np.vstack([np.zeros((1, 3)), _circle(segments)])
    k = np.arange(segments)
    faces = np.stack([np.zeros_like(k), 1 + k, 1 + (k + 1) % segments], axis=1)
    return vertices, faces.astype(np.uint32)


def _ring(segments: int = 48, inner: float = 0.975) -> tuple[FloatArray, NDArray[np.uint32]]:
    """The rim of the unit disc."""
    vertices = np.vstack([_circle(segments), inner * _circle(segments)])
    k = np.arange(segments)
    following = (k + 1) % segments
    out = np.stack([k, following, k + segments], axis=1)
    back = np.stack([following, following + segments, k + segments], axis=1)
    return vertices, np.vstack([out, back]).astype(np.uint32)

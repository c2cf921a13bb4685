"""Generated solids: the simple shapes of the catalogue.

Every generator returns ``(vertices, faces)``: ``(n, 3)`` float64 in metres and ``(m, 3)`` int64, a
closed, consistently outward-wound mesh about the origin with its top towards +z. Dimensions are in
millimetres up to :func:`to_metres`. Flat faces are divided into triangles of one to three
millimetres, so that a motion sphere of a millimetre meets edges inside a face too.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import trimesh
from manifold3d import CrossSection, Manifold
from numpy.typing import NDArray

from meshes.content import Arrays

Point2 = tuple[float, float]
Outline = Sequence[Point2] | NDArray[np.float64]


def to_metres(solid: Manifold) -> Arrays:
    """Vertices [m] and faces of a solid drawn in millimetres; the double-precision mesh."""
    mesh = solid.to_mesh64()
    vertices = np.array(mesh.vert_properties[:, :3], dtype=np.float64) * 1e-3  # [mm] -> [m]
    return vertices, np.array(mesh.tri_verts, dtype=np.int64)


def prism(outline: Outline, height: float) -> Manifold:
    """The upright solid [mm] over an anticlockwise outline, centred in z."""
    section = CrossSection([np.asarray(outline, dtype=np.float64)])
    return section.extrude(height).translate((0.0, 0.0, -height / 2))


def cube() -> Arrays:
    """A cube of 40 mm."""
    return to_metres(Manifold.cube((40.0, 40.0, 40.0), True).refine(20))


def sphere() -> Arrays:
    """An icosphere of radius 30 mm (four subdivisions)."""
    ball = trimesh.creation.icosphere(subdivisions=4, radius=0.030)
    return np.array(ball.vertices, dtype=np.float64), np.array(ball.faces, dtype=np.int64)


def cylinder() -> Arrays:
    """An upright cylinder, radius 20 mm, height 40 mm, of 72 sides."""
    solid = Manifold.cylinder(40.0, 20.0, circular_segments=72, center=True)
    return to_metres(solid.refine_to_length(2.0))


def cone() -> Arrays:
    """An upright cone, base radius 20 mm, height 40 mm, of 72 sides, apex up."""
    solid = Manifold.cylinder(40.0, 20.0, 0.0, circular_segments=72, center=True)
    return to_metres(solid.refine_to_length(2.0))


def torus() -> Arrays:
    """A lying ring: 96 sections of 32 sides, R = 30 mm, r = 10 mm."""
    ring = CrossSection.circle(10.0, 32).translate((30.0, 0.0)).revolve(96)
    return to_metres(ring)


def gear() -> Arrays:
    """A lying involute spur gear: 18 teeth of module 4 mm, 20° pressure angle, 15 mm high.

    Flanks are involutes r = r_b √(1 + t²), φ = t − atan t of the base circle r_b, from there to
    the tip circle; below the base circle they run radially to the root circle. Bore ⌀ 14 mm.
    """
    solid = prism(_gear_outline(), 15.0) - Manifold.cylinder(20.0, 7.0, 7.0, 48, True)
    return to_metres(solid.refine_to_length(2.5))


def _gear_outline(teeth: int = 18, module: float = 4.0, angle: float = 20.0) -> list[Point2]:
    """Anticlockwise outline [mm] of an involute gear."""
    alpha = math.radians(angle)
    r_pitch = teeth * module / 2
    r_base = r_pitch * math.cos(alpha)
    r_tip = r_pitch + module
    r_root = r_pitch - 1.25 * module
    # Half the tooth's angle at the base circle, where the involute starts.
    half = math.pi / (2 * teeth) + math.tan(alpha) - alpha
    t_tip = math.sqrt((r_tip / r_base) ** 2 - 1)
    # (radius, angle from the tooth's middle) of the left flank, tip to root.
    flank = [
        (r_base * math.sqrt(1 + t * t), half - (t - math.atan(t)))
        for t in np.linspace(t_tip, 0.0, 6)
    ]
    flank.append((r_root, half))
    tooth = [(r, -phi) for r, phi in reversed(flank)] + flank
    gap = 2 * (math.pi / teeth - half)  # [rad] of root circle between two teeth
    tooth.append((r_root, half + gap / 2))
    pitch = 2 * math.pi / teeth
    return [
        (r * math.cos(phi + k * pitch), r * math.sin(phi + k * pitch))
        for k in range(teeth)
        for r, phi in tooth
    ]


def l_block() -> Arrays:
    """An L of two legs, 40 mm long, 15 mm thick, 30 mm wide: one sharp inner edge along y."""
    outline = [(-20, -20), (20, -20), (20, -5), (-5, -5), (-5, 20), (-20, 20)]
    standing = prism(outline, 30.0).rotate((90.0, 0.0, 0.0))
    return to_metres(standing.refine_to_length(2.0))


def canal_block() -> Arrays:
    """A block, 40 × 40 × 25 mm, with an upright canal of 24 sides, ⌀ 9 mm, through its middle."""
    corner = 4.5 / math.cos(math.pi / 24)
    canal = Manifold.cylinder(40.0, corner, corner, 24, True)
    return to_metres(Manifold.cube((40.0, 40.0, 25.0), True).refine_to_length(2.0) - canal)


def stairs() -> Arrays:
    """Five steps up towards +x, each 10 mm deep and 6 mm high, 40 mm wide."""
    outline: list[Point2] = [(25.0, -15.0), (25.0, 15.0)]
    for step in range(5, 0, -1):
        x, z = 10.0 * (step - 1) - 25.0, 6.0 * step - 15.0
        outline += [(x, z), (x, z - 6.0)]
    standing = prism(outline, 40.0).rotate((90.0, 0.0, 0.0))
    return to_metres(standing.refine_to_length(2.0))


def star_prism() -> Arrays:
    """A lying seven-pointed star, outer radius 40 mm, inner 18 mm, 20 mm high."""
    angles = np.arange(14) * np.pi / 7
    radii = np.where(np.arange(14) % 2 == 0, 40.0, 18.0)
    outline = np.column_stack([radii * np.cos(angles), radii * np.sin(angles)])
    return to_metres(prism(outline, 20.0).refine_to_length(2.0))


def thin_plate() -> Arrays:
    """A lying plate, 100 × 100 × 0.5 mm: thinner than a motion sphere, both sides within it."""
    return to_metres(Manifold.cube((100.0, 100.0, 0.5), True).refine_to_length(2.5))


def saddle_slab() -> Arrays:
    """A lying slab, 96 × 96 × 8 mm, both faces bent to z = 6 sin(2πx/32) sin(2πy/32) [mm]."""

    def bend(points: NDArray[np.float64]) -> NDArray[np.float64]:
        bent = np.array(points)
        wave = 2 * np.pi / 32.0 * points[:, :2]
        bent[:, 2] += 6.0 * np.sin(wave[:, 0]) * np.sin(wave[:, 1])
        return bent

    slab = Manifold.cube((96.0, 96.0, 8.0), True).refine_to_length(2.0)
    return to_metres(slab.warp_batch(bend))


def gyroid() -> Arrays:
    """A ball of radius 25 mm cut from a gyroid solid of 20 mm period: winding channels."""
    k = 2 * math.pi / 20.0

    def solid(x: float, y: float, z: float) -> float:
        x, y, z = k * x, k * y, k * z
        s, c = math.sin, math.cos
        return s(x) * c(y) + s(y) * c(z) + s(z) * c(x)

    box = (-26.0, -26.0, -26.0, 26.0, 26.0, 26.0)
    # The ball is intersected afterwards: as part of the level set its rims would be ragged. The
    # intersection leaves slivers where the two grids nearly meet; collapsing them moves nothing
    # by more than a hundredth of a millimetre.
    ball = Manifold.sphere(25.0, 72)
    return to_metres((Manifold.level_set(solid, box, 2.0) ^ ball).simplify(0.01))

"""A synthetic paediatric skull cap, as in the paper's experiment.

Head axes: x to the right, y to the front, z up, origin in the middle of the head; recipes in
millimetres, results in metres. The outer surface is a super-ellipsoid along unit directions with
bumps and hollows added to its radius (bosses, brow, nose, orbits, temporal fossae) and grooves
pressed into it (the coronal and lambdoid sutures). The inner surface lies 2 mm inside along the
outer normals. The cap is open below and, unless closed, at the anterior fontanelle and (unless
fused) along the sagittal suture. Nothing here is traced from a patient.
"""

from __future__ import annotations

import numpy as np
from manifold3d import CrossSection, Manifold
from numpy.typing import NDArray

from meshes.builtin.shapes import to_metres
from meshes.content import Arrays

COARSE, STANDARD, FINE = 104, 344, 1104
"""Segments round the generating sphere: about 10, 94 and 936 thousand triangles."""

THICKNESS = 2.0  # [mm], as in the paper's phantom

_AXES = np.array([52.0, 68.0, 60.0])  # [mm] half width, length, height
_EXPONENT = 2.2
# Direction (mirrored in x), height [mm], concentration: A exp(κ (d·c − 1)).
_FEATURES = (
    ((0.45, 0.75, 0.50), 2.5, 14.0),  # frontal bosses
    ((0.80, -0.25, 0.55), 4.0, 10.0),  # parietal bosses
    ((0.00, -0.98, 0.10), 4.0, 12.0),  # occiput
    ((0.95, 0.40, -0.15), -4.0, 18.0),  # temporal fossae
    ((0.40, 0.86, -0.32), -15.0, 60.0),  # orbits
    ((0.38, 0.92, -0.04), 3.0, 60.0),  # brows
    ((0.00, 0.96, -0.30), 3.0, 60.0),  # nose
)
_FONTANELLE = np.array([(0.0, 37.0), (-11.0, 24.0), (0.0, 11.5), (11.0, 24.0)])  # [mm] x, y
_CUT_START, _CUT_LENGTH, _CUT_WIDTH = 10.0, 30.0, 0.6  # [mm] y, arc, width
_ABOVE = 200.0  # [mm] height of cutting tools, past the crown


def skull(
    segments: int = STANDARD, *, closed: bool = False, fused: bool = False, precut: bool = False
) -> Arrays:
    """The skull cap: vertices ``(n, 3)`` [m] and outward-wound faces ``(m, 3)``, watertight.

    ``segments`` sets the resolution (multiple of four). ``fused`` keeps the sagittal suture closed
    (craniosynostosis), ``closed`` the fontanelle too: it is then open below alone. ``precut``
    removes a 0.6 mm slot along :func:`planned_cut`.
    """
    ball = Manifold.sphere(1.0, segments)
    bone = ball.warp_batch(_outer) - ball.warp_batch(_inner)
    bone = bone.trim_by_plane((0.0, 0.30, 1.0), -32.0)
    if not closed:
        bone -= CrossSection([_FONTANELLE]).extrude(_ABOVE)
    if not (closed or fused):
        bone -= CrossSection([_suture_outline()]).extrude(_ABOVE)
    if precut:
        y_end = float(_cut_mm()[-1, 1])
        slot = Manifold.cube((_CUT_WIDTH, _CUT_START - y_end, _ABOVE))
        bone -= slot.translate((-_CUT_WIDTH / 2, y_end, 0.0))
    return to_metres(bone)


def outer_points(directions: NDArray[np.float64]) -> NDArray[np.float64]:
    """Points ``(n, 3)`` [m] of the outer surface along directions ``(n, 3)`` from the middle."""
    return _outer(np.asarray(directions, dtype=np.float64)) * 1e-3  # [mm] -> [m]


def endocranium(segments: int = STANDARD) -> Arrays:
    """The solid within the inner surface, openings closed, watertight.

    Vertices ``(n, 3)`` [m] in the skull's axes and outward-wound faces ``(m, 3)``. A tool may cut
    through the bone to this surface, and no farther.
    """
    inner = Manifold.sphere(1.0, segments).warp_batch(_inner)
    return to_metres(inner.trim_by_plane((0.0, 0.30, 1.0), -32.0))


def planned_cut() -> NDArray[np.float64]:
    """The planned sagittal cut: ``(31, 3)`` points [m] on the outer surface, in the skull's axes.

    30 mm of arc in the plane x = 0, from just behind the fontanelle (y = 10 mm) backwards, a point
    a millimetre. The points lie on the smooth surface; chords of the mesh run microns below it.
    """
    return _cut_mm() * 1e-3  # [mm] -> [m]


def _cut_mm() -> NDArray[np.float64]:
    elevation = np.linspace(0.3 * np.pi, 0.8 * np.pi, 20_001)  # from +y over the crown
    directions = np.column_stack([0.0 * elevation, np.cos(elevation), np.sin(elevation)])
    line = _outer(directions)
    arc = np.r_[0.0, np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))]
    start = np.interp(-_CUT_START, -line[:, 1], arc)
    stations = start + np.arange(_CUT_LENGTH + 1)
    return np.column_stack([np.interp(stations, arc, line[:, i]) for i in range(3)])


def _suture_outline() -> NDArray[np.float64]:
    """The open sagittal suture from above [mm]: a wavy ribbon 1.8 mm wide, anticlockwise."""
    y = np.linspace(-22.0, -52.0, 60)
    x = 1.2 * np.sin(2 * np.pi * (y + 22.0) / 9.0)
    return np.column_stack([np.r_[x - 0.9, x[::-1] + 0.9], np.r_[y, y[::-1]]])


def _unit(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def _outer(directions: NDArray[np.float64]) -> NDArray[np.float64]:
    """Points ``(n, 3)`` [mm] of the outer surface along ``directions`` ``(n, 3)``."""
    d = _unit(directions)
    radius = (np.abs(d / _AXES) ** _EXPONENT).sum(axis=1) ** (-1.0 / _EXPONENT)
    for centre, height, kappa in _FEATURES:
        for side in (1.0, -1.0) if centre[0] else (1.0,):
            c = np.array(centre) * (side, 1.0, 1.0)
            radius += height * np.exp(kappa * (d @ (c / np.linalg.norm(c)) - 1.0))
    x, y, z = (radius[:, None] * d).T
    above = 1.0 / (1.0 + np.exp(-(z - 15.0) / 4.0))  # sutures fade out towards the base
    for s in (y - 24.0 + 0.28 * np.abs(x), y + 50.0 - 0.45 * np.abs(x)):  # coronal, lambdoid
        radius -= 0.5 * above * np.exp(-((s / 1.3) ** 2))
    return radius[:, None] * d


def _inner(directions: NDArray[np.float64]) -> NDArray[np.float64]:
    """Points ``(n, 3)`` [mm] one bone thickness inside the outer surface, along its normals."""
    d = _unit(directions)
    # Any direction clearly across d starts the tangent frame.
    across = np.where(np.abs(d[:, 2:]) < 0.9, (0.0, 0.0, 1.0), (1.0, 0.0, 0.0))
    u = _unit(np.cross(across, d))
    v = np.cross(d, u)
    h = 1e-4  # [rad] step of the central differences
    normal = _unit(
        np.cross(_outer(d + h * u) - _outer(d - h * u), _outer(d + h * v) - _outer(d - h * v))
    )
    return _outer(d) - THICKNESS * normal

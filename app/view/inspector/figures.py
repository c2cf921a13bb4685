"""The cases of the paper's Figures 4 and 5, as surfaces of two triangles."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

import vf

FloatArray = NDArray[np.float64]

UNIT = 4e-3  # from the shared edge to the tool [m]
RADIUS = 2.0 * UNIT  # of the motion sphere [m]
LENGTH = 3.0 * UNIT  # of the triangles, perpendicular to the edge [m]
HALF_EDGE = 2.0 * UNIT
T1, T2 = 0, 1
NAMES = {T1: "T1", T2: "T2"}


@dataclass(frozen=True)
class Case:
    """Two triangles with a common edge, described in the plane perpendicular to it.

    Attributes:
        name: of the figure.
        rise: angle from the continuation of T1 up to T2 [°]; negative: convex, a ridge.
        bearing: angle from the continuation of T1 up to the tool, at the edge [°].
        expect: description of the result.
    """

    name: str
    rise: float
    bearing: float
    expect: str


CASES = {
    case.name: case
    for case in (
        Case(
            "Fig. 4 (a)", -60.0, 5.0,
            "Convex; the tool is over T2 and in front of both. T2 gives its face plane (Condition "
            "1). T1’s closest point is on the ridge, T2’s is elsewhere: T1 is passed over.",
        ),
        Case(
            "Fig. 4 (b)", -60.0, -20.0,
            "Convex; over T2 but behind T1’s plane. As in (a): T2 by Condition 1, T1 passed "
            "over, or its plane would lock the tool out of free space.",
        ),
        Case(
            "Fig. 4 (c)", -60.0, 60.0,
            "Convex; over the ridge itself. Both closest points are the same point of the edge: "
            "Condition 2, one plane for both, facing the tool.",
        ),
        Case(
            "Fig. 5 (a)", 60.0, 120.0,
            "Concave; over both faces. Both closest points are inside their faces: two planes by "
            "Condition 1.",
        ),
        Case(
            "Fig. 5 (b)", 40.0, 70.0,
            "Concave; over T2, beyond T1’s edge. T2 by Condition 1. T1’s closest point is on the "
            "valley’s edge: Condition 3 lets its face plane go on beyond it.",
        ),
        Case(
            "Fig. 5 (c)", 60.0, 30.0,
            "Concave; in front of T1 but already behind T2. T1 by Condition 3; T2 is passed over, "
            "the tool is behind it.",
        ),
        Case(
            "Fig. 5 (d)", 130.0, 110.0,
            "Concave and steep; over T1, behind T2, which leans over it. T1 by Condition 1, T2 "
            "passed over.",
        ),
        Case(
            "Fig. 5 (e)", 60.0, -40.0,
            "Concave; behind both. No condition fires and no plane guards: here the paper’s rule "
            "relies on never getting there.",
        ),
    )
}  # fmt: skip


def shape(case: Case) -> tuple[FloatArray, NDArray[np.int64]]:
    """Vertices (4, 3) [m] and faces (2, 3): edge along y through the origin, T1 towards −x."""
    far = LENGTH * _polar(case.rise)
    corners = [[0, -HALF_EDGE, 0], [0, HALF_EDGE, 0], [-LENGTH, 0, 0], far]
    return np.array(corners, dtype=np.float64), np.array([[0, 1, 2], [1, 0, 3]])


def place(case: Case, R: FloatArray, origin: FloatArray) -> tuple[vf.Surface, FloatArray]:
    """Surface and tool position of a case, rotated by R (3, 3) and moved to origin (3,) [m]."""
    vertices, faces = shape(case)
    x = UNIT * _polar(case.bearing)
    return vf.Surface.from_arrays(vertices @ R.T + origin, faces), R @ x + origin


def _polar(degrees: float) -> FloatArray:
    a = np.radians(degrees)
    return np.array([np.cos(a), 0.0, np.sin(a)])

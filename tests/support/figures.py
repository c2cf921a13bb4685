"""The two-triangle cases of the paper's Figures 4 and 5, worked out by hand."""

from __future__ import annotations

import numpy as np

import vf

FACE, RIDGE, VALLEY = vf.Rule.FACE, vf.Rule.RIDGE, vf.Rule.VALLEY

# The two-triangle cases are drawn in the plane y = 0, along the shared edge (the y axis, out of the
# page at O). T1 is the half-plane z = 0, x < 0; T2 leaves O at an angle to +x; both face up.
#
#   convex (ridge), T2 goes down               concave (valley), T2 goes up
#
#        a: over T2 only                                            / T2
#   T1 ____________O      c: over the edge             a: over both
#                   \\                          T1 __________O/
#                    \\ T2
#
CORNERS = [[0, -10, 0], [0, 10, 0], [-10, 0, 0]]  # T1 = 0 1 2; T2 = 1 0 3


def hinge(degrees: float) -> tuple[np.ndarray, np.ndarray]:
    a = np.radians(degrees)
    vertices = np.array([*CORNERS, [10 * np.cos(a), 0, 10 * np.sin(a)]], dtype=float)
    return vertices, np.array([[0, 1, 2], [1, 0, 3]])


def polar(degrees: float, length: float = 1.0) -> np.ndarray:
    a = np.radians(degrees)
    return length * np.array([np.cos(a), 0.0, np.sin(a)])


# Name: angle of T2, tool position, {triangle: rule}. In the convex (c) and in no other case the two
# triangles have one plane between them; it is written under T1.
T1, T2 = 0, 1
CASES = {
    # x projects into T2 and beyond T1's edge, above T1's plane: T1's closest point is on the ridge,
    # T2's is not there, so T1 meets no condition.
    "Fig. 4 (a)": (-60, polar(5), {T2: FACE}),
    # The same below T1's plane.
    "Fig. 4 (b)": (-60, polar(-20), {T2: FACE}),
    # In the wedge between the two faces' normals at O: both closest points are O.
    "Fig. 4 (c)": (-60, polar(60), {T1: RIDGE}),
    # Over both faces: an obtuse bowl, x in the middle.
    "Fig. 5 (a)": (60, polar(120), {T1: FACE, T2: FACE}),
    # Over T2's face and beyond T1's edge, above T1's plane.
    "Fig. 5 (b)": (40, polar(70), {T1: VALLEY, T2: FACE}),
    # Above T1's plane and beyond its edge, behind T2.
    "Fig. 5 (c)": (60, polar(30), {T1: VALLEY}),
    # Over T1's face, behind T2 (which leans over T1).
    "Fig. 5 (d)": (130, polar(110), {T1: FACE}),
    # Behind both.
    "Fig. 5 (e)": (60, polar(-40), {}),
}

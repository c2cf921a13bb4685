"""Known answers: whether the compiled kernels on this machine compute what they should."""

from __future__ import annotations

from collections.abc import Iterator
from math import inf, sqrt
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from vf.fixtures import RULES, MeshFixture
from vf.motion import Motion
from vf.planes import Planes
from vf.qp.least_squares import ConstrainedLeastSquares
from vf.rules.certified import certified_planes
from vf.rules.corridor import CorridorFixture
from vf.rules.paper import paper_planes
from vf.surface import Surface
from vf.tick.haptics import force
from vf.tree.nearest import nearest_face_freely

if TYPE_CHECKING:
    from vf.controller import Controller

CLOSE = 1e-9  # [m]
STANDOFF = 20e-6
# A block of 20 mm around the origin, two triangles a side.
CORNERS = 0.01 * np.array([[x, y, z] for z in (-1, 1) for y in (-1, 1) for x in (-1, 1)])
SIDES = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]]
FACES = np.array([t for a, b, c, d in SIDES for t in ((a, b, c), (a, c, d))])


def check_kernels() -> None:
    """Compare some answers with what geometry says they are; a fraction of a second.

    Raises:
        RuntimeError: one of them is wrong, so nothing that this installation computes can be
            trusted.
    """
    for what, found, known in _answers():
        got, right = np.asarray(found), np.asarray(known)
        if got.shape != right.shape or not (np.abs(got - right) <= CLOSE).all():
            raise RuntimeError(
                f"the compiled kernels give a wrong answer for {what}: {got.tolist()} instead of "
                f"{right.tolist()}. Nothing they compute can be trusted on "
                "this machine; delete the folders __pycache__ of the installation and start again"
            )


def warm_up(controller: Controller) -> None:
    """Call every kernel that a tick may call, after `check_kernels`: see `Controller.warm_up`."""
    check_kernels()
    arm, settings, made = controller.arm, controller.settings, type(controller)
    q = 0.5 * (arm.lower + arm.upper)
    T = arm.tip(q)
    corners = np.array([[0, 0, -1], [9, 0, -8], [-9, 9, -8], [-9, -9, -8]], dtype=float)
    faces = np.array([[0, 1, 2], [0, 2, 3], [0, 3, 1], [1, 3, 2]])
    for centre in (T.translation, T.translation + np.array([0.0, 0.0, 3e-3])):  # outside, inside
        surface = Surface.from_arrays(corners * 1e-3 + centre, faces)
        # Used by `Surface.nearest` only where much of the surface is at the same distance.
        tree = surface.tree
        nearest_face_freely(tree.nodes, tree.corners, T.translation.copy(), inf, -1)
        # Used only by steps out of a body.
        MeshFixture(surface).leads_out(T.translation, T.translation + 0.01)
        for rule in RULES:
            one = made(arm, [MeshFixture(surface, rule)], settings)
            goal = T.copy()
            goal.translation = T.translation - [0.0, 0.0, 4e-3]
            state = q
            for _ in range(40):
                state = one.step(state, goal).q
        deforming = surface.deforming(surface.vertices + 1e-6).deforming(surface.vertices)
        one = made(arm, [MeshFixture(deforming)], settings)
        here = pin.SE3.Identity()
        one.step(q, T, [Motion(here, here, blend=(0.0, 0.5))])
        one.shaped(0).leads_out(T.translation, T.translation + 0.01)
    along = np.array([0.01, 0.0, 0.0])
    walls = CorridorFixture([T.translation - along, T.translation + along], [0.0, 0.0, -1.0])
    made(arm, [walls, walls], settings).step(q, T)
    controller.step(q, T)


def _answers() -> Iterator[tuple[str, ArrayLike, ArrayLike]]:
    """What was asked, what came, and what it must be."""
    block = Surface.from_arrays(CORNERS, FACES)
    above, beside = np.array([1e-3, 2e-3, 0.013]), np.array([0.013, 1e-3, 0.014])
    yield "the side a point is on", [block.winding(np.zeros(3)), block.winding(above)], [1, 0]
    yield "the nearest point", block.nearest(above)[2], [1e-3, 2e-3, 0.01]
    yield "the distance from an edge", block.nearest(beside)[0], 5e-3
    found = block.within(above, 4e-3)
    yield "the triangles in a ball", np.sort(found.triangles), [2, 3]
    yield "their distances", np.sort(found.distances)[0], 3e-3

    planes = certified_planes(block, above, 5e-3, STANDOFF)
    yield "the planes above a face", _rows(planes), [[0, 0, 1, 0.01 + STANDOFF]]
    yield "the planes of Condition 1", _rows(paper_planes(block, above, 5e-3)), [[0, 0, 1, 0.01]]
    planes = certified_planes(block, beside, 6e-3, STANDOFF)
    normal = np.array([0.6, 0.0, 0.8])
    yield "the planes beside an edge", _rows(planes), [[*normal, 0.014 + STANDOFF]]
    planes = certified_planes(block, beside, 6e-3, STANDOFF, 1e-3)
    yield "the planes of a ball", _rows(planes), [[*normal, 0.015 + STANDOFF]]
    corner = np.array([0.012, 0.012, 0.012])
    planes = certified_planes(block, corner, 5e-3, STANDOFF)
    yield (
        "the planes before a corner",
        _rows(planes), [[*np.full(3, sqrt(1 / 3)), sqrt(3.0) * 0.01 + STANDOFF]],
    )  # fmt: skip
    turned = Surface.from_arrays(CORNERS, FACES[:4, ::-1])
    planes = certified_planes(turned, np.array([1e-3, 1e-3, 2e-3]), 0.02, STANDOFF)
    # Between two plates: the second plane is eased by 0.004 of its distance.
    far = 0.012 - STANDOFF
    yield (
        "the planes between two walls",
        _rows(planes),
        [[0, 0, -1, -0.01 + STANDOFF], [0, 0, 1, -0.01 + STANDOFF + 0.004 * far]],
    )

    corridor = CorridorFixture([[0.0, 0.0, 0.0], [0.0, 0.02, 0.0]], [0, 0, -1], 1e-3)
    x = np.array([4e-4, 0.01, 0.0])
    planes = corridor.planes(x, 5e-3, STANDOFF, 0.0, False)
    yield (
        "a corridor's walls",
        _rows(planes), [[-1, 0, 0, -1e-3 + STANDOFF], [1, 0, 0, -1e-3 + STANDOFF]],
    )  # fmt: skip

    solver = ConstrainedLeastSquares(3)
    goal = np.array([1e-3, -2e-3, 3e-4])
    J, bound = np.eye(3), np.full(3, 0.1)
    rows, limits = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0]]), np.array([-5e-4, -1.0])
    solution = solver.solve(J, goal, 0.0, rows, limits, -bound, bound)
    yield "a constrained step", solution.dq, [1e-3, -5e-4, 3e-4]
    yield "the force", force(np.array([0.0, 1e-3, 0.0]), np.zeros(3), 150.0, 4.0), [0, 0.15, 0]


def _rows(planes: Planes) -> np.ndarray:
    return np.column_stack([planes.normals, planes.offsets])

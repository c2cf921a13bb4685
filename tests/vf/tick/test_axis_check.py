"""The checks of a tick at 1 kHz for the ends of the axes: where linearisation alone is not enough.

Small sheets lie against a capsule where an end of its axis moves at full speed past them. What the
end leaves its tangent by in that tick, up to 4 µm, is more than the rows are tightened by.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator

import numpy as np

import robots
import vf

SQUARE = 2e-3 * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])  # [m]
HALVES = np.array([[0, 1, 2], [0, 2, 3]])
DT = 1e-3


def steps(
    standoff: float, sides: tuple[int, ...], trials: int
) -> Iterator[tuple[robots.Arm, np.ndarray, vf.Step]]:
    """Arm, joints and step of a tick at full speed, from where a capsule touches its standoff.

    Args:
        sides: of the capsule on which there is a sheet: −1 where the end of its axis bends towards
            it, 1 on the other.
        trials: random postures; those in which the end does not move are left out.
    """
    arm, rng = robots.load("psm"), np.random.default_rng(0)
    for _ in range(trials):
        k, end = int(rng.integers(3)), int(rng.integers(2))
        q = arm.lower + rng.uniform(0.1, 0.9, 6) * (arm.upper - arm.lower)
        dq = arm.velocity * DT * rng.choice([-1.0, 1.0], 6)
        axis, J = arm.axes(q)[k], arm.axis_jacobians(q)[k, end]
        bent = arm.axes(q + dq)[k, end] - axis[end] - J @ dq
        n = np.cross(axis[1] - axis[0], J @ dq)
        if not np.linalg.norm(n) > 1e-12:
            continue
        n /= -np.linalg.norm(n) * np.sign(n @ bent)
        flat = SQUARE @ np.linalg.svd(n[None])[2][1:]
        away = arm.capsules[k].radius + standoff + 1e-9
        corners = np.concatenate([flat + axis[end] + side * away * n for side in sides])
        faces = np.concatenate([HALVES + 4 * i for i in range(len(sides))])
        fixture = vf.MeshFixture(vf.Surface.from_arrays(corners, faces), radius=5e-3)
        settings = vf.Settings(dt=DT, guard="tool", standoff=standoff)
        yield arm, q, vf.Controller(arm, [fixture], settings).step(q, arm.tip(q + 4.0 * dq))


def lowest(arm: robots.Arm, q: np.ndarray, planes: vf.Planes) -> np.ndarray:
    """Height n·x of the lower end of the axis that each plane holds, (m,) [m]; inf for the tip."""
    assert planes.capsules is not None
    assert planes.of_axis is not None
    heights = (arm.axes(q)[planes.capsules] @ planes.normals[:, :, None])[:, :, 0].min(axis=1)
    return np.where(planes.of_axis, heights, np.inf)


def test_ends_of_axes_are_in_front_of_their_planes_after_a_tick_at_full_speed() -> None:
    """And the second attempt, with rows moved by what the ends left their tangents by, saves it."""
    statuses: Counter[vf.Status] = Counter()
    for arm, _q, step in steps(20e-6, (-1,), 250):
        assert (lowest(arm, step.q, step.planes) >= step.planes.offsets - 1e-13).all()
        statuses[step.status] += 1
    assert statuses[vf.Status.SOLVED] > 50
    assert statuses[vf.Status.SHORTENED] <= 5


def test_between_two_ticks_ends_of_axes_are_above_the_floors_of_their_planes() -> None:
    """In a slot with a standoff that is less than how far a path leaves its chord."""
    checked = 0
    for arm, q, step in steps(2e-7, (-1, 1), 250):
        assert step.planes.floors is not None
        for share in np.linspace(0.0, 1.0, 9):
            there = lowest(arm, q + share * (step.q - q), step.planes)
            assert (there >= step.planes.floors - 1e-13).all()
        checked += np.linalg.norm(step.q - q) > 1e-3
    assert checked > 30

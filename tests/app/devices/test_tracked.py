"""How far an instrument is off its path, against the kinematics of its capsules."""

from __future__ import annotations

import numpy as np

import robots
from app.devices.remote.tracked import Levers, Tracked

REACH = 0.01 * np.array([1.6, 1.6, 0.4, 3.0, 3.0, 3.0])


def ends(arm: robots.Arm, q: np.ndarray) -> np.ndarray:
    """The ends of all capsules and the tip (k, 3)."""
    return np.concatenate([arm.axes(q).reshape(-1, 3), arm.tip(q).translation[None]])


def test_no_part_moves_farther_than_the_bound_here_and_on_the_way_to_the_set_point() -> None:
    arm, rng = robots.load("psm"), np.random.default_rng(3)
    levers, shares = Levers(arm, REACH), []
    for _ in range(300):
        q = rng.uniform(arm.lower, arm.upper)
        for scale in (1e-5, 1e-2):
            error = scale * rng.choice([0.0, 1.0], 6) * rng.standard_normal(6)
            near = q + rng.uniform(-1.0, 1.0, 6) * REACH
            bound = levers.bound(near, error)
            moved = []
            # From the start, aside by the error, to a set-point in reach, ever less aside.
            end = near + rng.choice([-1.0, 1.0], 6) * REACH
            for s in (0.0, 0.3, 0.8):
                on_way = near + s * (end - near)
                aside = on_way + (1.0 - s) * error
                moved.append(np.linalg.norm(ends(arm, aside) - ends(arm, on_way), axis=1).max())
            assert max(moved) <= bound + 1e-12
            if error.any():
                shares.append(moved[0] / bound)
    assert np.median(shares) > 0.4  # and it is not much too large


def test_the_whole_is_off_its_path_where_the_tip_is_not() -> None:
    arm = robots.load("psm")
    q = np.array([0.2, -0.1, 0.12, 0.3, 0.5, -0.4])
    tracked = Tracked(arm, 4, REACH)
    tracked.anchor(q)
    # Motions of the joints that leave the tip where it is, to the first order.
    null = np.linalg.svd(arm.jacobian(q)[:3])[2][-1]
    aside = q + 0.02 * null
    shaft = np.linalg.norm(ends(arm, aside) - ends(arm, q), axis=1).max()
    assert shaft > 1e-4
    tip, alone = tracked.error(aside, whole=False)
    assert tip == alone < 0.1 * shaft
    assert tracked.error(aside, whole=True)[0] == tip
    assert tracked.error(aside, whole=True)[1] >= shaft
    assert max(tracked.error(q, whole=True)) < 1e-12

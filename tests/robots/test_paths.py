"""How far a tip leaves the straight line within a tick: searched for the worst, against the bound.

    python -m pytest -s -m slow -n 0 tests/robots/test_paths.py

prints the figures of docs/certified.md.
"""

from __future__ import annotations

import numpy as np
import pytest

import robots
from vf.qp.problem import sagitta

PERIOD = 1e-3


def off_chord(arm: robots.Arm, q: np.ndarray, dq: np.ndarray) -> float:
    """Largest distance [m] of the tip's path from q − dq/2 to q + dq/2 from its chord."""
    path = np.array([arm.tip(q + t * dq).translation for t in np.linspace(-0.5, 0.5, 9)])
    chord = path[-1] - path[0]
    off = path - path[0]
    shares = off @ chord / max(chord @ chord, 1e-300)
    return float(np.linalg.norm(off - shares[:, None] * chord, axis=1).max())


def bound(arm: robots.Arm, q: np.ndarray, dq: np.ndarray) -> float:
    return float(sagitta(arm.kinematics(q - 0.5 * dq)[1], dq, 1.0, arm.revolute))


@pytest.mark.parametrize("name", ["psm", "panda", "ur5"])
def test_no_path_leaves_its_chord_by_more_than_the_bound(name: str) -> None:
    arm = robots.load(name)
    rng = np.random.default_rng(1)
    room = arm.upper - arm.lower
    for _ in range(150):
        dq = arm.velocity * 10.0 ** rng.uniform(-3.5, -1.0) * rng.uniform(-1.0, 1.0, len(room))
        q = arm.lower + room * rng.uniform(0.0, 1.0, len(room))
        assert off_chord(arm, q, dq) <= bound(arm, q, dq) + 1e-15


@pytest.mark.slow
@pytest.mark.parametrize(("name", "known"), [("psm", 3.5e-6), ("panda", 5.8e-6), ("ur5", 7.1e-6)])
def test_the_worst_path_of_a_tick_is_within_the_bound(name: str, known: float) -> None:
    """Every joint at full speed, forwards or backwards; posture and signs by a local search."""
    arm = robots.load(name)
    rng = np.random.default_rng(0)
    reach, room = arm.velocity * PERIOD, arm.upper - arm.lower
    best, posture, signs = 0.0, arm.neutral, reach
    for _ in range(12):
        q = arm.lower + room * rng.uniform(0.0, 1.0, len(room))
        s = rng.choice([-1.0, 1.0], len(room))
        found = off_chord(arm, q, s * reach)
        for _ in range(500):
            size = 0.5 * rng.choice([1.0, 0.1, 0.01])
            q_new = np.clip(q + rng.normal(size=len(room)) * size * room, arm.lower, arm.upper)
            s_new = s.copy()
            if rng.random() < 0.2:
                s_new[rng.integers(len(s))] *= -1.0
            new = off_chord(arm, q_new, s_new * reach)
            if new > found:
                q, s, found = q_new, s_new, new
        if found > best:
            best, posture, signs = found, q, s
    limit = bound(arm, posture, signs * reach)
    print(f"\n{name}: {best * 1e6:.2f} µm off the chord, the bound there {limit * 1e6:.2f} µm")
    assert 0.95 * known <= best <= limit

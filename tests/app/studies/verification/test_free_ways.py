"""Where a free way exists the whole instrument goes it, as if there were no mesh."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

import meshes
import robots
import vf
from app.judges.sweep import Judge
from app.studies.verification import instrument
from tests.support.everyday import everyday

UM = 1e-6
NARROW = (22 * UM, 200 * UM)  # least clearance of a way: hardly more than the standoff
PACE = 1e-4  # of the fastest end in a tick, at most [m]
STARTS = 12


def way(judge: Judge, q: np.ndarray, rng: np.random.Generator) -> np.ndarray | None:
    """Joints (k, n), tick by tick, straight past the mesh as closely as `NARROW`; None: not found.

    The joints are brought to where the instrument nearly touches; the way leads through that place,
    across the direction in which the clearance grows.
    """
    arm = judge.arm
    for _ in range(6):
        gap = judge.clearance(q).min()
        slope = np.array(
            [
                judge.clearance(q + h).min() - judge.clearance(q - h).min()
                for h in 1e-6 * np.diag(arm.velocity)
            ]
        ) / (2e-6 * arm.velocity)
        scaled = slope * arm.velocity**2
        if not slope.any():
            return None
        if abs(gap - 60 * UM) > 5 * UM:
            q = arm.clamp(q - (gap - 60 * UM) / (slope @ scaled) * scaled)
    for _ in range(10):
        dq = rng.normal(size=len(q)) * arm.velocity
        dq -= (dq @ slope) / (slope @ scaled) * scaled
        dq *= 1e-6
        dq *= rng.uniform(1e-3, 6e-3) / judge.fastest(q, dq)
        first, last = arm.clamp(q - dq), arm.clamp(q + dq)
        gaps = [
            judge.clearance(first + s * (last - first)).min() for s in np.linspace(0.0, 1.0, 15)
        ]
        if NARROW[0] < min(gaps) < NARROW[1] and not judge.touches(first, last):
            count = int(np.ceil(judge.fastest(first, last - first) / PACE))
            return np.asarray(first + np.linspace(0.0, 1.0, count + 1)[:, None] * (last - first))
    return None


def followed(controller: vf.Controller, points: np.ndarray) -> np.ndarray:
    """Joints (k, n) of a tool whose proxy goes that way, and rests at its end."""
    arm, q, found = controller.arm, points[0], []
    for point in itertools.chain(points[1:], itertools.repeat(points[-1], 10)):
        q = controller.step(q, arm.tip(point)).q
        found.append(q)
    return np.array(found)


@pytest.mark.parametrize("name", everyday(["gear", "saddle-slab", "torus", "skull-coarse"], "gear"))
def test_a_narrow_free_way_is_gone_as_if_there_were_no_mesh(name: str) -> None:
    arm, rng = robots.load("psm"), np.random.default_rng(0)
    start = instrument._Starts(meshes.arrays(name))
    hindered = seen = 0
    for _ in range(STARTS):
        q, surface, judge = start.near(arm, rng)
        points = way(judge, q, rng)
        if points is None:
            continue
        fixture = vf.MeshFixture(surface, "certified", 5e-3)
        tools = [
            followed(
                vf.Controller(arm, fixtures, vf.Settings(guard="tool", standoff=standoff)), points
            )
            for fixtures, standoff in (([], 20 * UM), ([fixture], 20 * UM), ([fixture], 250 * UM))
        ]
        off = [np.abs(axes_of(arm, tool) - axes_of(arm, tools[0])).max() for tool in tools]
        # Near a singular posture a tool leaves its proxy's way, whatever there is around it.
        if min(judge.clearance(q).min() for q in tools[0]) < NARROW[0]:
            continue
        seen += len(points) > 15
        # Planes that come near without being in the way may add rounding.
        assert off[1] < 1 * UM, points.tolist()
        hindered += off[2] > 20 * UM
    # The ways are narrow: with a standoff that does not fit they are not free.
    assert seen > 5
    assert hindered > seen // 2


def axes_of(arm: robots.Arm, tool: np.ndarray) -> np.ndarray:
    """The capsules' axes (k, c, 2, 3) for joints (k, n)."""
    return np.array([arm.axes(q) for q in tool])

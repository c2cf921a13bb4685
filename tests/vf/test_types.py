"""Numbers of any kind at the border: none makes a kernel compile in the middle of a loop."""

from __future__ import annotations

import sys

import numpy as np
import pinocchio as pin
import pytest
from numba.core.dispatcher import Dispatcher

import robots
import vf

BLOCK = np.array([[x, y, z] for z in (-1, 1) for y in (-1, 1) for x in (-1, 1)])  # integers
FACES = [[0, 2, 3], [0, 3, 1], [4, 5, 7], [4, 7, 6]]


def compiled() -> int:
    """How many kinds of arguments all kernels of the library are compiled for."""
    modules = [module for name, module in sys.modules.items() if name.startswith("vf.")]
    found = {id(k): k for m in modules for k in vars(m).values() if isinstance(k, Dispatcher)}
    assert len(found) > 50
    return sum(len(kernel.signatures) for kernel in found.values())


def everything(one, half, none) -> None:
    """All public entries that take a length or a point, with numbers of one kind."""
    block = vf.Surface.from_arrays(BLOCK, FACES)
    x = [none, none, 2 * one]
    vf.certified_planes(block, x, one, half, none)
    vf.certified_planes(block, tuple(x), one)
    vf.paper_planes(block, x, 2 * one)
    vf.every_plane(block, x, 2 * one)
    block.within(x, 2 * one)
    block.nearest(x)
    block.nearest(x, one)
    block.winding(x)
    block.inside(x)
    vf.closest_point(np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]]), x)
    vf.force(np.asarray(x), np.zeros(3, dtype=int), one, one)
    walls = vf.CorridorFixture([[0, 0, 0], [0, 1, 0]], [0, 0, -1], one, one)
    walls.room(x)
    vf.explain(block, x, one, half, none)
    arm = robots.load("point")
    for fixture in (vf.MeshFixture(block, radius=one), walls):
        settings = vf.Settings(
            dt=one, standoff=one, tip_radius=none, rotation_length=one, damping=one,
            force_gain=one, force_cap=one, tip_speed=one,
        )  # fmt: skip
        controller = vf.Controller(arm, [fixture], settings)
        controller.step(list(arm.neutral), pin.SE3.Identity())
        fixture.planes(np.asarray(arm.neutral, dtype=float), fixture.radius, 0.5, 0.0, False)


@pytest.mark.parametrize("kind", [int, np.int64, np.float32, np.float16, np.array, bool])
def test_numbers_of_any_kind_are_taken_and_nothing_is_compiled(kind) -> None:
    everything(1.0, 0.5, 0.0)
    before = compiled()
    everything(kind(1), kind(1), kind(0))
    assert compiled() == before


@pytest.mark.parametrize("value", ["5 mm", None, [1.0, 2.0], 1j])
def test_what_is_no_number_is_refused_by_name(value) -> None:
    block = vf.Surface.from_arrays(BLOCK, FACES)
    for attempt in (
        lambda: vf.certified_planes(block, [0, 0, 3], value),
        lambda: block.within([0, 0, 3], value),
        lambda: vf.CorridorFixture([[0, 0, 0], [0, 1, 0]], [0, 0, -1], width=value),
        lambda: vf.Settings(tip_radius=value),
    ):
        with pytest.raises(ValueError, match=r"radius|width|tip_radius"):
            attempt()

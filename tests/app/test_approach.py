"""The limit of the speed of approach, from the command line to the tick."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from app.control.engine import Engine, Orders
from app.control.messages import Command, LoopStats
from app.options import parse_as
from app.scene import scene as scenes
from app.settings import Options
from app.words import OptionError

DT = 1e-3


@pytest.fixture(scope="module")
def cube() -> scenes.Scene:
    return scenes.build(Options(mesh="cube", robot="point"), 1)


def gaps(scene: scenes.Scene, approach: float) -> np.ndarray:
    """Distances from the cube beyond the standoff, tick by tick, of a tool drawn into it [m]."""
    options = Options(mesh="cube", robot="point", approach=approach)
    start = scene.T_base_start
    deep = pin.SE3(start.rotation, scene.surface.vertices.mean(axis=0))
    orders = Orders(scenes.plant(scene, options), Command(deep, 1))
    engine = Engine(orders)
    found = []
    for _ in range(200):
        telemetry, _ = engine.advance(orders, LoopStats())
        assert telemetry.step is not None
        tip = np.array(telemetry.step.tip.translation)
        found.append(scene.surface.nearest(tip)[0] - options.standoff)
    return np.array(found)


def test_it_is_off_unless_it_is_given(cube: scenes.Scene) -> None:
    assert Options().approach == 0.0
    assert scenes.plant(cube, cube.options).controller.settings.approach is None
    assert gaps(cube, 0.0)[-1] < 2e-5


def test_the_tool_comes_nearer_by_so_much_of_what_is_left_a_second(cube: scenes.Scene) -> None:
    left = gaps(cube, 20.0)
    assert left[-1] > 1e-4  # it has not arrived
    # From where the motion sphere has the plane: 5 mm.
    near = left[:-1] < 4e-3
    assert np.count_nonzero(near) > 50
    share = 1.0 - left[1:][near] / left[:-1][near]
    assert share.max() <= 20.0 * DT * 1.02
    assert share.max() > 20.0 * DT * 0.9
    assert gaps(cube, 60.0)[-1] < left[-1]


def test_it_is_given_as_a_number_and_refused_with_its_range() -> None:
    assert parse_as(Options, "vf-sandbox", ["--approach", "20"]).approach == 20.0
    with pytest.raises(OptionError, match="approach -1 /s is outside 0 /s to 1000 /s"):
        Options(approach=-1.0)

"""The measures of a trial against closed forms, on ways whose distances are known."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from app.control.messages import State
from app.motion.declared import Motion
from app.recording.format import ORDERS, ROWS, Recording
from app.recording.read import read
from app.scene import scene as scenes
from app.scene.scene import Scene
from app.settings import Options
from app.studies.experiments.site import PlannedCut
from app.studies.experiments.smoothness import sal, sparc
from app.studies.people.measures import episodes, heights, measure
from app.studies.people.tasks import Goal
from vf import Surface

KEPT = Path(__file__).parents[2] / "recording/kept"
HALF = 0.02  # of the cube's edge [m]


@pytest.fixture(scope="module")
def cube() -> Scene:
    return scenes.build(Options(mesh="cube", robot="point", at=(0.0, 0.0, 0.0)), 1, warm=False)


def recorded(scene: Scene, tips: np.ndarray, options: Options | None = None, **more) -> Recording:
    """A recording of a tip (n, 3) that is at these places, one a tick."""
    rows, orders = np.zeros(len(tips), dtype=ROWS), np.zeros(1 + ("resets" in more), dtype=ORDERS)
    rows["ticked"] = rows["stepped"] = 1
    rows["tip"], rows["q"][:, :3] = tips, tips
    rows["force"] = more.get("force", np.zeros(3))
    rows["phase"] = np.arange(1, len(tips) + 1) * 1e-3
    if "resets" in more:
        orders["resets"][1] = 1
        rows["order"][more["resets"] :] = 1
    state = State(tips[0], 0, 0, 0, None, None, False)
    options = options or scene.options
    return Recording((), ((0, options),), (None,), state, orders, rows, "", {})


NOWHERE = Goal("targeting", None, np.empty((0, 3)), 0.0, ())


def along(task: str, points: np.ndarray) -> Goal:
    """A task along straight points (k, 3) on the cube's top, in the direction of x."""
    n = len(points)
    ones = (np.tile(axis, (n, 1)) for axis in np.eye(3))
    stations = np.r_[0.0, np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))]
    return Goal(task, PlannedCut(stations, points, *ones), np.empty((0, 3)), 0.0, ())


def way(*corners: tuple[float, ...], speed: float = 20.0) -> np.ndarray:
    """Straight pieces between corners [mm], one place a tick of 1 ms at a speed [mm/s]; in m."""
    pieces = []
    for a, b in pairwise(corners):
        n = max(round(np.linalg.norm(np.subtract(b, a)) / speed * 1000.0), 1)
        pieces.append(np.linspace(a, b, n, endpoint=False))
    return np.vstack([*pieces, [corners[-1]]]) * 1e-3


def test_contacts_depth_time_and_force(cube: Scene) -> None:
    # Onto the top and 1.5 mm into it, off it, and to 0.3 mm over it, which is no contact.
    tips = way((0, 0, 30), (0, 0, 18.5), (0, 0, 25), (5, 0, 20.3), (5, 0, 30))
    found = measure(recorded(cube, tips, force=np.array([0.3, 0.0, 0.4])), NOWHERE, cube)
    assert found["contacts"] == found["contacts cube"] == 1.0
    assert found["penetration"] == pytest.approx(1.5e-3, abs=1e-9)
    assert found["time"] == pytest.approx(len(tips) * 1e-3)
    assert found["force_integral"] == pytest.approx(0.5 * len(tips) * 1e-3)


def test_a_tip_with_a_radius_is_in_contact_earlier(cube: Scene) -> None:
    tips = way((0, 0, 30), (0, 0, 20.5), (0, 0, 30))
    options = Options(mesh="cube", robot="point", at=(0.0, 0.0, 0.0), tip_radius=1e-3)
    assert measure(recorded(cube, tips), NOWHERE, cube)["penetration"] == 0.0
    found = measure(recorded(cube, tips, options), NOWHERE, cube)
    assert (found["contacts"], found["penetration"]) == (1.0, pytest.approx(0.5e-3, abs=1e-9))


def test_what_is_not_guarded_may_be_entered(cube: Scene) -> None:
    tips = way((0, 0, 30), (0, 0, 15))
    options = Options(mesh="cube", robot="point", at=(0.0, 0.0, 0.0), guarded=False)
    found = measure(recorded(cube, tips, options), NOWHERE, cube)
    assert (found["contacts"], found["penetration"], found["contacts cube"]) == (0.0, 0.0, 1.0)


def test_a_reset_begins_the_movement_anew(cube: Scene) -> None:
    tips = np.vstack([way((0, 0, 30), (0, 0, 15)), way((0, 0, 30), (10, 0, 30))])
    after = len(way((0, 0, 30), (0, 0, 15)))
    found = measure(recorded(cube, tips, resets=after), NOWHERE, cube)
    alone = measure(recorded(cube, tips[after:]), NOWHERE, cube)
    assert (found["contacts"], found["penetration"]) == (0.0, 0.0)
    assert found["sparc"] == alone["sparc"]
    assert found["time"] == pytest.approx(len(tips) * 1e-3)


@pytest.mark.parametrize(("task", "high"), [("tracing", 0.5), ("cutting", -0.3)])
def test_deviation_to_the_side_of_a_path(cube: Scene, task: str, high: float) -> None:
    goal = along(task, np.array([[x, 0.0, HALF] for x in np.arange(-10e-3, 10.5e-3, 1e-3)]))
    tips = way((-15, 8, 40), (-12, 0.7, 20 + high), (12, 0.7, 20 + high), (12, 9, 40))
    found = measure(recorded(cube, tips), goal, cube)
    assert found["path_deviation"] == pytest.approx(0.7e-3, abs=1e-6)
    # How high the tip is over the path does not matter, unless it was never at it.
    away = measure(recorded(cube, tips + np.array([0.0, 0.0, 5e-3])), goal, cube)
    assert np.isnan(away["path_deviation"])


def test_deviation_in_space_counts_every_millimetre_alike(cube: Scene) -> None:
    targets = np.array([[20.0, 0.0, 41.0], [20.0, 20.0, 41.0]]) * 1e-3
    goal = Goal("targeting", None, targets, 0.0, ())
    slow = way((0, 0, 41), (10, 0, 41), speed=2.0)  # on the way, and slow, which is not to count
    fast = way((10, 0, 43), (20, 0, 43), (20, 20, 43), speed=40.0)  # 2 mm off
    found = measure(recorded(cube, np.vstack([slow, fast])), goal, cube)
    assert found["path_deviation"] == pytest.approx(30 * 2e-3 / 40, rel=0.03)


def test_smoothness_is_that_of_the_experiments(cube: Scene) -> None:
    t = np.arange(1, 2001) * 1e-3
    s = (t / 2.0) ** 3 * (10 - 15 * t / 2 + 6 * (t / 2) ** 2)
    tips = np.stack([0.03 * s, 0 * s, 0 * s + 0.04], axis=1)
    found = measure(recorded(cube, tips), NOWHERE, cube)
    speed = np.abs(np.diff(tips[9::10, 0])) * 100.0
    assert found["sal"] == pytest.approx(sal(speed, 100.0), rel=1e-9)
    assert found["sparc"] == pytest.approx(sparc(speed, 100.0), rel=1e-9)
    assert found["sparc"] == pytest.approx(-1.40, abs=0.02)  # of a minimum jerk, as published
    assert np.isnan(found["path_deviation"])  # there is no target


def test_a_tool_that_never_moves_has_no_smoothness(cube: Scene) -> None:
    found = measure(recorded(cube, np.tile([0.0, 0.0, 0.03], (500, 1))), NOWHERE, cube)
    assert np.isnan(found["sal"])
    assert np.isnan(found["sparc"])
    assert found["contacts"] == found["penetration"] == 0.0
    one = measure(recorded(cube, np.array([[0.0, 0.0, 0.03]])), NOWHERE, cube)
    assert one["time"] == pytest.approx(1e-3)


def test_what_moves_is_met_where_it_is() -> None:
    options = Options(
        mesh="cube", robot="point", at=(0.0, 0.0, 0.0),
        motions=(Motion("knock", move=(0.0, 0.0, 0.008), period=0.06, after=0.2),),
    )  # fmt: skip
    scene = scenes.build(options, 1, warm=False)
    found = measure(recorded(scene, np.tile([0.0, 0.0, 0.025], (600, 1))), NOWHERE, scene)
    assert found["contacts"] == 1.0
    assert found["penetration"] == pytest.approx(3e-3, abs=1e-6)


def test_heights_of_a_way_are_those_of_all_its_points(cube: Scene) -> None:
    rng = np.random.default_rng(3)
    tips = np.cumsum(rng.normal(scale=4e-4, size=(4000, 3)), axis=0)
    tips += np.array([0.0, 0.0, 0.021])
    tips[1000:1400] = tips[1000]  # rests
    found = heights(cube.surface, tips, 1e-3)
    off = np.abs(tips) - HALF
    true = np.linalg.norm(np.maximum(off, 0.0), axis=1) + np.minimum(off.max(axis=1), 0.0)
    assert (true < 0.0).any()
    assert (true > 1e-3).any()
    near = true <= 1e-3
    np.testing.assert_allclose(found[near], true[near], atol=2e-6)
    assert (found[~near] >= 1e-3 - 2e-6).all()


def test_beside_a_sharp_edge_outside_is_outside() -> None:
    """Where the nearest of two triangles faces away, it is the winding number that decides."""
    wedge = np.array([[0, 0, 0], [1, 0.05, 0], [1, -0.05, 0], [0, 0, 1], [1, 0.05, 1],
                      [1, -0.05, 1]]) * 0.04  # fmt: skip
    faces = np.array([[0, 2, 1], [3, 4, 5], [0, 1, 4], [0, 4, 3], [1, 2, 5], [1, 5, 4],
                      [2, 0, 3], [2, 3, 5]])  # fmt: skip
    surface = Surface.from_arrays(wedge, faces)
    assert surface.closed
    y = np.linspace(-2e-3, 2e-3, 401)
    points = np.stack([np.full(401, -1e-3), y, np.full(401, 0.02)], axis=1)
    assert (heights(surface, points, 1e-2) > 0.0).all()


def test_a_contact_that_trembles_is_one() -> None:
    gaps = np.array([1.0, 0.05, 0.2, 0.05, -0.3, 0.4, 0.6, 0.3, 0.09, 2.0]) * 1e-3
    assert episodes(gaps) == 2
    assert episodes(np.full(5, np.inf)) == 0


@pytest.mark.parametrize("name", ["psm-point", "panda"])
def test_a_file_of_a_session(name: str) -> None:
    path = KEPT / f"{name}.vfrec"
    found, rows = measure(path, NOWHERE), read(path).rows
    assert found["time"] == pytest.approx((rows["ticked"] == 1).sum() * 1e-2)
    forces = np.sqrt((rows["force"] ** 2).sum(axis=1)) * (rows["stepped"] == 1)
    assert found["sparc"] < -1.0
    assert 0.0 < found["force_integral"] <= forces.sum() * 1e-2 + 1e-12
    assert {"contacts", "sal", "path_deviation", "penetration"} < set(found)

"""The memory of a tick and the names of what is in it."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

import robots
import vf
from vf import layout
from vf.planes import planes_of, write_records
from vf.rules.search import Search
from vf.tick.block import Block


def spans(groups: dict[str, list[tuple[str, int, int]]]) -> None:
    """No two names of a group may stand for the same place; (name, first, count) each."""
    for group, names in groups.items():
        taken: dict[int, str] = {}
        for name, first, count in names:
            for place in range(first, first + count):
                assert place not in taken, f"{group}: {name} and {taken[place]} at {place}"
                taken[place] = name


def test_no_two_things_stand_at_the_same_place() -> None:
    at = vars(layout)

    def block(first: str, last: str, sizes: dict[str, int]) -> list[tuple[str, int, int]]:
        """The names that the module defines from one to another, in order."""
        names = [name for name in at if name.isupper()]
        chosen = names[names.index(first) : names.index(last)]
        return [(name, at[name], sizes.get(name, 1)) for name in chosen]

    spans(
        {
            "plane": block("NORMAL", "PLANE", {"NORMAL": 3, "FOOT": 3}),
            "words": block("JOINTS", "WORDS", {}),
            "numbers": block("STANDOFF", "SCALARS", {"DESIRED": 6, "MARKS": 4}),
            "table": block("TASK", "JOINT_ROWS", {"TASK": 6}),
            "search": block("KIND", "SEARCH", {}),
            "side": block("SEEN", "SIDE", {"SEEN": 3}),
            "motion": block("FROM", "MOTION", {"FROM": 12, "TO": 12}),
            "report": block(
                "REPORT_STATUS", "HEAD",
                {"REPORT_MARKS": 4, "REPORT_FORCE": 3, "REPORT_TIP": 12},
            ),
        }
    )  # fmt: skip
    assert at["BUMP"] < at["PLANE"]
    assert at["REPORT_TIP"] + 12 == at["HEAD"]
    assert at["APPROACH"] + 1 == at["SCALARS"]


def test_addresses_lead_to_the_parts_and_go_on_doing_so_when_there_is_more_room() -> None:
    block = Block(3, None, [])
    for room in (64, 500):
        block.reserve(room)
        assert block.words[layout.ROOM] == room
        for word, part in (
            (layout.NUMBERS, block.numbers), (layout.TABLE, block.table),
            (layout.PLANES, block.planes), (layout.SCRATCH, block.scratch),
        ):  # fmt: skip
            assert block.words[word] == part.ctypes.data
        assert block.words[layout.PLANES] == block.words[layout.REPORT] + block.head
        assert len(block.report) == block.head + 8 * layout.PLANE * room


def test_what_a_tick_is_to_search_lies_in_one_piece() -> None:
    surface = vf.Surface.from_arrays(np.eye(3), [[0, 1, 2], [0, 2, 1]])
    strided = surface.tree._replace(corners=np.asfortranarray(surface.tree.corners))
    with pytest.raises(ValueError, match="contiguous"):
        Block(3, None, [Search(layout.MESH, strided, surface.edges)])


def test_planes_are_the_same_as_records_and_back() -> None:
    rng = np.random.default_rng(4)
    planes = vf.Planes(
        rng.normal(size=(5, 3)), rng.normal(size=5), rng.normal(size=(5, 3)),
        np.array([7, -1, 2**40, 0, 3]), np.array([0, 1, 2, 3, 5]), 2e-3, rng.normal(size=5),
    )  # fmt: skip
    records = np.full((8, layout.PLANE), np.nan)
    write_records(planes, 3, records)
    again = planes_of(records[:5], planes.radius)
    for name in ("normals", "offsets", "points", "triangles", "rules", "floors", "radius"):
        np.testing.assert_array_equal(getattr(again, name), getattr(planes, name))
    assert again.fixtures is not None
    assert again.capsules is not None
    assert (again.fixtures == 3).all()
    assert (again.capsules == 0).all()
    without = vf.Planes.none(1.0)
    write_records(without, 0, records)
    assert len(planes_of(records[:0], 1.0)) == 0


@pytest.mark.parametrize("given", [False, True])
def test_planes_of_a_step_say_which_fixture_they_are_of(given: bool) -> None:
    """A floor and a corridor's wall, found by the tick or handed over by the fixtures."""
    arm = robots.load("point")
    corners = 0.05 * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    floor = vf.MeshFixture(vf.Surface.from_arrays(corners, [[0, 1, 2], [0, 2, 3]]))
    path = [[0.0, -0.02, 0.0], [0.0, 0.02, 0.0]]
    walls = vf.CorridorFixture(path, [0.0, 0.0, 1.0], 1e-3, radius=5e-3)
    fixtures = [floor, walls]
    if given:
        floor.search = walls.search = None
    controller = vf.Controller(arm, fixtures)
    step = controller.step(np.array([0.0, 0.0, 1e-3]), pin.SE3(np.eye(3), np.zeros(3)))
    assert step.planes.fixtures is not None
    corridor = step.planes.rules == vf.Rule.CORRIDOR
    assert corridor.sum() == 2
    assert (step.planes.fixtures == corridor).all()
    assert (~corridor).sum() == 1


def test_a_side_is_known_of_the_place_where_the_last_tick_ended_and_of_no_other(
    monkeypatch,
) -> None:
    arm = robots.load("psm")
    tip = arm.tip(arm.neutral)
    box = np.array([[x, y, z] for z in (-1, 1) for y in (-1, 1) for x in (-1, 1)]) * 0.01
    faces = [[0, 2, 3], [0, 3, 1], [4, 5, 7], [4, 7, 6], [0, 1, 5], [0, 5, 4], [2, 6, 7],
             [2, 7, 3], [0, 4, 6], [0, 6, 2], [1, 3, 7], [1, 7, 5]]  # fmt: skip
    below = box + tip.translation - [0.0, 0.0, 0.012]
    asked = []
    fixtures = []
    for f in range(2):
        fixture = vf.MeshFixture(vf.Surface.from_arrays(below, faces))
        honest = fixture.inside
        monkeypatch.setattr(
            fixture, "inside", lambda x, f=f, honest=honest: asked.append(f) or honest(x)
        )
        fixtures.append(fixture)
    controller = vf.Controller(arm, fixtures)
    goal = pin.SE3(tip.rotation, tip.translation - [0.0, 0.0, 5e-3])
    q = arm.neutral
    for _ in range(50):
        q = controller.step(q, goal).q
    assert asked == [0, 1]  # at the start only, for a checked step stays on its side
    controller.step(q + 1e-5, goal)
    assert asked == [0, 1, 0, 1]
    turned = q + 2e-5 + np.array([0.0, 0.0, 0.0, 0.1, 0.0, 0.0])
    controller.step(turned, goal)
    assert asked == [0, 1] * 3


class Aloof:
    """An arm without a chain, as one of the user's own would be."""

    def __init__(self, arm: robots.Arm) -> None:
        self.lower, self.upper, self.velocity = arm.lower, arm.upper, arm.velocity
        self.revolute, self.tip, self.kinematics = arm.revolute, arm.tip, arm.kinematics


@pytest.mark.parametrize("period", [1e-3, 2e-2])
def test_an_arm_that_answers_itself_ends_where_one_with_a_chain_does(period: float) -> None:
    """Into a pit with three walls, at full speed and at a low rate, where steps are shortened."""
    arm = robots.load("psm")
    tip = arm.tip(arm.neutral)
    rim = [[0.02 * np.cos(a), 0.02 * np.sin(a), 0.0] for a in (0.1, 2.2, 4.3)]
    pit = np.array([[0.0, 0.0, -0.02], *rim]) + tip.translation + [0.0, 0.0, 5e-3]
    surface = vf.Surface.from_arrays(pit, [[0, 1, 2], [0, 2, 3], [0, 3, 1]])
    settings = vf.Settings(dt=period)
    own, asked = (
        vf.Controller(chosen, [vf.MeshFixture(surface)], settings) for chosen in (arm, Aloof(arm))
    )
    rng = np.random.default_rng(6)
    q = arm.neutral
    statuses = set()
    for _ in range(12):
        aim = pit[0] + rng.uniform(-8e-3, 8e-3, 3)
        goal = pin.SE3(pin.exp3(0.2 * rng.normal(size=3)) @ tip.rotation, aim)
        for _ in range(12):
            one, other = own.step(q, goal), asked.step(q, goal)
            assert (one.status, one.solver) == (other.status, other.solver)
            assert len(one.planes) == len(other.planes)
            assert np.abs(one.q - other.q).max() < 1e-10
            assert np.abs(one.tip.homogeneous - other.tip.homogeneous).max() < 1e-10
            statuses.add((one.status, one.solver))
            q = one.q
    assert len(statuses) >= 3

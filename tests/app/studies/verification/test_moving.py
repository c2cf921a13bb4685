"""The campaign beside anatomy that moves: nothing is met, and what breaks the guard is seen."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

import meshes
import robots
import vf
from app.commands import call
from app.motion.declared import Tracker
from app.motion.movement import Movement
from app.studies.verification import moved, moving, swelling, wander
from app.studies.verification.moving import Passed
from meshes.builtin.damage import damage

LATE = Tracker(rate=30.0, latency=0.03, bound=0.05, stale=2.0)
SPIN = 24  # of the record of a motion: how far it turns


def driven(robot: str = "psm", mesh: str = "torus", **options: object) -> Passed:
    wanted = {
        "motion": "rigid", "guard": "tool", "radius": 5e-3, "period": 1e-3, "steps": 400, "seed": 3
    } | options  # fmt: skip
    return moving.drive(robots.load(robot), meshes.arrays(mesh), **wanted)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("motion", "robot", "guard", "period", "noise"),
    [("rigid", "psm", "tool", 1e-3, 5e-3), ("rigid", "psm", "tool", 0.02, 0.0),
     ("rigid", "ur5", "tool", 5e-3, 0.0), ("rigid", "point", None, 5e-3, 5e-3),
     ("deforming", "psm", "tool", 5e-3, 5e-3), ("deforming", "point", None, 0.02, 0.0),
     ("both", "psm", "tool", 5e-3, 0.0), ("both", "psm", None, 1e-3, 5e-3)],
)  # fmt: skip
def test_nothing_is_met_but_in_overtaken_ticks_and_then_as_deep_as_said(
    motion: str, robot: str, guard: str | None, period: float, noise: float
) -> None:
    result = driven(robot, motion=motion, guard=guard, period=period, noise=noise)
    assert result.ticks == 400
    assert result.crossings == 0, result.first
    assert result.too_deep == 0, result.first_deep
    assert result.met <= result.statuses[vf.Status.OVERTAKEN]
    assert result.statuses[vf.Status.INSIDE] == 0
    assert result.near > 100  # or nothing was tried


def test_meshes_that_are_not_closed_are_judged_too() -> None:
    mesh = damage("holes", meshes.arrays("cube"), seed=1)
    result = moving.drive(
        robots.load("psm"), mesh, motion="rigid", guard="tool", radius=5e-3, period=5e-3,
        steps=400, seed=5,
    )  # fmt: skip
    assert (result.crossings, result.too_deep) == (0, 0), result.first


def test_a_guard_that_ignores_the_motion_is_seen_to_be_crossed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    motion = vf.Motion
    monkeypatch.setattr(vf, "Motion", lambda start, _end, **more: motion(start, start, **more))
    assert driven(guard=None).crossings > 0


def test_a_guard_that_ignores_how_it_deforms_is_seen_to_be_crossed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """It knows each shape when the vertices have left it."""
    motion = vf.Motion

    def late(*poses: pin.SE3, blend: tuple[float, float]) -> vf.Motion:
        return motion(*poses, blend=(blend[0], blend[0]))

    assert driven("point", motion="deforming", guard=None, period=5e-3).crossings == 0
    monkeypatch.setattr(vf, "Motion", late)
    assert driven("point", motion="deforming", guard=None, period=5e-3).crossings > 0


def test_shapes_are_as_fast_as_said_and_no_faster() -> None:
    rng = np.random.default_rng(2)
    mesh = meshes.arrays("torus")
    fastest = []
    for period in (1e-3, 5e-3, 0.02):
        one = swelling.Swelling(mesh, period, rng)
        before = one.vertices
        for _ in range(60):
            after = one.go(int(rng.integers(len(mesh[1]))), rng.normal(size=3))
            way = np.linalg.norm(after - before, axis=1).max()
            fastest.append(way / (one.ticks * period))
            before = after
    assert 0.06 < max(fastest) <= swelling.FASTEST
    assert min(fastest) == 0.0


def test_a_guard_that_leaves_out_the_bend_of_paths_is_seen_to_be_crossed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """With next to no standoff, which hides it else."""

    def bare(start: pin.SE3, end: pin.SE3, **more: object) -> vf.Motion:
        made = motion(start, end, **more)  # type: ignore[arg-type]
        record = made.record.copy()
        record[SPIN] = 0.0
        object.__setattr__(made, "record", record)
        object.__setattr__(made, "packed", record.tobytes())
        return made

    motion = vf.Motion
    options = {"guard": None, "robot": "point", "period": 0.02, "standoff": 1e-9, "steps": 800}
    assert driven(**options).crossings == 0  # type: ignore[arg-type]
    monkeypatch.setattr(vf, "Motion", bare)
    assert driven(**options).crossings > 0  # type: ignore[arg-type]


def test_what_is_said_of_the_depth_is_judged(monkeypatch: pytest.MonkeyPatch) -> None:
    """A controller that says less than it should."""
    options = {"period": 0.02, "steps": 600}
    result = driven(**options)  # type: ignore[arg-type]
    assert result.met > 5
    assert result.too_deep == 0, result.first_deep
    step = vf.Controller.step

    def less(*args: object, **more: object) -> vf.Step:
        made = step(*args, **more)  # type: ignore[arg-type]
        return _Says(made) if made.status is vf.Status.OVERTAKEN else made  # type: ignore[return-value]

    monkeypatch.setattr(vf.Controller, "step", less)
    result = driven(**options)  # type: ignore[arg-type]
    assert result.too_deep > 0
    assert "OVERTAKEN" in result.first_deep


class _Says:
    """A step that says that nothing was met."""

    def __init__(self, step: vf.Step) -> None:
        self._step = step
        self.violation = 1e-6

    def __getattr__(self, name: str) -> object:
        return getattr(self._step, name)


@pytest.mark.parametrize(("robot", "period"), [("point", 1e-3), ("point", 0.02)])
def test_a_late_tracker_with_a_true_bound_keeps_the_tool_off_the_true_mesh(
    robot: str, period: float
) -> None:
    result = driven(robot, guard=None, period=period, tracker=LATE, steps=800)
    assert result.crossings == result.late == result.met == 0, result.first
    assert max(result.margins) > 2.9e-3
    assert not result.stale


@pytest.mark.parametrize("part", ["margin", "growth"])
def test_a_margin_that_does_not_grow_with_the_age_is_seen(
    monkeypatch: pytest.MonkeyPatch, part: str
) -> None:
    """Without it the mesh crosses the tool; one that does not lead out is not kept."""
    during = Movement.during

    def without(self: Movement, start: float, end: float) -> object:
        told = during(self, start, end)
        (one,) = told.motions
        assert one is not None
        made = vf.Motion(one.start, one.end, one.margin * (part != "margin"))
        return replace(told, motions=(made,))

    monkeypatch.setattr(Movement, "during", without)
    result = driven("point", guard=None, tracker=LATE, period=5e-3, steps=800, seed=4)
    assert (result.crossings if part == "margin" else result.met) > 0


@pytest.mark.parametrize(
    ("mesh", "radius", "noise", "seed"),
    [("torus", None, 5e-3, 5000), ("cone", 5e-3, 5e-3, 4001), ("gyroid", 5e-3, 0.0, 13001)],
)
def test_the_whole_instrument_is_led_out_at_low_rates_before_a_late_tracker_tells(
    mesh: str, radius: float | None, noise: float, seed: int
) -> None:
    """Drives in which a shaft was led out where it could not go, or after the bend of its step."""
    result = driven(
        mesh=mesh, radius=radius, noise=noise, seed=seed, tracker=LATE, period=0.02, steps=200
    )
    assert result.crossings == result.late == result.met == 0, result.first
    assert result.near > 50  # or nothing was tried


@pytest.mark.parametrize("motion", ["deforming", "both"])
def test_a_late_tracker_of_what_deforms_keeps_the_tool_off_its_true_shape(motion: str) -> None:
    result = driven("point", motion=motion, guard=None, tracker=LATE, period=5e-3, steps=500)
    assert result.crossings == result.late == result.met == 0, result.first
    assert result.near > 100


def test_a_guard_that_is_not_told_of_new_shapes_is_seen_to_be_crossed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    at = swelling.Swelling.at
    monkeypatch.setattr(swelling.Swelling, "at", lambda self, _time: at(self, 0.0))
    result = driven(
        "point", motion="deforming", guard=None, tracker=LATE, period=5e-3, steps=800
    )  # fmt: skip
    assert result.crossings > 0


@pytest.mark.slow
def test_two_workers_find_what_one_process_finds() -> None:
    sources = {name: meshes.arrays(name) for name in ("torus", "stairs")}
    campaign = moved.Campaign(
        {"point": (robots.load("point"), 240)}, sources, ("none",), (5e-3,), ("rigid", "both"),
        None, "certified", 5e-3, None, 0,
    )  # fmt: skip
    one, two = moved.Findings(), moved.Findings()
    done: list[int] = []
    moved.run(campaign, one, lambda _case: None, lambda _ticks: None)
    moved.run(campaign, two, lambda _case: None, done.append, workers=2)
    assert sum(done) == campaign.work
    assert len(one.drives) == len(two.drives) == 4
    for (*here, a), (*there, b) in zip(one.drives, two.drives, strict=True):
        assert here == there
        assert replace(a, times=[]) == replace(b, times=[])


def test_what_moves_keeps_to_its_speeds_and_comes_back() -> None:
    rng = np.random.default_rng(0)
    aim = wander.Aim(np.array([0.1, 0.0, 0.0]), np.array([0.0, 0.0, 1.0]), 0.0, 0)
    moves = wander.twists(rng, aim, 1e-3)
    velocities, turns = map(np.array, zip(*(next(moves) for _ in range(20_000)), strict=True))
    speeds = np.linalg.norm(velocities, axis=1)
    assert 0.15 < speeds.max() <= wander.FASTEST
    assert 1.5 < np.linalg.norm(turns, axis=1).max() <= wander.FASTEST_TURN
    assert (speeds == 0.0).any()  # stops
    assert (np.einsum("ij,ij->i", velocities[1:], velocities[:-1]) < 0.0).mean() > 0.05  # reversals
    aim.distance = 0.02
    far = np.array([next(moves)[0] for _ in range(20_000)])[2_000:]
    assert np.mean(far @ aim.towards) > 0.01


def test_the_truth_is_known_at_any_time_and_a_twist_is_that_of_a_place() -> None:
    rng = np.random.default_rng(1)
    truth = wander.Truth(pin.SE3.Random())
    place, velocity, turn = rng.normal(size=(3, 3))
    twist = wander.body_twist(truth.now, place, velocity, turn)
    before = truth.now.actInv(place)
    h = 1e-6
    after = (truth.now * pin.exp6(h * twist)).act(before)
    np.testing.assert_allclose((after - place) / h, velocity, atol=1e-4)
    first = truth.now
    truth.go(twist, 0.01)
    truth.go(2.0 * twist, 0.02)
    assert truth.pose(0.005) == first * pin.exp6(0.005 * twist)
    assert truth.pose(0.02).isApprox(first * pin.exp6(0.03 * twist), 1e-9)
    assert truth.pose(9.0) == truth.now
    radius, bound = 0.07, 0.05
    slow = wander.slowed(50.0 * twist, radius, bound)
    marks = radius * np.array([rng.normal(size=3) for _ in range(500)])
    marks /= np.maximum(np.linalg.norm(marks, axis=1, keepdims=True) / radius, 1e-12)
    speeds = np.linalg.norm(slow[:3] + np.cross(slow[3:], marks), axis=1)
    assert 0.3 * bound < speeds.max() <= bound


def test_the_command_moves_the_mesh(capsys: pytest.CaptureFixture[str]) -> None:
    words = ["--robot", "psm", "--mesh", "torus", "--damage", "none", "--steps", "120"]
    assert call("verify", [*words, "--motion", "rigid", "--guard", "tool"]) == 0
    out = " ".join(capsys.readouterr().out.split())
    assert "whole instrument, guard tool, motion rigid" in out
    assert "0 crossings, 0 contacts led out too late, 0 ticks deeper than said" in out
    late = ["--tracker", "30", "--latency", "0.02", "--bound", "20mm/s"]
    assert call("verify", [*words, "--motion", "rigid", *late]) == 0
    assert "tracked at 30 Hz" in " ".join(capsys.readouterr().out.split())
    assert call("verify", [*words, *late]) == 2
    assert "a tracker is of --motion" in capsys.readouterr().err
    assert call("verify", [*words, "--workers", "2"]) == 2
    assert "workers are of --motion" in capsys.readouterr().err
    assert call("verify", [*words, "--motion", "rigid", "--outside"]) == 2
    assert call("verify", [*words, "--motion", "sideways"]) == 2


@pytest.mark.slow
@pytest.mark.parametrize(
    ("robot", "kind", "motion"),
    [("psm", "none", "both"), ("psm", "slivers", "rigid"), ("panda", "none", "rigid"),
     ("ur5", "slivers", "both"), ("point", "none", "both"), ("point", "slivers", "rigid")],
)  # fmt: skip
def test_nothing_is_met_in_long_campaigns(robot: str, kind: str, motion: str) -> None:
    for number, period in enumerate((1e-3, 5e-3, 0.02)):
        mesh = damage(kind, meshes.arrays(("gear", "thin-plate", "stairs")[number]), seed=1)
        result = moving.drive(
            robots.load(robot), mesh, motion=motion, guard="tool", radius=(5e-3, None)[number % 2],
            period=period, steps=1_500, seed=number, noise=5e-3 * (number % 2),
        )  # fmt: skip
        assert (result.crossings, result.too_deep) == (0, 0), (result.first, result.first_deep)

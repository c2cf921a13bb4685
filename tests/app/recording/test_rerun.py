"""The same commands give the same joints, to the bit."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pinocchio as pin
import pytest

import meshes
import robots
import vf
from app.control.messages import Command, Telemetry
from app.judges import boxes, oracles
from app.scene import scene as scenes
from app.session import Session
from app.settings import Options
from tests.support.brute import Oracle
from tests.support.everyday import everyday
from tests.support.headless import moved, wait_until
from tests.support.runs import run_headless


def joints(run: list[Telemetry]) -> bytes:
    return np.array([telemetry.q for telemetry in run]).tobytes()


def wandering(start: pin.SE3, count: int, seed: int) -> Iterator[Command]:
    """Jumps, rotations, silence, clutch and drags around and below the start."""
    rng = np.random.default_rng(seed)
    for k in range(1, count + 1):
        if k % 25 != 1:
            yield None  # type: ignore[misc]
            continue
        target = pin.SE3(
            start.rotation @ pin.exp3(0.3 * rng.standard_normal(3)),
            start.translation + rng.uniform([-0.02, -0.02, -0.03], [0.02, 0.02, 0.005]),
        )
        yield Command(target, k, clutch=k % 150 == 1, held=k % 100 == 1)


@pytest.mark.parametrize(("mesh", "robot"), [("gear", "point"), ("stairs", "psm")])
@pytest.mark.parametrize("rule", ["certified", "paper"])
def test_two_runs_of_the_same_commands_are_bit_identical(mesh: str, robot: str, rule: str) -> None:
    options = Options(mesh=mesh, robot=robot, rule=rule)
    start = run_headless(options, [], 1)[0].step
    assert start is not None
    runs = [run_headless(options, wandering(start.tip, 900, seed=7), 900) for _ in range(2)]
    assert joints(runs[0]) == joints(runs[1])
    other = run_headless(options, wandering(start.tip, 900, seed=8), 900)
    assert joints(other) != joints(runs[0])
    # It was a run worth repeating: free, in contact, held and clutched.
    met = [t.step for t in runs[0] if t.step is not None]
    assert any(len(step.planes) for step in met)
    assert any(t.target is None for t in runs[0])


def test_the_autopilot_repeats_itself() -> None:
    options = Options(mesh="cube", robot="psm")
    first, second = (run_headless(options, [], 1500, autopilot=True) for _ in range(2))
    assert joints(first) == joints(second)
    assert np.ptp([t.q for t in first], axis=0).max() > 1e-3


def tip_path(options: Options, run: list[Telemetry]) -> np.ndarray:
    """Where the tip was after every tick, by an arm of our own."""
    arm = robots.load(options.robot)
    return np.array([arm.tip(telemetry.q).translation for telemetry in run])


def check_tour(options: Options) -> None:
    """A whole tour of the autopilot, every tick of it against the whole mesh."""
    scene = scenes.build(options, 1)
    ticks = int(scene.autopilot.duration / options.dt)
    run = run_headless(options, [], ticks, autopilot=True)
    truth = Oracle(scene.surface.vertices, scene.surface.faces)
    path = tip_path(options, run)
    assert truth.crossings(path) == 0
    # The oracle would have noticed: the proxy itself goes in and out.
    proxy = np.array([telemetry.target.translation for telemetry in run])
    assert truth.crossings(proxy) >= 4
    # And the tool did not just stay away: at the end, with the proxy outside, it is there too, or
    # the surface is between them (one skull has a slit, and the tool may have slipped through).
    last = np.array([path[-1], proxy[-1]])
    assert np.linalg.norm(last[0] - last[1]) < 1e-3 or truth.crossings(last) == 1
    assert {telemetry.step.status for telemetry in run if telemetry.step} <= {
        vf.Status.SOLVED,
        vf.Status.SHORTENED,
        vf.Status.RECOVERING,
    }


@pytest.mark.parametrize("mesh", everyday(["gear", "thin-plate"], "thin-plate"))
def test_the_tool_stays_out_for_a_whole_tour(mesh: str) -> None:
    check_tour(Options(mesh=mesh))


def test_the_tour_of_the_first_sight_keeps_the_standoff() -> None:
    """As docs/guide.md says; by the judges' distance, which the planes have nothing to do with."""
    options = Options()
    scene = scenes.build(options, 1)
    run = run_headless(options, [], int(scene.autopilot.duration / options.dt), autopilot=True)
    around, near = boxes.of(scene.surface), 0
    for p in tip_path(options, run):
        triangles = boxes.near(around, p, p, 2.0 * options.standoff)
        if len(triangles):
            distance = oracles.distances(scene.surface, triangles, p).min()
            assert distance >= options.standoff
            near += distance < 2.0 * options.standoff
    assert near > 100  # it is pressed on the surface


TOURS = ("psm", None), ("psm", 5e-4), ("psm", 5e-3), ("point", 5e-3), ("panda", 5e-3), ("ur5", 5e-3)


@pytest.mark.slow
# Every mesh with two of them, in turn.
# Without the pre-cut skull: the tour may lead the tool through its open slot, where a tool that is
# still below when the proxy has left is right, and "follows when free" is the wrong question.
@pytest.mark.parametrize(
    ("mesh", "robot", "radius"),
    [
        (mesh, *TOURS[k])
        for number, mesh in enumerate(name for name in meshes.names() if name != "skull-precut")
        for k in (number % 3, 3 + number % 3)
    ],
)
def test_the_tool_stays_out_of_everything_with_every_arm(
    mesh: str, robot: str, radius: float | None
) -> None:
    # The judge looks at the tip; `verify --guard tool` judges every part of the instrument.
    check_tour(Options(mesh=mesh, robot=robot, radius=radius, guard="tip"))


def test_a_live_session_is_repeated_from_its_record(tapes: list) -> None:
    options = Options(mesh="saddle-slab", robot="psm")
    with Session(options) as session:
        start = session.scene.T_base_start
        for dx, dz in ((0.004, -0.02), (-0.01, -0.025), (0.02, -0.018), (0.0, 0.004)):
            tick = session.latest().tick
            session.drive(moved(start, dx=dx, dz=dz))
            wait_until(lambda tick=tick: session.latest().tick > tick + 150)
    live = tapes[1].items[1:]
    commands = [Command(t.target, t.sequence) for t in live]
    assert joints(run_headless(options, commands, len(commands))) == joints(live)

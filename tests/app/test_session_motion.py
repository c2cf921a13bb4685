"""Sessions in which structures move: what the guard is told, orders, recordings, replays."""

from __future__ import annotations

import itertools
import warnings
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

import vf
from app.control.engine import Engine, Orders
from app.control.messages import Command, LoopStats, Telemetry
from app.motion.declared import Motion, Tracker
from app.options import parse_as
from app.recording import rerun
from app.recording.format import RecordingError
from app.recording.playback import Player, build_scenes
from app.recording.read import read
from app.recording.write import Recorder
from app.scenarios.file import Scenario, ScenarioError, dumps, loads, write
from app.scenarios.file import read as read_scenario
from app.scene import scene as scenes
from app.scene.scene import Scene
from app.session import Session
from app.settings import Options
from app.words import OptionError, Refused
from tests.support import structured
from tests.support.headless import wait_until

LIFT = Motion("breathing", move=(0.0, 0.0, 0.006), period=0.5)
LATE = Tracker(rate=50.0, latency=0.04, bound=0.06)
STATS = LoopStats()
# Of a breath, by its sentence in `app.motion.declared`: twelve millimetres in a second, at most
# 4.88 times that.
STEEPEST = 4.88


def options(**more: Any) -> Options:
    return Options(**{"mesh": "cube", "robot": "point", "motions": (LIFT,), **more})


@pytest.fixture(scope="module")
def cube() -> Scene:
    return scenes.build(options(), 1)


@pytest.fixture(scope="module")
def tracked() -> Scene:
    return scenes.build(options(tracker=LATE), 1)


class Run:
    """An engine tick by tick, with what its controller was told."""

    def __init__(self, scene: Scene, **orders: Any) -> None:
        self.scene = scene
        self.plant = scenes.plant(scene, scene.options)
        self.orders = Orders(self.plant, Command(None, 0), **orders)
        self.engine = Engine(self.orders)
        self.told: list[list[vf.Motion | None] | None] = []
        step = self.plant.controller.step

        def listening(q: Any, target: Any, motions: Any = None) -> vf.Step:
            self.told.append(motions)
            return step(q, target, motions)

        self.plant.controller.step = listening  # type: ignore[method-assign]
        self.seen: list[Telemetry] = []

    def go(self, ticks: int, target: pin.SE3 | None = None, **orders: Any) -> None:
        if target is not None:
            orders["command"] = Command(target, self.orders.command.sequence + 1)
        self.orders = replace(self.orders, **orders)
        for _ in range(ticks):
            self.seen.append(self.engine.advance(self.orders, STATS)[0])

    def heights(self) -> np.ndarray:
        """Of the tip above the cube's top where it truly is, after every tick [m]."""
        top = self.scene.surface.vertices[:, 2].max()
        found = []
        for telemetry in self.seen:
            assert telemetry.step is not None
            lift = 0.006 * np.sin(np.pi * telemetry.phase / 0.5) ** 6
            found.append(telemetry.step.tip.translation[2] - top - lift)
        return np.array(found)


def deep(scene: Scene) -> pin.SE3:
    """A pose inside the cube, straight below the start."""
    start = scene.T_base_start
    middle = scene.surface.vertices.mean(axis=0)
    return pin.SE3(start.rotation, np.array([*start.translation[:2], middle[2]]))


def test_the_tool_leans_on_the_moving_cube_and_never_goes_in(cube: Scene) -> None:
    run = Run(cube)
    run.go(1500, deep(cube))
    heights = run.heights()
    assert heights.min() > 0.0
    assert heights[600:].max() < 1e-3  # it follows it down again
    tips = np.array([t.step.tip.translation[2] for t in run.seen[600:] if t.step is not None])
    assert np.ptp(tips) > 5e-3


def test_each_tick_begins_with_the_very_pose_that_the_last_one_ended_with(cube: Scene) -> None:
    run = Run(cube)
    run.go(300, deep(cube))
    told = [one[0] for one in run.told if one is not None]
    assert len(told) == 300
    for before, after in itertools.pairwise(told):
        assert before is not None
        assert after is not None
        assert before.record[12:24].tobytes() == after.record[:12].tobytes()
    assert told[-1] is not None
    rise = 0.006 * np.sin(np.pi * 0.3 / 0.5) ** 6
    assert told[-1].end.translation == pytest.approx([0.0, 0.0, rise], abs=1e-12)


def test_rest_and_pace_are_orders(cube: Scene) -> None:
    run = Run(cube)
    run.go(10)
    run.go(10, pace=2.0)
    run.go(10, moving=False)
    phases = [telemetry.phase for telemetry in run.seen]
    assert phases[9] == pytest.approx(0.010)
    assert phases[19] == pytest.approx(0.030)
    assert phases[19:] == [phases[19]] * 11
    assert [t.phase_before for t in run.seen[1:]] == phases[:-1]
    run.go(1, moving=True, pace=1.0, resets=1)
    assert run.seen[-1].phase == pytest.approx(0.001)


@pytest.mark.parametrize("hold", ["clutch", "stale hand"])
def test_a_tool_that_is_held_yields_to_what_comes(cube: Scene, hold: str) -> None:
    run = Run(cube)
    run.go(150, deep(cube), moving=False)
    low = run.heights()[-1]
    assert low < 1e-4
    command = run.orders.command
    if hold == "clutch":
        run.go(1, command=replace(command, sequence=command.sequence + 1, clutch=True))
    else:
        run.go(600, command=replace(command, sequence=command.sequence + 1, held=True))
        assert run.seen[-1].stale
        assert run.seen[-1].step is not None
        assert run.seen[-1].step.status is vf.Status.HELD
    began = len(run.seen)
    run.go(250, moving=True)  # up to the top of the breath
    assert run.heights()[began:].min() > 0.0
    last = run.seen[-1].step
    assert last is not None
    assert last.tip.translation[2] - cube.surface.vertices[:, 2].max() == pytest.approx(
        0.006, abs=2e-4
    )
    assert np.linalg.norm(last.force) == 0.0


def test_a_late_tracker_with_a_true_bound_never_lets_the_tool_touch(tracked: Scene) -> None:
    assert LATE.bound > STEEPEST * 0.006 / 0.5
    run = Run(tracked)
    run.go(2500, deep(tracked))
    assert run.heights().min() > 0.0
    told = [one[0] for one in run.told if one is not None and one[0] is not None]
    margins = np.array([one.margin for one in told[200:]])
    # From as old as the latency to older by a period of the tracker.
    assert margins.min() == pytest.approx(LATE.bound * 0.04, rel=0.05)
    assert margins.max() == pytest.approx(LATE.bound * 0.06, rel=0.05)


@pytest.mark.parametrize(
    "changes",
    [
        {"noise": 2e-4, "dropouts": 0.5},
        {"noise": 1e-4, "dropouts": 0.2, "predictor": "periodic", "period": 0.5},
        {"rate": 7.0, "latency": 0.0, "seed": 3},
    ],
    ids=["noisy", "predicted", "rare"],
)
def test_nor_does_a_noisy_one_that_misses_much(changes: dict[str, Any]) -> None:
    scene = scenes.build(options(tracker=replace(LATE, **changes)), 1)
    run = Run(scene)
    run.go(3000, deep(scene))
    assert run.heights().min() > 0.0
    # What is seen displaced by noise is somewhere else at once, its margin with it: until the tool
    # has left that, the cube may be in it for all that is known.
    most = max(run.plant.movement().margin(t.phase) for t in run.seen)
    late = [t.step for t in run.seen if t.step and t.step.status == vf.Status.OVERTAKEN]
    assert all(0.0 < step.violation <= most for step in late)


def test_with_a_bound_of_nothing_it_is_touched() -> None:
    """That the test above can fail."""
    scene = scenes.build(options(tracker=replace(LATE, bound=0.0)), 1)
    assert any("declared as 0 mm/s" in note for note in scene.notes)
    run = Run(scene)
    run.go(1000, deep(scene))
    assert run.heights().min() < -1e-4


def test_while_a_structure_was_seen_too_long_ago_the_tool_holds(cube: Scene) -> None:
    blind = Tracker(rate=0.5, latency=0.0, bound=0.06, stale=0.2)
    scene = scenes.build(options(tracker=blind), 1)
    run = Run(scene)
    run.go(400, deep(scene))
    lost = [telemetry.lost for telemetry in run.seen]
    assert not any(lost[:195])
    assert all(lost[205:])
    tips = np.array([t.step.tip.translation for t in run.seen if t.step is not None])
    assert np.ptp(tips[210:], axis=0).max() < 1e-9
    assert {t.step.status for t in run.seen[210:] if t.step is not None} == {vf.Status.HELD}
    # It stops growing, so that the tool is not led away for ever.
    assert max(one[0].margin for one in run.told if one and one[0]) <= blind.most + 1e-12


def test_only_what_is_named_moves_and_an_unknown_name_is_refused(tmp_path: Path) -> None:
    folder = structured.balls(tmp_path / "balls")
    motion = replace(LIFT, of="nerve")
    scene = scenes.build(structured.options(folder, motions=(motion,)), 1)
    assert [course is not None for course in scene.courses] == [False, False, True, False]
    run = Run(scene)
    run.go(3)
    assert run.told[-1] is not None
    assert [one is not None for one in run.told[-1]] == [False, False, True, False]
    with pytest.raises(OptionError, match=r"'liver'.*choose from cube, dura, nerve, vessel"):
        scenes.build(structured.options(folder, motions=(replace(LIFT, of="liver"),)), 1)


def test_structures_that_move_alike_share_a_course_about_the_middle_of_the_mesh(
    tmp_path: Path,
) -> None:
    folder = structured.balls(tmp_path / "balls")
    turn = Motion("shift", turn=(0.0, 0.0, 0.3), period=1.0)
    scene = scenes.build(structured.options(folder, motions=(turn,)), 1)
    assert len({id(course) for course in scene.courses}) == 1
    vertices = scene.surface.vertices
    middle = 0.5 * (vertices.min(axis=0) + vertices.max(axis=0))
    course = scene.courses[0]
    assert course is not None
    assert course.pose(1.0).act(middle) == pytest.approx(middle)


# Options, scenario files


def test_motions_and_tracker_are_given_on_the_command_line() -> None:
    words = (
        "--mesh liver --motion breathing --move 0,0,10mm --period 4 --of liver "
        "--motion knock --move 1mm,0,0 --tracker 20 --latency 0.1 --bound 20mm/s --margin 2mm"
    )
    found = parse_as(Options, "test", words.split())
    assert found.motions == (
        Motion("breathing", move=(0.0, 0.0, 0.01), period=4.0, of="liver"),
        Motion("knock", move=(0.001, 0.0, 0.0)),
    )
    assert found.tracker == Tracker(20.0, latency=0.1, bound=0.02)
    assert found.margin == pytest.approx(0.002)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        off = parse_as(Options, "test", ["--tracker", "off"], default=found)
    assert off.tracker is None
    assert off.motions == found.motions


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (
            "--motion sneeze",
            "choose one of breathing, heartbeat, shift, knock, poses, deforming, vertices",
        ),
        ("--motion breathing --period 0", "period 0 s is outside"),
        ("--tracker 30 --bound 9m/s", "bound 9 m/s is outside"),
        ("--tracker 30 --predictor crystal", "choose one of off, periodic"),
        ("--motion poses", "needs a file"),
    ],
)
def test_bad_words_are_refused_with_what_is_valid(words: str, told: str) -> None:
    with pytest.raises(OptionError) as refusal:
        parse_as(Options, "test", words.split())
    assert told in str(refusal.value)


def test_a_scenario_file_has_them_and_its_files_are_beside_it(tmp_path: Path) -> None:
    table(tmp_path / "poses.csv")
    poses = Motion("poses", file=str(tmp_path / "poses.csv"))
    scenario = Scenario("a", "b.", options(motions=(LIFT, poses), tracker=LATE))
    write(scenario, tmp_path / "mine.json")
    assert read_scenario(tmp_path / "mine.json") == scenario
    assert '"file": "poses.csv"' in (tmp_path / "mine.json").read_text()
    text = dumps(scenario).replace("poses.csv", "../poses.csv")
    with pytest.raises(ScenarioError, match="may not lead out"):
        loads(text, tmp_path)


# Recordings


def table(path: Path, rise: float = 4.0) -> None:
    path.write_text(f"t,x,y,z\n0,0,0,0\n0.1,0,0,{rise}\n0.2,0,0,0\n")


@pytest.fixture(params=[False, True], ids=["thread", "process"])
def session(request: pytest.FixtureRequest) -> Iterator[Session]:
    with Session(options(tracker=LATE), process=request.param) as running:
        yield running


def test_a_session_moves_its_structures_and_its_recording_repeats_bit_for_bit(
    session: Session, tmp_path: Path
) -> None:
    wait_until(lambda: session.latest().phase > 0.05)
    session.drive(deep(session.scene))
    session.record(tmp_path / "run.vfrec")
    wait_until(lambda: session.latest().phase > 0.4)
    session.move_structures(pace=2.0)
    wait_until(lambda: session.latest().phase > 1.0)
    session.move_structures(on=False)
    tick = session.latest().tick
    wait_until(lambda: session.latest().tick > tick + 50)
    rested = session.latest().phase
    session.set(tip_radius=1e-4)  # another plant, the same motion
    wait_until(lambda: session.latest().tick > tick + 100)
    assert session.latest().phase == rested
    session.reset()
    session.move_structures(on=True, pace=1.0)
    wait_until(lambda: 0.0 < session.latest().phase < 0.4)
    session.stop_recording()
    assert session.contacts == 0
    recording = read(tmp_path / "run.vfrec")
    assert {0.0, 1.0} >= set(recording.orders["moving"].tolist())
    assert set(recording.orders["pace"].tolist()) == {1.0, 2.0}
    assert recording.state.phase > 0.0
    assert rerun.first_difference(recording) is None
    # A replay shows structures where they were.
    player = Player(recording, build_scenes(recording, 1, like=session.scene))
    for row in (3, len(player) // 2, len(player) - 1):
        moment, phase = player.moment(row), float(recording.rows["phase"][row])
        lift = 0.006 * np.sin(np.pi * phase / 0.5) ** 6
        pose = moment.pose(0)
        assert pose is not None
        assert pose.translation == pytest.approx([0.0, 0.0, lift], abs=1e-12)
        assert moment.telemetry.phase == phase
        assert moment.places.margin > 0.0


def test_a_pace_that_is_no_number_from_0_to_2_is_refused(cube: Scene) -> None:
    with Session(cube.options, scene=cube) as running:
        for pace in (-0.1, 2.1, float("nan")):
            with pytest.raises(Refused, match="pace"):
                running.move_structures(pace=pace)
        assert running.motion == (True, 1.0)


def test_a_repetition_that_moves_otherwise_is_found_out(cube: Scene, tmp_path: Path) -> None:
    run = Run(cube)
    recorder = Recorder(tmp_path / "run.vfrec")
    recorder.begin(run.engine.seen, run.engine.state)
    orders = replace(run.orders, command=Command(deep(cube), 1))
    for _ in range(200):
        recorder.add(orders, *run.engine.advance(orders, STATS))
    recorder.close()
    recording = read(recorder.path)
    assert rerun.first_difference(recording) is None
    faster = replace(recording, orders=recording.orders.copy())
    faster.orders["pace"] = 1.5
    found = rerun.first_difference(faster)
    assert found is not None
    assert found.row == 0


def test_a_file_of_poses_is_told_by_its_content(tmp_path: Path) -> None:
    path = tmp_path / "poses.csv"
    table(path)
    scene = scenes.build(options(motions=(Motion("poses", file=str(path)),)), 1)
    run = Run(scene)
    recorder = Recorder(tmp_path / "run.vfrec")
    recorder.begin(run.engine.seen, run.engine.state)
    for _ in range(120):
        recorder.add(run.orders, *run.engine.advance(run.orders, STATS))
    recorder.close()
    recording = read(recorder.path)
    assert rerun.first_difference(recording) is None
    table(path, 5.0)
    with pytest.raises(RecordingError, match=r"poses of '.*' are not those that were recorded"):
        rerun.first_difference(recording)


def test_a_structure_that_gets_another_name_is_moved_on(tmp_path: Path) -> None:
    folder = structured.balls(tmp_path / "balls")
    wanted = structured.options(folder, motions=(replace(LIFT, of="nerve"),))
    with Session(wanted) as running:
        running.set_structure(2, name="facial nerve")
        assert running.options.motions[0].of == "facial nerve"
        running.change(robot="psm")
        assert [course is not None for course in running.scene.courses] == [
            False, False, True, False,
        ]  # fmt: skip

"""Sessions in which structures change their shape: guard, watch, recordings, replays, the page."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

import meshes
import vf
from app.control.engine import Engine, Orders
from app.control.messages import Command, LoopStats, Telemetry
from app.control.watch import Watch
from app.motion.declared import Motion, Tracker
from app.recording import rerun
from app.recording.format import RecordingError
from app.recording.playback import Player, build_scenes
from app.recording.read import read
from app.recording.write import Recorder
from app.scene import scene as scenes
from app.scene.scene import Scene
from app.session import Session
from app.settings import Options
from app.words import OptionError
from tests.support import naive
from tests.support.headless import wait_until

BEAT = Motion("deforming", period=0.4, amplitude=0.6)
FRAME, REST = 0.02, 0.002  # from shape to shape, and at a shape [s], by docs/motion.md


def options(**more: Any) -> Options:
    return Options(**{"mesh": "vessel", "robot": "point", "motions": (BEAT,), **more})


@pytest.fixture(scope="module")
def vessel() -> Scene:
    return scenes.build(options(), 1)


def true_shape(scene: Scene, time: float) -> np.ndarray:
    """Vertices at a time, by the sentence of docs/motion.md."""
    one = meshes.deforming("vessel")

    def shape(number: int) -> np.ndarray:
        moved = one.shape(number * FRAME / 0.4) - one.vertices
        return (one.vertices + 0.6 * moved) @ scene.T_base_mesh[:3, :3].T + scene.T_base_mesh[:3, 3]

    number = int(time / FRAME + 1e-9)
    share = np.clip((time - number * FRAME - REST) / (FRAME - REST), 0.0, 1.0)
    return (1.0 - share) * shape(number) + share * shape(number + 1)


class Run:
    """An engine tick by tick, and the watch beside it."""

    def __init__(self, scene: Scene, wanted: Options | None = None) -> None:
        self.scene = scene
        self.plant = scenes.plant(scene, wanted or scene.options)
        self.orders = Orders(self.plant, Command(None, 0))
        self.engine, self.watch = Engine(self.orders), Watch()
        self.seen: list[Telemetry] = []

    def go(self, ticks: int, target: pin.SE3 | None = None, **orders: Any) -> None:
        if target is not None:
            orders["command"] = Command(target, self.orders.command.sequence + 1)
        self.orders = replace(self.orders, **orders)
        for _ in range(ticks):
            telemetry, ticked = self.engine.advance(self.orders, LoopStats())
            self.watch.take(self.orders, telemetry, ticked)
            self.seen.append(telemetry)
        self.watch.look()

    def gap(self, telemetry: Telemetry) -> float:
        """Of the tip from the true shape, by brute force [m]."""
        assert telemetry.step is not None
        vertices = true_shape(self.scene, telemetry.phase)
        p = telemetry.step.tip.translation
        return float(naive.closest(vertices[self.scene.surface.faces], p)[1].min())


def deep(scene: Scene) -> pin.SE3:
    """A pose inside the vessel, below the start."""
    start = scene.T_base_start
    vertices = scene.surface.vertices
    near = vertices[np.linalg.norm(vertices[:, :2] - start.translation[:2], axis=1) < 8e-3]
    return pin.SE3(start.rotation, np.array([*start.translation[:2], near[:, 2].mean()]))


def test_the_tool_rides_on_a_vessel_that_swells_and_never_touches_it(vessel: Scene) -> None:
    run = Run(vessel)
    run.go(900, deep(vessel))
    gaps = np.array([run.gap(telemetry) for telemetry in run.seen[::7]])
    assert gaps.min() > 10e-6
    assert np.median(gaps[60:]) < 200e-6  # it leans on it
    tips = np.array([t.step.tip.translation for t in run.seen[400:] if t.step is not None])
    assert np.ptp(tips, axis=0).max() > 3e-4
    assert run.watch.contacts == 0
    assert {t.step.status for t in run.seen if t.step is not None} <= {
        vf.Status.SOLVED, vf.Status.SHORTENED, vf.Status.RECOVERING,
    }  # fmt: skip


def test_a_tool_that_rests_is_seen_to_be_touched_where_nothing_guards_it(vessel: Scene) -> None:
    """The vessel comes to the tool: the watch knows the true shape."""
    start = Run(vessel)
    start.go(300, deep(vessel), moving=False)
    held = start.seen[-1]
    assert held.step is not None
    run = Run(vessel, replace(vessel.options, rule="off"))
    for _ in range(3):
        run.go(100, held.step.tip)
    assert run.watch.contacts > 0
    assert run.watch.crossing is not None


def test_a_late_tracker_with_a_true_bound_never_lets_the_tool_touch() -> None:
    late = Tracker(rate=25.0, latency=0.04, bound=0.06)
    scene = scenes.build(options(tracker=late), 1)
    assert not [note for note in scene.notes if "declared" in note]
    run = Run(scene)
    run.go(1200, deep(scene))
    gaps = np.array([run.gap(telemetry) for telemetry in run.seen[::13]])
    assert gaps.min() > 0.0
    assert run.watch.contacts == 0


def test_a_scene_that_can_be_faster_than_the_bound_says_so() -> None:
    scene = scenes.build(options(tracker=Tracker(bound=1e-3)), 1)
    assert any("declared as 1 mm/s" in note for note in scene.notes)
    with pytest.raises(OptionError, match="predictor periodic is of poses"):
        options(tracker=Tracker(predictor="periodic"))


def test_another_plant_goes_on_with_the_same_shape(vessel: Scene) -> None:
    run = Run(vessel)
    run.go(333, deep(vessel))
    run.go(0, plant=scenes.plant(vessel, replace(vessel.options, tip_radius=1e-4)))
    run.go(60)
    assert run.watch.contacts == 0
    assert run.gap(run.seen[-1]) > 1e-4


@pytest.fixture(params=[False, True], ids=["thread", "process"])
def session(request: pytest.FixtureRequest) -> Iterator[Session]:
    tracked = options(tracker=Tracker(rate=40.0, latency=0.03, bound=0.06))
    with Session(tracked, process=request.param) as running:
        yield running


def test_a_recording_repeats_bit_for_bit_and_a_replay_shows_the_shapes(
    session: Session, tmp_path: Path
) -> None:
    wait_until(lambda: session.latest().phase > 0.05)
    session.drive(deep(session.scene))
    session.record(tmp_path / "run.vfrec")
    wait_until(lambda: session.latest().phase > 0.4)
    session.move_structures(pace=2.0)
    wait_until(lambda: session.latest().phase > 0.9)
    session.reset()
    wait_until(lambda: 0.0 < session.latest().phase < 0.4)
    session.stop_recording()
    assert session.contacts == 0
    recording = read(tmp_path / "run.vfrec")
    assert rerun.first_difference(recording) is None
    player = Player(recording, build_scenes(recording, 1, like=session.scene))
    for row in (3, len(player) // 2, len(player) - 1):
        moment, phase = player.moment(row), float(recording.rows["phase"][row])
        wanted = true_shape(session.scene, phase)
        assert moment.shape(0) == pytest.approx(wanted, abs=1e-12)
        assert moment.structures[0].surface.vertices == pytest.approx(wanted, abs=1e-12)
        believed = moment.shape(0, believed=True)
        assert believed is not None
        assert np.abs(believed - wanted).max() < 5e-3
        assert moment.telemetry.step is not None


def test_a_file_of_vertices_moves_a_structure_and_is_told_by_its_content(tmp_path: Path) -> None:
    path = tmp_path / "cube.npz"
    rest = meshes.arrays("cube")[0]

    def write(size: float) -> None:
        sizes = 1.0 + size * np.array([0.0, 1.0, 0.0])
        np.savez(path, times=[0.0, 0.1, 0.2], vertices=1e3 * sizes[:, None, None] * rest)

    write(0.02)
    wanted = Options(mesh="cube", robot="point", motions=(Motion("vertices", file=str(path)),))
    scene = scenes.build(wanted, 1)
    run = Run(scene)
    recorder = Recorder(tmp_path / "run.vfrec")
    recorder.begin(run.engine.seen, run.engine.state)
    for _ in range(120):
        recorder.add(run.orders, *run.engine.advance(run.orders, LoopStats()))
    recorder.close()
    course = scene.courses[0]
    assert course is not None
    assert course.form is not None
    size = np.ptp(course.form.vertices(0.1), axis=0) / np.ptp(scene.surface.vertices, axis=0)
    assert size == pytest.approx(1.02, abs=1e-9)
    recording = read(recorder.path)
    assert rerun.first_difference(recording) is None
    write(0.03)
    with pytest.raises(RecordingError, match=r"of '.*' are not those that were recorded"):
        rerun.first_difference(recording)

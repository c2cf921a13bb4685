"""A session goes into a file and comes out of it again, tick by tick, bit by bit."""

from __future__ import annotations

import csv
import io
import math
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
import trimesh

import meshes
from app.commands import call
from app.control.engine import Engine, Orders
from app.control.messages import Command, LoopStats
from app.recording import playback, rerun
from app.recording.export import table
from app.recording.format import COMPARED, RecordingError
from app.recording.read import read
from app.recording.write import Recorder
from app.scene import scene as scenes
from app.scene import worker
from app.session import Session
from app.settings import Options
from tests.support.forgery import forged, npy
from tests.support.runs import a_run

CUBE = Options(mesh="cube", robot="point")


@pytest.fixture(scope="module")
def session_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What a user may do in a minute, in a second; the recording begins in the middle."""
    path = tmp_path_factory.mktemp("record") / "session.vfrec"
    with Session(CUBE) as session:

        def ticks(n: int = 30) -> None:
            until = session.latest().tick + n
            while session.latest().tick < until:
                time.sleep(1e-3)

        def drive(dx: float, dz: float) -> None:
            start = session.scene.T_base_start
            shift = np.array([dx, 0.0005, dz])
            session.drive(pin.SE3(start.rotation, start.translation + shift), held=True)
            ticks()

        drive(0.001, -0.01)
        session.record(path)
        drive(0.003, -0.05)
        session.set(rule="paper")
        ticks()
        session.set(radius=None)
        session.set(standoff=50e-6)
        session.set(tip_radius=1e-4)
        session.set(force_gain=80.0)
        session.set(tip_speed=0.5)
        session.set(scale=0.5)
        session.set(lock_orientation=True)
        drive(-0.004, -0.05)
        session.clutch(True)
        ticks()
        session.clutch(False)
        session.pause()
        session.single_step()
        session.set(rule="certified")
        session.resume()
        session.reset()
        drive(0.0, -0.05)
        session.change(mesh="stairs")
        drive(0.002, -0.05)
        session.change(robot="psm")
        session.set_autopilot(True)
        ticks(100)
        session.set_autopilot(False)
        ticks()
        session.stop_recording()
    return path


def test_a_session_is_repeated_to_the_last_bit(session_file: Path) -> None:
    recording = read(session_file)
    assert [p.options.mesh for p in recording.places] == ["cube", "stairs", "stairs"]
    assert [p.options.robot for p in recording.places] == ["point", "point", "psm"]
    assert {options.rule for _, options in recording.plants} == {"certified", "paper"}
    assert recording.orders["autopilot"].any()
    assert recording.orders["clutch"].any()
    assert recording.orders["scale"][-1] == 0.5
    assert recording.orders["resets"][-1] == 1
    assert recording.rows["planes"].max() > 0
    assert recording.state.tick > 0  # it began in the middle
    assert rerun.first_difference(recording) is None


@pytest.mark.parametrize("field", COMPARED)
def test_one_changed_bit_is_found_and_named(sound: Path, field: str) -> None:
    recording = read(sound)
    rows = recording.rows.copy()
    at = 40
    if field in ("order", "sensed"):  # of what is repeated, not of what comes of it
        rows[field][at] += 1
        same = rerun.compare(recording.rows, rows)
    else:
        raw = rows[field][at : at + 1].copy()
        raw.view(np.uint8).reshape(-1)[0] ^= 1
        rows[field][at : at + 1] = raw
        same = rerun.first_difference(replace(recording, rows=rows))
    assert same is not None
    assert (same.row, same.field) == (at, field)
    assert f"{field} differs" in str(same)


def test_a_changed_command_shows_in_the_joints(sound: Path) -> None:
    recording = read(sound)
    orders = recording.orders.copy()
    orders["target"][1, 0] = np.nextafter(orders["target"][1, 0], 1.0)
    found = rerun.first_difference(replace(recording, orders=orders))
    assert found is not None
    assert found.tick == 4  # the first tick with that command


def test_the_command_line_checks_and_says_so(
    sound: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert call("replay", [str(sound), "--check"]) == 0
    assert "the same to the last bit" in capsys.readouterr().out
    assert call("replay", [str(sound)]) == 0
    assert "not compared" in capsys.readouterr().out

    def other(header: dict[str, Any], members: dict[str, bytes]) -> None:
        q = np.load(io.BytesIO(members["rows/00000/q.npy"]))
        q[20, 1] = np.nextafter(q[20, 1], 1.0)
        members["rows/00000/q.npy"] = npy(q)

    changed = forged(sound, tmp_path, other)
    assert call("replay", [str(changed), "--check"]) == 1
    assert "tick 21: q differs" in capsys.readouterr().out
    assert call("replay", [str(tmp_path / "none"), "--check"]) == 2
    assert "none" in capsys.readouterr().err


def test_csv_has_a_line_a_tick_and_its_units(sound: Path, tmp_path: Path) -> None:
    out = tmp_path / "run.csv"
    assert call("replay", [str(sound), "--csv", str(out)]) == 0
    with out.open(encoding="utf-8") as file:
        lines = list(csv.DictReader(file))
    recording = read(sound)
    assert len(lines) == len(recording.rows)
    for name in ("time [s]", "q1 [rad or m]", "tip z [m]", "force x [N]", "proxy x [m]"):
        assert name in lines[0]
    for k in (0, 30, 65):
        row, line = recording.rows[k], lines[k]
        assert int(line["tick"]) == row["tick"]
        assert math.isclose(float(line["time [s]"]), 1e-3 * row["tick"])
        assert float(line["q2 [rad or m]"]) == row["q"][1]
        assert float(line["tip z [m]"]) == row["tip"][2]
    assert lines[0]["q4 [rad or m]"] == ""  # this arm has three joints
    assert lines[0]["proxy x [m]"] == ""  # there was no target yet
    assert lines[30]["rule"] == "certified"
    with pytest.raises(RecordingError, match="exists already"):
        table.write(recording, out)


def test_a_mesh_that_has_changed_is_refused(sound: Path) -> None:
    recording = read(sound)
    with pytest.raises(RecordingError, match=r"not the one that was recorded: .* triangles"):
        rerun.first_difference(recording, mesh="stairs")
    with pytest.raises(ValueError, match="no-such-mesh"):
        rerun.first_difference(recording, mesh="no-such-mesh")


def test_any_row_is_shown_as_it_was(session_file: Path) -> None:
    recording = read(session_file)
    said = [telemetry for _, telemetry, _ in rerun.rerun(recording)]
    show = playback.Player(recording, playback.build_scenes(recording, 1))
    assert len(show) == len(said)
    rng = np.random.default_rng(3)
    turns = rng.integers(1, len(said), 60)
    for row in turns:  # to and fro
        moment, then = show.moment(int(row)), said[row]
        now = moment.telemetry
        assert now.scene == moment.scene.version == then.scene
        assert (now.tick, now.autopilot, now.stale) == (then.tick, then.autopilot, then.stale)
        assert now.q.tolist() == then.q.tolist()
        assert (now.target is None) == (then.target is None)
        if now.target is not None:
            assert now.target.homogeneous.tolist() == then.target.homogeneous.tolist()
        if recording.rows["stepped"][row]:
            assert now.step.tip.homogeneous.tolist() == then.step.tip.homogeneous.tolist()
            assert now.step.force.tolist() == then.step.force.tolist()
            assert now.step.status == then.step.status
    moved = [r for r in turns if recording.rows["planes"][r] and said[r].target is not None]
    assert len(moved) > 5
    for row in moved:
        planes = show.moment(int(row)).telemetry.step.planes
        if recording.rows["order"][row] == recording.rows["order"][row - 1]:
            assert planes.offsets.tolist() == said[row].step.planes.offsets.tolist()


def test_a_scene_like_the_present_one_is_not_built_again(sound: Path) -> None:
    recording = read(sound)
    present = scenes.build(CUBE, 7)
    assert playback.build_scenes(recording, 100, like=present) == (present,)
    other = scenes.build(replace(CUBE, mesh="stairs"), 8)
    (built,) = playback.build_scenes(recording, 100, like=other)
    assert built.version == 100


def test_the_scenes_of_a_replay_are_built_aside_and_can_be_stopped(
    sound: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    recording = read(sound)
    here = playback.build_scenes(recording, 100)
    monkeypatch.setattr(worker, "light", lambda _mesh: False)
    monkeypatch.setattr(meshes, "read", None)  # nothing can be built in this process
    words: list[str] = []
    aside = playback.build_scenes(recording, 100, progress=words.append)
    assert "starting a process for the mesh" in words
    for ours, theirs in zip(here, aside, strict=True):
        assert theirs.version == ours.version
        assert theirs.surface.checksum == ours.surface.checksum
        assert theirs.start.tobytes() == ours.start.tobytes()
        assert playback.Player(recording, aside).moment(0).scene in aside
    stop = worker.Stop()
    with pytest.raises(worker.Stopped):
        playback.build_scenes(recording, 100, progress=lambda _text: stop(), stop=stop)
    # What is wrong with a recording is said as if it had been found here.
    other = replace(recording.places[0], checksum="0" * 64)
    with pytest.raises(RecordingError, match="not the one that was recorded"):
        playback.build_scenes(replace(recording, places=(other,)), 100)


def test_a_replay_plays_pauses_and_seeks(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = [50.0]
    monkeypatch.setattr(playback.time, "monotonic", lambda: clock[0])
    transport = playback.Transport(np.arange(101) * 0.01)
    assert transport.row() == 0
    clock[0] += 5.0
    assert transport.row() == 0  # it rests until told to play
    transport.play(True)
    clock[0] += 0.205
    assert transport.row() == 20
    transport.pace(0.1)
    clock[0] += 0.5
    assert transport.row() == 25
    transport.play(False)
    clock[0] += 9.0
    assert transport.row() == 25
    transport.seek(0.804)
    assert transport.row() == 80
    transport.pace(1.0)
    transport.play(True)
    clock[0] += 1.0
    assert transport.row() == 100
    assert not transport.playing
    transport.play(True)  # from the beginning
    clock[0] += 0.105
    assert transport.row() == 10
    transport.seek(99.0)
    assert transport.row() == 100


@pytest.mark.parametrize("dt", [0.002, 0.001, 1 / 3000])
def test_a_replay_seeks_to_the_row_whose_time_is_given_in_milliseconds(dt: float) -> None:
    times = np.arange(3000) * dt
    transport = playback.Transport(times)
    for row in range(0, 3000, 7):
        transport.seek(round(float(times[row]), 3))
        assert abs(times[transport.row()] - times[row]) <= 0.5e-3
        if dt >= 0.001:
            assert transport.row() == row


def test_one_order_that_counts_from_the_first_row_to_the_last_is_repeated(tmp_path: Path) -> None:
    scene = scenes.build(CUBE, 1)
    plant = scenes.plant(scene, CUBE)
    engine = Engine(Orders(plant, Command(None, 0)))
    recorder = Recorder(tmp_path / "run.vfrec")
    recorder.begin(engine.seen, engine.state)
    goal = pin.SE3(scene.T_base_start.rotation, scene.T_base_start.translation - [0, 0, 0.05])
    orders = Orders(plant, Command(goal, 1))
    for _ in range(5):
        recorder.add(orders, *engine.advance(orders, LoopStats()))
    recorder.close()
    recording = read(recorder.path)
    assert recording.rows["order"].tolist() == [1] * 5
    assert rerun.first_difference(recording) is None


@pytest.mark.parametrize("name", ["a\u200cb \u202e", "two\nlines", "\udce9t\udce9", "頭 {}[red]"])
def test_a_mesh_whose_file_is_called_anything_is_recorded_and_found_from_anywhere(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], name: str
) -> None:
    monkeypatch.chdir(tmp_path)
    path = Path(f"{name}.stl")
    trimesh.creation.box((30.0, 30.0, 30.0)).export("box.stl")
    Path("box.stl").rename(path)
    a_run(tmp_path / "run.vfrec", replace(CUBE, mesh=str(path), unit="mm"), 5)
    monkeypatch.chdir("/")
    assert read(tmp_path / "run.vfrec").places[0].options.mesh == str(tmp_path / path)
    assert call("replay", [str(tmp_path / "run.vfrec"), "--check"]) == 0
    assert "the same to the last bit" in capsys.readouterr().out
    (tmp_path / path).rename(tmp_path / "moved.stl")
    assert call("replay", [str(tmp_path / "run.vfrec"), "--check"]) == 2
    assert len(capsys.readouterr().err.splitlines()) == 1


def test_a_mesh_whose_unit_was_guessed_when_it_was_recorded_is_found_by_its_checksum(
    tmp_path: Path,
) -> None:
    trimesh.creation.box((3.0, 3.0, 2.0)).export(tmp_path / "box.stl")  # in mm, or in m
    a_run(tmp_path / "run.vfrec", replace(CUBE, mesh=str(tmp_path / "box.stl"), unit="mm"), 5)

    def guessed(header: dict[str, Any], members: dict[str, bytes]) -> None:
        for entry in (*header["places"], *header["plants"]):
            entry["options"]["unit"] = None

    old = read(forged(tmp_path / "run.vfrec", tmp_path, guessed, version=1))
    assert old.places[0].options.unit is None
    assert rerun.first_difference(old) is None
    trimesh.creation.box((3.0, 3.0, 2.1)).export(tmp_path / "box.stl")
    with pytest.raises(meshes.UnitNeeded):
        rerun.first_difference(old)

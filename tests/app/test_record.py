"""A session goes into a file and comes out of it again, tick by tick, bit by bit."""

from __future__ import annotations

import csv
import io
import json
import math
import time
import zipfile
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from app import player, record, replay, table, tape
from app import scene as scenes
from app.commands import replay as command
from app.engine import Engine, Orders
from app.mailbox import Mailbox
from app.messages import Command, LoopStats
from app.record import Recorder, Recording, RecordingError
from app.session import Refused, Session
from app.settings import Options

CUBE = Options(mesh="cube", robot="point")
Wait = Callable[[Callable[[], bool]], None]


def a_run(path: Path, options: Options = CUBE, ticks: int = 60) -> None:
    """A recording without thread: pushed into the cube, pausing, with single steps and a reset."""
    scene = scenes.build(options, 1)
    plant = scenes.plant(scene, options)
    down = pin.SE3(
        scene.T_base_start.rotation, scene.T_base_start.translation - [0.001, 0.002, 0.05]
    )
    orders = Orders(plant, Command(None, 0))
    engine = Engine(orders)
    recorder = Recorder(path)
    recorder.begin(engine.seen, engine.state)

    def advance(orders: Orders, times: int = 1) -> None:
        for _ in range(times):
            recorder.add(orders, *engine.advance(orders, LoopStats()))

    advance(orders, 3)
    orders = replace(orders, command=Command(down, 1, held=True))
    advance(orders, ticks)
    orders = replace(orders, paused=True)
    advance(orders)
    orders = replace(orders, steps=2)
    advance(orders, 2)
    orders = replace(orders, paused=False, command=Command(None, 2), resets=1)
    advance(orders, 4)
    recorder.close()


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A short recording."""
    path = tmp_path_factory.mktemp("record") / "run.vfrec"
    a_run(path)
    return path


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
        session.set_rule("paper")
        ticks()
        session.set_radius(None)
        session.set_standoff(50e-6)
        session.set_tip_radius(1e-4)
        session.set_force_gain(80.0)
        session.set_tip_speed(0.5)
        session.set_scale(0.5)
        session.set_orientation_lock(True)
        drive(-0.004, -0.05)
        session.clutch(True)
        ticks()
        session.clutch(False)
        session.pause()
        session.single_step()
        session.set_rule("certified")
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
    recording = record.read(session_file)
    assert [p.options.mesh for p in recording.places] == ["cube", "stairs", "stairs"]
    assert [p.options.robot for p in recording.places] == ["point", "point", "psm"]
    assert {options.rule for _, options in recording.plants} == {"certified", "paper"}
    assert recording.orders["autopilot"].any()
    assert recording.orders["clutch"].any()
    assert recording.orders["scale"][-1] == 0.5
    assert recording.orders["resets"][-1] == 1
    assert recording.rows["planes"].max() > 0
    assert recording.state.tick > 0  # it began in the middle
    assert replay.first_difference(recording) is None


def test_the_file_holds_what_the_loop_said(
    tmp_path: Path, tape: type[Mailbox], monkeypatch: pytest.MonkeyPatch
) -> None:
    from app import session as sessions

    tapes: list = []

    def recorded(value: object = None) -> Mailbox:
        tapes.append(tape(value))
        return tapes[-1]

    monkeypatch.setattr(sessions, "Mailbox", recorded)
    session = Session(CUBE)
    session.record(tmp_path / "run.vfrec")
    with session:
        start = session.scene.T_base_start
        session.drive(pin.SE3(start.rotation, start.translation - [0.0, 0.001, 0.03]))
        while session.latest().tick < 120:
            time.sleep(1e-3)
    said = tapes[1].items[1:]
    recording = record.read(tmp_path / "run.vfrec")
    assert recording.rows["tick"].tolist() == [t.tick for t in said]
    assert recording.rows["q"][:, :3].tobytes() == np.array([t.q for t in said]).tobytes()
    assert (recording.rows["q"][:, 3:] == 0.0).all()
    force = np.array([t.step.force for t in said])
    assert recording.rows["force"].tobytes() == force.tobytes()
    assert np.abs(force).max() > 0.0
    assert [recording.joints(k).tolist() for k in (-1, 5)] == [
        session.scene.start.tolist(),
        said[5].q.tolist(),
    ]


@pytest.mark.parametrize("field", record.COMPARED)
def test_one_changed_bit_is_found_and_named(sound: Path, field: str) -> None:
    recording = record.read(sound)
    rows = recording.rows.copy()
    at = 40
    if field == "order":
        rows[field][at] += 1
        same = replay.compare(recording.rows, rows)
    else:
        raw = rows[field][at : at + 1].copy()
        raw.view(np.uint8).reshape(-1)[0] ^= 1
        rows[field][at : at + 1] = raw
        same = replay.first_difference(replace(recording, rows=rows))
    assert same is not None
    assert (same.row, same.field) == (at, field)
    assert f"{field} differs" in str(same)


def test_a_changed_command_shows_in_the_joints(sound: Path) -> None:
    recording = record.read(sound)
    orders = recording.orders.copy()
    orders["target"][1, 0] = np.nextafter(orders["target"][1, 0], 1.0)
    found = replay.first_difference(replace(recording, orders=orders))
    assert found is not None
    assert found.tick == 4  # the first tick with that command


def test_the_command_line_checks_and_says_so(
    sound: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert command.main([str(sound), "--check"]) == 0
    assert "the same to the last bit" in capsys.readouterr().out
    assert command.main([str(sound)]) == 0
    assert "not compared" in capsys.readouterr().out

    def other(header: dict[str, Any], members: dict[str, bytes]) -> None:
        q = np.load(io.BytesIO(members["rows/00000/q.npy"]))
        q[20, 1] = np.nextafter(q[20, 1], 1.0)
        members["rows/00000/q.npy"] = npy(q)

    changed = forged(sound, tmp_path, other)
    assert command.main([str(changed), "--check"]) == 1
    assert "tick 21: q differs" in capsys.readouterr().out
    assert command.main([str(tmp_path / "none"), "--check"]) == 2
    assert "none" in capsys.readouterr().err


def test_csv_has_a_line_a_tick_and_its_units(sound: Path, tmp_path: Path) -> None:
    out = tmp_path / "run.csv"
    assert command.main([str(sound), "--csv", str(out)]) == 0
    with out.open(encoding="utf-8") as file:
        lines = list(csv.DictReader(file))
    recording = record.read(sound)
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


def test_nothing_is_written_over(sound: Path) -> None:
    before = sound.read_bytes()
    with pytest.raises(RecordingError, match="exists already"):
        Recorder(sound)
    session = Session(CUBE)
    with pytest.raises(Refused, match="exists already"):
        session.record(sound)
    with pytest.raises(Refused, match="nothing is being recorded"):
        session.stop_recording()
    assert sound.read_bytes() == before


def test_one_recording_at_a_time(tmp_path: Path, wait_until: Wait) -> None:
    with Session(CUBE) as session:
        going = session.record(tmp_path / "a.vfrec")
        with pytest.raises(Refused, match="under way"):
            session.record(tmp_path / "b.vfrec")
        wait_until(lambda: going.rows > 0)
        done = session.stop_recording()
        assert not done.running
        assert done.rows > 0
        again = session.record(tmp_path / "b.vfrec")
        wait_until(lambda: again.rows > 0)
    assert {p.name for p in tmp_path.iterdir()} == {"a.vfrec", "b.vfrec"}
    assert replay.first_difference(record.read(tmp_path / "b.vfrec")) is None


def test_a_writer_that_falls_behind_ends_the_recording_not_the_loop(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, wait_until: Wait
) -> None:
    monkeypatch.setattr(tape, "BEHIND", 5)
    monkeypatch.setattr(tape, "PERIOD", 0.1)
    with Session(CUBE) as session:
        going = session.record(tmp_path / "a.vfrec")
        wait_until(lambda: not going.running)
        assert "behind" in going.note
        tick = session.latest().tick
        wait_until(lambda: session.latest().tick > tick + 20)
    recording = record.read(tmp_path / "a.vfrec")
    assert len(recording.rows) >= 1
    assert "behind" in recording.note
    assert replay.first_difference(recording) is None


def test_a_full_disk_ends_the_recording_not_the_loop(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, wait_until: Wait
) -> None:
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Recorder, "_table", full)
    with Session(CUBE) as session:
        going = session.record(tmp_path / "a.vfrec")
        wait_until(lambda: going.rows > 0)
        with_reason = session.stop_recording()
        assert with_reason is going
        assert "No space left" in going.outcome
        tick = session.latest().tick
        wait_until(lambda: session.latest().tick > tick + 20)
    assert not list(tmp_path.iterdir())


def test_a_mesh_that_has_changed_is_refused(sound: Path) -> None:
    recording = record.read(sound)
    with pytest.raises(RecordingError, match=r"not the one that was recorded: .* triangles"):
        replay.first_difference(recording, mesh="stairs")
    with pytest.raises(ValueError, match="no-such-mesh"):
        replay.first_difference(recording, mesh="no-such-mesh")


def test_any_row_is_shown_as_it_was(session_file: Path) -> None:
    recording = record.read(session_file)
    said = [telemetry for _, telemetry, _ in replay.rerun(recording)]
    show = player.Player(recording, player.build_scenes(recording, 1))
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
    recording = record.read(sound)
    present = scenes.build(CUBE, 7)
    assert player.build_scenes(recording, 100, like=present) == (present,)
    other = scenes.build(replace(CUBE, mesh="stairs"), 8)
    (built,) = player.build_scenes(recording, 100, like=other)
    assert built.version == 100


def test_a_replay_plays_pauses_and_seeks(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = [50.0]
    monkeypatch.setattr(player.time, "monotonic", lambda: clock[0])
    transport = player.Transport(np.arange(101) * 0.01)
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
    transport = player.Transport(times)
    for row in range(0, 3000, 7):
        transport.seek(round(float(times[row]), 3))
        assert abs(times[transport.row()] - times[row]) <= 0.5e-3
        if dt >= 0.001:
            assert transport.row() == row


# Files that nobody should trust


def npy(array: np.ndarray) -> bytes:
    stream = io.BytesIO()
    np.save(stream, array)
    return stream.getvalue()


def forged(
    sound: Path, folder: Path, change: Callable[[dict[str, Any], dict[str, bytes]], None]
) -> Path:
    """A copy of a recording with its header and members changed."""
    with zipfile.ZipFile(sound) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    header = json.loads(members.pop("header.json"))
    change(header, members)
    path = folder / "forged.vfrec"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("header.json", json.dumps(header))
        for name, data in members.items():
            archive.writestr(name, data)
    return path


def hostile() -> Iterator[tuple[str, Callable[[dict[str, Any], dict[str, bytes]], None], str]]:
    def case(name: str, match: str) -> Callable:
        def add(change: Callable[[dict[str, Any], dict[str, bytes]], None]) -> None:
            cases.append((name, change, match))

        return add

    cases: list = []

    @case("version", "version 2 of the format")
    def _(header: dict[str, Any], members: dict[str, bytes]) -> None:
        header["version"] = 2

    @case("format", "the format is not")
    def _(header: dict[str, Any], members: dict[str, bytes]) -> None:
        header["format"] = "something else"

    @case("missing", "orders/clutch.npy is missing")
    def _(header: dict[str, Any], members: dict[str, bytes]) -> None:
        del members["orders/clutch.npy"]

    @case("surplus", "do not belong")
    def _(header: dict[str, Any], members: dict[str, bytes]) -> None:
        members["../../evil"] = b"x"

    @case("bomb", "unpacks to 10,000,000 bytes")
    def _(header: dict[str, Any], members: dict[str, bytes]) -> None:
        members["rows/00000/q.npy"] = bytes(10_000_000)

    @case("sizes", "at most 4,000,000 are read")
    def _(header: dict[str, Any], members: dict[str, bytes]) -> None:
        header["chunks"] = [4096] * 1000

    @case("chunk", "rows of a chunk is 1000000000000")
    def _(header: dict[str, Any], members: dict[str, bytes]) -> None:
        header["chunks"] = [10**12]

    @case("orders", "number of orders is -1")
    def _(header: dict[str, Any], members: dict[str, bytes]) -> None:
        header["orders"] = -1

    @case("nan joints", "rows/q of row 7 is not finite")
    def _(header: dict[str, Any], members: dict[str, bytes]) -> None:
        q = np.load(io.BytesIO(members["rows/00000/q.npy"]))
        q[7, 0] = np.nan
        members["rows/00000/q.npy"] = npy(q)

    @case("nan command", "orders/target of row 1 is not finite")
    def _(header: dict[str, Any], members: dict[str, bytes]) -> None:
        target = np.load(io.BytesIO(members["orders/target.npy"]))
        target[1] = np.inf
        members["orders/target.npy"] = npy(target)

    @case("nan header", "NaN in the header")
    def _(header: dict[str, Any], members: dict[str, bytes]) -> None:
        header["state"]["q"][0] = math.nan

    @case("pickle", "is damaged")
    def _(header: dict[str, Any], members: dict[str, bytes]) -> None:
        stream = io.BytesIO()
        np.save(stream, np.array([{}] * 3, dtype=object), allow_pickle=True)
        members["rows/00000/tick.npy"] = stream.getvalue()

    @case("dtype", "is float32")
    def _(header: dict[str, Any], members: dict[str, bytes]) -> None:
        q = np.load(io.BytesIO(members["rows/00000/q.npy"]))
        members["rows/00000/q.npy"] = npy(q.astype(np.float32))

    @case("mirror", "is not a rotation")
    def _(header: dict[str, Any], members: dict[str, bytes]) -> None:
        rotation = np.load(io.BytesIO(members["orders/rotation.npy"]))
        members["orders/rotation.npy"] = npy(3.0 * rotation)

    @case("plant", "orders/plant of row 1 is not one of the plants")
    def _(header: dict[str, Any], members: dict[str, bytes]) -> None:
        plant = np.load(io.BytesIO(members["orders/plant.npy"]))
        plant[1] = 9
        members["orders/plant.npy"] = npy(plant)

    @case("ticks", "does not count on")
    def _(header: dict[str, Any], members: dict[str, bytes]) -> None:
        tick = np.load(io.BytesIO(members["rows/00000/tick.npy"]))
        tick[5] += 10**6
        members["rows/00000/tick.npy"] = npy(tick)

    @case("range", "radius 1e")
    def _(header: dict[str, Any], members: dict[str, bytes]) -> None:
        header["plants"][0]["options"]["radius"] = 1e9

    @case("option kind", "option rule in the header is not usable")
    def _(header: dict[str, Any], members: dict[str, bytes]) -> None:
        header["plants"][0]["options"]["rule"] = ["certified"]

    @case("unknown option", "not those of a session")
    def _(header: dict[str, Any], members: dict[str, bytes]) -> None:
        header["plants"][0]["options"]["host"] = "0.0.0.0"

    for name, value, line in (
        ("times", [0.0, 0.0], "do not rise from 0"),
        ("times", [1.0, 2.0], "do not rise from 0"),
        ("times", "soon", "not 1 to 1000 finite numbers"),
        ("points", [[0.0] * 3], "not 2 rows"),
        ("points", [[0.0] * 2] * 2, "not of three columns"),
        ("rotation", [[2.0, 0, 0], [0, 1, 0], [0, 0, 1]], "rotation of a course"),
        ("rotation", [[-1, 0, 0], [0, 1, 0], [0, 0, 1]], "rotation of a course"),
    ):

        @case(f"course: {name} {value}", line)
        def _(
            header: dict[str, Any],
            members: dict[str, bytes],
            name: str = name,
            value: object = value,
        ) -> None:
            course = {
                "times": [0.0, 1.0],
                "points": [[0.0] * 3] * 2,
                "rotation": np.eye(3).tolist(),
            }
            header["plants"][0]["course"] = {**course, name: value}

    @case("checksum", "not a SHA-256")
    def _(header: dict[str, Any], members: dict[str, bytes]) -> None:
        header["places"][0]["checksum"] = 5

    @case("pose", "no pose")
    def _(header: dict[str, Any], members: dict[str, bytes]) -> None:
        header["state"]["target"] = np.zeros((4, 4)).tolist()

    @case("pose kind", "target in the header is not")
    def _(header: dict[str, Any], members: dict[str, bytes]) -> None:
        header["state"]["target"] = [1, 2, 3, 4]

    @case("huge number", "joints in the header is not")
    def _(header: dict[str, Any], members: dict[str, bytes]) -> None:
        header["state"]["q"] = [10**400]

    @case("nothing", "'places' in the header")
    def _(header: dict[str, Any], members: dict[str, bytes]) -> None:
        header["places"] = []

    yield from cases


@pytest.mark.parametrize(("name", "change", "match"), list(hostile()), ids=lambda x: str(x)[:20])
def test_a_hostile_file_is_refused_in_one_line(
    name: str,
    change: Callable[[dict[str, Any], dict[str, bytes]], None],
    match: str,
    sound: Path,
    tmp_path: Path,
) -> None:
    path = forged(sound, tmp_path, change)
    with pytest.raises(RecordingError, match=match) as caught:
        record.read(path)
    assert "\n" not in str(caught.value)
    assert str(path) in str(caught.value)


def test_a_forged_copy_without_changes_is_sound(sound: Path, tmp_path: Path) -> None:
    copy: Recording = record.read(forged(sound, tmp_path, lambda header, members: None))
    assert replay.first_difference(copy) is None


@pytest.mark.parametrize("content", [b"", b"PK", b"not a zip at all" * 50])
def test_a_file_of_another_kind_is_refused(content: bytes, tmp_path: Path) -> None:
    path = tmp_path / "some.vfrec"
    path.write_bytes(content)
    with pytest.raises(RecordingError, match="not a readable recording"):
        record.read(path)


def test_a_flipped_byte_anywhere_is_refused_or_harmless(sound: Path, tmp_path: Path) -> None:
    data = sound.read_bytes()
    whole = record.read(sound)
    rng = np.random.default_rng(1)
    refused = 0
    for at in rng.integers(0, len(data), 60):
        path = tmp_path / "flipped.vfrec"
        path.write_bytes(data[:at] + bytes([data[at] ^ 0x55]) + data[at + 1 :])
        try:
            found = record.read(path)
        except RecordingError:
            refused += 1
        else:
            assert found.rows.tobytes() == whole.rows.tobytes()
    assert refused > 30

"""Sessions with a structure whose shapes come over a socket, from senders in other processes."""

from __future__ import annotations

import re
import socket
import struct
import subprocess
import sys
import textwrap
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

import meshes
import vf
from app.control.engine import Engine, Orders
from app.control.messages import Command, LoopStats
from app.devices.sockets.frames import FrameServer
from app.kinds.links import parse_address
from app.motion.declared import Motion, Tracker
from app.motion.movement import Movement, streamed
from app.motion.stream import Stream, StreamForm
from app.recording import rerun
from app.recording.playback import Player
from app.recording.read import read
from app.recording.write import Recorder
from app.scenarios.file import Scenario, ScenarioError, dumps, loads, write
from app.scenarios.file import read as read_scenario
from app.scene import scene as scenes
from app.scene.scene import Scene
from app.session import Session
from app.settings import Options
from app.words import OptionError, Refused
from tests.support.headless import wait_until

ANY = "socket://127.0.0.1:0"
DOCS = Path(__file__).parents[2] / "docs/motion.md"
VESSEL = meshes.deforming("vessel")
FRAME, LATENCY, BOUND, STALE = 0.02, 0.03, 0.05, 0.5  # by docs/motion.md


def options(**more: Any) -> Options:
    one = Motion("vertices", stream=ANY)
    return Options(**{"mesh": "vessel", "robot": "point", "motions": (one,), **more})


def packed(vertices: np.ndarray, stamp: float, magic: bytes = b"VERT", n: int = -1) -> bytes:
    """A frame, by the table of docs/motion.md."""
    count = len(vertices) if n < 0 else n
    return struct.pack("<4sId", magic, count, stamp) + vertices.astype("<f4").tobytes()


# The engine, without a socket


@pytest.fixture
def scene() -> Scene:
    return scenes.build(options(), 1)


class Run:
    """An engine tick by tick, the tool drawn to the middle of the vessel."""

    def __init__(self, scene: Scene) -> None:
        self.plant = scenes.plant(scene, scene.options)
        deep = pin.SE3(scene.T_base_start.rotation, scene.surface.vertices.mean(axis=0))
        self.command = Command(deep, 1)
        self.orders = Orders(self.plant, self.command)
        self.engine = Engine(self.orders)
        form = streamed(scene.courses)
        assert form is not None
        self.form, self.stream = form, form.stream

    def ticks(self, n: int) -> Any:
        for _ in range(n):
            telemetry, _ = self.engine.advance(self.orders, LoopStats())
        return telemetry


def test_a_shape_that_came_is_reached_and_the_margin_grows_until_the_tool_holds(
    scene: Scene,
) -> None:
    run = Run(scene)
    shape = VESSEL.shape(0.3).astype(np.float32)
    R, t = scene.T_base_mesh[:3, :3], scene.T_base_mesh[:3, 3]
    came = run.ticks(100).phase
    run.stream.hear(shape)
    telemetry = run.ticks(70)
    movement = Movement(scene.courses, None)
    (there,) = movement.truths(telemetry.phase)
    np.testing.assert_allclose(there, shape.astype(np.float64) @ R.T + t, rtol=0, atol=1e-15)
    for more in (0, 200):
        telemetry = run.ticks(more) if more else telemetry
        age = telemetry.phase - came + LATENCY
        assert movement.margin(telemetry.phase) == pytest.approx(BOUND * age, abs=1e-9)
        assert not telemetry.lost
    telemetry = run.ticks(300)
    assert telemetry.lost
    assert telemetry.step is not None
    assert telemetry.step.status is vf.Status.HELD
    assert movement.margin(telemetry.phase) == pytest.approx(BOUND * STALE)
    # And it goes on with the next one.
    run.stream.hear(VESSEL.shape(0.6).astype(np.float32))
    assert not run.ticks(70).lost


def test_what_a_tick_was_told_of_does_not_change_and_a_late_frame_is_older(scene: Scene) -> None:
    run = Run(scene)
    movement = Movement(scene.courses, None)
    phase = run.ticks(30).phase
    told = [np.array(run.form.shape(k)) for k in range(int(phase / FRAME) + 2)]
    first = run.stream.hear(VESSEL.shape(0.4).astype(np.float32), late=0.2)
    assert first.seen == 0.0  # before anything moved
    for k, shape in enumerate(told):
        np.testing.assert_array_equal(run.form.shape(k), shape)
    phase = run.ticks(300).phase
    second = run.stream.hear(VESSEL.shape(0.4).astype(np.float32), late=0.1)
    assert second.seen == pytest.approx(phase - LATENCY - 0.1, abs=2e-3)
    assert second.shape > int(phase / FRAME) + 1
    run.ticks(60)
    assert movement.truth(phase)[0] is not None


def test_a_reset_does_not_take_the_stream_back(scene: Scene, tmp_path: Path) -> None:
    """And the recording of it repeats, and is shown with the shapes that it had."""
    run = Run(scene)
    recorder = Recorder(tmp_path / "run.vfrec")
    run.ticks(40)
    recorder.begin(run.engine.seen, run.engine.state)
    for k in range(160):
        if k % 25 == 0:
            run.stream.hear(VESSEL.shape(0.05 * k).astype(np.float32))
        if k == 80:
            run.orders = Orders(run.plant, run.command, resets=1)
        recorder.add(run.orders, *run.engine.advance(run.orders, LoopStats()))
        recorder.flush()
    phase = run.engine.state.phase
    assert phase == pytest.approx(0.2)
    recorder.close()
    recording = read(recorder.path)
    assert len(recording.shapes) == 7
    assert rerun.first_difference(recording) is None
    player = Player(recording, [rerun.build(recording.places[0], 7)])
    moment = player.moment(len(recording.rows) - 1)
    np.testing.assert_array_equal(moment.shape(0), run.form.vertices(phase))
    # A recording with another shape is another run.
    number, frame = recording.shapes[2]
    other = type(frame)(frame.number, frame.shape, frame.seen, frame.vertices * np.float32(1.01))
    shapes = (*recording.shapes[:2], (number, other), *recording.shapes[3:])
    forged = type(recording)(**{**vars(recording), "shapes": shapes})
    assert rerun.first_difference(forged) is not None


@pytest.mark.parametrize(
    ("motions", "told"),
    [
        ((Motion("vertices", stream=ANY), Motion("breathing")), "it takes no other motion"),
        ((Motion("vertices", stream=ANY, of="nerve"),), "there is no such structure"),
    ],
)
def test_a_scene_that_cannot_be_streamed_is_refused(motions: tuple[Motion, ...], told: str) -> None:
    with pytest.raises(OptionError, match=told):
        scenes.build(options(motions=motions), 1)


@pytest.mark.parametrize(
    ("values", "told"),
    [
        ({"kind": "vertices"}, "needs a file or a stream"),
        ({"kind": "breathing", "stream": ANY}, "takes no stream"),
        ({"kind": "vertices", "stream": ANY, "file": "a.npz"}, "not both"),
        ({"kind": "vertices", "stream": ANY, "after": 1.0}, "its stream says it"),
        ({"kind": "vertices", "stream": "udp://a:1"}, "is no device: choose one of socket://"),
        ({"kind": "vertices", "stream": "socket://a"}, "write socket://HOST:PORT"),
        ({"kind": "vertices", "stream": ANY + "?listen"}, "write socket://HOST:PORT"),
    ],
)
def test_bad_words_are_refused_with_what_is_valid(values: dict[str, Any], told: str) -> None:
    with pytest.raises(OptionError, match=re.escape(told)):
        Motion(**values)


def test_only_one_structure_is_streamed() -> None:
    with pytest.raises(OptionError, match="of one structure"):
        options(motions=2 * (Motion("vertices", stream=ANY),))


def test_a_tracker_declares_latency_and_bound_of_the_frames_too() -> None:
    stream = Stream(ANY, Tracker(latency=0.1, bound=0.2, stale=1.0))
    form = StreamForm(stream, VESSEL.vertices, np.eye(4), 1e-3)
    stream.now = 0.5
    stream.hear(VESSEL.vertices.astype(np.float32))
    belief = form.belief(0.9)
    assert belief.age == pytest.approx(0.9 - 0.4)
    assert belief.margin == pytest.approx(0.2 * 0.5)
    assert not belief.stale
    assert form.belief(1.5).stale


def test_a_scenario_has_it_and_listens_on_this_machine_alone(tmp_path: Path) -> None:
    scenario = Scenario("a", "b.", options())
    write(scenario, tmp_path / "mine.json")
    assert read_scenario(tmp_path / "mine.json") == scenario
    with pytest.raises(ScenarioError, match="on this machine alone"):
        loads(dumps(scenario).replace("127.0.0.1", "0.0.0.0"), tmp_path)


# The socket


class Server:
    """A server of frames of four vertices, and what it gave."""

    def __init__(self) -> None:
        self.frames: list[np.ndarray] = []
        self.late: list[float] = []
        self.server = FrameServer(parse_address("stream", ANY))
        self.server.aim(self.take, 4, BOUND)
        self.server.start()

    def take(self, vertices: np.ndarray, late: float) -> bool:
        self.frames.append(vertices)
        self.late.append(late)
        return True

    def connect(self) -> socket.socket:
        host, port = self.server.url.removeprefix("socket://").rsplit(":", 1)
        return socket.create_connection((host, int(port)), timeout=10)

    def refused(self, reason: str) -> int:
        return self.server.report.refused.get(reason, 0)


@pytest.fixture
def served() -> Iterator[Server]:
    one = Server()
    yield one
    one.server.close()


CORNERS = np.array([[0, 0, 0], [0.01, 0, 0], [0, 0.01, 0], [0, 0, 0.01]])
NAN = np.where(CORNERS > 0, np.nan, CORNERS)


@pytest.mark.parametrize(
    ("bad", "reason"),
    [
        (packed(np.zeros((7, 3)), 2.0), "wrong number of vertices"),
        (packed(NAN, 2.0), "not finite"),
        (packed(CORNERS, float("nan")), "not finite"),
        (packed(CORNERS + 11.0, 2.0), "a vertex farther than 10 m"),
        (packed(CORNERS, 0.5), "time goes back"),
        (packed(CORNERS, 1.0), "time goes back"),
    ],
)
def test_a_bad_frame_is_passed_over(served: Server, bad: bytes, reason: str) -> None:
    with served.connect() as link:
        link.sendall(packed(CORNERS, 1.0) + bad)
        # In pieces, as a network may deliver it.
        for byte in packed(CORNERS + 1e-4, 3.0):
            link.sendall(bytes([byte]))
        wait_until(lambda: len(served.frames) == 2)
        assert served.refused(reason) == 1
        assert reason in served.server.report.trouble
    np.testing.assert_allclose(served.frames[1], CORNERS + 1e-4, atol=1e-9)


@pytest.mark.parametrize(
    ("bad", "reason"),
    [
        (packed(CORNERS, 2.0, magic=b"HTTP"), "no frame"),
        (packed(CORNERS, 2.0, n=0), "an absurd size"),
        (packed(CORNERS, 2.0, n=2**32 - 1), "an absurd size"),
    ],
)
def test_what_cannot_be_told_apart_ends_the_connection(
    served: Server, bad: bytes, reason: str
) -> None:
    with served.connect() as link:
        link.sendall(packed(CORNERS, 1.0) + bad)
        told = b""
        while piece := link.recv(1000):
            told += piece
        assert reason in told.decode()
    assert served.refused(reason) == 1
    with served.connect() as link:  # and it may come again, with a clock of its own
        link.sendall(packed(CORNERS, 0.1))
        wait_until(lambda: len(served.frames) == 2)


def test_a_second_sender_is_turned_away_until_the_first_is_silent(
    served: Server, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("app.devices.sockets.frames.SILENT", 60.0)
    with served.connect() as first:
        first.sendall(packed(CORNERS, 1.0))
        wait_until(lambda: served.frames)
        with served.connect() as second:
            assert b"is sending here" in second.recv(1000)
            assert second.recv(1000) == b""
        assert served.refused("a second sender") == 1
        monkeypatch.setattr("app.devices.sockets.frames.SILENT", 0.0)
        with served.connect() as second:
            second.sendall(packed(CORNERS, 0.5))
            wait_until(lambda: len(served.frames) == 2)
            assert first.recv(1000) == b""


def test_frames_that_wait_on_their_way_are_older_than_their_arrival(served: Server) -> None:
    with served.connect() as link:
        for stamp in (10.0, 10.5, 10.6):  # half a second of what the sender saw, at once
            link.sendall(packed(CORNERS, stamp))
        wait_until(lambda: len(served.frames) == 3)
        first, second, third = served.late
        assert first == second == 0.0
        link.sendall(packed(CORNERS, 10.61))
        time.sleep(0.2)
        link.sendall(packed(CORNERS, 10.62))
        wait_until(lambda: len(served.frames) == 5)
        assert served.late[4] - served.late[3] > 0.15
        assert third == 0.0


def test_what_is_faster_than_declared_is_taken_and_said(served: Server) -> None:
    with served.connect() as link:
        link.sendall(packed(CORNERS, 1.0) + packed(CORNERS + 0.001, 1.1))
        wait_until(lambda: len(served.frames) == 2)
        assert not served.server.report.trouble
        link.sendall(packed(CORNERS + 0.02, 1.2))
        wait_until(lambda: len(served.frames) == 3)
        wait_until(lambda: "faster than the declared bound" in served.server.report.trouble)
        assert not served.server.report.refused


def test_a_port_that_is_taken_is_refused(served: Server) -> None:
    with pytest.raises(OptionError, match="cannot listen there"):
        FrameServer(parse_address("stream", served.server.url))


# Whole sessions, with a sender in a process of its own


def sender() -> str:
    """The program of docs/motion.md."""
    found = re.findall(r"(?:^(?:    .*)?\n)+", DOCS.read_text("utf-8"), re.MULTILINE)
    return textwrap.dedent(next(one for one in found if "create_connection" in one))


@contextmanager
def sending(session: Session, mesh: str, change: Callable[[str], str] = str) -> Iterator[Any]:
    report = session.stream
    assert report is not None
    port = report.url.rsplit(":", 1)[1]
    program = sender().replace("48060", port).replace('"heart"', f'"{mesh}"')
    process = subprocess.Popen([sys.executable, "-c", change(program)], stderr=subprocess.DEVNULL)
    try:
        yield process
    finally:
        process.kill()
        process.wait()


@pytest.mark.parametrize("process", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_the_sender_of_the_docs_moves_the_vessel_and_the_recording_repeats(
    process: bool, tmp_path: Path
) -> None:
    with Session(options(), process=process) as session:
        form = streamed(session.scene.courses)
        assert form is not None
        wait_until(lambda: session.latest().lost, 30.0)
        with pytest.raises(Refused, match="come as they are sent"):
            session.move_structures(on=False)
        with sending(session, "vessel"):
            wait_until(lambda: not session.latest().lost, 60.0)
            session.record(tmp_path / "run.vfrec")
            before = form.stream.number
            wait_until(lambda: form.stream.number > before + 30, 60.0)  # through a part of a beat
            session.stop_recording()
            report = session.stream
            assert report is not None
            assert report.peer
            assert not report.refused
        wait_until(lambda: session.latest().lost)
        report = session.stream
        assert report is not None
        assert "no sender" in report.trouble
    recording = read(tmp_path / "run.vfrec")
    assert len(recording.shapes) > 6
    spread = np.ptp([frame.vertices for _, frame in recording.shapes], axis=0)
    assert spread.max() > 1e-3  # it was not at rest
    assert rerun.first_difference(recording) is None

"""The control process: sessions run in it as in a thread, and each side survives the other."""

from __future__ import annotations

import gc
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from app.control.process import handle, shared
from app.control.process.child import HOLD_ALONE
from app.recording import rerun
from app.recording.read import read
from app.session import Session
from app.settings import Options
from app.words import Refused
from tests.support.controls import controls_of, gone
from tests.support.headless import moved, wait_until

CUBE = Options(mesh="cube", robot="point")
ROOT = Path(__file__).parents[4]


@pytest.fixture(autouse=True)
def nothing_left_behind() -> Iterator[None]:
    """No process, no descriptor, no name in shared memory."""
    gc.collect()
    shm = set(os.listdir("/dev/shm"))
    fds = len(os.listdir("/proc/self/fd"))
    controls = controls_of(os.getpid())
    yield
    wait_until(lambda: controls_of(os.getpid()) == controls)
    assert set(os.listdir("/dev/shm")) == shm
    gc.collect()  # a session and its parts know each other
    assert len(os.listdir("/proc/self/fd")) <= fds


@pytest.fixture(scope="module")
def session() -> Iterator[Session]:
    with Session(CUBE, process=True) as running:
        yield running


def below(session: Session, depth: float = 0.03) -> pin.SE3:
    return moved(session.scene.T_base_start, dx=1e-3, dz=-depth)


def test_a_session_ticks_in_another_process(session: Session) -> None:
    place = session._loop.place
    assert place is not None
    assert place[0] != os.getpid()
    assert controls_of(os.getpid()) == [place[0]]
    names = Path(f"/proc/{place[0]}/maps").read_text()
    assert "viser" not in names
    session.reset()
    session.drive(below(session))
    wait_until(lambda: session.latest().step is not None and session.latest().step.force.any())
    assert session.latest().step.status.name in ("SOLVED", "SHORTENED")
    wait_until(lambda: np.linalg.norm(session.master.force) > 0.0)
    session.set(rule="off")
    wait_until(lambda: session.crossing is not None)
    assert session.unwatched == 0
    session.set(rule="certified")
    session.reset()
    wait_until(lambda: session.crossing is None)
    wait_until(lambda: session.latest().stats.rate > 100.0)
    assert sum(session.latest().stats.counts.values()) > 100


def test_what_is_read_twice_is_the_same_until_there_is_a_newer_tick(session: Session) -> None:
    session.pause()
    wait_until(lambda: session.latest().paused)
    tick = session.latest().tick
    session.single_step(3)
    wait_until(lambda: session.latest().tick == tick + 3)
    first = session.latest()
    wait_until(lambda: session.latest() is not first)  # a paused loop answers too
    assert session.latest().tick == tick + 3
    session.resume()
    wait_until(lambda: session.latest().tick > tick + 10)


def test_a_recording_of_a_process_repeats_to_the_last_bit(session: Session, tmp_path: Path) -> None:
    session.reset()
    tape = session.record(tmp_path / "run.vfrec")
    for k in range(60):
        session.drive(below(session, 5e-4 * k), held=True)
        time.sleep(4e-3)
    session.set(radius=2e-3)
    session.clutch(True)
    session.drive(below(session, 0.01))
    session.clutch(False)
    session.pause()
    session.single_step(4)
    wait_until(lambda: session.latest().paused)
    session.resume()
    session.set_autopilot(True)
    tick = session.latest().tick
    wait_until(lambda: session.latest().tick > tick + 300)
    session.change(mesh="sphere", robot="psm")
    session.set_autopilot(True)
    tick = session.latest().tick
    wait_until(lambda: session.latest().tick > tick + 300)
    last = session.latest().tick
    session.stop_recording()
    recording = read(tape.path)
    assert rerun.first_difference(recording) is None
    ticks = recording.rows["tick"][recording.rows["ticked"] == 1]
    assert (np.diff(ticks) == 1).all()
    assert ticks[-1] >= last
    assert len(recording.orders) > 40
    assert len(recording.places) == 2
    session.change(mesh="cube", robot="point")


class Script:
    """A script that another process has never heard of."""

    def __reduce__(self) -> str:
        raise TypeError("it is not for others")

    def pose(self, time: float) -> pin.SE3:
        return pin.SE3.Identity()


def test_what_cannot_be_handed_over_is_refused_and_changes_nothing(session: Session) -> None:
    with pytest.raises(Refused, match="not for others"):
        session.perform(Script())
    tick = session.latest().tick
    wait_until(lambda: session.latest().tick > tick + 10)
    session.reset()
    session.drive(below(session, 0.002))
    wait_until(lambda: session.latest().target is not None)


@pytest.mark.parametrize(
    ("end", "why"),
    [
        (signal.SIGKILL, "signal SIGKILL"),
        (signal.SIGSEGV, "signal SIGSEGV"),
        (signal.SIGTERM, r"it was told to \(SIGTERM\)"),
    ],
)
def test_a_control_process_that_ends_is_told_and_goes_on_where_it_was(
    tmp_path: Path, end: signal.Signals, why: str
) -> None:
    with Session(CUBE, process=True) as session:
        tape = session.record(tmp_path / "run.vfrec")
        session.set(radius=1e-3)
        session.drive(below(session), held=False)
        wait_until(lambda: session.latest().tick > 200)
        place = session._loop.place
        assert place is not None
        os.kill(place[0], end)
        wait_until(lambda: session.ended)
        assert re.fullmatch(why, session.ended)
        # What is known is still there: the last tick, the settings, the recording up to it.
        last = session.latest()
        recording = read(tape.path)
        assert recording.note == f"the control loop ended ({session.ended})"
        assert recording.cut == ""
        assert recording.rows["tick"][-1] == last.tick
        assert rerun.first_difference(recording) is None
        assert session.options.radius == 1e-3
        # Orders are taken meanwhile; what they ask for comes when it runs again.
        session.set(radius=2e-3)
        session.restart()
        assert session.ended == ""
        wait_until(lambda: session.latest().tick > last.tick)
        again = session.latest()
        assert again.target is None, "the tool holds, whatever it was doing"
        np.testing.assert_array_equal(again.q, last.q)
        assert again.tick < last.tick + 2000
        with pytest.raises(Refused, match="runs"):
            session.restart()
        other = session.record(tmp_path / "again.vfrec")
        session.drive(below(session, 0.01))
        tick = session.latest().tick
        wait_until(lambda: session.latest().tick > tick + 100)
    assert rerun.first_difference(read(other.path)) is None
    assert read(other.path).rows["tick"][0] > last.tick


def test_a_process_that_cannot_start_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(handle.sys, "executable", "/bin/false")
    session = Session(CUBE, process=True)
    with pytest.raises(Refused, match="could not be started: exit code 1"):
        session.start()
    session.close()


def test_a_session_that_never_starts_leaves_no_process() -> None:
    before = controls_of(os.getpid())
    session = Session(CUBE, process=True)
    assert len(controls_of(os.getpid())) == len(before) + 1
    assert session.latest().tick == 0
    session.close()
    session.close()
    with pytest.raises(ValueError, match="no-such-mesh"):
        Session(Options(mesh="no-such-mesh"), process=True)


def test_a_stuck_reader_loses_ticks_but_not_the_loop(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(handle, "ROOM", 1 << 16)
    with Session(CUBE, process=True) as session:
        wait_until(lambda: session.latest().tick > 20)
        tape = session.record(tmp_path / "run.vfrec")
        wait_until(lambda: tape.rows > 0)
        with session._loop._reading:
            tick = session.latest().tick
            while session._loop._queue.count < 2000:
                time.sleep(0.01)
        wait_until(lambda: session.unwatched > 0)
        wait_until(lambda: session.latest().tick > tick + 1000)
        wait_until(lambda: not tape.running)
        assert "behind" in tape.note
    assert rerun.first_difference(read(tape.path)) is None


LEAVES = """
import logging, os, signal, sys, time
from app.session import Session
from app.settings import Options
signal.signal(signal.SIGHUP, signal.SIG_DFL)  # a test run without a terminal may ignore it
session = Session(Options(mesh="cube", robot="point"), process=True)
session.start()
session.set_autopilot(True)
while session.latest().tick < 100: time.sleep(0.01)
print(*session._loop.place, flush=True)
time.sleep(100)
"""


@pytest.mark.parametrize(
    "end", [signal.SIGKILL, pytest.param(signal.SIGHUP, marks=pytest.mark.slow)]
)
def test_a_control_process_that_is_left_alone_holds_and_ends(end: signal.Signals) -> None:
    shm = set(os.listdir("/dev/shm"))
    with subprocess.Popen(
        [sys.executable, "-c", LEAVES], stdout=subprocess.PIPE, stderr=subprocess.PIPE,
        text=True, cwd=ROOT,
    ) as page:  # fmt: skip
        assert page.stdout is not None
        assert page.stderr is not None
        control, thread = map(int, page.stdout.readline().split())
        page.send_signal(end)
        page.wait(10)
        began = time.monotonic()
        ran = cpu(control, thread)
        line = page.stderr.readline()
        assert "the page's process ended: the tool holds where it is" in line
        wait_until(lambda: cpu(control, thread) > ran, timeout=2.0)  # it ticks
        assert "ended" in page.stderr.read()  # to its end: nobody has the other side any more
        assert 0.5 * HOLD_ALONE < time.monotonic() - began < HOLD_ALONE + 5.0
    wait_until(lambda: gone(control))
    assert set(os.listdir("/dev/shm")) == shm


def cpu(process: int, thread: int) -> int:
    """Processor time of a thread [ns]."""
    return int(Path(f"/proc/{process}/task/{thread}/schedstat").read_text().split()[0])


def test_room_is_for_seconds_of_ticks() -> None:
    ticks = shared.ROOM / 4000  # bytes of a tick with a dozen planes, generously
    assert ticks / 10_000 > 1.0

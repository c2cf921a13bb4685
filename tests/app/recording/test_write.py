"""The file holds what the loop said; what keeps it from being written does not stop the loop."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from app.recording import capture, rerun
from app.recording.read import read
from app.session import Session
from app.settings import Options
from app.words import Refused
from tests.support.headless import wait_until

CUBE = Options(mesh="cube", robot="point")


def test_the_file_holds_what_the_loop_said(tmp_path: Path, tapes: list) -> None:
    session = Session(CUBE)
    session.record(tmp_path / "run.vfrec")
    with session:
        start = session.scene.T_base_start
        session.drive(pin.SE3(start.rotation, start.translation - [0.0, 0.001, 0.03]))
        while session.latest().tick < 120:
            time.sleep(1e-3)
    said = tapes[1].items[1:]
    recording = read(tmp_path / "run.vfrec")
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


def test_a_recording_that_cannot_begin_is_refused_with_the_reason(tmp_path: Path) -> None:
    session = Session(CUBE)
    with pytest.raises(Refused, match="nothing is being recorded"):
        session.stop_recording()
    for path, reason in (
        (tmp_path / "none" / "run.vfrec", "No such file or directory"),
        (Path("/proc/run.vfrec"), "cannot record to /proc/run.vfrec"),
    ):
        with pytest.raises(Refused, match=reason) as caught:
            session.record(path)
        assert "Errno" not in str(caught.value)


def test_one_recording_at_a_time(tmp_path: Path) -> None:
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
    assert rerun.first_difference(read(tmp_path / "b.vfrec")) is None


def test_a_writer_that_falls_behind_ends_the_recording_not_the_loop(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(capture, "BEHIND", 5)
    monkeypatch.setattr(capture, "PERIOD", 0.1)
    with Session(CUBE) as session:
        going = session.record(tmp_path / "a.vfrec")
        wait_until(lambda: not going.running)
        assert "behind" in going.note
        tick = session.latest().tick
        wait_until(lambda: session.latest().tick > tick + 20)
    recording = read(tmp_path / "a.vfrec")
    assert len(recording.rows) >= 1
    assert "behind" in recording.note
    assert rerun.first_difference(recording) is None

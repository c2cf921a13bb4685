"""What was written until then is readable: after a kill, on a full disk, beside another session."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from app.commands import call
from app.recording import rerun
from app.recording.format import RecordingError
from app.recording.read import read
from app.recording.write import Recorder
from app.session import Session
from app.settings import Options
from tests.support import killed
from tests.support.headless import wait_until

CUBE = Options(mesh="cube", robot="point")
ROOT = Path(__file__).parents[3]


@pytest.fixture(scope="module")
def processes() -> Iterator[multiprocessing.context.ForkServerContext]:
    """Starts processes that have everything loaded already."""
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["tests.support.prepared"])
    with pytest.MonkeyPatch.context() as patch:
        # What is to be loaded is looked for there; this process's own path is not handed on.
        patch.setenv("PYTHONPATH", str(ROOT))
        yield context
    from multiprocessing import forkserver, resource_tracker

    forkserver._forkserver._stop()  # type: ignore[attr-defined]
    resource_tracker._resource_tracker._stop()  # type: ignore[attr-defined]


def said(folder: Path, stem: str = "run") -> int:
    try:
        return int((folder / f"said-{stem}").read_text() or -1)
    except FileNotFoundError:
        return -1


@pytest.mark.parametrize("kills", [6, pytest.param(60, marks=pytest.mark.slow)])
def test_a_recording_survives_a_kill_at_any_moment(
    processes: multiprocessing.context.ForkServerContext, tmp_path: Path, kills: int
) -> None:
    rng = np.random.default_rng()
    for k in range(kills):
        folder = tmp_path / str(k)
        folder.mkdir()
        process = processes.Process(target=killed.record, args=(str(folder),))
        process.start()
        wait_until(lambda folder=folder, k=k: said(folder) >= k % 3)
        time.sleep(rng.uniform(0.0, 0.3))  # not to wait for anything: at any moment
        os.kill(process.pid, signal.SIGKILL)
        process.join()
        if said(folder) == 0:
            with contextlib.suppress(RecordingError):  # before the first tick: nothing to lose
                read(folder / "run.vfrec")
            continue
        recording = read(folder / "run.vfrec")
        assert len(recording.rows) >= said(folder)
        assert recording.cut.startswith(
            f"The recording was cut off: {len(recording.rows) * 1e-3:.2f} "
        )
        assert rerun.first_difference(recording) is None


def test_the_command_line_says_what_is_left_and_what_is_not(
    sound: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "cut.vfrec"
    path.write_bytes(sound.read_bytes()[:-90])
    left = len(read(path).rows)
    assert 0 < left < len(read(sound).rows)
    assert call("replay", [str(path), "--check"]) == 0
    out = capsys.readouterr().out
    assert f"The recording was cut off: {left * 1e-3:.2f} of at least" in out
    assert f"{left} ticks the same to the last bit as far as they are readable" in out
    csv = tmp_path / "cut.csv"
    assert call("replay", [str(path), "--csv", str(csv)]) == 0
    assert "cut off" in capsys.readouterr().out
    assert len(csv.read_text().splitlines()) == 1 + left


def test_a_second_session_with_this_name_takes_another_and_what_is_there_stays(
    tmp_path: Path,
) -> None:
    remains = tmp_path / "run.vfrec"
    with Session(CUBE) as one, Session(CUBE) as two:
        first, second = one.record(remains), two.record(remains)
        assert [t.path.name for t in (first, second)] == ["run.vfrec", "run-2.vfrec"]
        wait_until(lambda: first.rows > 20 and second.rows > 20)
        so_far = read(remains)
        assert so_far.cut == (
            f"The recording is still going on: {len(so_far.rows) * 1e-3:.2f} s so far."
        )
    assert "run.vfrec was there already" in second.outcome
    assert first.elsewhere == ""
    before = remains.read_bytes()
    for path in (remains, tmp_path / "run-2.vfrec"):
        assert read(path).cut == ""
        assert rerun.first_difference(read(path)) is None
    # Nor does a third one that begins and is cut off touch them.
    Recorder(remains).discard()
    assert remains.read_bytes() == before
    assert {p.name for p in tmp_path.iterdir()} == {"run.vfrec", "run-2.vfrec"}


def test_a_name_that_leads_elsewhere_is_not_followed(tmp_path: Path) -> None:
    target = tmp_path / "precious"
    target.write_text("precious")
    for name, to in (("link.vfrec", target), ("dangling.vfrec", tmp_path / "nothing")):
        (tmp_path / name).symlink_to(to)
        recorder = Recorder(tmp_path / name)
        assert recorder.path.name == name.replace(".", "-2.")
        recorder.discard()
    assert target.read_text() == "precious"
    assert not (tmp_path / "nothing").exists()


@pytest.mark.parametrize("limit", [0, 23, 700, 30_000])
def test_what_fits_is_kept_where_no_file_may_grow(
    processes: multiprocessing.context.ForkServerContext, tmp_path: Path, limit: int
) -> None:
    process = processes.Process(target=killed.record, args=(str(tmp_path), limit))
    process.start()
    process.join(60)
    assert process.exitcode == 0
    kept(tmp_path, (tmp_path / "outcome").read_text(), limit)


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A file system of 64 kB."""
    place = tmp_path / "disk"
    place.mkdir()
    command = ["mount", "-t", "tmpfs", "-o", "size=64k", "tmpfs", str(place)]
    try:
        subprocess.run(command, check=True, capture_output=True)
    except (OSError, subprocess.CalledProcessError) as error:
        pytest.skip(f"no file system can be mounted here ({error})")
    yield place
    subprocess.run(["umount", str(place)], check=True)


def test_what_fits_is_kept_on_a_full_disk_and_the_loop_goes_on(small_disk: Path) -> None:
    with Session(CUBE) as session:
        (small_disk / "other").write_bytes(bytes(30_000))
        going = session.record(small_disk / "run.vfrec")
        session.set_autopilot(True)
        wait_until(lambda: not going.running)
        assert "it ended because the disk is full (No space left on device)" in going.outcome
        tick = session.latest().tick
        wait_until(lambda: session.latest().tick > tick + 20)
    kept(small_disk, going.outcome, 30_000)
    assert (small_disk / "other").stat().st_size == 30_000
    # A disk that is full from the beginning.
    (small_disk / "other").write_bytes(bytes(4096))
    with (small_disk / "rest").open("wb", buffering=0) as file, contextlib.suppress(OSError):
        while True:
            file.write(bytes(512))
    with Session(CUBE) as session:
        going = session.record(small_disk / "none.vfrec")
        wait_until(lambda: not going.running)
    assert going.outcome == ("Nothing was recorded: the disk is full (No space left on device).")
    assert not (small_disk / "none.vfrec").exists()


def kept(folder: Path, outcome: str, limit: int) -> None:
    """What there is can be read and repeated, and is what the outcome says."""
    path = folder / "run.vfrec"
    if not path.exists():
        assert limit < 30_000
        assert outcome == "Nothing was recorded: the file cannot be written (File too large)."
        return
    recording = read(path)
    assert f"Recorded {len(recording.rows):,} ticks" in outcome
    assert "No space left" in outcome or "File too large" in outcome
    # There may have been no room for the end of it.
    assert "cut off" in recording.cut or (recording.note and recording.note in outcome)
    assert rerun.first_difference(recording) is None
    assert path.stat().st_size > 0.2 * limit


@pytest.mark.slow
def test_a_whole_sandbox_that_is_killed_leaves_a_recording(tmp_path: Path) -> None:
    path = tmp_path / "run.vfrec"
    words = ["--mesh", "cube", "--robot", "point", "--port", "0", "--record", str(path)]
    with subprocess.Popen(
        [sys.executable, "-u", "-m", "app", *words], stdout=subprocess.PIPE, text=True, cwd=ROOT
    ) as process:
        try:
            assert process.stdout is not None
            assert any("Open http" in line for line in process.stdout)
            deadline = time.monotonic() + 30.0
            while rows(path) < 200:
                assert time.monotonic() < deadline
                time.sleep(0.02)
        finally:
            process.kill()
    check = [sys.executable, "-m", "app", "replay", str(path), "--check"]
    done = subprocess.run(check, capture_output=True, text=True, cwd=ROOT, check=False)
    assert done.returncode == 0, done.stderr
    assert "The recording was cut off" in done.stdout
    assert "the same to the last bit" in done.stdout


def rows(path: Path) -> int:
    try:
        return len(read(path).rows)
    except RecordingError:
        return 0

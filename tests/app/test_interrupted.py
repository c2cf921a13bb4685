"""An interrupted command ends with what there is so far, and with exit code 130."""

from __future__ import annotations

import contextlib
import importlib
import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import meshes
from app.__main__ import main
from app.recording import rerun as rerun_module
from app.session import Session
from app.settings import Options
from app.studies import batch as study
from app.studies.experiments import calibration, protocol
from app.studies.verification import campaign
from tests.support.headless import wait_until

ROOT = Path(__file__).parents[2]
SHORT = ["--rate", "50", "--length", "2mm"]
Broken = Callable[[Any, str, int], None]


@pytest.fixture
def broken(monkeypatch: pytest.MonkeyPatch) -> Broken:
    """Ctrl-C comes into the n-th call of a function."""

    def at(owner: Any, name: str, call: int) -> None:
        whole = getattr(owner, name)
        calls = 0

        def interrupted(*arguments: Any, **keywords: Any) -> Any:
            nonlocal calls
            calls += 1
            if calls == call:
                raise KeyboardInterrupt
            return whole(*arguments, **keywords)

        monkeypatch.setattr(owner, name, interrupted)

    return at


def test_verify_tells_the_cases_it_has_done(
    broken: Broken, capsys: pytest.CaptureFixture[str]
) -> None:
    broken(campaign, "drive", 3)
    words = ["verify", "--mesh", "cube", "--steps", "2200", "--damage", "all"]
    assert main(words) == 130
    out, err = capsys.readouterr()
    assert "crossings at radius" in out
    assert err == "vf-sandbox verify: interrupted: this is of 200 ticks and 0 queries\n"


def test_experiments_report_the_trials_that_are_whole(
    broken: Broken, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    broken(protocol, "run", 4)
    words = ["experiment", "tracing", "--mesh", "skull-coarse", *SHORT, "--out", str(tmp_path)]
    assert main(words) == 130
    out, err = capsys.readouterr()
    assert "1 + 1 trials" in out
    assert "interrupted: this is of 2 trials of 10" in err
    assert len((tmp_path / "trials.csv").read_text("utf-8").splitlines()) == 3


def test_a_study_tells_what_is_done_and_that_it_can_go_on(
    broken: Broken, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    broken(study, "outcome_text", 3)
    words = ["study", "--operators", "2", "--meshes", "skull-coarse", *SHORT, "--workers", "0",
             "--out", str(tmp_path)]  # fmt: skip
    assert main(words) == 130
    out, err = capsys.readouterr()
    assert "2 trials, seed 0" in out
    assert "interrupted: 2 of 4 trials done and kept; the same command goes on" in err
    assert len((tmp_path / "summary.csv").read_text("utf-8").splitlines()) == 3
    assert main(words) == 0
    assert "4 trials, seed 0" in capsys.readouterr().out


def test_a_calibration_tells_the_nearest_so_far(
    broken: Broken, capsys: pytest.CaptureFixture[str]
) -> None:
    broken(calibration, "reached", 3)
    assert main(["experiment", "calibrate", "--trials", "2"]) == 130
    out, err = capsys.readouterr()
    assert "view_angle = " in out
    assert "interrupted: this is the nearest so far" in err


def test_a_replay_tells_how_far_it_is_the_same(
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
) -> None:
    path = tmp_path / "some.vfrec"
    with Session(Options(mesh="cube", robot="point", rate=500.0)) as session:
        tape = session.record(str(path))
        wait_until(lambda: session.latest().tick > 10)
        tape.finish()
    whole = rerun_module.rerun

    def rerun(*arguments: Any, **keywords: Any) -> Any:
        for k, row in enumerate(whole(*arguments, **keywords)):
            if k == 2:
                raise KeyboardInterrupt
            yield row

    monkeypatch.setattr(rerun_module, "rerun", rerun)
    assert main(["replay", str(path)]) == 130
    assert "interrupted: 2 of " in capsys.readouterr().err
    assert main(["replay", str(path), "--check"]) == 130
    assert "all the same to the last bit" in capsys.readouterr().err


def test_nothing_is_written_by_half(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    def interrupt(*_: Any, **__: Any) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(meshes, "repair", interrupt)
    monkeypatch.setattr(meshes, "health", interrupt)
    out = tmp_path / "out.ply"
    assert main(["mesh", "repair", "cube", str(out)]) == 130
    assert "vf-sandbox mesh repair: interrupted: nothing was written" in capsys.readouterr().err
    assert main(["mesh", "check", "cube"]) == 130
    assert "vf-sandbox mesh check: interrupted: no report yet" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_a_measurement_in_part_does_not_replace_a_whole_one(
    broken: Broken, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    broken(meshes, "health", 3)  # the first is to compile the kernels
    kept = tmp_path / "meshes.json"
    kept.write_text("{}")
    words = ["bench", "meshes", "--mesh", "cube", "--formats", "stl", "--out", str(tmp_path)]
    assert main(words) == 130
    out, err = capsys.readouterr()
    assert "STL file to a ready fixture" in out
    assert "interrupted: this is what there was so far" in err
    assert json.loads(kept.read_text()) == {}


HIDES = """
import sys, signal, time, os
from app.__main__ import main
import app.cli
class Hides:
    def __del__(self):
        os.kill(os.getpid(), signal.SIGINT)
        for _ in range(1000): pass
def run(words):
    Hides()  # Ctrl-C comes where its exception is lost
    while True: time.sleep(0.01)
app.cli.run = run
sys.exit(main([]))
"""
IMPORTS = """
import sys, signal, os
from app.__main__ import main
import app.cli
def run(words):
    sys.path.insert(0, sys.argv[1])
    import halfway
    print(halfway.whole, flush=True)
    while True: signal.pause()
app.cli.run = run
sys.exit(main([]))
"""


@pytest.mark.parametrize(
    ("code", "told"), [(HIDES, ""), (IMPORTS, "True\n")], ids=["in a destructor", "in an import"]
)
def test_an_interrupt_is_neither_lost_nor_in_the_middle_of_an_import(
    code: str, told: str, tmp_path: Path
) -> None:
    (tmp_path / "halfway.py").write_text(
        "import os, signal\nos.kill(os.getpid(), signal.SIGINT)\n"
        "for _ in range(1000): pass\nwhole = True\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, str(tmp_path)],
        capture_output=True, text=True, timeout=60, cwd=ROOT,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )  # fmt: skip
    assert done.returncode == 130, done.stderr
    assert done.stdout == told
    assert "Traceback" not in done.stderr


KERNEL = """
from vf.kernels import njit

@njit(cache=True)
def largest(values):
    best = values[0]
    for value in values:
        if not value > 0.0:
            raise ValueError("must be positive")
        best = max(best, value)
    return best
"""
LOADS = """
import importlib, os, signal, sys
import numpy as np
from app import interrupts
from app.__main__ import main
import app.cli
import llvmlite.binding.ffi as ffi
import numba.core.caching as files

interrupts.RETRY_DELAY = 1e6  # the alarm is rung below
calls = 0

def interrupt(frame, event, _):
    global calls
    if event != "return":
        return
    call = frame.f_code is ffi._lib_fn_wrapper.__call__.__code__
    if call or frame.f_code.co_filename == files.__file__:
        calls += call
        os.kill(os.getpid(), signal.SIGINT)

def run(words):
    sys.path.insert(0, sys.argv[1])
    import kernel
    for loaded in (0, 1):
        before = calls
        kernel = importlib.reload(kernel)
        sys.setprofile(interrupt)
        assert kernel.largest(np.array([1.0, 3.0, 2.0])) == 3.0
        sys.setprofile(None)
        assert calls > before
        assert sum(kernel.largest.stats.cache_hits.values()) == loaded
    print("whole", flush=True)
    signal.raise_signal(signal.SIGALRM)
    while True: signal.pause()

app.cli.run = run
sys.exit(main([]))
"""


def test_no_interrupt_comes_between_the_compiler_and_what_it_owns(tmp_path: Path) -> None:
    (tmp_path / "kernel.py").write_text(KERNEL)
    # After every call into LLVM and every step with a file, while a kernel is compiled and while
    # it is read.
    done = subprocess.run(
        [sys.executable, "-c", LOADS, str(tmp_path)],
        capture_output=True, text=True, timeout=60, cwd=ROOT,
        env={key: value for key, value in os.environ.items() if key != "NUMBA_CACHE_DIR"},
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )  # fmt: skip
    assert done.stdout == "whole\n", done.stderr
    assert done.returncode == 130, done.stderr
    assert done.stderr == ""


LOCKED = """
import os, signal, sys, threading
from app import interrupts
from app.__main__ import main
import app.cli
from numba.core.compiler_lock import _CompilerLock, global_compiler_lock

interrupts.RETRY_DELAY = 1e6
name = sys.argv[1]

def interrupt(frame, event, _):
    if event == "return" and frame.f_code is getattr(_CompilerLock, name).__code__:
        sys.setprofile(None)
        os.kill(os.getpid(), signal.SIGINT)

def run(words):
    sys.setprofile(interrupt)
    with global_compiler_lock:
        pass
    assert sys.getprofile() is None
    def take():
        with global_compiler_lock:
            print("free", flush=True)
    other = threading.Thread(target=take, daemon=True)
    other.start()
    other.join(10.0)
    signal.raise_signal(signal.SIGALRM)
    while True: signal.pause()

app.cli.run = run
sys.exit(main([]))
"""


@pytest.mark.parametrize("name", ["acquire", "release"])
def test_an_interrupt_leaves_the_compiler_to_other_threads(name: str) -> None:
    done = subprocess.run(
        [sys.executable, "-c", LOCKED, name],
        capture_output=True, text=True, timeout=60, cwd=ROOT,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )  # fmt: skip
    assert done.stdout == "free\n", done.stderr
    assert done.returncode == 130, done.stderr


CLUSTER = """
import asyncio, os, signal, sys
from distributed.nanny import Nanny
from app.__main__ import main

begin = Nanny.start_unsafe

async def interrupted(self):
    os.kill(os.getpid(), signal.SIGINT)
    await asyncio.sleep(1.0)
    return await begin(self)

Nanny.start_unsafe = interrupted
sys.exit(main(sys.argv[1:]))
"""


@pytest.mark.slow
def test_an_interrupt_while_workers_begin_leaves_none(tmp_path: Path) -> None:
    pytest.importorskip("distributed")
    done = subprocess.run(
        [sys.executable, "-c", CLUSTER, "study", "--operators", "1", "--meshes", "skull-coarse",
         *SHORT, "--workers", "1", "--out", str(tmp_path)],
        capture_output=True, text=True, timeout=120, cwd=ROOT,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )  # fmt: skip
    assert done.returncode == 130, done.stderr
    assert "Traceback" not in done.stderr
    assert "interrupted: 0 of 2 trials done and kept" in done.stderr.splitlines()[-1]


def test_what_a_dead_cluster_leaves_is_told(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    whole = study.outcome_text

    def die(trials: Any, workers: int, scheduler: str | None) -> Any:
        yield whole(trials[0])
        raise study.ClusterLost("the scheduler is gone")

    monkeypatch.setattr(study, "_distributed", die)
    words = ["study", "--operators", "1", "--meshes", "skull-coarse", *SHORT,
             "--out", str(tmp_path)]  # fmt: skip
    assert main(words) == 2
    out, err = capsys.readouterr()
    assert "1 trial, seed 0" in out
    assert err.endswith(
        "vf-sandbox study: error: the scheduler is gone; 1 of 2 trials done and kept; the same "
        "command goes on with the rest\n"
    )


GRID: dict[str, Any] = {
    "experiments": ["cutting"], "operators": 4, "meshes": ["skull-coarse"], "rules": ["off"],
    "noise": [0.0], "rate": 50.0, "length": 2e-3,
}  # fmt: skip


def test_a_scheduler_that_is_gone_gives_back_no_outcomes(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    distributed = pytest.importorskip("distributed")
    client = importlib.import_module("distributed.client")
    text = study.outcome_text(study.grid(**GRID)[0])

    class Client:
        def submit(self, *_: Any, **__: Any) -> None:
            pass

    # Futures of a lost scheduler are given back with their error as the result.
    results = [(None, text), (None, client.FutureCancelledError("key", "lost", "why"))]
    monkeypatch.setattr(study, "_client", lambda *_: contextlib.nullcontext(Client()))
    monkeypatch.setattr(distributed, "as_completed", lambda *_, **__: iter(results))
    with pytest.raises(study.ClusterLost, match="the scheduler is gone"):
        study.run_all(study.grid(**GRID), tmp_path, workers=1)
    assert len(list(tmp_path.glob("*.json"))) == 1


@pytest.fixture(scope="module")
def offload() -> None:
    """A thread that Dask keeps for good is there before it is looked for what a test leaves."""
    importlib.import_module("distributed.utils")._offload_executor.submit(int).result()


@pytest.mark.slow
def test_workers_that_die_are_one_line(
    offload: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("distributed")
    monkeypatch.setattr(study, "RETRIES", 0)
    monkeypatch.setattr(study, "outcome_text", lambda _trial: os.kill(os.getpid(), 9))
    with pytest.raises(study.ClusterLost, match="1 worker died under the trial cutting-skull"):
        study.run_all(study.grid(**GRID), tmp_path, workers=1)

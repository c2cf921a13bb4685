"""Helpers for the tests of the headless app, and an oracle that knows nothing of the fixtures."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import threading
import time
import urllib.request
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from app import session as sessions
from app.control.mailbox import Mailbox

ROOT = Path(__file__).parents[2]


class Oracle:
    """Brute force over the whole mesh, in numpy: crossings and winding numbers."""

    def __init__(self, vertices: np.ndarray, faces: np.ndarray) -> None:
        self.corners = np.asarray(vertices)[np.asarray(faces)]  # (m, 3, 3)
        self.low, self.high = self.corners.min(axis=1), self.corners.max(axis=1)

    def crossings(self, path: np.ndarray) -> int:
        """How many steps of a path (k, 3) cut a triangle (Möller–Trumbore, double sided)."""
        # Every triangle whose box meets the box of a stretch is tested against each of its steps.
        return sum(self._crossings(path[k : k + 51]) for k in range(0, len(path) - 1, 50))

    def _crossings(self, path: np.ndarray) -> int:
        low, high = path.min(axis=0) - 1e-6, path.max(axis=0) + 1e-6
        near = (self.low <= high).all(axis=1) & (self.high >= low).all(axis=1)
        a, b, c = self.corners[near].transpose(1, 0, 2)
        e1, e2 = b - a, c - a
        count = 0
        for k in np.flatnonzero((np.diff(path, axis=0) != 0.0).any(axis=1)):
            start, move = path[k], path[k + 1] - path[k]
            h = np.cross(move, e2)
            det = (e1 * h).sum(axis=1)
            with np.errstate(divide="ignore", invalid="ignore"):
                s = start - a
                u = (s * h).sum(axis=1) / det
                q = np.cross(s, e1)
                v = (q @ move) / det
                t = (e2 * q).sum(axis=1) / det
                hit = (u >= 0) & (v >= 0) & (u + v <= 1) & (t >= 0) & (t <= 1)
            count += bool(hit.any())
        return count

    def winding(self, x: np.ndarray) -> float:
        """Generalised winding number: the sum of solid angles (Van Oosterom and Strackee)."""
        a, b, c = (self.corners - x).transpose(1, 0, 2)
        la, lb, lc = (np.linalg.norm(v, axis=1) for v in (a, b, c))
        numerator = (a * np.cross(b, c)).sum(axis=1)
        denominator = (
            la * lb * lc + (a * b).sum(axis=1) * lc + (b * c).sum(axis=1) * la
            + (c * a).sum(axis=1) * lb
        )  # fmt: skip
        return float(np.arctan2(numerator, denominator).sum() / (2.0 * np.pi))


class Tape(Mailbox):
    """A mailbox that remembers everything put into it."""

    __slots__ = ("items",)

    def __init__(self, value: object = None) -> None:
        super().__init__(value)
        self.items: list = []

    def put(self, value: object) -> None:
        self.items.append(value)
        super().put(value)


@pytest.fixture(scope="session")
def oracle() -> type[Oracle]:
    return Oracle


@pytest.fixture(scope="session")
def tape() -> type[Tape]:
    return Tape


@pytest.fixture
def tapes(monkeypatch: pytest.MonkeyPatch) -> list[Tape]:
    """The mailboxes of the sessions to come, all they were given: orders, then telemetry."""
    made: list[Tape] = []

    def recorded(value: object = None) -> Tape:
        made.append(Tape(value))
        return made[-1]

    monkeypatch.setattr(sessions, "Mailbox", recorded)
    return made


@pytest.fixture(scope="session")
def wait_until() -> Callable[[Callable[[], bool]], None]:
    def wait(condition: Callable[[], bool], timeout: float = 20.0) -> None:
        deadline = time.monotonic() + timeout
        while not condition():
            if time.monotonic() > deadline:
                raise AssertionError("the condition did not become true in time")
            time.sleep(2e-3)

    return wait


@pytest.fixture(scope="session")
def moved() -> Callable[..., pin.SE3]:
    """A pose displaced along the base frame's axes [m]."""

    def move(pose: pin.SE3, dx: float = 0.0, dy: float = 0.0, dz: float = 0.0) -> pin.SE3:
        return pin.SE3(pose.rotation, pose.translation + np.array([dx, dy, dz]))

    return move


@pytest.fixture(autouse=True)
def no_thread_left_behind() -> Iterator[None]:
    before = set(threading.enumerate())
    yield
    left = [t for t in threading.enumerate() if t not in before]
    for thread in left:
        thread.join(2.0)  # one that was told to stop may take a moment (a progress bar's)
    assert [t.name for t in left if t.is_alive()] == []


@pytest.fixture
def page_of_command() -> Callable[..., str]:
    """Run a command that opens a page, fetch the page, end the command as asked: what it said."""

    def run(*words: str, end: signal.Signals = signal.SIGINT) -> str:
        with subprocess.Popen(
            [sys.executable, "-u", "-m", "app", *words],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            cwd=ROOT,
            env={**os.environ, "COLUMNS": "200"},
            # A shell's background jobs ignore interrupts, and so would what they start.
            preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
        ) as process:
            try:
                assert process.stdout is not None
                before: list[str] = []
                address = None
                for line in process.stdout:
                    before.append(line)
                    if address := re.search(r"Open (http://127\.0\.0\.1:\d+)", line):
                        break
                assert address is not None, (before, process.stderr and process.stderr.read())
                with urllib.request.urlopen(address[1], timeout=30) as page:
                    assert page.status == 200
                process.send_signal(end)
                out, err = process.communicate(timeout=30)
            finally:
                process.kill()
        assert process.returncode == 0, err
        assert "Closing." in out
        assert "Traceback" not in err
        return "".join(before)

    return run

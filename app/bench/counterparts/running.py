"""Starts the stand-ins, each in a process of its own, and speaks to them; a guard between them."""

from __future__ import annotations

import json
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from app.settings import Options

MODULES = {
    "arm": "app.bench.counterparts.arm",
    "console": "app.bench.counterparts.console",
    "relay": "app.bench.counterparts.relay",
}
QUITS = 60.0  # how long it may take a stand-in to write what it saw [s]


def free_port() -> int:
    """A UDP port that nobody listens on."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as one:
        one.bind(("127.0.0.1", 0))
        return int(one.getsockname()[1])


def guarded(
    arm: int, console: int, age: str, of_arm: str = "", of_master: str = "", **options: Any
) -> Options:
    """The options of a guard of a PSM between these two ports.

    Args:
        age: how old the newest value of a device may be, such as "100ms".
        of_arm, of_master: what follows in their addresses.
    """
    values: dict[str, Any] = {
        "mesh": "sphere", "robot": "psm", "standoff": 1e-4,
        "arm": f"socket://127.0.0.1:{arm}?age={age}{of_arm}",
        "master": f"socket://127.0.0.1:{console}?age={age}{of_master}",
    }  # fmt: skip
    return Options(**values | options)


class Counterpart:
    """A process that runs a stand-in."""

    def __init__(self, process: subprocess.Popen[str]) -> None:
        self.process = process

    def tell(self, *words: str) -> None:
        """Give it a line."""
        assert self.process.stdin is not None
        self.process.stdin.write(" ".join(words) + "\n")
        self.process.stdin.flush()

    def line(self) -> str:
        """The next line it says; waits for it.

        Raises:
            RuntimeError: it ended.
        """
        assert self.process.stdout is not None
        line = self.process.stdout.readline()
        if not line:
            raise RuntimeError(f"{self.process.args!r} ended")
        return line.rstrip("\n")

    def make(self, fault: str) -> tuple[float, float]:
        """Have it make a fault; when it did, by the monotonic clock: before and after [s]."""
        self.tell(fault)
        while True:
            word, *rest = self.line().split()
            if word == "made" and rest[0] == fault:
                return float(rest[1]), float(rest[2])

    def asked(self) -> dict[str, Any]:
        """What a console has heard so far."""
        self.tell("tell")
        while True:
            line = self.line()
            if line.startswith("{"):
                found: dict[str, Any] = json.loads(line)
                return found

    def quit(self) -> None:
        """End it, and wait until it has written what it saw.

        Raises:
            RuntimeError: it failed, or heard what an original could not read.
        """
        if self.process.poll() is None:
            self.tell("quit")
        assert self.process.stdout is not None
        rest = self.process.stdout.read()
        if self.process.wait(QUITS) != 0 or "done" not in rest or "too long" in rest:
            raise RuntimeError(f"{self.process.args!r} failed: {rest}")


@contextmanager
def process(*command: str) -> Iterator[Counterpart]:
    """A stand-in that is started by this command, and is ready; killed in the end."""
    with subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
        start_new_session=True,  # Ctrl-C is not for it: it is told to quit
    ) as started:  # fmt: skip
        try:
            found = Counterpart(started)
            if found.line() != "ready":
                raise RuntimeError(f"{command!r} is not ready")
            yield found
        finally:
            started.kill()


@contextmanager
def counterpart(kind: str, port: int, *words: str) -> Iterator[Counterpart]:
    """A running stand-in; `kind`: one of `MODULES`."""
    with process(sys.executable, "-m", MODULES[kind], "127.0.0.1", str(port), *words) as found:
        yield found

"""Starts the stand-ins for arms and consoles, each in a process of its own, and speaks to them."""

from __future__ import annotations

import json
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[2]
MODULES = {"arm": "dvrk_arm", "console": "dvrk_console", "slicer": "slicer"}


def free_port() -> int:
    """A UDP port that nobody listens on."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as one:
        one.bind(("127.0.0.1", 0))
        return int(one.getsockname()[1])


class Counterpart:
    """A process that runs a stand-in."""

    def __init__(self, process: subprocess.Popen[str]) -> None:
        self.process = process

    def tell(self, *words: str) -> None:
        assert self.process.stdin is not None
        self.process.stdin.write(" ".join(words) + "\n")
        self.process.stdin.flush()

    def asked(self) -> dict[str, Any]:
        """What a console has heard so far."""
        self.tell("tell")
        assert self.process.stdout is not None
        line = self.process.stdout.readline()
        found: dict[str, Any] = json.loads(line)
        return found

    def quit(self) -> None:
        if self.process.poll() is None:
            self.tell("quit")
        assert self.process.stdout is not None
        rest = self.process.stdout.read()
        assert self.process.wait(30) == 0, rest
        assert "done" in rest, rest
        assert "too long" not in rest


@contextmanager
def counterpart(kind: str, port: int, *words: str) -> Iterator[Counterpart]:
    """A running stand-in; `kind`: one of `MODULES`."""
    with subprocess.Popen(
        [sys.executable, "-m", f"tests.support.{MODULES[kind]}", "127.0.0.1", str(port), *words],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, cwd=ROOT,
    ) as process:  # fmt: skip
        try:
            assert process.stdout is not None
            assert process.stdout.readline() == "ready\n"
            yield Counterpart(process)
        finally:
            process.kill()

"""The places of a server: a process for each participant who is there, one per core."""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import sys
import threading
import time
from pathlib import Path

PATIENCE = 600.0  # a place of whom nothing was heard is free again [s]
ENDING = 15.0  # for a process to end [s]


def cores() -> int:
    """How many control loops at 1 kHz this machine carries: one per core that may be used."""
    return max(len(os.sched_getaffinity(0)), 1)


class Place:
    """A participant's process.

    Attributes:
        port, token: of its page; None until it is served.
        ended: whether the process ended.
    """

    def __init__(self, folder: Path, code: str, host: str, front: str) -> None:
        """Start it.

        Raises:
            OSError: it cannot be started.
        """
        self.port: int | None = None
        self.token: str | None = None
        self._process = subprocess.Popen(
            [
                sys.executable, "-m", "app.studies.people.served.room",
                str(folder), code, host, front,
            ],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, start_new_session=True,
        )  # fmt: skip
        threading.Thread(target=self._read, name=f"room {code}", daemon=True).start()

    def _read(self) -> None:
        assert self._process.stdout is not None
        line = self._process.stdout.readline()
        with contextlib.suppress(ValueError, KeyError, TypeError):
            told = json.loads(line)
            self.token, self.port = told["token"], int(told["port"])
        self._process.stdout.read()

    @property
    def ended(self) -> bool:
        return self._process.poll() is not None

    def nudge(self) -> None:
        """Tell it that the participant is at the front page."""
        assert self._process.stdin is not None
        with contextlib.suppress(OSError, ValueError):
            self._process.stdin.write("here\n")
            self._process.stdin.flush()

    def close(self) -> None:
        """Have it end: by the end of its input, else by force."""
        assert self._process.stdin is not None
        with contextlib.suppress(OSError, ValueError):
            self._process.stdin.close()
        try:
            self._process.wait(ENDING)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()


class Places:
    """Who is there. Thread-safe.

    Attributes:
        most: how many participants at once.
    """

    def __init__(self, folder: Path, host: str, most: int) -> None:
        self.most = most
        self._folder, self._host = folder, host
        self._seen: dict[str, float] = {}  # by code: monotonic time [s]
        self._rooms: dict[str, Place] = {}
        self._lock = threading.Lock()

    def take(self, code: str) -> bool:
        """Take a place, or keep the one this participant has; False: all are taken."""
        with self._lock:
            self._sweep()
            if code not in self._seen and len(self._seen) >= self.most:
                return False
            self._seen[code] = time.monotonic()
            if code in self._rooms:
                self._rooms[code].nudge()
            return True

    def room(self, code: str, front: str) -> Place:
        """The process of a participant who has a place; it is started if there is none.

        Raises:
            OSError: it cannot be started.
        """
        with self._lock:
            if code not in self._rooms or self._rooms[code].ended:
                self._rooms[code] = Place(self._folder, code, self._host, front)
            return self._rooms[code]

    def leave(self, code: str) -> None:
        """Free the place of a participant; the process ends meanwhile."""
        with self._lock:
            self._seen.pop(code, None)
            room = self._rooms.pop(code, None)
        if room is not None:
            threading.Thread(target=room.close, name="leaving", daemon=True).start()

    def close(self) -> None:
        """End all processes, and wait for it."""
        with self._lock:
            rooms = list(self._rooms.values())
            self._rooms, self._seen = {}, {}
        for room in rooms:
            room.close()

    def _sweep(self) -> None:
        """Free the places of those whose process ended by itself, or who never came back."""
        now = time.monotonic()
        for code in list(self._seen):
            room = self._rooms.get(code)
            silent = now - self._seen[code] > PATIENCE
            if silent and (room is None or room.ended):
                del self._seen[code]
                self._rooms.pop(code, None)

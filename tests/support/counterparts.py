"""Stand-ins for devices in processes of their own, with one for 3D Slicer, of the tests."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from app.bench.counterparts import running
from app.bench.counterparts.running import Counterpart, free_port

__all__ = ["ROOT", "Counterpart", "counterpart", "free_port"]

ROOT = Path(__file__).parents[2]


@contextmanager
def counterpart(kind: str, port: int, *words: str) -> Iterator[Counterpart]:
    """A running stand-in; `kind`: "arm", "console" or "slicer"."""
    if kind != "slicer":
        with running.counterpart(kind, port, *words) as found:
            yield found
        return
    command = sys.executable, "-m", "tests.support.slicer", "127.0.0.1", str(port), *words
    with running.process(*command) as found:
        yield found

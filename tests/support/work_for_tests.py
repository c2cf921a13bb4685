"""Work for a process aside, some of it more than it may do."""

from __future__ import annotations

import threading
from collections.abc import Callable

import numpy as np

import meshes

Progress = Callable[[str], None]


def add(one: int, other: int, progress: Progress) -> int:
    return one + other


def spin(progress: Progress) -> None:
    while True:
        pass


def fill(progress: Progress) -> int:
    return sum(len(np.ones(10_000_000)) for _ in [np.ones(100_000_000)])


def fill_and_blame_the_file(progress: Progress) -> None:
    try:
        fill(progress)
    except Exception as error:
        raise meshes.MeshError("bone.stl: cannot be read as STL") from error


def wait(progress: Progress) -> None:
    progress("waiting")
    threading.Event().wait()

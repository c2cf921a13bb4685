"""A session in one file: every order that took effect, every tick, and what they started from.

The file, version 2, is only ever appended to, in blocks that are complete or not there: whatever
ends the writing, all complete blocks are readable. It is `MAGIC` and then

- one ``HEAD``: JSON with format, version, package versions, and the state the engine started from;
- any number of ``PART``, zlib-compressed: the length of the JSON as a `LENGTH`, the JSON, and the
  columns of two tables one after another. The JSON has the scenes that are new in it (options at
  the time they were built, the mesh by name, size and SHA-256 of the placed surface, start joints),
  the plants that are new (scene, options and a scenario's course, one for every change of a
  setting), and the number of new orders. The tables are those orders, as `ORDERS`: what the session
  wanted, one row for every `Orders` the engine saw; and `ROWS`: one row for every tick, and one for
  every change of the orders while the loop was paused, as they happened. The column ``order`` is
  the order that counted, so the first row with an order tells the tick at which it took effect;
- one ``LAST``: JSON with why the recording ended. A file without it was cut off.

Each block begins with a `BLOCK`: its kind, the length of what follows [byte], how many rows are in
it (in ``LAST``: in all), and the CRC-32 of all this but itself, begun with that of the block before
(that of `MAGIC` before the first), so that no block can be lost or put elsewhere unnoticed.

Columns are little-endian, SI units, poses in the arm's base frame. An order that was replaced by a
newer one before the engine looked had no effect and is not in the file. Planes are not stored:
`vf.Controller.step` is a pure function of the joints and the target, so they are computed again,
and checked against ``planes_crc``.

Version 1, a zip archive whose list of contents came last, is still read: see `archive`. Host, port
and other matters of the server are not recorded.
"""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from app.control.autopilot import Course
from app.control.engine import State
from app.options import declared
from app.settings import Options

FORMAT, VERSION = "vf-sandbox recording", 2
MAGIC = b"vf-sandbox recording 2\n"
BLOCK = struct.Struct("<4sIII")
LENGTH = struct.Struct("<I")
HEAD, PART, LAST = b"HEAD", b"PART", b"LAST"
SUFFIX = ".vfrec"
JOINTS = 8  # width of the column q; an arm with fewer has zeros behind
CHUNK = 4096  # most rows that are compressed together
MAX_ROWS = 4_000_000  # over an hour at 1 kHz
MAX_ORDERS = 1_000_000
MAX_PLANTS = 20_000
MAX_WAYPOINTS = 1000  # of a course
MAX_HEADER = 64_000_000  # [byte]
MAX_BLOCK = 16_000_000  # [byte], unpacked

RECORDED = tuple(name for name, told in declared(Options).items() if told.recorded)

ORDERS = np.dtype(
    [
        ("plant", "<u4"),  # index of the header's plants
        ("driven", "u1"),  # whether there was a target
        ("target", "<f8", (3,)),  # of the tip (the proxy) [m]
        ("rotation", "<f8", (3, 3)),  # of the target
        ("sequence", "<i8"),  # of the command
        ("clutch", "u1"),
        ("held", "u1"),
        ("stamp", "<f8"),  # monotonic time of the command [s]
        ("paused", "u1"),
        ("steps", "<i8"),  # single steps ordered so far
        ("resets", "<i8"),  # resets ordered so far
        ("autopilot", "u1"),
        ("scale", "<f8"),  # of the teleoperation
        ("lock", "u1"),  # of the orientation
    ]
)
ROWS = np.dtype(
    [
        ("order", "<u4"),  # row of the orders that counted
        ("ticked", "u1"),  # 0: paused, only the orders changed
        ("tick", "<i8"),
        ("q", "<f8", (JOINTS,)),  # joints after the tick [rad or m]
        ("driven", "u1"),  # whether the tick had a target
        ("target", "<f8", (3,)),  # of the tip (the proxy) [m]
        ("stale", "u1"),
        ("stepped", "u1"),  # whether the controller was asked; else what follows is zero
        ("tip", "<f8", (3,)),  # [m]
        ("force", "<f8", (3,)),  # [N]
        ("status", "u1"),  # vf.Status
        ("solver", "u1"),  # vf.Solver
        ("distance", "<f8"),  # to the nearest plane's closest point [m]; inf: none
        ("radius", "<f8"),  # of the motion sphere [m]
        ("planes", "<u4"),  # how many
        ("turns_crc", "<u4"),  # of the rotations of target and tip
        ("planes_crc", "<u4"),
        ("forces_crc", "<u4"),  # of the planes' multipliers and the joints at their limits
        ("spent", "<f4"),  # time in the controller [s]; not repeatable, not compared
    ]
)
COMPARED = tuple(name for name in ROWS.names or () if name != "spent")


class RecordingError(ValueError):
    """A file that is no recording, or not one that can be used here; the message says why."""


def chained(crc: int, kind: bytes, rows: int, content: bytes) -> int:
    """The CRC-32 of a block, by that of the one before."""
    return zlib.crc32(content, zlib.crc32(BLOCK.pack(kind, len(content), rows, 0), crc))


@dataclass(frozen=True)
class Place:
    """A scene of a recording, by reference.

    Attributes:
        options: those it was built with.
        vertices, triangles: size of its mesh.
        checksum: `vf.Surface.checksum` of the mesh in its place.
        start: (n,) joints the tool starts from.
    """

    options: Options
    vertices: int
    triangles: int
    checksum: str
    start: NDArray[np.float64]


@dataclass(frozen=True)
class Recording:
    """What a file holds, checked.

    Attributes:
        places: the scenes, in the order they were entered.
        plants: scene (index of `places`) and options of every plant.
        courses: a scenario's script of every plant; None: the scene's own autopilot.
        state: the engine's, before the first row.
        orders: (k,) `ORDERS`; the first is what counted before the first row.
        rows: (n,) `ROWS`.
        note: why the recording ended, if not because it was told to.
        packages: versions it was made with, by name.
        cut: a sentence on what is missing at its end; empty: nothing is.
    """

    places: tuple[Place, ...]
    plants: tuple[tuple[int, Options], ...]
    courses: tuple[Course | None, ...]
    state: State
    orders: NDArray[Any]
    rows: NDArray[Any]
    note: str
    packages: dict[str, str]
    cut: str = ""

    @property
    def dt(self) -> float:
        """Length of a tick [s]; the same all through a session."""
        return self.plants[0][1].dt

    def joints(self, row: int) -> NDArray[np.float64]:
        """(n,) joints after a row; −1: before the first."""
        if row < 0:
            return self.state.q
        place = self.plants[self.orders["plant"][self.rows["order"][row]]][0]
        return np.array(self.rows["q"][row, : len(self.places[place].start)])

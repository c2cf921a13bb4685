"""Format of a recording: every order that took effect, every tick, and the state before them.

A file of version 7 is append-only and consists of blocks: wherever the writing ends, all complete
blocks are readable. It is `MAGIC`, followed by

- one ``HEAD``: JSON with format, version, package versions, and the initial state of the engine;
- any number of ``PART``, zlib-compressed: the length of the JSON as a `LENGTH`, the JSON, and the
  columns of two tables one after another. The JSON has the new scenes (options they were built
  with, the mesh by name, size and SHA-256 of the placed surface, the other structures by size and
  SHA-256 in the order of the options, start joints), the new plants
  (scene, options and a scenario's course; one for every change of a setting), and the number of new
  orders. The tables are the new orders, as `ORDERS`, one row for every `Orders` the engine saw; and
  `ROWS`, one row for every tick, and one for every change of the orders while the loop was paused.
  The column ``order`` is the order in force, so the first row with an order is the tick at which it
  took effect;
- any number of ``SHAP``: a shape of a structure that came from elsewhere, before the ``PART`` with
  the first row that it matters to: a `SHAPE` and its vertices, zlib-compressed, x, y, z of each in
  single precision;
- one ``LAST``: JSON with why the recording ended. A file without it is truncated.

Each block begins with a `BLOCK`: kind, length of the content [byte], number of its rows (in
``LAST``: of all rows), and the CRC-32 of these and the content, starting from the CRC of the
previous block (of `MAGIC` for the first), so that a missing or moved block is detected.

Columns are little-endian, SI units, poses in the arm's base frame. An order that was replaced by a
newer one before the engine read it had no effect and is not in the file. Planes are not stored:
`vf.Controller.step` is a pure function of the joints and the target, so they are computed again,
and checked against ``planes_crc``; so is how structures move, from the phase of their motion in
every row, and from the shapes where these come from elsewhere. Of devices there is what entered the
ticks: the joints that an arm measured, the goals of a master as they passed the border, and the
operating state. Options of the server, such as host and port, are not recorded.

Older versions are still read. They lack the options of `ADDED`, the columns of `LATER` and the
structures, and are else the same; for version 1 see `archive`.
"""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from app.control.autopilot import Course
from app.control.messages import State
from app.motion.stream import Frame
from app.options import declared
from app.settings import Options

FORMAT = "vf-sandbox recording"
VERSION = 7
MAGIC = b"vf-sandbox recording 7\n"
MAGICS = {b"vf-sandbox recording %d\n" % version: version for version in range(2, VERSION + 1)}
"""The versions of append-only files, by what they begin with; all equally long."""
ADDED: dict[int, dict[str, object]] = {
    3: {"guard": "tip", "trocar": 0.0},
    4: {"structures": [], "margin": 0.0, "guarded": True, "colour": None, "opacity": 1.0},
    5: {"motions": [], "tracker": None},
    6: {"registration": None},
    7: {"approach": 0.0, "arm": "sim"},
}
"""By version: the options that are in a recording since then, and what they were before."""
BLOCK = struct.Struct("<4sIII")
LENGTH = struct.Struct("<I")
# Index of the scene; number of the frame, of the shape; phase when it was seen [s]; how many
# vertices: see `app.motion.stream.Frame`.
SHAPE = struct.Struct("<IQQdI")
HEAD, PART, SHAP, LAST = b"HEAD", b"PART", b"SHAP", b"LAST"
SUFFIX = ".vfrec"
JOINTS = 8  # width of the column q, padded with zeros
CHUNK = 4096  # largest number of rows in a part
MAX_ROWS = 4_000_000  # over an hour at 1 kHz
MAX_ORDERS = MAX_ROWS  # a master that is elsewhere gives one a tick
MAX_PLANTS = 20_000
MAX_WAYPOINTS = 1000  # of a course
MAX_SHAPES = 2 * 10**8  # numbers in all shapes
MAX_HEADER = 64_000_000  # [byte]
MAX_BLOCK = 16_000_000  # [byte], unpacked

RECORDED = tuple(name for name, entry in declared(Options).items() if entry.recorded)

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
        ("moving", "u1"),  # whether structures that have a motion move …
        ("pace", "<f8"),  # … and how fast, over their own speed
        ("state", "u1"),  # operating state of an arm: index of `messages.STATES`
    ]
)
ROWS = np.dtype(
    [
        ("order", "<u4"),  # row of the orders in force
        ("ticked", "u1"),  # 0: paused, only the orders changed
        ("tick", "<i8"),
        ("q", "<f8", (JOINTS,)),  # joints after the tick [rad or m]
        ("driven", "u1"),  # whether the tick had a target
        ("target", "<f8", (3,)),  # of the tip (the proxy) [m]
        ("stale", "u1"),
        ("stepped", "u1"),  # whether the controller was called; else the columns below are zero
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
        ("phase", "<f8"),  # time of the motion of structures at the end of the tick [s]
        ("lost", "u1"),  # whether the tool held because a structure was not seen for too long
        ("sensed", "u1"),  # of the joints before the tick: `SIMULATED`, `MEASURED` or `UNKNOWN`
        ("measured", "<f8", (JOINTS,)),  # what the arm measured, where it did [rad or m]
    ]
)
SIMULATED, MEASURED, UNKNOWN = range(3)
"""Of the column `sensed`: the arm is where the tick before put it; where it measures; not known."""
LATER: dict[int, dict[str, object]] = {
    5: {"moving": 1, "pace": 1.0, "phase": 0.0, "lost": 0},
    7: {"state": 0, "sensed": SIMULATED, "measured": 0.0},
}
"""By version: the columns that tables have since then, and what they were before."""
MOTION_ADDED: dict[int, dict[str, object]] = {7: {"stream": None}}
"""By version: what an entry of the motions has since then, and what it was before."""
COMPARED = tuple(name for name in ROWS.names or () if name != "spent")


class RecordingError(ValueError):
    """A file that is not a usable recording; the message says why."""


def columns(table: np.dtype[Any], version: int) -> tuple[str, ...]:
    """The columns that `ORDERS` or `ROWS` has in a file of this version."""
    later = {name for since, names in LATER.items() if version < since for name in names}
    return tuple(name for name in table.names or () if name not in later)


def blank(table: np.dtype[Any], version: int, n: int) -> NDArray[Any]:
    """A table (n,) for the content of a file of this version: other columns as they were then."""
    made = np.zeros(n, dtype=table)
    for since, names in LATER.items():
        for name, value in names.items():
            if version < since and name in (table.names or ()):
                made[name] = value
    return made


def chained(crc: int, kind: bytes, rows: int, content: bytes) -> int:
    """The CRC-32 of a block, starting from that of the previous one."""
    return zlib.crc32(content, zlib.crc32(BLOCK.pack(kind, len(content), rows, 0), crc))


@dataclass(frozen=True)
class Shape:
    """A surface of a recording, by reference.

    Attributes:
        vertices, triangles: its size.
        checksum: `vf.Surface.checksum` of the placed surface.
    """

    vertices: int
    triangles: int
    checksum: str


@dataclass(frozen=True)
class Place:
    """A scene of a recording, by reference.

    Attributes:
        options: those it was built with.
        vertices, triangles: size of its mesh.
        checksum: `vf.Surface.checksum` of the placed mesh.
        start: (n,) joints the tool starts from.
        structures: the surfaces beside the mesh, in the order of the options.
        poses: `app.motion.movement.checksum` of the motions.
    """

    options: Options
    vertices: int
    triangles: int
    checksum: str
    start: NDArray[np.float64]
    structures: tuple[Shape, ...] = ()
    poses: str = ""


@dataclass(frozen=True)
class Recording:
    """The validated content of a file.

    Attributes:
        places: the scenes, in order of their use.
        plants: scene (index of `places`) and options of every plant.
        courses: a scenario's script of every plant; None: the scene's own autopilot.
        state: the engine's, before the first row.
        orders: (k,) `ORDERS`; the first are those in force before the first row.
        rows: (n,) `ROWS`.
        note: why the recording ended, if it was not stopped by the user.
        packages: versions it was made with, by name.
        cut: what is missing at its end, in one sentence; empty: nothing.
        shapes: those that came from elsewhere, each with its scene (index of `places`).
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
    shapes: tuple[tuple[int, Frame], ...] = ()

    @property
    def dt(self) -> float:
        """Length of a tick [s], constant in a session."""
        return self.plants[0][1].dt

    def joints(self, row: int) -> NDArray[np.float64]:
        """(n,) joints after a row; −1: before the first."""
        if row < 0:
            return self.state.q
        place = self.plants[self.orders["plant"][self.rows["order"][row]]][0]
        return np.array(self.rows["q"][row, : len(self.places[place].start)])

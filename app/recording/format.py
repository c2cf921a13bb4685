"""A session in one file: every order that took effect, every tick, and what they started from.

The file is a zip archive, version 1, of

- ``header.json``: format, version, package versions, the state the engine started from, the scenes
  (options at the time they were built, the mesh by name, size and SHA-256 of the placed surface,
  start joints), the plants (scene, options and a scenario's course, one for every change of a
  setting), the number of orders and of rows in each chunk, and why the recording ended.
- ``orders/<column>.npy``: what the session wanted, one row for every `Orders` the engine saw.
- ``rows/<chunk>/<column>.npy``: one row for every tick, and one for every change of the orders
  while the loop was paused, as they happened. ``rows/…/order`` is the row of ``orders`` that
  counted, so the first row with an order tells the tick at which it took effect.

Columns are numpy arrays without pickles, little-endian, SI units, poses in the arm's base frame;
`ORDERS` and `ROWS` list them. An order that was replaced by a newer one before the engine looked
had no effect and is not in the file. Planes are not stored: `vf.Controller.step` is a pure function
of the joints and the target, so they are computed again, and checked against ``planes_crc``.

Host, port and other matters of the server are not recorded.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from app.autopilot import Course
from app.engine import State
from app.settings import Options

FORMAT, VERSION = "vf-sandbox recording", 1
SUFFIX = ".vfrec"
JOINTS = 8  # width of the column q; an arm with fewer has zeros behind
CHUNK = 4096  # rows that are compressed together
MAX_ROWS = 4_000_000  # over an hour at 1 kHz
MAX_ORDERS = 1_000_000
MAX_PLANTS = 20_000
MAX_WAYPOINTS = 1000  # of a course
MAX_HEADER = 64_000_000  # [byte]

# The options that a tick, or the way to it, can depend on.
RECORDED = (
    "mesh", "unit", "at", "rotate", "up", "damage", "seed", "repair", "flip", "path", "corridor",
    "robot", "rule", "radius", "rate", "standoff", "tip_radius", "scale", "lock_orientation",
    "tip_speed", "force_gain", "stale_after",
)  # fmt: skip

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
    """

    places: tuple[Place, ...]
    plants: tuple[tuple[int, Options], ...]
    courses: tuple[Course | None, ...]
    state: State
    orders: NDArray[Any]
    rows: NDArray[Any]
    note: str
    packages: dict[str, str]

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

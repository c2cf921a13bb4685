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

import contextlib
import importlib.metadata
import io
import json
import math
import os
import platform
import struct
import zipfile
import zlib
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

import vf
from app.autopilot import Course
from app.engine import Orders, Plant, State
from app.messages import Command, Telemetry
from app.settings import OptionError, Options

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

T = TypeVar("T")


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


class Recorder:
    """Writes a recording. No thread, no clock: whoever runs an `Engine` calls `add`.

    Not thread-safe. `close` makes the file; before that there is one with ``.part`` appended.
    """

    def __init__(self, path: Path | str) -> None:
        """Open the file; `begin` comes next.

        Raises:
            RecordingError: the file exists.
            OSError: it cannot be written.
        """
        self.path = Path(path)
        if self.path.exists():
            raise RecordingError(f"{self.path} exists already: choose another name")
        self._state: State | None = None
        self._part = self.path.with_name(self.path.name + ".part")
        self._zip = zipfile.ZipFile(self._part, "w", zipfile.ZIP_DEFLATED, compresslevel=1)
        self._places: list[dict[str, Any]] = []
        self._versions: list[int] = []  # of the scenes, as `Plant.scene`
        self._plants: list[dict[str, Any]] = []
        self._plant: Plant | None = None
        self._last: Orders | None = None
        self._step: vf.Step | None = None
        self._orders = np.zeros(256, dtype=ORDERS)
        self._count = 0  # of orders
        self._rows = np.zeros(CHUNK, dtype=ROWS)
        self._filled = 0
        self._chunks: list[int] = []

    def begin(self, seen: Orders, state: State) -> None:
        """Start from an engine's state and the orders that it saw last.

        Raises:
            RecordingError: the arm has more joints than fit.
        """
        self._state, self._step = state, state.step
        self._note_orders(seen)

    @property
    def rows(self) -> int:
        """How many rows there are so far."""
        return sum(self._chunks) + self._filled

    def add(self, orders: Orders, telemetry: Telemetry, ticked: bool) -> None:
        """Append what `Engine.advance` made of these orders.

        Raises:
            RecordingError: one of the limits of a recording is reached; `close` is still possible.
            OSError: the disk is full or the like.
        """
        if self.rows >= MAX_ROWS:
            raise RecordingError(f"a recording holds at most {MAX_ROWS:,} ticks")
        if orders is not self._last:
            self._note_orders(orders)
        fill(self._rows, self._filled, self._count - 1, telemetry, ticked, self._step)
        self._step = telemetry.step
        self._filled += 1
        if self._filled == CHUNK:
            self._flush()

    def close(self, note: str = "") -> None:
        """Finish the file under its name. `note`: why it ends here, if it was not told to."""
        state = self._state
        if state is None:
            raise RecordingError("nothing was recorded")
        self._flush()
        self._table("orders", self._orders[: self._count])
        header = {
            "format": FORMAT,
            "version": VERSION,
            "packages": packages(),
            "note": note,
            "state": {
                "q": state.q.tolist(),
                "tick": state.tick,
                "steps": state.steps,
                "silent": state.silent,
                "autopilot_since": state.autopilot_since,
                "target": None if state.target is None else state.target.homogeneous.tolist(),
                "stale": state.stale,
            },
            "places": self._places,
            "plants": self._plants,
            "orders": self._count,
            "chunks": self._chunks,
        }
        self._zip.writestr("header.json", json.dumps(header))
        self._zip.close()
        os.replace(self._part, self.path)

    def discard(self) -> None:
        """Leave nothing behind."""
        with contextlib.suppress(OSError, ValueError):
            self._zip.close()
        self._part.unlink(missing_ok=True)

    def _note_orders(self, orders: Orders) -> None:
        if orders.plant is not self._plant:
            self._note_plant(orders.plant)
        if self._count >= MAX_ORDERS:
            raise RecordingError(f"a recording holds at most {MAX_ORDERS:,} orders")
        if self._count == len(self._orders):
            self._orders = np.concatenate([self._orders, np.zeros_like(self._orders)])
        command, target = orders.command, orders.command.target
        self._orders[self._count] = (
            len(self._plants) - 1,
            target is not None,
            0.0 if target is None else target.translation,
            0.0 if target is None else target.rotation,
            command.sequence,
            command.clutch,
            command.held,
            command.stamp,
            orders.paused,
            orders.steps,
            orders.resets,
            orders.autopilot,
            orders.scale,
            orders.lock_orientation,
        )
        self._count += 1
        self._last = orders

    def _note_plant(self, plant: Plant) -> None:
        if len(plant.q0) > JOINTS:
            raise RecordingError(f"an arm of {len(plant.q0)} joints: at most {JOINTS} are recorded")
        if len(self._plants) >= MAX_PLANTS:
            raise RecordingError(f"a recording holds at most {MAX_PLANTS:,} changes of settings")
        if not self._versions or self._versions[-1] != plant.scene:
            self._versions.append(plant.scene)
            self._places.append(
                {
                    "options": as_json(plant.scene_options),
                    "vertices": len(plant.surface.vertices),
                    "triangles": len(plant.surface.faces),
                    "checksum": plant.surface.checksum,
                    "start": plant.q0.tolist(),
                }
            )
        script = plant.autopilot
        self._plants.append(
            {
                "place": len(self._places) - 1,
                "options": as_json(plant.options),
                "course": None
                if not isinstance(script, Course)
                else {
                    "rotation": script.rotation.tolist(),
                    "times": script.times.tolist(),
                    "points": script.points.tolist(),
                },
            }
        )
        self._plant = plant

    def _flush(self) -> None:
        if self._filled:
            self._table(f"rows/{len(self._chunks):05d}", self._rows[: self._filled])
            self._chunks.append(self._filled)
            self._filled = 0

    def _table(self, folder: str, table: NDArray[Any]) -> None:
        for name in table.dtype.names or ():
            stream = io.BytesIO()
            np.save(stream, np.ascontiguousarray(table[name]), allow_pickle=False)
            self._zip.writestr(f"{folder}/{name}.npy", stream.getvalue())


def fill(
    rows: NDArray[Any],
    k: int,
    order: int,
    telemetry: Telemetry,
    ticked: bool,
    before: vf.Step | None,
) -> None:
    """Write a tick into row k of a table of `ROWS`; `before` is the step of the row before."""
    q = np.zeros(JOINTS)
    q[: len(telemetry.q)] = telemetry.q
    target, step = telemetry.target, telemetry.step
    goal, turns = np.zeros(3), 0
    if target is not None:
        goal, turns = target.translation, zlib.crc32(target.rotation.tobytes())
    head = (order, ticked, telemetry.tick, q, target is not None, goal, telemetry.stale)
    if step is None or step is before:
        rows[k] = (*head, False, 0.0, 0.0, 0, 0, 0.0, 0.0, 0, turns, 0, 0, 0.0)
        return
    planes = step.planes
    crc = zlib.crc32(planes.normals.tobytes())
    for array in (planes.offsets, planes.points, planes.triangles, planes.rules):
        crc = zlib.crc32(array.tobytes(), crc)
    crc = zlib.crc32(np.float64(planes.radius).tobytes(), crc)
    rows[k] = (
        *head,
        True,
        step.tip.translation,
        step.force,
        step.status,
        step.solver,
        step.distance,
        step.radius,
        len(planes),
        zlib.crc32(step.tip.rotation.tobytes(), turns),
        crc,
        zlib.crc32(step.limits.tobytes(), zlib.crc32(step.multipliers.tobytes())),
        step.timings.total,
    )


def packages() -> dict[str, str]:
    """Versions of what a tick's last bit can depend on."""
    found = {"python": platform.python_version(), "machine": platform.machine()}
    for name in ("vf-sandbox", "numpy", "numba", "osqp", "pin"):
        with contextlib.suppress(importlib.metadata.PackageNotFoundError):
            found[name] = importlib.metadata.version(name)
    return found


def as_json(options: Options) -> dict[str, Any]:
    """The options that are recorded."""
    return {name: getattr(options, name) for name in RECORDED}


def command(order: np.void) -> Command:
    """The command of a row of `ORDERS`."""
    target = pin.SE3(order["rotation"], order["target"]) if order["driven"] else None
    return Command(
        target,
        int(order["sequence"]),
        bool(order["clutch"]),
        bool(order["held"]),
        float(order["stamp"]),
    )


def read(path: Path | str) -> Recording:
    """A recording from a file that nobody vouches for.

    Raises:
        RecordingError: it is no recording, damaged, of another version, or larger than any; the
            message is one line.
        OSError: it cannot be read.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            return _Reader(archive).recording()
    except RecordingError as error:
        raise RecordingError(f"{path}: {error}") from None
    except (
        zipfile.BadZipFile,
        zlib.error,
        NotImplementedError,  # a compression of another kind
        RuntimeError,  # encrypted
        EOFError,
        struct.error,
    ) as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        raise RecordingError(f"{path}: not a readable recording ({reason})") from None


class _Reader:
    """Reads one archive; no size is believed before it is compared with what it must be."""

    def __init__(self, archive: zipfile.ZipFile) -> None:
        self._archive = archive
        self._members = {info.filename: info for info in archive.infolist()}
        if len(self._members) != len(archive.infolist()):
            raise RecordingError("a member is there twice")

    def recording(self) -> Recording:
        if "header.json" not in self._members:
            raise RecordingError("not a recording: header.json is missing")
        try:
            header = json.loads(self._bytes("header.json", MAX_HEADER), parse_constant=_no_constant)
        except RecordingError:
            raise
        except (ValueError, RecursionError) as error:
            raise RecordingError(f"header.json is damaged ({str(error)[:120]})") from None
        if not isinstance(header, dict) or header.get("format") != FORMAT:
            raise RecordingError(f"not a recording: the format is not '{FORMAT}'")
        if header.get("version") != VERSION:
            raise RecordingError(
                f"version {str(header.get('version'))[:20]} of the format: "
                f"this program reads version {VERSION}"
            )
        places = tuple(_place(entry) for entry in _items(header, "places", MAX_PLANTS))
        plants = tuple(_plant(entry, len(places)) for entry in _items(header, "plants", MAX_PLANTS))
        courses = tuple(_course(entry.get("course")) for entry in header["plants"])
        if len({options.rate for _, options in plants}) != 1:
            raise RecordingError("the rate changes within the recording")
        chunks = [
            _whole(n, "the rows of a chunk", 1, CHUNK)
            for n in _items(header, "chunks", MAX_ROWS, least=0)
        ]
        if sum(chunks) > MAX_ROWS:
            raise RecordingError(f"{sum(chunks):,} rows: at most {MAX_ROWS:,} are read")
        count = _whole(header.get("orders"), "the number of orders", 1, MAX_ORDERS)
        orders = self._table("orders", ORDERS, count)
        rows = np.zeros(sum(chunks), dtype=ROWS)
        at = 0
        for k, n in enumerate(chunks):
            rows[at : at + n] = self._table(f"rows/{k:05d}", ROWS, n)
            at += n
        expected = 1 + len(ORDERS.names or ()) + len(chunks) * len(ROWS.names or ())
        if len(self._members) != expected:
            raise RecordingError("there are members that do not belong into a recording")
        recording = Recording(
            places=places,
            plants=plants,
            courses=courses,
            state=_state(header.get("state"), len(places[plants[0][0]].start)),
            orders=orders,
            rows=rows,
            note=_text(header.get("note"), "note"),
            packages={
                _text(name, "package"): _text(version, "version")
                for name, version in _mapping(header, "packages").items()
            },
        )
        _check(recording)
        return recording

    def _bytes(self, name: str, limit: int) -> bytes:
        info = self._members.get(name)
        if info is None:
            raise RecordingError(f"the member {name} is missing")
        if info.file_size > limit:
            raise RecordingError(f"{name} unpacks to {info.file_size:,} bytes, {limit:,} allowed")
        return self._archive.read(info)

    def _table(self, folder: str, dtype: np.dtype[Any], n: int) -> NDArray[Any]:
        table = np.zeros(n, dtype=dtype)
        for name in dtype.names or ():
            column = dtype[name]
            member = f"{folder}/{name}.npy"
            data = self._bytes(member, n * column.itemsize + 1024)
            try:
                array = np.load(io.BytesIO(data), allow_pickle=False)
            except (ValueError, OSError, EOFError, SyntaxError) as error:
                reason = " ".join(str(error).split())[:120]
                raise RecordingError(f"{member} is damaged ({reason})") from None
            wanted = (n, *column.shape)
            if array.dtype != column.base or array.shape != wanted:
                raise RecordingError(
                    f"{member} is {array.dtype} {array.shape}, not {column.base} {wanted}"
                )
            table[name] = array
        return table


def _check(recording: Recording) -> None:
    """Refuse what no recorder writes."""
    orders, rows = recording.orders, recording.rows
    for name in ("target", "rotation", "stamp", "scale"):
        _all(np.isfinite(orders[name]), f"orders/{name}", "is not finite")
    _all(orders["plant"] < len(recording.plants), "orders/plant", "is not one of the plants")
    _all(np.diff(orders["plant"].astype(np.int64)) >= 0, "orders/plant", "goes back")
    turned = orders["rotation"][orders["driven"] != 0]
    off = np.abs(np.einsum("kij,klj->kil", turned, turned) - np.eye(3)).max(axis=(1, 2), initial=0)
    _all(off < 1e-3, "orders/rotation", "is not a rotation")
    for name in ("q", "target", "tip", "force", "radius", "spent"):
        _all(np.isfinite(rows[name]), f"rows/{name}", "is not finite")
    _all(~np.isnan(rows["distance"]), "rows/distance", "is not a number")
    _all(rows["status"] <= max(vf.Status), "rows/status", "is not a status")
    order = rows["order"].astype(np.int64)
    _all(order < len(orders), "rows/order", "is not one of the orders")
    _all(np.diff(order, prepend=0) >= 0, "rows/order", "goes back")
    ticks = np.diff(rows["tick"], prepend=recording.state.tick)
    _all(ticks == (rows["ticked"] != 0), "rows/tick", "does not count on")


def _all(good: NDArray[np.bool_], column: str, what: str) -> None:
    if not good.all():
        row = int(np.argmin(good.reshape(len(good), -1).all(axis=1)))
        raise RecordingError(f"{column} of row {row} {what}")


def _items(header: dict[str, Any], name: str, limit: int, least: int = 1) -> list[Any]:
    found = header.get(name)
    if not isinstance(found, list) or not least <= len(found) <= limit:
        raise RecordingError(f"'{name}' in the header is not a list of {least} to {limit:,}")
    return found


def _mapping(header: object, name: str) -> dict[str, Any]:
    found = header.get(name) if isinstance(header, dict) else None
    if not isinstance(found, dict):
        raise RecordingError(f"'{name}' is missing in the header")
    return found


def _text(value: object, name: str) -> str:
    if not isinstance(value, str) or len(value) > 4096 or not value.isprintable():
        raise RecordingError(f"the {name} in the header is no text")
    return value


def _whole(value: object, name: str, low: int, high: int) -> int:
    if type(value) is not int or not low <= value <= high:
        raise RecordingError(f"{name} is {str(value)[:30]}, not {low:,} to {high:,}")
    return value


def _numbers(value: object, name: str, most: int) -> NDArray[np.float64]:
    sound = (
        isinstance(value, list) and 1 <= len(value) <= most and all(_is_number(x) for x in value)
    )
    if not sound:
        raise RecordingError(f"{name} in the header is not 1 to {most} finite numbers")
    return np.array(value, dtype=np.float64)


def _is_number(value: object) -> bool:
    if type(value) is int:
        return abs(value) < 1 << 63
    return isinstance(value, float) and math.isfinite(value)


def _options(entry: object) -> Options:
    values = _mapping(entry, "options")
    if set(values) != set(RECORDED):
        odd = sorted(set(values) ^ set(RECORDED))[0][:40]
        raise RecordingError(f"the options in the header are not those of a session ('{odd}')")
    for field in fields(Options):
        value = values.get(field.name)
        if field.name not in values or value is None:
            continue
        default = field.default
        if field.name in ("at", "rotate"):
            values[field.name] = tuple(_numbers(value, field.name, 3))
            sound = len(values[field.name]) == 3
        elif isinstance(default, bool | int):
            sound = type(value) is type(default) and abs(value) < 2**63
        elif isinstance(default, str) or field.name in ("unit", "path"):
            sound = isinstance(value, str) and len(value) <= 4096 and value.isprintable()
        else:
            sound = _is_number(value)
        if not sound:
            raise RecordingError(f"the option {field.name} in the header is not usable")
    optional = ("unit", "at", "path", "corridor", "radius")
    for name in RECORDED:
        if values[name] is None and name not in optional:
            raise RecordingError(f"the option {name} is missing in the header")
    try:
        return Options(**values)
    except OptionError as error:
        raise RecordingError(str(error)) from None


def _place(entry: object) -> Place:
    if not isinstance(entry, dict):
        raise RecordingError("a place in the header is not usable")
    checksum = entry.get("checksum")
    if not isinstance(checksum, str) or len(checksum) != 64:
        raise RecordingError("a checksum in the header is not a SHA-256")
    return Place(
        options=_options(entry),
        vertices=_whole(entry.get("vertices"), "the number of vertices", 1, 1 << 40),
        triangles=_whole(entry.get("triangles"), "the number of triangles", 1, 1 << 40),
        checksum=checksum,
        start=_numbers(entry.get("start"), "the start", JOINTS),
    )


def _plant(entry: object, places: int) -> tuple[int, Options]:
    if not isinstance(entry, dict):
        raise RecordingError("a plant in the header is not usable")
    return _whole(entry.get("place"), "the place of a plant", 0, places - 1), _options(entry)


def _course(entry: object) -> Course | None:
    if entry is None:
        return None
    if not isinstance(entry, dict):
        raise RecordingError("a course in the header is not usable")
    times = _numbers(entry.get("times"), "the times of a course", MAX_WAYPOINTS)
    tables = []
    for name, rows in (("rotation", 3), ("points", len(times))):
        table = entry.get(name)
        if not isinstance(table, list) or len(table) != rows:
            raise RecordingError(f"the {name} of a course in the header is not {rows} rows")
        found = [_numbers(row, f"the {name} of a course", 3) for row in table]
        if any(len(row) != 3 for row in found):
            raise RecordingError(f"the {name} of a course in the header is not of three columns")
        tables.append(np.array(found))
    rotation, points = tables
    if np.abs(rotation @ rotation.T - np.eye(3)).max() > 1e-3 or np.linalg.det(rotation) < 0.0:
        raise RecordingError("the rotation of a course in the header is none")
    if times[0] != 0.0 or (np.diff(times) <= 0.0).any():
        raise RecordingError("the times of a course in the header do not rise from 0")
    return Course(rotation, times, points)


def _state(entry: object, joints: int) -> State:
    if not isinstance(entry, dict):
        raise RecordingError("'state' is missing in the header")
    q = _numbers(entry.get("q"), "the joints", JOINTS)
    if len(q) != joints:
        raise RecordingError(f"{len(q)} joints in the header's state, not {joints}")
    target = entry.get("target")
    if target is not None:
        if not isinstance(target, list) or len(target) != 4:
            raise RecordingError("the target in the header is no pose")
        rows = [_numbers(row, "the target", 4) for row in target]
        pose = np.array([row if len(row) == 4 else np.zeros(4) for row in rows])
        if np.abs(pose[:3, :3] @ pose[:3, :3].T - np.eye(3)).max() > 1e-3:
            raise RecordingError("the target in the header is no pose")
        target = pin.SE3(pose[:3, :3], pose[:3, 3])
    since = entry.get("autopilot_since")
    most = (1 << 62) - 1
    return State(
        q=q,
        tick=_whole(entry.get("tick"), "the tick", 0, most),
        steps=_whole(entry.get("steps"), "the steps", 0, most),
        silent=_whole(entry.get("silent"), "the silent ticks", 0, most),
        autopilot_since=None if since is None else _whole(since, "the autopilot", 0, most),
        target=target,
        stale=entry.get("stale") is True,
    )


def _no_constant(word: str) -> float:
    raise RecordingError(f"{word} in the header")

"""Writes a recording tick by tick, with the versions of the packages."""

from __future__ import annotations

import contextlib
import fcntl
import importlib.metadata
import itertools
import json
import os
import platform
import zlib
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import meshes
import vf
from app import choices
from app.control.autopilot import Course
from app.control.engine import Orders, Plant
from app.control.messages import STATES, State, Telemetry
from app.files import numbered
from app.motion.movement import checksum, streamed
from app.motion.stream import Frame, Stream
from app.options import raw
from app.recording.format import (
    BLOCK,
    CHUNK,
    FORMAT,
    HEAD,
    JOINTS,
    LAST,
    LENGTH,
    MAGIC,
    MAX_ORDERS,
    MAX_PLANTS,
    MAX_ROWS,
    MAX_SHAPES,
    ORDERS,
    PART,
    RECORDED,
    ROWS,
    SHAP,
    SHAPE,
    VERSION,
    RecordingError,
    chained,
)
from app.recording.rows import fill
from app.settings import Options
from app.structure import split

MAX_PART_PLANTS = 64  # a plant with a course is large
NAMES = 1000  # number of file names that are tried


class Recorder:
    """Writes a recording, without thread or clock. Not thread-safe.

    What `flush` has written stays readable even if the process is killed.

    Attributes:
        path: of the file; another one than was requested if that existed.
        kept: number of rows in the file.
    """

    def __init__(self, path: Path | str) -> None:
        """Make the file; `begin` comes next.

        Raises:
            OSError: it cannot be made.
        """
        descriptor, self.path = _create(Path(path))
        self._file = os.fdopen(descriptor, "wb", buffering=0)
        self._state: State | None = None
        self._scene: int | None = None  # `Plant.scene` of the newest place
        self._plant: Plant | None = None
        self._last: Orders | None = None
        self._step: vf.Step | None = None
        self._counts = {"places": 0, "plants": 0, "orders": 0}
        # Not written yet:
        self._places: list[dict[str, Any]] = []
        self._plants: list[dict[str, Any]] = []
        self._orders: list[tuple[Any, ...]] = []
        self._rows = np.zeros(CHUNK, dtype=ROWS)
        self._filled = 0
        self._streams: list[tuple[int, Stream, int]] = []  # scene, and the last frame written
        self._shaped = 0  # numbers in all shapes so far
        self.kept = 0
        self._end = 0  # of the last complete block [byte]
        self._crc = zlib.crc32(MAGIC)

    @property
    def rows(self) -> int:
        """Number of rows so far."""
        return self.kept + self._filled

    def begin(self, seen: Orders, state: State) -> None:
        """Write the engine's state and the orders that it saw last.

        Raises:
            RecordingError: the arm has too many joints.
            OSError: the file cannot be written.
        """
        self._state, self._step = state, state.step
        self._append(MAGIC)
        content = {
            "format": FORMAT,
            "version": VERSION,
            "packages": packages(),
            "state": {
                "q": state.q.tolist(),
                "tick": state.tick,
                "steps": state.steps,
                "silent": state.silent,
                "autopilot_since": state.autopilot_since,
                "target": None if state.target is None else state.target.homogeneous.tolist(),
                "stale": state.stale,
                "phase": state.phase,
            },
        }
        self._block(HEAD, 0, json.dumps(content).encode())
        self._note_orders(seen)
        self.flush()

    def add(self, orders: Orders, telemetry: Telemetry, ticked: bool) -> None:
        """Append the result of `Engine.advance` for these orders.

        Raises:
            RecordingError: a limit of a recording is reached; `close` is still possible.
            OSError: the file cannot be written.
        """
        if self.rows >= MAX_ROWS:
            raise RecordingError(f"a recording holds at most {MAX_ROWS:,} ticks")
        if orders is not self._last:
            self._note_orders(orders)
        fill(self._rows, self._filled, self._counts["orders"] - 1, telemetry, ticked, self._step)
        self._step = telemetry.step
        self._filled += 1
        if self._filled == CHUNK or len(self._plants) == MAX_PART_PLANTS:
            self.flush()

    def flush(self) -> None:
        """Write the pending rows and orders as a part, and before it the shapes that have come.

        Raises:
            RecordingError: a limit of a recording is reached; `close` is still possible.
            OSError: the file cannot be written; it is unchanged.
        """
        if not (self._filled or self._orders):
            return
        self._write_shapes()
        about = {"places": self._places, "plants": self._plants, "orders": len(self._orders)}
        text = json.dumps(about).encode()
        content = b"".join(
            (
                LENGTH.pack(len(text)),
                text,
                _columns(np.array(self._orders, dtype=ORDERS)),
                _columns(self._rows[: self._filled]),
            )
        )
        self._block(PART, self._filled, zlib.compress(content, 1))
        self.kept += self._filled
        self._places, self._plants, self._orders, self._filled = [], [], [], 0

    def close(self, note: str = "") -> None:
        """Finish the file. `note`: why the recording ends, if the user did not stop it.

        Raises:
            RecordingError: nothing was recorded.
            OSError: the file cannot be written; what it contains is still readable.
        """
        if self._state is None:
            raise RecordingError("nothing was recorded")
        try:
            try:
                self.flush()
            except OSError as error:
                note = note or f"the file cannot be written ({error.strerror})"
                raise
            except RecordingError as error:
                note = note or str(error)
                raise
            finally:
                self._block(LAST, self.kept, json.dumps({"note": note}).encode())
                os.fsync(self._file.fileno())
        finally:
            self._file.close()

    def discard(self) -> None:
        """Delete the file."""
        self.path.unlink(missing_ok=True)
        self._file.close()

    def _write_shapes(self) -> None:
        """Write the shapes that came since the last time."""
        for k, (place, stream, last) in enumerate(self._streams):
            for frame in stream.since(last):
                self._shaped += frame.vertices.size
                if self._shaped > MAX_SHAPES:
                    raise RecordingError(
                        f"a recording holds at most {MAX_SHAPES:,} numbers of shapes"
                    )
                self._block(SHAP, 0, packed(place, frame))
                self._streams[k] = place, stream, frame.number
        del self._streams[:-1]  # scenes before the present one

    def _note_orders(self, orders: Orders) -> None:
        if self._counts["orders"] >= MAX_ORDERS:
            raise RecordingError(f"a recording holds at most {MAX_ORDERS:,} orders")
        if orders.plant is not self._plant:
            self._note_plant(orders.plant)
        command, target = orders.command, orders.command.target
        self._orders.append(
            (
                self._counts["plants"] - 1,
                target is not None,
                np.zeros(3) if target is None else target.translation,
                np.zeros((3, 3)) if target is None else target.rotation,
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
                orders.moving,
                orders.pace,
                STATES.index(orders.state),
            )
        )
        self._counts["orders"] += 1
        self._last = orders

    def _note_plant(self, plant: Plant) -> None:
        if len(plant.q0) > JOINTS:
            raise RecordingError(f"an arm of {len(plant.q0)} joints: at most {JOINTS} are recorded")
        if self._counts["plants"] >= MAX_PLANTS:
            raise RecordingError(f"a recording holds at most {MAX_PLANTS:,} changes of settings")
        if self._scene != plant.scene:
            self._scene = plant.scene
            self._places.append(
                {
                    "options": as_json(plant.scene_options),
                    **_shape(plant.surface),
                    "start": plant.q0.tolist(),
                    "structures": [_shape(one) for one in plant.structures],
                    "poses": checksum(plant.courses),
                }
            )
            form = streamed(plant.courses)
            if form is not None:
                self._streams.append((self._counts["places"], form.stream, 0))
            self._counts["places"] += 1
        script = plant.autopilot
        self._plants.append(
            {
                "place": self._counts["places"] - 1,
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
        self._counts["plants"] += 1
        self._plant = plant

    def _block(self, kind: bytes, rows: int, content: bytes) -> None:
        crc = chained(self._crc, kind, rows, content)
        self._append(BLOCK.pack(kind, len(content), rows, crc) + content)
        self._crc = crc

    def _append(self, content: bytes) -> None:
        """Append all of the content; after an error the file is unchanged."""
        left = memoryview(content)
        try:
            while left:
                left = left[self._file.write(left) :]
        except OSError:
            with contextlib.suppress(OSError):
                self._file.truncate(self._end)
                self._file.seek(self._end)
            raise
        self._end += len(content)


def packed(place: int, frame: Frame) -> bytes:
    """A shape of a scene, as in a block."""
    head = SHAPE.pack(place, frame.number, frame.shape, frame.seen, len(frame.vertices))
    return head + zlib.compress(frame.vertices.astype("<f4").tobytes(), 1)


def packages() -> dict[str, str]:
    """Versions of the packages on which a tick's last bit can depend."""
    found = {"python": platform.python_version(), "machine": platform.machine()}
    for name in ("vf-sandbox", "numpy", "numba", "osqp", "pin"):
        with contextlib.suppress(importlib.metadata.PackageNotFoundError):
            found[name] = importlib.metadata.version(name)
    return found


def as_json(options: Options) -> dict[str, Any]:
    """The recorded options; paths of files are absolute."""
    values = {name: raw(getattr(options, name)) for name in RECORDED}
    values["mesh"] = _absolute(options.mesh)
    for entry in values["structures"]:
        entry["file"] = _absolute(entry["file"])
    for entry in values["motions"]:
        if entry["file"] is not None:
            entry["file"] = os.path.abspath(entry["file"])
    if options.path is not None:
        values["path"] = os.path.abspath(options.path)
    return values


def _shape(surface: vf.Surface) -> dict[str, Any]:
    return {
        "vertices": len(surface.vertices),
        "triangles": len(surface.faces),
        "checksum": surface.checksum,
    }


def _absolute(name: str) -> str:
    """The path of a mesh; names of the catalogue stay."""
    known = name in meshes.catalogue() or split(name)[0] in choices.SETS
    return name if known else os.path.abspath(name)


def _create(path: Path) -> tuple[int, Path]:
    """Descriptor and path of a new file, locked until it is closed; numbered if the path exists."""
    for name in itertools.islice(numbered(path), NAMES - 1):
        try:
            descriptor = os.open(name, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o666)
        except FileExistsError:
            continue
        with contextlib.suppress(OSError):  # a file system without locks
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        return descriptor, name
    raise FileExistsError(f"{path} and {NAMES - 2} names after it exist: choose another")


def _columns(table: NDArray[Any]) -> bytes:
    """The columns of a table, one after another."""
    return b"".join(table[name].tobytes() for name in table.dtype.names or ())

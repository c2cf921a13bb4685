"""Writes a recording, tick by tick, and what it was made with."""

from __future__ import annotations

import contextlib
import importlib.metadata
import io
import json
import os
import platform
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import vf
from app.autopilot import Course
from app.engine import Orders, Plant, State
from app.messages import Telemetry
from app.recording.format import (
    CHUNK,
    FORMAT,
    JOINTS,
    MAX_ORDERS,
    MAX_PLANTS,
    MAX_ROWS,
    ORDERS,
    RECORDED,
    ROWS,
    VERSION,
    RecordingError,
)
from app.recording.rows import fill
from app.settings import Options


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

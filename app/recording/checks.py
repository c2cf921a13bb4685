"""Validates the tables of a recording, of any version of the format."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

import vf
from app.control.messages import STATES
from app.recording.format import UNKNOWN, Recording, RecordingError
from app.settings import number


def check(recording: Recording) -> None:
    """Refuse tables that no recorder writes.

    Raises:
        RecordingError: with the column and the row.
    """
    orders, rows = recording.orders, recording.rows
    if len({options.rate for _, options in recording.plants}) != 1:
        raise RecordingError("the rate changes within the recording")
    for name in ("target", "rotation", "stamp", "scale", "pace"):
        _all(np.isfinite(orders[name]), f"orders/{name}", "is not finite")
    scale = number("scale")
    within = (orders["scale"] >= scale.low) & (orders["scale"] <= scale.high)
    _all(within, "orders/scale", "is out of range")
    _all((orders["pace"] >= 0.0) & (orders["pace"] <= 2.0), "orders/pace", "is out of range")
    _all((rows["phase"] >= 0.0) & (rows["phase"] <= 1e9), "rows/phase", "is out of range")
    _all(orders["plant"] < len(recording.plants), "orders/plant", "is not one of the plants")
    _all(np.diff(orders["plant"].astype(np.int64)) >= 0, "orders/plant", "goes back")
    turned = orders["rotation"][orders["driven"] != 0]
    off = np.abs(np.einsum("kij,klj->kil", turned, turned) - np.eye(3)).max(axis=(1, 2), initial=0)
    _all(off < 1e-3, "orders/rotation", "is not a rotation")
    _all(orders["state"] < len(STATES), "orders/state", "is not a state")
    _all(rows["sensed"] <= UNKNOWN, "rows/sensed", "is not one of three")
    for name in ("q", "target", "tip", "force", "radius", "spent", "phase", "measured"):
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

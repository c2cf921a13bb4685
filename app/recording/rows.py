"""Conversion of telemetry and commands to and from rows of a recording's tables."""

from __future__ import annotations

import zlib
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

import vf
from app.control.messages import Command, Telemetry
from app.recording.format import JOINTS, MEASURED, SIMULATED, UNKNOWN


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
    measured = np.zeros(JOINTS)
    sensed = SIMULATED if telemetry.known else UNKNOWN
    if telemetry.measured is not None:
        sensed = MEASURED
        measured[: len(telemetry.measured)] = telemetry.measured
    tail = (telemetry.phase, telemetry.lost, sensed, measured)
    head = (order, ticked, telemetry.tick, q, target is not None, goal, telemetry.stale)
    if step is None or step is before:
        rows[k] = (*head, False, 0.0, 0.0, 0, 0, 0.0, 0.0, 0, turns, 0, 0, 0.0, *tail)
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
        *tail,
    )


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

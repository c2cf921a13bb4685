"""A lagging, noisy arm that a console drives into a mesh, over links that lose."""

from __future__ import annotations

import tempfile
import threading
import time
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import vf
from app.bench.counterparts.kinematics import tips
from app.bench.counterparts.running import counterpart, free_port, guarded
from app.bench.counterparts.ticks import Ticks
from app.judges.meeting import first_meeting
from app.session import Session

LOSS = "0.01"  # of the datagrams, each way
AGE = "100ms"
STARTS = 60.0  # until the arm moves [s]
LOOK = 0.1  # period of looking at what the guard says of its devices [s]


def push(mesh: str, seconds: float, stop: threading.Event, guard: str = "tip") -> dict[str, Any]:
    """Drive an arm into a mesh for so long; returns what came of it."""
    arm, console = free_port(), free_port()
    with tempfile.TemporaryDirectory() as folder, ExitStack() as stack:
        log = Path(folder) / "arm.npz"
        session = Session(guarded(arm, console, AGE, mesh=mesh, guard=guard), process=True)
        stack.callback(session.close)
        ticks = Ticks(session)
        session.start()
        start = [repr(float(x)) for x in session.scene.start]
        hardware = stack.enter_context(
            counterpart("arm", arm, "--loss", LOSS, "--log", str(log), "--start", *start)
        )
        operator = stack.enter_context(
            counterpart("console", console, "--loss", LOSS, "--follow", "--enable")
        )
        moves = ticks.wait(True, 0, STARTS)
        begun, began = (ticks.count, ticks.held), time.monotonic()
        worst, states = _attend(session, seconds, stop)
        lasted = time.monotonic() - began
        made, held = ticks.count - begun[0], ticks.held - begun[1]
        operator.quit()
        hardware.quit()
        seen = np.load(log)
        surface = session.scene.surface
        row = {
            "mesh": mesh,
            "triangles": len(surface.faces),
            "seconds": lasted,
            "ticks": made,
            "rate [Hz]": made / lasted,
            "contacts": ticks.contacts,
            "share pushed back": ticks.pushed / max(ticks.count, 1),
            "share held": held / max(made, 1),
            "worst error [m]": worst,
            "states": sorted(states),
            "measurements": len(seen["told"]),
            "crossings of the measured tip": crossings(surface, tips(seen["told"])),
            "crossings of the true tip": crossings(surface, tips(seen["truth"])),
            "crossings of a tick": int(session.crossing is not None),
            "ended": session.ended,
        }
    row["complaints"] = _complaints(row, moves)
    return row


def _attend(session: Session, seconds: float, stop: threading.Event) -> tuple[float, set[str]]:
    """The largest error off the certified path [m], and the states seen, for so long."""
    worst, states = 0.0, set()
    until = time.monotonic() + seconds
    while time.monotonic() < until and not stop.wait(LOOK) and not session.ended:
        report = session.devices
        if report is not None:
            worst = max(worst, report.largest)
            states.add(report.state)
    return worst, states


def crossings(surface: vf.Surface, path: NDArray[np.float64]) -> int:
    """How many steps of a path (k, 3) [m] meet the surface."""
    count, first = 0, 0
    while first < len(path) - 1:
        found = first_meeting(surface, path[first:-1], path[first + 1 :])
        if found is None:
            break
        count += 1
        first += found.segment + 1
    return count


def _complaints(row: dict[str, Any], moves: bool) -> list[str]:
    found = []
    crossed = sum(count for name, count in row.items() if name.startswith("crossings"))
    if crossed:
        found.append(f"{row['mesh']}: {crossed} crossings")
    if row["ended"]:
        found.append(f"{row['mesh']}: {row['ended']}")
    if not moves or not row["contacts"]:
        found.append(f"{row['mesh']}: the tool never came to the mesh")
    return found


def line(row: dict[str, Any]) -> str:
    """A row for people."""
    crossed = sum(count for name, count in row.items() if name.startswith("crossings"))
    return (
        f"{row['mesh']} ({row['triangles']:,} triangles): {row['ticks']:,} ticks at "
        f"{row['rate [Hz]']:.0f} Hz, {row['measurements']:,} measurements, {row['contacts']:,} "
        f"contacts, {row['share pushed back']:.0%} of the ticks pushed back, "
        f"{row['share held']:.1%} held, {1e3 * row['worst error [m]']:.2f} mm off the path at "
        f"most, {crossed} crossings"
    )

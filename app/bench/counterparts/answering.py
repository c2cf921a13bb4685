"""From a console's goal to the set-point that follows it, through a guard and through a relay.

The console steps its goal back and forth. A goal's time is taken just before it is sent, a
set-point's by the kernel when it arrives at the arm: how late the arm looks is not in it. Between
them are the wait for the tick, the tick, and what the machine does meanwhile. The relay shows what
is left without a guard; guard and relay take turns.
"""

from __future__ import annotations

import tempfile
import threading
import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from app.bench.counterparts.running import counterpart, free_port, guarded
from app.session import Session

AGE = "200ms"
STEP = 2e-3  # of the goal, in free space [m]
TURNS = 3  # of each
SEEN = 20e-3  # a goal that no set-point follows for so long was held [s]
MOVED = 1e-6  # insertion that counts as a motion; at rest it is steadier than that [m]
WARM = 1.0  # before goals count [s]


def compare(
    seconds: float, stop: threading.Event, advance: Callable[[float], None]
) -> list[dict[str, Any]]:
    """Latencies of guard and relay, so long each, in turns; a row for each."""
    found: dict[str, list[NDArray[np.float64]]] = {"guard": [], "relay": []}
    inside: list[tuple[float, float]] = []
    with Session(guarded(*_ports(), AGE), process=True):
        pass  # compiled now
    for k in range(2 * TURNS):
        if stop.is_set():
            break
        which = ("guard", "relay")[k % 2]
        found[which].append(_of_relay(seconds / TURNS) if k % 2 else _of_guard(seconds, inside))
        advance((k + 1) / (2 * TURNS))
    return [_row(name, parts, inside) for name, parts in found.items() if parts]


def _ports() -> tuple[int, int]:
    return free_port(), free_port()


def _of_guard(seconds: float, inside: list[tuple[float, float]]) -> NDArray[np.float64]:
    arm, console = _ports()
    with Session(guarded(arm, console, AGE), process=True) as session:
        found = answers(arm, console, seconds / TURNS)
        assert session.devices is not None
        inside.append(session.devices.latency)
    return found


def _of_relay(seconds: float) -> NDArray[np.float64]:
    arm, console = _ports()
    with counterpart("relay", arm, "--console", str(console)) as relay:
        found = answers(arm, console, seconds)
        relay.quit()
    return found


def answers(arm: int, console: int, seconds: float) -> NDArray[np.float64]:
    """Times from steps of a console's goal to the set-points that turn towards them [s].

    inf: none did, as the tool was held: a process was kept off its core for too long.
    """
    with tempfile.TemporaryDirectory() as folder, ExitStack() as stack:
        logs = Path(folder) / "arm.npz", Path(folder) / "console.npz"
        hardware = stack.enter_context(
            counterpart("arm", arm, "--noise", "0", "--log", str(logs[0]))
        )
        operator = stack.enter_context(
            counterpart(
                "console", console, "--follow", "--enable", "--step", repr(STEP), "--log",
                str(logs[1]),
            )
        )  # fmt: skip
        time.sleep(WARM + seconds)
        operator.quit()
        hardware.quit()
        goals, sent = np.load(logs[0])["goals"], np.load(logs[1])["sent"]
    return latencies(sent, goals, sent[0, 0] + WARM)


def latencies(
    sent: NDArray[np.float64], goals: NDArray[np.float64], begin: float
) -> NDArray[np.float64]:
    """The same, from what both ends saw.

    Args:
        sent: (k, 4) time and goal (3,) of the console [s, m].
        goals: (m, 7) time and set-point (6,) of the arm [s, rad or m].
        begin: goals before that do not count [s].
    """
    steps = np.flatnonzero(np.abs(np.diff(sent[:, 3])) > 0.5 * STEP) + 1
    found = []
    for k in steps[(sent[steps, 0] >= begin) & (sent[steps, 0] < goals[-1, 0] - 2.0 * SEEN)]:
        at, up = sent[k, 0], sent[k, 3] > sent[k - 1, 3]
        first, last = np.searchsorted(goals[:, 0], (at, at + SEEN))
        if first == 0:
            continue
        moves = np.diff(goals[first - 1 : last, 3])  # the insertion grows downwards
        turns = np.flatnonzero(moves < -MOVED if up else moves > MOVED)
        found.append(goals[first + turns[0], 0] - at if len(turns) else np.inf)
    return np.array(found)


def _row(
    name: str, parts: list[NDArray[np.float64]], inside: list[tuple[float, float]]
) -> dict[str, Any]:
    found = np.concatenate(parts)
    row: dict[str, Any] = {
        "through": name,
        "goals": len(found),
        "held": int(np.isinf(found).sum()),
        "median [s]": float(np.median(found)),
        "99 % [s]": float(np.quantile(found, 0.99, method="higher")),
        "99.9 % [s]": float(np.quantile(found, 0.999, method="higher")),
    }
    if name == "guard":
        row["inside, median [s]"] = float(np.median([median for median, _ in inside]))
        row["inside, 99.9 % [s]"] = max(late for _, late in inside)
    return row


def line(row: dict[str, Any]) -> str:
    """A row for people."""
    text = (
        f"{row['through']}: {row['goals']:,} goals, median {1e3 * row['median [s]']:.2f} ms, 99 % "
        f"within {1e3 * row['99 % [s]']:.2f} ms, 99.9 % within {1e3 * row['99.9 % [s]']:.2f} ms"
    )
    if "inside, median [s]" in row:
        text += (
            f"; from arrival to sending {1e3 * row['inside, median [s]']:.2f} ms in the median, "
            f"99.9 % within {1e3 * row['inside, 99.9 % [s]']:.2f} ms"
        )
    return text

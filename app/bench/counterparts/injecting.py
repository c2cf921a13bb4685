"""Makes every fault an arm or a console can have, again and again, and looks at what comes of it.

The tool is in motion and pushed into a mesh meanwhile. A fault that is to be held must be held by
the tick under way when it was made, or by one of the two that follow: no goal moves the tool in it.
What networks do all the time is to be ignored. Whatever it was, the tool must move again, without
anything but what the stand-ins do by themselves.
"""

from __future__ import annotations

import tempfile
import threading
import time
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np

from app.bench.counterparts import arm, console
from app.bench.counterparts.kinematics import tips
from app.bench.counterparts.pushing import crossings
from app.bench.counterparts.running import Counterpart, counterpart, free_port, guarded
from app.bench.counterparts.ticks import Ticks
from app.session import Session

AGE = 0.1  # how old the newest value may be [s]
SILENCE = 0.13  # how long a device is silent, for a fault of it [s]
TICKS = 2  # within which a fault is to be held
IGNORED = ("repeat", "swap", "garbage", "long", "array")
FAULTS = (
    *(("arm", fault) for fault in arm.FAULTS),
    *(("console", fault) for fault in console.FAULTS),
)
"""Of which device, and what."""
REST = 0.5  # before the end, for what the guard says of its devices [s]


def inject(
    faults: Sequence[tuple[str, str]],
    times: int,
    stop: threading.Event,
    mesh: str = "sphere",
) -> list[dict[str, Any]]:
    """Make these faults so often each, one after the other, in one session; a row for each."""
    ports = free_port(), free_port()
    age = f"{1e3 * AGE:g}ms"
    wanted = guarded(*ports, age, "&frame=PSM1_base", "&frame=base", mesh=mesh)
    with tempfile.TemporaryDirectory() as folder, ExitStack() as stack:
        log = Path(folder) / "arm.npz"
        session = Session(wanted, process=True)
        stack.callback(session.close)
        ticks = Ticks(session)
        session.start()
        start = [repr(float(x)) for x in session.scene.start]
        silence = "--silence", repr(SILENCE)
        makers = {
            "arm": stack.enter_context(
                counterpart("arm", ports[0], "--log", str(log), "--start", *start, *silence)
            ),
            "console": stack.enter_context(
                counterpart("console", ports[1], "--follow", "--enable", *silence)
            ),
        }
        if not ticks.wait(True, 0):
            raise TimeoutError("the guard does not move the arm")
        rows = [_row(ticks, makers, *one, times, stop) for one in faults if not stop.is_set()]
        time.sleep(REST)
        report = session.devices
        assert report is not None
        for maker in makers.values():
            maker.quit()
        seen = np.load(log)
        surface = session.scene.surface
        crossed = crossings(surface, tips(seen["told"])) + crossings(surface, tips(seen["truth"]))
        complaints = {
            "crossings of the measured or true tip": crossed,
            "crossings of a tick": int(session.crossing is not None),
            "errors in the guard": report.errors,
            "ends of the control loop": int(bool(session.ended)),
        }
    for row in rows:
        row["complaints"] += [f"{count} {what}" for what, count in complaints.items() if count]
    return rows


def _row(
    ticks: Ticks,
    makers: dict[str, Counterpart],
    of: str,
    fault: str,
    times: int,
    stop: threading.Event,
) -> dict[str, Any]:
    """What came of a fault that was made so often."""
    # A silence is known of when the newest value is too old.
    after, lasts = (AGE, SILENCE) if fault == "silence" else (0.0, 0.0)
    ignored = fault in IGNORED
    made = in_time = over = 0
    again: list[float] = []
    while made < times and not stop.is_set():
        if not ticks.wait(True, ticks.newest):
            break
        before, done = makers[of].make(fault)
        made += 1
        holds, last = ticks.holds(before + after, done + after, TICKS)
        in_time += bool(holds.any()) != ignored
        over += ticks.wait(True, last)
        again.append(time.monotonic() - done - lasts)
    row: dict[str, Any] = {
        "of": of, "fault": fault, "made": made, "outcome": "ignored" if ignored else "held",
        "in time": in_time, "got over": over,
        "median [s]": float(np.median(again)) if again else float("nan"), "complaints": [],
    }  # fmt: skip
    if made < times and not stop.is_set():
        row["complaints"].append(f"{of}, {fault}: made {made} of {times} times")
    if over < made:
        row["complaints"].append(f"{of}, {fault}: got over {over} of {made} times")
    if in_time < made and not ignored:
        row["complaints"].append(f"{of}, {fault}: held {in_time} of {made} times in two ticks")
    return row

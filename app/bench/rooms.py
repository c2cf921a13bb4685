"""`bench rooms`: how punctual the control loops of a study's participants are, all at once.

Each participant has what `user-study serve` gives them: a process with a page, and a control
process. A headless Chromium looks at each page, and all do a trial, which is recorded, at the same
time: the hand goes round and round over the bone.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from rich.console import Console

from app.bench.loop import BARE, FIRST_TICK, SETTLE, Tap, summary
from app.bench.tools import bare, report
from app.bench.tools.machine import machine
from app.bench.tools.settings import Rooms
from app.bench.tools.watcher import Watcher
from app.console import Column, show_table
from app.control.priority import raise_process_priority
from app.studies.people.folder import Study
from app.studies.people.served.room import Room
from app.studies.people.sitting import Sitting

RATE = 1000.0  # of the participants' control loops [Hz]
MOVES = 60.0  # of the hand, a second [Hz]
ROUND = 4e-3, 1.5  # radius [m] and time [s] of the hand's circle
LIMIT = 600.0  # of the trial [s]
PROTOCOL = f"""
format = 1
name = "Rooms"
about = "For a benchmark."
title = "Rooms"
repetitions = 1
rest = 0
[consent]
text = "No person takes part."
[[tasks]]
task = "tracing"
limit = {LIMIT:g}
[[conditions]]
name = "with"
[[conditions]]
name = "without"
rule = "off"
"""


def run(
    options: Rooms, say: Callable[[str], None], advance: Callable[[float], None]
) -> dict[str, Any]:
    """Measure all rooms; returns the content of `rooms.json`. See `runtime.run` for the callbacks.

    Raises:
        NoBrowser: there is none.
    """
    about = machine()
    say("a loop that does nothing, for comparison")
    seconds = min(options.seconds, BARE)
    nothing = summary(bare.measure(RATE, seconds), seconds, RATE)
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        (folder / "rooms.toml").write_text(PROTOCOL)
        study = Study.make(folder / "study", str(folder / "rooms.toml"))
        rooms = []
        for k in range(options.participants):
            say(f"room {k + 1} of {options.participants}, with a browser")
            code = f"P{k + 1}"
            Sitting.enter(study, code).consent(True)
            command = [sys.executable, "-m", "app.bench.rooms", str(study.path), code]
            room = subprocess.Popen(
                [*command, repr(options.seconds)],
                stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
                start_new_session=True,  # Ctrl-C is for this process, which ends the others
            )  # fmt: skip
            stack.callback(room.kill)
            rooms.append(room)
            stack.enter_context(Watcher(_answer(room)["url"]))
            advance(0.5 * (k + 1) / options.participants)
        say(f"a trial in each, {options.seconds:g} s")
        for room in rooms:
            assert room.stdin is not None
            room.stdin.write("go\n")
            room.stdin.flush()
        rows = [_answer(room) for room in rooms]
        advance(1.0)
    return {
        "what": "vf-sandbox bench rooms",
        "machine": about,
        "options": asdict(options),
        "a loop that does nothing": nothing,
        "rooms": rows,
    }


def show(result: dict[str, Any], console: Console) -> None:
    """Print the result as a table."""
    report.header(result, console)
    nothing = result["a loop that does nothing"]
    rows = [("a loop that does nothing", nothing)]
    rows += [(f"participant {k + 1}", row) for k, row in enumerate(result["rooms"])]
    show_table(
        console,
        [Column("loop", left=True), Column("ticks"), Column("< 1 ms late"), Column("< 0.1 ms"),
         Column("late p99.9 [µs]"), Column("longest stall [ms]")],
        [
            (name, f"{row['ticks']:,}", f"{100 * row['punctual']:.3f} %",
             f"{100 * row['prompt']:.3f} %", f"{row['late [us]']['p99.9']:.0f}",
             f"{row['longest stall [ms]']:.2f}")
            for name, row in rows
        ],
        title="Participants at once, each in a trial with a browser",
    )  # fmt: skip


def _answer(room: subprocess.Popen[str]) -> dict[str, Any]:
    """The next line that a room says.

    Raises:
        RuntimeError: it ended.
    """
    assert room.stdout is not None
    line = room.stdout.readline()
    if not line:
        raise RuntimeError(f"{room.args!r} ended")
    return dict(json.loads(line))


def _lead(folder: Path, code: str, seconds: float) -> None:
    """In the separate process: be a participant's room, and say how punctual its loop was."""
    raise_process_priority()
    room = Room(Sitting(Study.open(folder), code), "127.0.0.1", "http://127.0.0.1:1")
    try:
        session, hand, page = room._session, room._hand, room.page
        tap = Tap(session, round(RATE * (seconds + LIMIT)))
        threading.Thread(target=room.run, name="room", daemon=True).start()
        print(json.dumps({"url": f"http://127.0.0.1:{page.port}/"}), flush=True)
        if not sys.stdin.readline():
            return
        deadline = time.monotonic() + FIRST_TICK
        while page.hidden:
            page.begin.set()
            if time.monotonic() > deadline:
                raise TimeoutError("the trial does not begin")
            time.sleep(0.1)
        start = session.scene.T_base_start
        began = time.perf_counter() + SETTLE
        while (now := time.perf_counter()) < began + seconds:
            turn = 2.0 * np.pi * (now - began) / ROUND[1]
            aside = ROUND[0] * np.array([np.cos(turn) - 1.0, np.sin(turn), 0.0])
            hand.drive(pin.SE3(start.rotation, start.translation + aside))
            time.sleep(1.0 / MOVES)
        print(json.dumps(summary(tap.between(began, began + seconds), seconds, RATE)), flush=True)
    finally:
        room.close()


if __name__ == "__main__":
    _lead(Path(sys.argv[1]), sys.argv[2], float(sys.argv[3]))

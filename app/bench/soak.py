"""`bench soak`: growth of memory and queues while the autopilot runs and a client reconnects."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import asdict
from typing import Any

import numpy as np
from rich.console import Console

from app.bench.loop import Tap, summary
from app.bench.tools.machine import machine, proportional
from app.bench.tools.settings import Soak
from app.bench.tools.watcher import Watcher
from app.control.priority import raise_process_priority
from app.session import Session
from app.settings import Options
from app.view import guard
from app.view.page import Page

GROWTH = 0.05  # relative growth of memory that is tolerated
WARM_UP = 0.2  # share of the run that is not compared, in which caches fill
SAMPLES = 240  # at most, over the run
BACKLOG = 2000  # tolerated messages in a client's queue: one second at the highest load


def run(
    options: Soak, say: Callable[[str], None], advance: Callable[[float], None]
) -> dict[str, Any]:
    """Run the test; returns the content of `soak.json`.

    Raises:
        NoBrowser: no browser is available.
        ValueError: an unusable mesh.
    """
    about = machine()
    raise_process_priority()
    seconds = 60.0 * options.minutes
    with ExitStack() as stack:
        wanted = Options(mesh=options.mesh, rate=options.rate, port=0)
        session = Session(wanted, progress=say, process=True)
        tap = Tap(session, int(options.rate * (seconds + 300.0)))
        stack.callback(session.close)
        session.start()
        page = Page(session, "127.0.0.1", 0)
        stack.callback(page.close)
        session.set_autopilot(True)
        say("opening the browser")
        browser = stack.enter_context(Watcher(page.url))
        say(f"{options.minutes:g} min of autopilot, a client anew every {options.reconnect:g} s")
        began = time.perf_counter()
        visits, samples = 1, []
        sample = max(seconds / SAMPLES, 1.0)
        whole = False
        try:
            while (gone := time.perf_counter() - began) < seconds:
                if gone > visits * options.reconnect:
                    browser.request("again")
                    visits += 1
                time.sleep(sample)
                samples.append(_sample(time.perf_counter() - began, page, session))
                advance(gone / seconds)
            whole = True
        except KeyboardInterrupt:
            if not samples:
                raise
        ended = time.perf_counter()
        ticks = summary(tap.between(began, ended), ended - began, options.rate)
    return {
        "what": "vf-sandbox bench soak",
        "machine": about,
        "options": asdict(options),
        "visits": visits,
        "loop": ticks,
        "samples": samples,
        "growth": growth([s["memory [MB]"] for s in samples]),
        "complaints": complaints(samples),
        "interrupted": not whole,
    }


def _sample(at: float, page: Page, session: Session) -> dict[str, Any]:
    place = session._loop.place
    control = None if place is None else proportional(place[0])
    return {
        "at [s]": at,
        "memory [MB]": (proportional() or float("nan")) + (control or 0.0),
        "threads": threading.active_count(),
        **guard.resource_counts(page.server),
    }


def _ends(values: list[float]) -> tuple[float, float]:
    """Medians of the first and of the last third of the values after the warm-up."""
    after = np.array(values[round(WARM_UP * len(values)) :], dtype=float)
    third = max(len(after) // 3, 1)
    return float(np.median(after[:third])), float(np.median(after[-third:]))


def growth(values: list[float]) -> float:
    """Relative growth of a quantity, from after the warm-up to the end."""
    before, after = _ends(values)
    return after / before - 1.0


def complaints(samples: list[dict[str, Any]]) -> list[str]:
    """Failed conditions; empty if there are none."""
    found = []
    grown = growth([s["memory [MB]"] for s in samples])
    if not grown < GROWTH:
        found.append(f"memory grew by {grown:.1%}")
    for what in ("nodes", "controls", "messages", "threads"):
        before, after = _ends([s[what] for s in samples])
        # Counts vary with the number of planes; only a trend is a leak.
        if after > before + max(3.0, GROWTH * before):
            found.append(f"{what} grew from {before:.0f} to {after:.0f}")
    behind = max(s["backlog"] for s in samples)
    if behind > BACKLOG:
        found.append(f"a client was {behind:,} messages behind")
    clients = max(s["clients"] for s in samples)
    if clients > 2:
        found.append(f"{clients} clients were counted, where there was never more than one")
    return found


def show(result: dict[str, Any], console: Console) -> None:
    """Print the result."""
    samples, loop = result["samples"], result["loop"]
    console.print(
        f"{samples[-1]['at [s]'] / 60:.1f} min, {result['visits']} visits, "
        f"{loop['ticks']:,} ticks at {loop['rate [Hz]']:.1f} Hz, {loop['punctual']:.2%} less than "
        f"1 ms late, longest stall {loop['longest stall [ms]']:.1f} ms"
    )
    for what in ("memory [MB]", "nodes", "controls", "messages", "threads", "backlog"):
        values = [s[what] for s in samples]
        before, after = _ends(values)
        console.print(
            f"  {what:12} {before:9,.0f} after the warm-up, {after:9,.0f} at the end, "
            f"{max(values):9,.0f} at most"
        )
    for complaint in result["complaints"]:
        console.print(f"[red]{complaint}[/red]")
    if not result["complaints"]:
        console.print(f"flat: memory changed by {result['growth']:+.1%}")

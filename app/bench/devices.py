"""`bench devices`: faults, contacts and latency of a guard between stand-ins, over sockets."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import asdict
from typing import Any

from rich.console import Console

from app.bench.counterparts import answering, injecting, pushing
from app.bench.tools.machine import machine
from app.bench.tools.settings import Devices
from app.console import Column, show_table
from app.control.priority import raise_process_priority

Say = Callable[[str], None]


def run(options: Devices, say: Say, advance: Callable[[float], None]) -> dict[str, Any]:
    """Run the parts; returns the content of `devices.json`. See `runtime.run` for the callbacks."""
    about = machine()
    raise_process_priority()
    stop = threading.Event()
    result: dict[str, Any] = {
        "what": "vf-sandbox bench devices", "machine": about, "options": asdict(options),
        "faults": [], "meshes": [], "latency": [],
    }  # fmt: skip
    if "faults" in options.parts:
        say(f"{options.faults} of each fault, {options.guards} guards side by side")
        shares = [injecting.FAULTS[k :: options.guards] for k in range(options.guards)]
        works = [
            lambda share=share: injecting.inject(share, options.faults, stop)
            for share in shares
            if share
        ]
        for rows in _side_by_side(works, options.guards, stop, advance):
            result["faults"] += rows
        order = list(injecting.FAULTS)
        result["faults"].sort(key=lambda row: order.index((row["of"], row["fault"])))
    if "meshes" in options.parts:
        seconds = 60.0 * options.minutes
        pushes = [
            lambda mesh=mesh: pushing.push(mesh, seconds, stop, options.guard)
            for mesh in options.meshes
        ]
        say(f"{options.minutes:g} min into each mesh, {options.guards} side by side")
        for row in _side_by_side(pushes, options.guards, stop, advance):
            result["meshes"].append(row)
            say(pushing.line(row))
    if "latency" in options.parts and not stop.is_set():
        say(f"latency, {options.seconds:g} s")
        result["latency"] = answering.compare(options.seconds, stop, advance)
    result["complaints"] = [
        complaint
        for part in ("faults", "meshes", "latency")
        for row in result[part]
        for complaint in row.get("complaints", ())
    ]
    result["interrupted"] = stop.is_set()
    return result


def _side_by_side(
    works: Sequence[Callable[[], Any]],
    most: int,
    stop: threading.Event,
    advance: Callable[[float], None],
) -> Any:
    """Results of works that need processes of their own, so many at once, as they end."""
    with ThreadPoolExecutor(most) as pool:
        pending = {pool.submit(work) for work in works}
        try:
            for k, one in enumerate(as_completed(list(pending))):
                pending.remove(one)
                yield one.result()
                advance((k + 1) / len(works))
        except KeyboardInterrupt:
            stop.set()
            for one in pending:
                one.cancel()
            for one in pending:
                if not one.cancelled() and one.exception() is None:
                    yield one.result()


def show(result: dict[str, Any], console: Console) -> None:
    """Print what was found."""
    if result["faults"]:
        show_table(
            console,
            [Column("of", left=True), Column("fault", left=True), Column("made"),
             Column("outcome", left=True), Column("in two ticks"), Column("got over"),
             Column("again after [ms]")],
            [[row["of"], row["fault"], str(row["made"]), row["outcome"], str(row["in time"]),
              str(row["got over"]), f"{1e3 * row['median [s]']:.0f}"] for row in result["faults"]],
            labels=2,
            title="Faults over sockets; again after: until the tool moves, in the median",
        )  # fmt: skip
    for row in result["meshes"]:
        console.print(pushing.line(row), markup=False)
    for row in result["latency"]:
        console.print(answering.line(row), markup=False)
    for complaint in result["complaints"]:
        console.print(f"[red]{complaint}[/]")

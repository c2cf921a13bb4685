"""Repeat a recorded session without page and clock, compare it bit for bit, write it as CSV."""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro
from rich.console import Console
from rich.markup import escape

from app.files import shown
from app.settings import OptionError, parse_as

if TYPE_CHECKING:
    from app.recording.format import Recording

SAME, DIFFERENT, USAGE_ERROR = 0, 1, 2
ABOUT = """Repeat a recorded session: the same orders to a fresh engine, without page and clock.

With --check every tick is compared bit for bit. Exit code 0: the same, or not compared; 1:
different (the first differing tick and field are named); 2: the file or its mesh is not usable.
Of a recording that was cut off, this is about what is readable, which is said."""


@dataclass(frozen=True)
class Replay:
    """What to repeat, and what to make of it."""

    file: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="FILE")]
    """A recording, made with --record or on the page."""
    check: bool = False
    """Compare every tick with the recorded one, bit for bit."""
    csv: Path | None = None
    """Write the recorded ticks to this file, a line each, units in the heading."""
    mesh: str | None = None
    """Where the mesh is now, if it was a file that has moved; it must be the very same mesh."""
    path: str | None = None
    """Where the planned path is now, likewise."""


def main(arguments: list[str]) -> int:
    """Run `replay`; returns the exit code."""
    options = parse_as(Replay, "vf-sandbox replay", arguments, ABOUT)
    console = Console(highlight=False, soft_wrap=True)
    try:
        return run(options, console)
    except OptionError as error:
        return _complain(str(error))
    except (ValueError, OSError) as error:
        return _complain(" ".join(str(error).split()))


def run(options: Replay, console: Console) -> int:
    """Do it and print what came of it; returns the exit code."""
    from app import replay
    from app.recording.read import read

    recording = read(options.file)
    for line in summary(recording):
        console.print(escape(line))
    if options.csv is not None:
        from app import table

        table.write(recording, options.csv)
        console.print(escape(f"written: {options.csv}, {len(recording.rows):,} lines"))
        if not options.check:
            return SAME
    began = time.perf_counter()
    difference = None
    if options.check:
        difference = replay.first_difference(recording, options.mesh, options.path)
    else:
        for _ in replay.rerun(recording, options.mesh, options.path):
            pass
    took = f"{time.perf_counter() - began:.1f} s"
    if difference is not None:
        console.print(f"[red]different[/] after {took}: {escape(str(difference))}")
        return DIFFERENT
    same = "the same to the last bit" if options.check else "repeated, not compared (see --check)"
    if recording.cut:
        same += " as far as they are readable"
    console.print(f"{len(recording.rows):,} ticks {same}, {took}")
    return SAME


def summary(recording: Recording) -> list[str]:
    """What is in it, a line each."""
    from app.recording.write import packages

    ticks = int(recording.rows["ticked"].sum())
    lines = [
        f"{ticks:,} ticks, {ticks * recording.dt:.1f} s at {1.0 / recording.dt:g} Hz, "
        f"{len(recording.orders) - 1:,} orders, {len(recording.plants) - 1:,} changes of settings",
    ]
    lines += [
        f"  {place.options.robot} over {shown(place.options.mesh)}, {place.triangles:,} triangles"
        for place in recording.places
    ]
    if recording.cut:
        lines.append(recording.cut)
    if recording.note:
        lines.append(f"The recording ended because {recording.note}.")
    here = packages()
    other = [
        f"{name} {version} (here {here.get(name, 'none')})"
        for name, version in recording.packages.items()
        if here.get(name) != version
    ]
    if other:
        lines.append("Recorded with " + ", ".join(other) + ": the last bits may differ.")
    return lines


def _complain(message: str) -> int:
    print(f"vf-sandbox replay: error: {message}", file=sys.stderr)
    return USAGE_ERROR

"""Repeat a recorded session without page and clock, compare it bit for bit, write it as CSV."""

from __future__ import annotations

import pathlib
import time
from dataclasses import dataclass
from typing import TYPE_CHECKING

from rich.markup import escape

from app.commands import interrupted
from app.console import console as new_console
from app.console import count
from app.files import shown
from app.kinds import File, Maybe, Path, Switch
from app.options import Checked, option

if TYPE_CHECKING:
    from app.recording.format import Recording

PROGRAM = "vf-sandbox replay"
SAME, DIFFERENT = 0, 1


@dataclass(frozen=True)
class Replay(Checked):
    """Repeat a recorded session: the same orders to a fresh engine, without page and clock.

    With --check every tick is compared bit for bit. Exit code 0: the same, or not compared; 1:
    different (the first differing tick and field are named); 2: the file or its mesh is not usable.
    Of a recording that was cut off, this is about what is readable, which is said.
    """

    file: pathlib.Path = option(
        Path(metavar="FILE"), about="A recording, made with --record or on the page.",
        positional=True,
    )  # fmt: skip
    check: bool = option(Switch(), False, "Compare every tick with the recorded one, bit for bit.")
    csv: pathlib.Path | None = option(
        Maybe(Path()), None,
        "Write the recorded ticks to this file, a line each, units in the heading.",
    )  # fmt: skip
    mcap: pathlib.Path | None = option(
        Maybe(Path()), None,
        "Write the recorded ticks to this file as MCAP with messages of ROS 2, for Foxglove and "
        "rosbag2 (extra: mcap).",
    )  # fmt: skip
    mesh: str | None = option(
        Maybe(File()), None,
        "Where the mesh is now, if it was a file that has moved; it must be the very same mesh.",
    )  # fmt: skip
    path: str | None = option(Maybe(File()), None, "Where the planned path is now, likewise.")


def run(options: Replay) -> int:
    """Repeat the recording and print the result; returns the exit code."""
    from app.recording import rerun
    from app.recording.read import read

    console = new_console(soft_wrap=True)
    recording = read(options.file)
    for line in summary(recording):
        console.print(escape(line))
    if options.csv is not None:
        from app.recording.export import table

        table.write(recording, options.csv)
        console.print(escape(f"written: {options.csv}, {count(len(recording.rows), 'line')}"))
    if options.mcap is not None:
        from app.recording.export import bag

        messages = bag.write(recording, options.mcap)
        console.print(escape(f"written: {options.mcap}, {count(messages, 'message')}"))
    if (options.csv or options.mcap) and not options.check:
        return SAME
    began = time.perf_counter()
    difference = None
    done = 0

    def repeated(rows: int) -> None:
        nonlocal done
        done = rows

    try:
        if options.check:
            difference = rerun.first_difference(
                recording, options.mesh, options.path, repeated=repeated
            )
        else:
            for _ in rerun.rerun(recording, options.mesh, options.path):
                done += 1
    except KeyboardInterrupt:
        same = ", all the same to the last bit" if options.check else ""
        return interrupted(PROGRAM, f"{done:,} of {count(len(recording.rows), 'tick')}{same}")
    took = f"{time.perf_counter() - began:.1f} s"
    if difference is not None:
        console.print(f"[red]different[/] after {took}: {escape(str(difference))}")
        return DIFFERENT
    same = "the same to the last bit" if options.check else "repeated, not compared (see --check)"
    if recording.cut:
        same += " as far as they are readable"
    console.print(f"{count(len(recording.rows), 'tick')} {same}, {took}")
    return SAME


def summary(recording: Recording) -> list[str]:
    """Description of a recording, in lines."""
    from app.recording.write import packages

    ticks = int(recording.rows["ticked"].sum())
    lines = [
        f"{count(ticks, 'tick')}, {ticks * recording.dt:.1f} s at {1.0 / recording.dt:g} Hz, "
        f"{count(len(recording.orders) - 1, 'order')}, "
        f"{count(len(recording.plants) - 1, 'change')} of settings",
    ]
    lines += [
        f"  {place.options.robot} over {shown(place.options.mesh)}, "
        f"{count(place.triangles, 'triangle')}"
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


KINDS = {"": (Replay, run)}
MISSING = "pip install 'vf-sandbox[mcap]'"

"""`verify` beside anatomy that moves."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from time import perf_counter
from typing import TYPE_CHECKING

from rich.console import Console

from app.commands import interrupted
from app.console import count, run_counted
from app.words import format_length

if TYPE_CHECKING:
    from app.commands.verify import Verify
    from meshes.builtin.shapes import Arrays

PASSED, BROKEN = 0, 1


def run_moving(
    options: Verify,
    sources: dict[str, Arrays],
    damages: Sequence[str],
    radii: Sequence[float | None],
    console: Console,
    show_places: Callable[[Sequence[str], Console], None],
    program: str,
) -> int:
    """The campaign of `--motion`, and its tables; returns the exit code."""
    import robots
    from app.studies.verification import guarded, moved, moving

    assert options.motion is not None
    if options.robot == "all":
        arms = guarded.all_arms(options.steps)
    else:
        arms = {options.robot: (robots.load(options.robot), options.steps)}
    kinds = moving.MOTIONS if options.motion == "all" else (options.motion,)
    campaign = moved.Campaign(
        arms, sources, damages, radii, kinds, options.guard, options.rule, options.noise,
        options.tracker, options.seed,
    )  # fmt: skip
    found = moved.Findings()
    began = perf_counter()
    run = partial(moved.run, campaign, found, workers=options.workers)
    stopped = run_counted("verify", campaign.work, run)
    if stopped and not found.drives:
        return interrupted(program, "before anything was done")
    parts = "the tip" if options.guard is None else f"whole instrument, guard {options.guard}"
    known = "known" if options.tracker is None else f"tracked at {options.tracker.rate:g} Hz"
    moved.show(
        found, console,
        f"{parts}, motion {options.motion}, {known}, rule {options.rule}, arm {options.robot}, "
        f"seed {options.seed}, {count(len(sources), 'mesh', 'meshes')}, damage {options.damage}, "
        "radius " + ", ".join(map(format_length, radii)),
    )  # fmt: skip
    show_places(moved.complaints(found), console)
    console.print(
        f"{count(found.crossings, 'crossing')}, {count(found.late, 'contact')} led out too late, "
        f"{count(found.too_deep, 'tick')} deeper than said; {perf_counter() - began:.0f} s"
    )
    if stopped:
        return interrupted(program, "this is of what was done until then")
    return BROKEN if found.crossings or found.late or found.too_deep else PASSED

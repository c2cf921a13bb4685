"""Measure: run time, other libraries, the control thread, devices, the page, files, an hour."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from importlib import import_module
from typing import Any

from rich.console import Console

from app.bench.tools.settings import (
    Devices,
    Loop,
    Meshes,
    Motion,
    Peers,
    Rooms,
    Runtime,
    Soak,
    Structures,
    View,
)
from app.bench.tools.watcher import NoBrowser
from app.commands import interrupted
from app.console import console as new_console
from app.console import progress
from app.words import OptionError

PROGRAM = "vf-sandbox bench"
MISSING = "pip install 'vf-sandbox[bench]'"
WRONG = 1


def measure(options: Any) -> int:
    """Run a benchmark, the module of `app.bench` that has its name; returns the exit code.

    Its `run(options, say, advance)` returns what is written as JSON, `show(result, console)` prints
    it, and `draw(result, file)`, where it has one, makes a picture of it.
    """
    name = type(options).__name__.lower()
    options.out.mkdir(parents=True, exist_ok=True)  # before the work, to fail early
    module = import_module(f"app.bench.{name}")
    console = new_console()
    try:
        result = _run(console, partial(module.run, options))
    except NoBrowser as error:
        raise OptionError(str(error)) from None
    module.show(result, console)
    if result.get("interrupted"):
        # Nothing is written, so that an earlier complete result is kept.
        return interrupted(f"{PROGRAM} {name}", "this is what there was so far, it is not written")
    from app.bench.tools.machine import write

    console.print(f"written: {write(options.out, name, result)}", markup=False)
    if hasattr(module, "draw"):
        picture = options.out / f"{name}.png"
        try:
            module.draw(result, picture)
        except ImportError:
            console.print(f"no figure: matplotlib is not installed ({MISSING})", markup=False)
        else:
            console.print(f"written: {picture}", markup=False)
    return WRONG if result.get("complaints") else 0


def _run(
    console: Console,
    work: Callable[[Callable[[str], None], Callable[[float], None]], dict[str, Any]],
) -> dict[str, Any]:
    """Run the work with a progress bar."""
    with progress(refresh=2) as shown:  # drawing competes with the measured code
        bar = shown.add_task("starting", total=1.0)

        def say(text: str) -> None:
            shown.update(bar, description=text)
            if not console.is_terminal:
                console.print(f"  {text} …", markup=False)

        return work(say, lambda share: shown.update(bar, completed=share))


_ALL = (Runtime, Structures, Motion, Peers, Loop, Rooms, Devices, View, Meshes, Soak)
KINDS = {kind.__name__.lower(): (kind, measure) for kind in _ALL}

"""Measure: run time, other libraries, the control thread, the page, files, an hour of it all."""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, TextColumn, TimeElapsedColumn

from app.bench.tools.settings import Loop, Meshes, Peers, Runtime, Soak, View
from app.bench.tools.watcher import NoBrowser
from app.commands import interrupted
from app.console import console as new_console
from app.console import progress
from app.words import OptionError

_MODULES: dict[type, str] = {
    Loop: "app.bench.loop",
    View: "app.bench.latency",
    Meshes: "app.bench.meshes",
    Soak: "app.bench.soak",
}
PROGRAM = "vf-sandbox bench"
MISSING = "pip install 'vf-sandbox[bench]'"
WRONG_ANSWER = 1
GREW = 1


def measure(options: Any) -> int:
    """Run one of the benchmarks; returns the exit code."""
    name = type(options).__name__.lower()
    options.out.mkdir(parents=True, exist_ok=True)  # before the work, to fail early
    try:
        if isinstance(options, Runtime):
            result = _runtime(options)
        elif isinstance(options, Peers):
            result = _peers(options)
        else:
            result = _measured(options, name, import_module(_MODULES[type(options)]))
    except NoBrowser as error:
        raise OptionError(str(error)) from None
    if result.get("interrupted"):
        # Nothing is written, so that an earlier complete result is kept.
        return interrupted(f"{PROGRAM} {name}", "this is what there was so far, it is not written")
    if isinstance(options, Peers):
        # A wrong answer of another library is shown in its row; ours is an error.
        ours = [entry for task in result["tasks"] for entry in task["entries"] if entry["ours"]]
        return 0 if all(entry["agrees"] for entry in ours) else WRONG_ANSWER
    return GREW if result.get("complaints") else 0


def _runtime(options: Runtime) -> dict[str, Any]:
    from app.bench import runtime
    from app.bench.tools import report

    console = new_console()
    result = _shown(console, lambda say, advance: runtime.run(options, say, advance))
    report.runtime(result, console)
    _write(options.out, "runtime", result, console)
    if not result.get("interrupted"):
        picture = options.out / "runtime.png"
        try:
            report.figure(result, picture)
        except ImportError:
            console.print(
                "no figure: matplotlib is not installed (pip install 'vf-sandbox[bench]')",
                markup=False,
            )
        else:
            console.print(f"written: {picture}", markup=False)
    return result


def _peers(options: Peers) -> dict[str, Any]:
    from app.bench import peers
    from app.bench.tools import report

    console = new_console()
    result = _shown(console, lambda say, advance: peers.run(options, say, advance))
    report.peers(result, console)
    _write(options.out, "peers", result, console)
    return result


def _measured(options: Loop | View | Meshes | Soak, name: str, module: Any) -> dict[str, Any]:
    """Run a benchmark module, and print and write its result."""
    console = new_console()
    result = _shown(console, lambda say, advance: module.run(options, say, advance))
    module.show(result, console)
    _write(options.out, name, result, console)
    return result


def _write(out: Path, name: str, result: dict[str, Any], console: Console) -> None:
    from app.bench.tools.machine import write

    if not result.get("interrupted"):
        console.print(f"written: {write(out, name, result)}", markup=False)


def _shown(
    console: Console,
    work: Callable[[Callable[[str], None], Callable[[float], None]], dict[str, Any]],
) -> dict[str, Any]:
    """Run the work with a progress bar."""
    with progress(
        TextColumn("{task.description}"),
        BarColumn(),
        TimeElapsedColumn(),
        refresh=2,  # drawing competes with the measured code
    ) as shown:
        bar = shown.add_task("starting", total=1.0)

        def say(text: str) -> None:
            shown.update(bar, description=text)
            if not console.is_terminal:
                console.print(f"  {text} …", markup=False)

        return work(say, lambda share: shown.update(bar, completed=share))


KINDS = {
    kind.__name__.lower(): (kind, measure) for kind in (Runtime, Peers, Loop, View, Meshes, Soak)
}

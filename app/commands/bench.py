"""Measure: run time, other libraries, the control thread, the page, files, an hour of it all."""

from __future__ import annotations

import sys
from collections.abc import Callable
from importlib import import_module
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from app.bench.settings import Loop, Meshes, Peers, Runtime, Soak, View
from app.bench.watcher import NoBrowser
from app.settings import OptionError, parse_as

_KINDS: dict[str, type[Runtime | Peers | Loop | View | Meshes | Soak]] = {
    "runtime": Runtime,
    "peers": Peers,
    "loop": Loop,
    "view": View,
    "meshes": Meshes,
    "soak": Soak,
}
_MODULES: dict[type, str] = {
    Loop: "app.bench.loop",
    View: "app.bench.latency",
    Meshes: "app.bench.meshes",
    Soak: "app.bench.soak",
}
USAGE_ERROR = 2
WRONG_ANSWER = 1
GREW = 1


def main(arguments: list[str]) -> int:
    """Run one of the measurements; returns the exit code."""
    if not arguments or arguments[0] in ("-h", "--help"):
        print(f"usage: vf-sandbox bench {{{','.join(_KINDS)}}} [options]\n")
        for name, kind in _KINDS.items():
            print(f"  {name:8} {(kind.__doc__ or '').strip().splitlines()[0]}")
        return 0 if arguments else USAGE_ERROR
    name, *words = arguments
    if name not in _KINDS:
        return _complain(f"unknown measurement '{name}': choose from {', '.join(_KINDS)}")
    try:
        kind = _KINDS[name]
        options = parse_as(kind, f"vf-sandbox bench {name}", words, kind.__doc__ or "")
        options.out.mkdir(parents=True, exist_ok=True)  # rather now than after the work
        if isinstance(options, Runtime):
            return _runtime(options)
        if isinstance(options, Peers):
            return _peers(options)
        result = _told(options, name, import_module(_MODULES[type(options)]))
        return GREW if result.get("complaints") else 0
    except (OptionError, ValueError, OSError, NoBrowser) as error:
        return _complain(str(error))


def _runtime(options: Runtime) -> int:
    from app.bench import report, runtime
    from app.bench.machine import write

    console = Console(highlight=False, width=None if sys.stdout.isatty() else 130)
    result = _shown(console, lambda say, advance: runtime.run(options, say, advance))
    result["options"] = runtime.options_of(options)
    report.runtime(result, console)
    console.print(f"written: {write(options.out, 'runtime', result)}")
    picture = options.out / "runtime.png"
    try:
        report.figure(result, picture)
    except ImportError:
        console.print("no figure: matplotlib is not installed (pip install 'vf-sandbox[bench]')")
    else:
        console.print(f"written: {picture}")
    return 0


def _peers(options: Peers) -> int:
    from app.bench import peers, report
    from app.bench.machine import write

    console = Console(highlight=False, width=None if sys.stdout.isatty() else 130)
    result = _shown(console, lambda say, advance: peers.run(options, say, advance))
    report.peers(result, console)
    console.print(f"written: {write(options.out, 'peers', result)}")
    # A peer may be wrong, and says so in its row; ours may not.
    ours = [entry for task in result["tasks"] for entry in task["entries"] if entry["ours"]]
    return 0 if all(entry["agrees"] for entry in ours) else WRONG_ANSWER


def _told(options: Loop | View | Meshes | Soak, name: str, module: Any) -> dict[str, Any]:
    """Measure, tell and write what a module with `run` and `tell` has to say."""
    from app.bench.machine import write

    console = Console(highlight=False, width=None if sys.stdout.isatty() else 130)
    result = _shown(console, lambda say, advance: module.run(options, say, advance))
    module.tell(result, console)
    console.print(f"written: {write(options.out, name, result)}")
    return result


def _shown(
    console: Console,
    work: Callable[[Callable[[str], None], Callable[[float], None]], dict[str, Any]],
) -> dict[str, Any]:
    """Do the work under a progress bar."""
    with Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        TimeElapsedColumn(),
        console=console,
        transient=True,
        refresh_per_second=2,  # drawing takes the interpreter from what is being measured
    ) as progress:
        bar = progress.add_task("starting", total=1.0)

        def say(text: str) -> None:
            progress.update(bar, description=text)
            if not console.is_terminal:
                console.print(f"  {text} …")

        return work(say, lambda share: progress.update(bar, completed=share))


def _complain(message: str) -> int:
    print(f"vf-sandbox bench: error: {message}", file=sys.stderr)
    return USAGE_ERROR

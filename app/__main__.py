"""The command line: `vf-sandbox` starts the page, `vf-sandbox <command> …` runs a command."""

from __future__ import annotations

import ast
import errno
import importlib
import importlib.util
import pkgutil
import signal
import socket
import sys
import threading
import time
from types import FrameType, TracebackType

from rich.console import Console
from rich.markup import escape
from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

import app.commands
from app.interrupts import interrupts
from app.presets import find
from app.scenario import Scenario
from app.settings import OptionError, Options, format_length, parse

USAGE_ERROR = 2
INTERRUPTED = 130

ABOUT = """Drag a simulated surgical tool over anatomy; virtual fixtures keep it out.

Starts the control loop and a page for the browser, and prints the page's address.

Try:  vf-sandbox --mesh gear --rule paper --radius 0.5mm

Try:  vf-sandbox --scenario slide-into-the-orbit

Try:  vf-sandbox --mesh scan.stl --unit mm --robot point --tip-radius 1mm"""


def main(arguments: list[str] | None = None) -> int:
    """Run the command line (default: this process's words); returns the exit code."""
    words = sys.argv[1:] if arguments is None else arguments
    _interrupt_on_terminate()
    try:
        if words and not words[0].startswith("-"):
            return _command(words[0], words[1:])
        return serve(*_wanted(words))
    except OptionError as error:
        return _complain(str(error))
    except KeyboardInterrupt:
        return INTERRUPTED


def serve(options: Options, scenario: Scenario | None = None) -> int:
    """Start session and page, and keep them until Ctrl-C; returns the exit code.

    Args:
        scenario: what to begin with; the options have its settings in them.
    """
    if problem := bind_problem(options.host, options.port):
        return _complain(problem)
    console = Console(highlight=False)
    console.print(
        f"[bold]vf-sandbox[/]: {escape(options.mesh)}, {options.robot}, rule {options.rule}, "
        f"motion sphere {format_length(options.radius)}, {options.rate:g} Hz"
    )
    began = time.perf_counter()
    try:
        with _Steps(console) as step:
            step("loading libraries")
            from app.loop import prefer_this_process
            from app.session import Session

            prefer_this_process()

            session = Session(options, progress=step)
            tape = None if options.record is None else session.record(options.record)
            with session:
                step("opening the page")
                from app.view.page import Page

                page = Page(session, options.host, options.port, scenario)
                try:
                    if scenario is not None:
                        from app.course import begin

                        begin(scenario, session)
                    step.done()
                    for note in session.scene.notes:
                        console.print(f"  [yellow]![/] {escape(note)}")
                    if tape is not None and tape.elsewhere:
                        note = f"Recording to {tape.path}.{tape.elsewhere}"
                        console.print(f"  [yellow]![/] {escape(note)}")
                    with interrupts() as wait:
                        console.print(
                            f"Ready after {time.perf_counter() - began:.1f} s. "
                            f"Open [bold]{escape(page.url)}[/] (Ctrl-C ends)",
                            soft_wrap=True,
                        )
                        if page.warning:
                            console.print(f"  [yellow]![/] {escape(page.warning)}", soft_wrap=True)
                        wait()
                        console.print("Closing.")
                    return 0
                finally:
                    page.close()
                    if tape is not None:
                        tape.finish()
                        console.print(escape(tape.outcome))
    except (ValueError, OSError) as error:
        # Reasons a user can act upon: names, meshes, a port taken since it was tried.
        return _complain(str(error))


def bind_problem(host: str, port: int) -> str | None:
    """Why the page could not listen on this address, or None if it could.

    Tried beforehand because viser moves on to the next port when one is taken, and hangs on an
    address that is not ours.
    """
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(
            host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE
        )[0]
        with socket.socket(family, kind, protocol) as attempt:
            # As the server will: a port in TIME_WAIT is not taken.
            attempt.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            attempt.bind(address)
            attempt.listen(1)
    except OSError as error:
        if error.errno == errno.EADDRINUSE:
            return (
                f"port {port} on {host} is taken: "
                "choose another with --port, or --port 0 for any free one"
            )
        return (
            f"cannot listen on host '{host}', port {port} ({error.strerror or error}): "
            "--host takes an address of this machine, such as 127.0.0.1 or 0.0.0.0"
        )
    return None


def _wanted(words: list[str]) -> tuple[Options, Scenario | None]:
    """What the words say, where they say nothing the scenario they name."""
    about = _about()
    options = parse(words, about)
    if options.scenario is None:
        return options, None
    scenario = find(options.scenario)
    options = parse(words, about, scenario.applied(Options()))
    if options.mesh != scenario.options.mesh:
        raise OptionError(
            f"--mesh {options.mesh} with --scenario {options.scenario}: "
            f"the scenario is made for the mesh {scenario.options.mesh}; leave one of the two out"
        )
    return options, scenario


def _command(name: str, rest: list[str]) -> int:
    known = _commands()
    if name not in known:
        choices = f"the commands are {', '.join(known)}" if known else "there are no commands yet"
        return _complain(f"unknown command '{name}': {choices}; without one the page starts")
    return int(importlib.import_module(f"app.commands.{name}").main(rest))


def _about() -> str:
    """The help text: what the page is, and a line for each command, read without importing it."""
    lines = [ABOUT]
    for name in _commands():
        spec = importlib.util.find_spec(f"app.commands.{name}")
        source = spec.loader.get_source(spec.name) if spec else None  # type: ignore[union-attr]
        doc = ast.get_docstring(ast.parse(source or "")) or ""
        lines.append(f"vf-sandbox {name}: {doc.splitlines()[0] if doc else ''}")
    return "\n\n".join(lines)


def _commands() -> list[str]:
    return sorted(module.name for module in pkgutil.iter_modules(app.commands.__path__))


def _complain(message: str) -> int:
    print(f"vf-sandbox: error: {message}", file=sys.stderr)
    return USAGE_ERROR


def _interrupt_on_terminate() -> None:
    """Let SIGTERM close everything just as Ctrl-C does."""

    def interrupt(number: int, frame: FrameType | None) -> None:
        raise KeyboardInterrupt

    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGTERM, interrupt)


class _Steps:
    """Shows the step under way with the time it takes, and leaves a line for each one done."""

    def __init__(self, console: Console) -> None:
        self._console = console
        self._progress = Progress(
            SpinnerColumn(),
            TextColumn("{task.description}"),
            TimeElapsedColumn(),
            console=console,
            transient=True,
        )
        self._text = ""
        self._since = 0.0

    def __enter__(self) -> _Steps:
        self._progress.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._progress.stop()

    def __call__(self, text: str) -> None:
        """Begin a step; the one before it is done."""
        self._finish()
        self._text, self._since = escape(text), time.perf_counter()
        for task in self._progress.task_ids:
            self._progress.remove_task(task)
        self._progress.add_task(self._text, total=None)
        if not self._console.is_terminal:
            self._console.print(f"  {self._text} …")

    def done(self) -> None:
        """The last step is done: stop showing progress."""
        self._finish()
        self._progress.stop()

    def _finish(self) -> None:
        if self._text and self._console.is_terminal:
            seconds = time.perf_counter() - self._since
            self._console.print(f"  [green]✓[/] {self._text} [dim]{seconds:.1f} s[/]")
        self._text = ""


if __name__ == "__main__":
    sys.exit(main())

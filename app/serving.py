"""`vf-sandbox` without a command: runs a session and its page until Ctrl-C."""

from __future__ import annotations

import errno
import socket
import threading
import time
import webbrowser
from types import TracebackType
from typing import TYPE_CHECKING

from rich.console import Console
from rich.markup import escape
from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

from app.console import console as new_console
from app.interrupts import interrupts
from app.scenarios.file import Scenario
from app.settings import Options
from app.words import OptionError, format_length

if TYPE_CHECKING:
    from app.view.page import Page


def serve(options: Options, scenario: Scenario | None = None) -> int:
    """Start session and page, and run them until Ctrl-C; returns the exit code.

    Args:
        scenario: scenario to start with; `options` already contain its settings.

    Raises:
        ValueError, OSError: a name, a mesh or an address that cannot be used.
    """
    if problem := bind_problem(options.host, options.port):
        raise OptionError(problem)
    console = new_console()
    console.print(
        f"[bold]vf-sandbox[/]: {escape(options.mesh)}, {options.robot}, rule {options.rule}, "
        f"motion sphere {format_length(options.radius)}, {options.rate:g} Hz"
    )
    began = time.perf_counter()
    with _Steps(console) as step:
        step("loading libraries")
        from app.control.priority import raise_process_priority
        from app.session import Session

        raise_process_priority()
        session = Session(options, progress=step, process=True)
        tape = None if options.record is None else session.record(options.record)
        with session:
            step("opening the page")
            from app.view.page import Page

            page = Page(session, options.host, options.port, scenario)
            try:
                if scenario is not None:
                    from app.scenarios.staging import begin

                    begin(scenario, session)
                step.done()
                for note in session.scene.notes:
                    console.print(f"  [yellow]![/] {escape(note)}")
                if tape is not None and tape.elsewhere:
                    note = f"Recording to {tape.path}.{tape.elsewhere}"
                    console.print(f"  [yellow]![/] {escape(note)}")
                attend(
                    page, console, f"Ready after {time.perf_counter() - began:.1f} s", options.open
                )
                return 0
            finally:
                page.close()
                if tape is not None:
                    tape.finish()
                    console.print(escape(tape.outcome))


def attend(page: Page, console: Console, ready: str, show: bool = False, more: str = "") -> None:
    """Print the page's address, and wait for Ctrl-C.

    Args:
        ready: printed before the address.
        show: open the address in the user's browser.
        more: printed after the address.
    """
    with interrupts() as wait:
        console.print(
            f"{escape(ready)}. Open [bold]{escape(page.url)}[/] (Ctrl-C ends){escape(more)}",
            soft_wrap=True,
        )
        if page.warning:
            console.print(f"  [yellow]![/] {escape(page.warning)}", soft_wrap=True)
        if show:
            open_browser(page.url, console)
        wait()
        console.print("Closing.")


def bind_problem(host: str, port: int) -> str | None:
    """Why the page could not listen on this address, or None if it could.

    Tested beforehand because viser takes the next port when one is in use, and hangs on an address
    that this machine does not have.
    """
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(
            host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE
        )[0]
        with socket.socket(family, kind, protocol) as attempt:
            # As the server does: a port in TIME_WAIT counts as free.
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


def open_browser(url: str, console: Console) -> None:
    """Open the address in the user's browser; in a thread, as `webbrowser.open` may block."""

    def browse() -> None:
        if not webbrowser.open(url):
            console.print("  [yellow]![/] no browser was found: open the address yourself")

    threading.Thread(target=browse, name="browser", daemon=True).start()


class _Steps:
    """Shows the current step with its elapsed time, and prints a line for each finished step."""

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
        """Finish the previous step and begin this one."""
        self._finish()
        self._text, self._since = escape(text), time.perf_counter()
        for task in self._progress.task_ids:
            self._progress.remove_task(task)
        self._progress.add_task(self._text, total=None)
        if not self._console.is_terminal:
            self._console.print(f"  {self._text} …")

    def done(self) -> None:
        """Finish the last step."""
        self._finish()
        self._progress.stop()

    def _finish(self) -> None:
        if self._text and self._console.is_terminal:
            seconds = time.perf_counter() - self._since
            self._console.print(f"  [green]✓[/] {self._text} [dim]{seconds:.1f} s[/]")
        self._text = ""

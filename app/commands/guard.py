"""Guard a real arm: between a master and an arm that are elsewhere, without a page."""

from __future__ import annotations

import threading
import time
from dataclasses import dataclass
from typing import TYPE_CHECKING

from rich.console import Console
from rich.markup import escape

from app.choices import NO_MESH, check_mesh
from app.console import console as new_console
from app.interrupts import interrupts
from app.kinds import Switch
from app.options import like, option
from app.settings import Options
from app.words import OptionError

if TYPE_CHECKING:
    from app.devices.report import LinkReport, Report
    from app.session import Session

PERIOD = 0.25  # between two looks at the devices [s]
TOLD = 10.0  # between two lines about them [s]


@dataclass(frozen=True)
class Guard(Options):
    """Stand between a master and an arm that are elsewhere, and keep the arm out of structures.

    To a console the guard is a CRTK arm, to the arm a client. Either may be started first, vanish
    and come back. Nothing moves the arm before it is enabled: --enable, state_command, or the
    page's button. A simulator and research tool, not a medical device.
    """

    mesh: str = like(Options, "mesh", NO_MESH)
    standoff: float = like(
        Options, "standoff", 1e-4,
        "Distance the tool keeps from the surface; no less than what the arm's joints are off.",
    )  # fmt: skip
    master: str = like(Options, "master", "sim")
    page: bool = option(Switch(), False, "Serve the page too.")


def run(options: Guard) -> int:
    """Guard until Ctrl-C; returns the exit code."""
    from app.control.priority import raise_process_priority
    from app.serving import bind_problem
    from app.session import Session

    _check(options)
    if options.page and (problem := bind_problem(options.host, options.port)):
        raise OptionError(problem)
    console = new_console(soft_wrap=True)
    began = time.perf_counter()
    raise_process_priority()
    session = Session(
        options, progress=lambda text: console.print(f"  {escape(text)} …"), process=True
    )
    with session:
        for note in session.scene.notes:
            console.print(f"  [yellow]![/] {escape(note)}")
        names = ", ".join(str(own.name) for own in options.anatomy if own.guarded)
        if options.mesh == NO_MESH:
            names = ", ".join(str(own.name) for own in session.options.anatomy if own.guarded)
        console.print(
            f"Guarding {escape(names)} after {time.perf_counter() - began:.1f} s: arm "
            f"[bold]{escape(options.arm)}[/], master [bold]{escape(options.master)}[/]. "
            + ("" if options.enable else "The arm is not enabled yet. ")
            + "Not a medical device."
        )
        if options.page:
            _with_page(options, session, console)
        else:
            _attend(session, console)
    return 0


def _check(options: Guard) -> None:
    if options.mesh == NO_MESH and not options.structures:
        raise OptionError("what is to be guarded? --structure FILE, or --mesh NAME|FILE")
    if options.master == "page" and not options.page:
        raise OptionError("--master page needs --page")
    check_mesh(options.mesh)
    for one in options.structures:
        check_mesh(one.file)


def _with_page(options: Guard, session: Session, console: Console) -> None:
    from app.serving import attend
    from app.view.page import Page

    page = Page(session, options.host, options.port)
    try:
        attend(page, console, "Ready", options.open)
    finally:
        page.close()


def _attend(session: Session, console: Console) -> None:
    """Print what changes of the devices until Ctrl-C."""
    ended = threading.Event()

    def tell() -> None:
        said, due = "", time.monotonic() + TOLD
        while not ended.wait(PERIOD):
            report = session.devices
            if session.ended:
                console.print(f"[red]The control loop ended[/]: {escape(session.ended)}")
                return
            if report is None:
                continue
            now, state = time.monotonic(), _state(report)
            if state != said or now > due:
                said, due = state, now + TOLD
                console.print(escape("; ".join((state, *_figures(report)))))

    teller = threading.Thread(target=tell, name="devices", daemon=True)
    with interrupts() as wait:
        console.print("Ready (Ctrl-C ends).")
        teller.start()
        wait()
        ended.set()
        teller.join()
        console.print("Closing.")


def _state(report: Report) -> str:
    """Operating state and what keeps the tool from moving, for people."""
    text = report.state
    if report.why:
        text += f": {report.why}"
    elif report.holds:
        text += f", holds: {report.holds}"
    return text


def _figures(report: Report) -> list[str]:
    lines = [_link("arm", report.arm), _link("master", report.master)]
    if report.sent:
        lines.append(f"{1e6 * report.largest:.0f} µm off the path at most")
    median, worst = report.latency
    if median == median:
        lines.append(f"latency {1e3 * median:.2f} ms, 99.9 % within {1e3 * worst:.2f} ms")
    return lines


def _link(name: str, link: LinkReport) -> str:
    if not link.rate:
        return f"{name} {link.trouble or 'here'}"
    refused = sum(link.refused.values())
    return f"{name} {link.rate:.0f} Hz" + (f", {refused} refused" if refused else "")


KINDS = {"": (Guard, run)}

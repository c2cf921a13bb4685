"""A user study: participants, or simulated ones, take it; its data are analysed or deleted."""

from __future__ import annotations

import pathlib
from dataclasses import dataclass

from rich.markup import escape

from app.console import console as new_console
from app.console import count
from app.interrupts import interrupts
from app.kinds import SEEDS, Listed, Maybe, Path, Text, Whole
from app.options import Checked, like, option
from app.settings import Options
from app.studies.people.reading import BUILT_IN
from app.words import OptionError

PROGRAM = "vf-sandbox user-study"
MISSING = "pip install 'vf-sandbox[experiments,study]'"
_PROTOCOL = f"A protocol: {', '.join(BUILT_IN)}; or a TOML file."


@dataclass(frozen=True)
class Serve(Checked):
    """Let people take a study: a page where they enter their code, a session of their own each.

    As many at once as there are cores for a control loop each. Who comes back with the same code
    goes on where they were.
    """

    protocol: str = option(Text(4096), about=_PROTOCOL, positional=True)
    out: pathlib.Path = option(Path(), about="Folder of the study; an earlier one goes on.")
    host: str = like(Options, "host")
    port: int = like(Options, "port")
    open: bool = like(Options, "open")


@dataclass(frozen=True)
class Simulate(Checked):
    """Let simulated operators take a study, faster than real time.

    They go through the same sitting and the same session as people do. An earlier, interrupted
    simulation in the same folder goes on.
    """

    protocol: str = option(Text(4096), about=_PROTOCOL, positional=True)
    out: pathlib.Path = option(Path(), about="Folder of the study; an earlier one goes on.")
    participants: int = option(Whole(1, 10_000), 24, "How many.")
    effect: tuple[str, ...] | None = option(
        Maybe(Listed(Text(100))), None,
        "By how much the errors of the operators differ in a condition, such as fixture=0.5: half "
        "of those elsewhere. Several are separated by commas.",
    )  # fmt: skip
    seed: int = option(Whole(*SEEDS), 0, "Of the operators, beside the protocol's.")
    workers: int = option(Whole(0, 1000), 0, "Processes; 0: one per core.")


@dataclass(frozen=True)
class Analyse(Checked):
    """Write tables and a report about the data of a study."""

    folder: pathlib.Path = option(Path(), about="Folder of the study.", positional=True)


@dataclass(frozen=True)
class Delete(Checked):
    """Remove everything that is kept of a participant."""

    folder: pathlib.Path = option(Path(), about="Folder of the study.", positional=True)
    code: str = option(Text(24), about="The participant's code.", positional=True)


def _serve(options: Serve) -> int:
    from app.serving import bind_problem, open_browser
    from app.studies.people.served.front import Front

    if problem := bind_problem(options.host, options.port):
        raise OptionError(problem)
    front = Front(options.out, options.protocol, options.host, options.port)
    out = new_console()
    try:
        with interrupts() as wait:
            out.print(
                f"“{escape(front.study.protocol.name)}” in {escape(str(options.out))}, "
                f"{count(front.places.most, 'participant')} at once (one per core).\n"
                f"Open [bold]{escape(front.url)}[/] (Ctrl-C ends)",
                soft_wrap=True,
            )
            if options.open:
                open_browser(front.url, out)
            wait()
            out.print("Closing.")
    finally:
        front.close()
    return 0


def _simulate(options: Simulate) -> int:
    from app.studies.people.simulated.taking import simulate

    return simulate(
        options.protocol, options.out, options.participants, options.effect or (), options.seed,
        options.workers,
    )  # fmt: skip


def _analyse(options: Analyse) -> int:
    from app.studies.people.analysis import analyse

    return analyse(options.folder)


def _delete(options: Delete) -> int:
    from app.studies.people.analysis import delete

    return delete(options.folder, options.code)


KINDS = {
    "serve": (Serve, _serve),
    "simulate": (Simulate, _simulate),
    "analyse": (Analyse, _analyse),
    "delete": (Delete, _delete),
}

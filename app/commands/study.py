"""Many simulated trials over a grid of operators, skulls, rules and noise, on Dask."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Annotated

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

from app import choices, limits
from app.commands import answer, interrupted
from app.console import Column, count, progress, show_table
from app.console import console as new_console
from app.limits import Limit, Text, Whole
from app.settings import OptionError, listed, parse_as
from app.studies.experiments.limits import EXPERIMENTS, RULES, TRIAL, WORKERS
from app.words import parse_length

if TYPE_CHECKING:
    from app.studies.experiments.protocol import Outcome, Trial

PROGRAM = "vf-sandbox study"
BROKEN = 1
COLUMNS = (
    "trials", "|PD| [mm]", "CPD [mm]", "SAL", "time [s]", "TRE [mm]", "violations", "unfinished",
)  # fmt: skip
ABOUT = """Run the experiments over a grid: operators × skulls × rules × noise of the registration.

Every trial is written to its own file as it finishes; the same command goes on where it stopped.
A trial's numbers do not depend on how many workers there are. Needs the extra: study."""


@dataclass(frozen=True)
class Study:
    """What to run, and where."""

    experiment: Annotated[str, listed(EXPERIMENTS)] = "cutting"
    """One or both, joined by commas."""
    operators: int = 20
    """How many operators, each a variation of the calibrated one."""
    meshes: Annotated[str, listed(choices.SKULLS)] = "skull"
    """Skulls, joined by commas."""
    rules: Annotated[str, listed(RULES)] = "certified,off"
    """Rules, joined by commas: off is plain teleoperation."""
    noise: str = "0.35mm"
    """Fiducial localisation errors (root mean square), joined by commas."""
    trials: int = 1
    """Trials of each combination."""
    seed: int = 0
    """Of everything random."""
    rate: float = 1000.0
    """Ticks per second of simulated control."""
    length: str | None = None
    """Only this much of the planned cut, such as 5mm."""
    workers: int = 2
    """Processes of the local cluster; 0 computes in this process, without Dask."""
    scheduler: str | None = None
    """Address of a Dask cluster to use instead, such as tcp://host:8786."""
    out: Path = Path("study")
    """Where the trials and the summary are kept."""

    def __post_init__(self) -> None:
        limits.check(self, STUDY)
        for name, field in (
            ("experiment", "experiment"), ("meshes", "mesh"), ("rules", "rule"),
        ):  # fmt: skip
            for word in _words(getattr(self, name)):
                TRIAL[field].check(field, word)
        for word in _words(self.noise):
            TRIAL["noise"].check("noise", parse_length(word))
        if self.length is not None:
            TRIAL["length"].check("length", parse_length(self.length))


STUDY: dict[str, Limit] = {
    **dict.fromkeys(("experiment", "meshes", "rules", "noise"), Text(1000)),
    "operators": Whole(1, 100_000),
    "trials": Whole(1, 10_000),
    "seed": TRIAL["seed"],
    "rate": TRIAL["rate"],
    "length": Text(100, optional=True),
    "workers": WORKERS,
    "scheduler": Text(300, optional=True),
    "out": limits.Path(),
}


@dataclass(frozen=True)
class Collected:
    """What came of a list of trials.

    Attributes:
        outcomes: of those that were done, in the order of the trials.
        wanted: how many trials there were.
        elapsed: [s].
        stopped: what ended it before all were done: an interrupt, or the loss of the cluster.
    """

    outcomes: list[Outcome]
    wanted: int
    elapsed: float
    stopped: BaseException | None

    def end(self, program: str) -> int:
        """Say that it is not all; the exit code, or what ended it."""
        assert self.stopped is not None
        so_far = (
            f"{len(self.outcomes)} of {count(self.wanted, 'trial')} done and kept; the same "
            "command goes on with the rest"
        )
        if isinstance(self.stopped, KeyboardInterrupt):
            return interrupted(program, so_far)
        raise OSError(f"{self.stopped}; {so_far}") from None


def main(arguments: list[str]) -> int:
    """Run `study`; returns the exit code."""
    return answer(PROGRAM, lambda: _run(arguments))


def _run(arguments: list[str]) -> int:
    options = parse_as(Study, PROGRAM, arguments, ABOUT)
    try:
        return run(options, new_console())
    except ImportError as error:
        raise OptionError(f"{error}: pip install 'vf-sandbox[study]', or --workers 0") from None


def run(options: Study, console: Console) -> int:
    """Run the grid and print its summary; returns the exit code."""
    from app.studies import batch as study

    trials = study.grid(
        experiments=_words(options.experiment),
        operators=options.operators,
        meshes=_words(options.meshes),
        rules=_words(options.rules),
        noise=[parse_length(word) for word in _words(options.noise)],
        trials=options.trials,
        seed=options.seed,
        rate=options.rate,
        length=None if options.length is None else parse_length(options.length),
    )
    options.out.mkdir(parents=True, exist_ok=True)  # rather now than after the work
    found = collect(trials, options.out / "trials", options.workers, options.scheduler)
    if found.outcomes:
        _tell(found, options, console)
    if found.stopped is not None:
        return found.end(PROGRAM)
    return BROKEN if any(o.crossings + o.outside for o in found.outcomes) else 0


def _tell(found: Collected, options: Study, console: Console) -> None:
    """Print the summary, and write it as CSV."""
    rows = [(*cell, *_summary(some)) for cell, some in _cells(found.outcomes)]
    names = ("experiment", "skull", "noise [mm]", "rule", *COLUMNS)
    show_table(
        console,
        [Column(name, left=k in (0, 1, 3)) for k, name in enumerate(names)],
        [[f"{x:.3g}" if isinstance(x, float) else str(x) for x in row] for row in rows],
        labels=4,
        title=f"{count(len(found.outcomes), 'trial')}, seed {options.seed}, {found.elapsed:.0f} s",
    )
    path = options.out / "summary.csv"
    with path.open("w", newline="", encoding="utf-8") as file:
        csv.writer(file).writerows([names, *rows])
    console.print(f"written: {path}", markup=False)


def collect(
    trials: Sequence[Trial], folder: Path, workers: int, scheduler: str | None
) -> Collected:
    """Do the trials under a progress bar, until all are done or something ends it.

    Raises:
        ImportError, OSError: of `study.run_all`, but for the loss of the cluster.
    """
    from app.studies import batch as study

    began = perf_counter()
    done: dict[str, Outcome] = {}
    stopped: BaseException | None = None
    with progress(
        TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(),
        TimeRemainingColumn(),
    ) as bar:  # fmt: skip
        task = bar.add_task("trials", total=len(trials))

        def keep(outcome: Outcome) -> None:
            done[outcome.trial.key] = outcome
            bar.advance(task)

        try:
            study.run_all(trials, folder, workers=workers, scheduler=scheduler, done=keep)
        except (KeyboardInterrupt, study.ClusterLost) as end:
            stopped = end
    outcomes = [done[trial.key] for trial in trials if trial.key in done]
    return Collected(outcomes, len(trials), perf_counter() - began, stopped)


def _cells(outcomes: Sequence[Outcome]) -> list[tuple[tuple[object, ...], list[Outcome]]]:
    """Outcomes by combination, in order of appearance."""
    cells: dict[tuple[object, ...], list[Outcome]] = {}
    for outcome in outcomes:
        trial = outcome.trial
        cell = (trial.experiment, trial.mesh, 1e3 * trial.noise, trial.rule)
        cells.setdefault(cell, []).append(outcome)
    return list(cells.items())


def _summary(outcomes: list[Outcome]) -> tuple[object, ...]:
    import numpy as np

    from app.studies.results import analysis

    return (
        len(outcomes),
        float(analysis.penetrations(outcomes).mean()),
        float(analysis.deviations(outcomes).mean()),
        float(np.mean([o.sal for o in outcomes])),
        float(np.mean([o.duration for o in outcomes])),
        1e3 * float(np.mean([o.tre for o in outcomes])),
        analysis.violations(outcomes),
        sum(not o.finished for o in outcomes),
    )


def _words(text: str) -> list[str]:
    words = [word.strip() for word in text.split(",") if word.strip()]
    if not words:
        raise OptionError("a list joined by commas is empty")
    return list(dict.fromkeys(words))

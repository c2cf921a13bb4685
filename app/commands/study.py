"""Many simulated trials over a grid of operators, skulls, rules and noise, on Dask."""

from __future__ import annotations

import csv
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.table import Table

from app.settings import OptionError, parse_as, parse_length

if TYPE_CHECKING:
    from app.experiments.protocol import Outcome, Trial

USAGE_ERROR, BROKEN = 2, 1
COLUMNS = (
    "trials", "|PD| [mm]", "CPD [mm]", "SAL", "time [s]", "TRE [mm]", "violations", "unfinished",
)  # fmt: skip
ABOUT = """Run the experiments over a grid: operators × skulls × rules × noise of the registration.

Every trial is written to its own file as it finishes; the same command goes on where it stopped.
A trial's numbers do not depend on how many workers there are. Needs the extra: study."""


@dataclass(frozen=True)
class Study:
    """What to run, and where."""

    experiment: str = "cutting"
    """cutting, tracing, or both, joined by commas."""
    operators: int = 20
    """How many operators, each a variation of the calibrated one."""
    meshes: str = "skull"
    """Skulls: skull, skull-coarse, skull-fine, joined by commas."""
    rules: str = "certified,off"
    """Rules, joined by commas: off is plain teleoperation; certified, paper."""
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
        for name in ("operators", "trials"):
            if getattr(self, name) < 1:
                raise OptionError(f"{name} must be one or more, got {getattr(self, name)}")
        if self.workers < 0:
            raise OptionError(f"workers must be zero or more, got {self.workers}")


def main(arguments: list[str]) -> int:
    """Run `study`; returns the exit code."""
    options = parse_as(Study, "vf-sandbox study", arguments, ABOUT)
    console = Console(highlight=False, width=None if sys.stdout.isatty() else 140)
    try:
        return run(options, console)
    except ImportError as error:
        return _complain(f"{error}: pip install 'vf-sandbox[study]', or --workers 0")
    except OSError as error:
        return _complain(str(error))


def run(options: Study, console: Console) -> int:
    """Run the grid and print its summary; returns the exit code."""
    from app.experiments import study

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
    outcomes, elapsed = collect(
        trials, options.out / "trials", options.workers, options.scheduler, console
    )
    rows = [(*cell, *_summary(found)) for cell, found in _cells(outcomes)]
    table = Table(title=f"{len(outcomes)} trials, seed {options.seed}, {elapsed:.0f} s")
    names = ("experiment", "skull", "noise [mm]", "rule", *COLUMNS)
    for k, name in enumerate(names):
        table.add_column(name, justify="left" if k < 4 else "right")
    for row in rows:
        table.add_row(*(f"{x:.3g}" if isinstance(x, float) else str(x) for x in row))
    console.print(table)
    path = options.out / "summary.csv"
    with path.open("w", newline="", encoding="utf-8") as file:
        csv.writer(file).writerows([names, *rows])
    console.print(f"written: {path}")
    return BROKEN if any(o.crossings + o.outside for o in outcomes) else 0


def collect(
    trials: Sequence[Trial],
    folder: Path,
    workers: int,
    scheduler: str | None,
    console: Console,
) -> tuple[list[Outcome], float]:
    """Do the trials under a progress bar: outcomes in order, and the time it took [s]."""
    from app.experiments import study

    began = time.perf_counter()
    with Progress(
        TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(),
        TimeRemainingColumn(), console=Console(stderr=True), transient=True,
    ) as bar:  # fmt: skip
        task = bar.add_task("trials", total=len(trials))
        outcomes = study.run_all(
            trials, folder, workers=workers, scheduler=scheduler,
            done=lambda _outcome: bar.advance(task),
        )  # fmt: skip
    return outcomes, time.perf_counter() - began


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

    from app.experiments import analysis

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


def _complain(message: str) -> int:
    print(f"vf-sandbox study: error: {message}", file=sys.stderr)
    return USAGE_ERROR

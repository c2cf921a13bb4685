"""Many simulated trials over a grid of operators, skulls, rules and noise, on Dask."""

from __future__ import annotations

import csv
import pathlib
from collections.abc import Sequence
from dataclasses import dataclass
from time import perf_counter
from typing import TYPE_CHECKING

from rich.console import Console

from app.commands import interrupted
from app.console import Column, count, progress, show_table
from app.console import console as new_console
from app.kinds import Kind, Listed, Maybe, Path, Text, Whole
from app.options import Checked, declared, like, option
from app.studies.experiments.description import WORKERS, Trial

if TYPE_CHECKING:
    from app.studies.experiments.protocol import Outcome

PROGRAM = "vf-sandbox study"
BROKEN = 1
COLUMNS = (
    "trials", "|PD| [mm]", "CPD [mm]", "SAL", "time [s]", "TRE [mm]", "injured", "deepest [mm]",
    "bone left [mm]", "violations", "unfinished",
)  # fmt: skip
MISSING = "pip install 'vf-sandbox[study]', or --workers 0"


def _listed(name: str) -> Kind:
    """The kind of a list of values of this option of a trial."""
    return Listed(declared(Trial)[name].kind)


@dataclass(frozen=True)
class Study(Checked):
    """Run the experiments over a grid: operators × skulls × rules × noise × margins.

    Every trial is written to its own file as it finishes; the same command goes on where it
    stopped. A trial's numbers do not depend on how many workers there are. Needs the extra: study.
    """

    experiment: tuple[str, ...] = option(
        _listed("experiment"), ("cutting",), "One or both, joined by commas."
    )
    operators: int = option(
        Whole(1, 100_000), 20, "How many operators, each a variation of the calibrated one."
    )
    meshes: tuple[str, ...] = option(_listed("mesh"), ("skull",), "Skulls, joined by commas.")
    rules: tuple[str, ...] = option(
        _listed("rule"), ("certified", "off"),
        "Rules, joined by commas: off is plain teleoperation.",
    )  # fmt: skip
    noise: tuple[float, ...] = option(
        _listed("noise"), (0.35e-3,),
        "Fiducial localisation errors (root mean square), joined by commas.",
    )  # fmt: skip
    margin: tuple[float, ...] = option(
        _listed("margin"), (0.0,),
        "Factors of the margin map over the target registration error, joined by commas; 0: none.",
    )  # fmt: skip
    trials: int = option(Whole(1, 10_000), 1, "Trials of each combination.")
    seed: int = like(Trial, "seed")
    rate: float = like(Trial, "rate")
    length: float | None = like(Trial, "length")
    workers: int = option(
        WORKERS, 2,
        "Processes of the local cluster; 0 computes in this process, without Dask.",
    )  # fmt: skip
    scheduler: str | None = option(
        Maybe(Text(300)), None,
        "Address of a Dask cluster to use instead, such as tcp://host:8786.",
    )  # fmt: skip
    out: pathlib.Path = option(
        Path(), pathlib.Path("study"), "Where the trials and the summary are kept."
    )


@dataclass(frozen=True)
class Collected:
    """The outcomes of a list of trials.

    Attributes:
        outcomes: of the finished trials, in the order of the trials.
        wanted: number of trials.
        elapsed: [s].
        stopped: an interrupt, or the loss of the cluster; None: all trials are finished.
    """

    outcomes: list[Outcome]
    wanted: int
    elapsed: float
    stopped: BaseException | None

    def end(self, program: str) -> int:
        """Report an incomplete list: the exit code of an interrupt, or raise the error."""
        assert self.stopped is not None
        so_far = (
            f"{len(self.outcomes)} of {count(self.wanted, 'trial')} done and kept; the same "
            "command goes on with the rest"
        )
        if isinstance(self.stopped, KeyboardInterrupt):
            return interrupted(program, so_far)
        raise OSError(f"{self.stopped}; {so_far}") from None


def run(options: Study) -> int:
    """Run the grid and print its summary; returns the exit code."""
    from app.studies import batch as study

    trials = study.grid(
        experiments=options.experiment,
        operators=options.operators,
        meshes=options.meshes,
        rules=options.rules,
        noise=options.noise,
        margins=options.margin,
        trials=options.trials,
        seed=options.seed,
        rate=options.rate,
        length=options.length,
    )
    options.out.mkdir(parents=True, exist_ok=True)  # before the work, to fail early
    found = collect(trials, options.out / "trials", options.workers, options.scheduler)
    if found.outcomes:
        _report(found, options, new_console())
    if found.stopped is not None:
        return found.end(PROGRAM)
    return BROKEN if any(o.crossings + o.outside for o in found.outcomes) else 0


def _report(found: Collected, options: Study, console: Console) -> None:
    """Print the summary, and write it as CSV."""
    rows = [(*cell, *_summary(some)) for cell, some in _cells(found.outcomes)]
    names = ("experiment", "skull", "noise [mm]", "rule", "margin", *COLUMNS)
    show_table(
        console,
        [Column(name, left=k in (0, 1, 3)) for k, name in enumerate(names)],
        [[f"{x:.3g}" if isinstance(x, float) else str(x) for x in row] for row in rows],
        labels=5,
        title=f"{count(len(found.outcomes), 'trial')}, seed {options.seed}, {found.elapsed:.0f} s",
    )
    path = options.out / "summary.csv"
    with path.open("w", newline="", encoding="utf-8") as file:
        csv.writer(file).writerows([names, *rows])
    console.print(f"written: {path}", markup=False)


def collect(
    trials: Sequence[Trial], folder: pathlib.Path, workers: int, scheduler: str | None
) -> Collected:
    """Run the trials with a progress bar, until all are finished or it is stopped.

    Raises:
        ImportError, OSError: as `study.run_all`, except the loss of the cluster.
    """
    from app.studies import batch as study

    began = perf_counter()
    done: dict[str, Outcome] = {}
    stopped: BaseException | None = None
    with progress(counted=True) as bar:
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
        cell = (trial.experiment, trial.mesh, 1e3 * trial.noise, trial.rule, trial.margin)
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
        sum(o.injured > 0 for o in outcomes),
        1e3 * max(o.deepest for o in outcomes),
        -float(analysis.penetrations(outcomes, signed=True).mean()),
        analysis.violations(outcomes),
        sum(not o.finished for o in outcomes),
    )


KINDS = {"": (Study, run)}

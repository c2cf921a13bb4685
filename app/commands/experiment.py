"""The paper's experiments with a simulated operator: tracing, cutting, power, replay."""

from __future__ import annotations

import dataclasses
import json
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from app.interrupts import interrupts
from app.settings import Length, OptionError, parse_as

if TYPE_CHECKING:
    from app.experiments.protocol import Outcome, Trial

USAGE_ERROR, BROKEN = 2, 1
ENOUGH = 0.95  # of the seeds must find the fixture significantly better


@dataclass(frozen=True)
class Experiment:
    """Options that tracing and cutting share."""

    trials: int | None = None
    """Trials of each mode; the paper's number if not given (tracing 5, cutting 2)."""
    seed: int = 0
    """Of everything random."""
    out: Path = Path("results")
    """Where CSV files and the report go."""
    mesh: str = "skull"
    """skull, skull-coarse or skull-fine."""
    rule: str = "certified"
    """What guards the inner surface in fixture mode: certified or paper."""
    noise: Length = 0.35e-3
    """Fiducial localisation error, root mean square in 3D."""
    width: Length = 1e-3
    """Of the corridor, to either side of the planned cut."""
    rate: float = 1000.0
    """Ticks per second of simulated control."""
    length: Length = 30e-3
    """How much of the planned cut is done."""

    def __post_init__(self) -> None:
        if self.trials is not None and self.trials < 1:
            raise OptionError(f"trials must be one or more, got {self.trials}")
        if self.rule not in ("certified", "paper"):
            raise OptionError(f"unknown rule '{self.rule}': choose one of certified, paper")


@dataclass(frozen=True)
class Tracing(Experiment):
    """Trace the pre-cut skull with and without the fixture (section V-B): smoothness, in pairs."""


@dataclass(frozen=True)
class Cutting(Experiment):
    """Cut the skull with and without the fixture (section V-C): path deviation, penetration."""


@dataclass(frozen=True)
class Power:
    """Repeat the cutting experiment with many seeds: how often is the fixture found better?"""

    seeds: int = 100
    """How many experiments, seeds 0 and up."""
    rate: float = 50.0
    """Ticks per second of simulated control; 1000 takes twenty times as long, with like results."""
    workers: int = 0
    """Processes, on Dask; 0 computes in this one."""
    out: Path = Path("power")
    """Where the trials are kept; the same command goes on where it stopped."""

    def __post_init__(self) -> None:
        if self.seeds < 1 or self.workers < 0:
            raise OptionError("seeds must be one or more, workers zero or more")


@dataclass(frozen=True)
class Calibrate:
    """Fit the operator to the paper's plain teleoperation, and print its values."""

    trials: int = 12
    """Simulated trials behind every figure."""
    seed: int = 0
    """Of everything random."""

    def __post_init__(self) -> None:
        if self.trials < 2 or self.seed < 0:
            raise OptionError("trials must be two or more, seed zero or more")


@dataclass(frozen=True)
class Replay:
    """Do one trial again and open it in the page, where it is played in real time."""

    experiment: str = "cutting"
    """tracing or cutting."""
    rule: str = "certified"
    """off, certified or paper."""
    number: int = 0
    """Which trial of the experiment, from 0."""
    seed: int = 0
    """Of the experiment."""
    rate: float = 1000.0
    """Ticks per second, as in the experiment."""
    length: Length = 30e-3
    """How much of the planned cut, as in the experiment."""
    trial: Path | None = None
    """A trial's file from a study, instead of all the above."""
    host: str = "127.0.0.1"
    """Address the page listens on."""
    port: int = 8080
    """Port of the page; 0 takes any free one."""


_KINDS: dict[str, type] = {
    "tracing": Tracing,
    "cutting": Cutting,
    "power": Power,
    "calibrate": Calibrate,
    "replay": Replay,
}


def main(arguments: list[str]) -> int:
    """Run one of the kinds of `experiment`; returns the exit code."""
    if not arguments or arguments[0] in ("-h", "--help"):
        print(f"usage: vf-sandbox experiment {{{','.join(_KINDS)}}} [options]\n")
        for name, kind in _KINDS.items():
            print(f"  {name:10} {(kind.__doc__ or '').strip().splitlines()[0]}")
        return 0 if arguments else USAGE_ERROR
    name, *words = arguments
    if name not in _KINDS:
        return _complain(f"unknown experiment '{name}': choose from {', '.join(_KINDS)}")
    console = Console(highlight=False, width=None if sys.stdout.isatty() else 150)
    try:
        kind = _KINDS[name]
        options: Any = parse_as(kind, f"vf-sandbox experiment {name}", words, kind.__doc__ or "")
        if isinstance(options, Power):
            return _power(options, console)
        if isinstance(options, Calibrate):
            return _calibrate(options, console)
        if isinstance(options, Replay):
            return _replay(options, console)
        return _compare(name, options, console)
    except ImportError as error:
        return _complain(f"{error}: pip install 'vf-sandbox[experiments,study]'")
    except (ValueError, OSError) as error:
        return _complain(str(error))


def _compare(experiment: str, options: Experiment, console: Console) -> int:
    from app.experiments import analysis, protocol, published, report

    usual = published.TRACING_TRIALS if experiment == "tracing" else published.CUTTING_TRIALS
    trials = [
        protocol.Trial(
            experiment, rule, number, mesh=options.mesh, noise=options.noise, width=options.width,
            seed=options.seed, rate=options.rate, length=options.length,
        )
        for number in range(options.trials or usual)
        for rule in ("off", options.rule)
    ]  # fmt: skip
    outcomes = _shown(trials, console)
    report.show(outcomes, console)
    written = report.write(outcomes, options.out)
    for path in written:
        console.print(f"written: {escape(str(path))}")
    if not any(path.suffix == ".html" for path in written):
        console.print("no report: matplotlib is missing (pip install 'vf-sandbox[experiments]')")
    return BROKEN if analysis.violations(outcomes) else 0


def _shown(trials: list[Trial], console: Console) -> list[Outcome]:
    """Do trials one after the other under a progress bar."""
    from app.experiments import protocol

    outcomes = []
    with Progress(
        TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(),
        console=console, transient=True,
    ) as bar:  # fmt: skip
        task = bar.add_task("preparing", total=len(trials))
        for trial in trials:
            bar.update(task, description=f"trial {trial.number + 1}, rule {trial.rule}")
            outcomes.append(protocol.run(trial))
            bar.advance(task)
    return outcomes


def _power(options: Power, console: Console) -> int:
    from app.commands.study import collect
    from app.experiments import analysis, protocol, published

    trials = [
        protocol.Trial("cutting", rule, number, seed=seed, rate=options.rate)
        for seed in range(options.seeds)
        for number in range(published.CUTTING_TRIALS)
        for rule in ("off", "certified")
    ]
    outcomes, elapsed = collect(trials, options.out / "trials", options.workers, None, console)
    better = {published.DEVIATION.name: 0, published.PENETRATION.name: 0}
    both = 0
    for seed in range(options.seeds):
        mine = [o for o in outcomes if o.trial.seed == seed]
        found = {line.name: line.comparison for line in analysis.cutting(mine)}
        hits = [
            c is not None and c.significant and c.difference < 0.0
            for c in (found[name] for name in better)
        ]
        for name, hit in zip(better, hits, strict=True):
            better[name] += hit
        both += all(hits)
    table = Table(title=f"{options.seeds} experiments of 2 + 2 skulls, {elapsed:.0f} s")
    for column in ("fixture significantly better in", "experiments"):
        table.add_column(column)
    for name, count in (*better.items(), ("both", both)):
        table.add_row(name, f"{count} of {options.seeds}")
    console.print(table)
    broken = analysis.violations(outcomes)
    ticks = sum(o.ticks for o in outcomes if o.trial.assisted)
    console.print(f"{broken} violations in {ticks:,} assisted ticks")
    return BROKEN if broken or both < ENOUGH * options.seeds else 0


def _calibrate(options: Calibrate, console: Console) -> int:
    from app.experiments import calibration, operators

    with console.status("fitting") as status:
        found = calibration.calibrate(options.trials, options.seed, status.update)
    table = Table(title="plain teleoperation: the paper's figures and the fitted model's")
    for column in ("figure", "paper", "model"):
        table.add_column(column)
    for name, wanted, reached in found.rows:
        table.add_row(escape(name), f"{wanted:.4g}", f"{reached:.4g}")
    console.print(table)
    units = {f.name: f.metadata["unit"] for f in dataclasses.fields(operators.Operator)}
    for name in calibration.FITTED:
        console.print(f"{name} = {getattr(found.operator, name):.6g} {units[name]}")
    return 0


def _replay(options: Replay, console: Console) -> int:
    from app.__main__ import bind_problem
    from app.experiments import playback, protocol
    from app.session import Session
    from app.view.page import Page

    if problem := bind_problem(options.host, options.port):
        return _complain(problem)
    if options.trial is not None:
        values = json.loads(options.trial.read_text("utf-8"))
        trial = protocol.Outcome.from_json(values).trial
    else:
        trial = protocol.Trial(
            options.experiment, options.rule, options.number, seed=options.seed,
            rate=options.rate, length=options.length,
        )  # fmt: skip
    with console.status(f"doing trial {escape(trial.key)}"):
        recorded = protocol.record(trial)
        scene = playback.scene(recorded)
    with Session(playback.options(trial), scene=scene) as session:
        page = Page(session, options.host, options.port)
        try:
            session.set_autopilot(True)
            with interrupts() as wait:
                console.print(
                    f"{escape(trial.key)}: {recorded.outcome.duration:.0f} s. "
                    f"Open [bold]{page.url}[/] (Ctrl-C ends); reset and switch the autopilot on "
                    "to see it again",
                    soft_wrap=True,
                )
                if page.warning:
                    console.print(escape(page.warning), soft_wrap=True)
                wait()
                console.print("Closing.")
        finally:
            page.close()
    return 0


def _complain(message: str) -> int:
    print(f"vf-sandbox experiment: error: {message}", file=sys.stderr)
    return USAGE_ERROR

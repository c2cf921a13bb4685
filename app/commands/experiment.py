"""The paper's experiments with a simulated operator: tracing, cutting, margins, power, replay."""

from __future__ import annotations

import contextlib
import dataclasses
import json
import pathlib
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from rich.markup import escape

from app.commands import interrupted
from app.console import Column, count, progress, show_table
from app.console import console as new_console
from app.kinds import Maybe, Number, OneOf, Path, Whole
from app.options import Checked, like, option
from app.settings import Options
from app.studies.experiments.description import RULES, WORKERS, Trial
from app.words import OptionError

if TYPE_CHECKING:
    from app.studies.experiments.protocol import Outcome

PROGRAM = "vf-sandbox experiment"
BROKEN = 1
ENOUGH = 0.95  # least share of the seeds with a significant improvement
GUARDS = RULES[1:]
MARGIN_TRIALS = 20

MISSING = "pip install 'vf-sandbox[experiments,study]'"


@dataclass(frozen=True)
class Experiment(Checked):
    """Common options of tracing and cutting."""

    trials: int | None = option(
        Maybe(Whole(1, 10_000)), None,
        "Trials of each mode; the paper's number if not given (tracing 5, cutting 2).",
    )  # fmt: skip
    seed: int = like(Trial, "seed")
    out: pathlib.Path = option(
        Path(), pathlib.Path("results"), "Where CSV files and the report go."
    )
    mesh: str = like(Trial, "mesh")
    rule: str = option(
        OneOf("rule", GUARDS), "certified", "What guards the inner surface in fixture mode."
    )
    noise: float = like(Trial, "noise")
    width: float = like(Trial, "width")
    rate: float = like(Trial, "rate")
    length: float | None = like(Trial, "length", 30e-3)


@dataclass(frozen=True)
class Tracing(Experiment):
    """Trace the pre-cut skull with and without the fixture (section V-B): smoothness, in pairs."""


@dataclass(frozen=True)
class Cutting(Experiment):
    """Cut the skull with and without the fixture (section V-C): path deviation, penetration."""


@dataclass(frozen=True)
class Margins(Experiment):
    """Cut without and with the margin map of the registration, in pairs: injuries and the price.

    The same operator, skull, registration and random numbers both times. Injuries are of the true
    inner surface; the guard knows where the registration puts it.
    """

    trials: int | None = option(Maybe(Whole(1, 10_000)), None, "Pairs of cuts; 20 if not given.")
    factor: float = option(
        Number(0.1, 10.0), 2.0, "Factor of the margins over the target registration error."
    )


@dataclass(frozen=True)
class Power(Checked):
    """Repeat the cutting experiment with many seeds: how often is the fixture found better?"""

    seeds: int = option(Whole(1, 100_000), 100, "How many experiments, seeds 0 and up.")
    rate: float = like(
        Trial, "rate", 50.0,
        "Ticks per second of simulated control; 1000 takes twenty times as long, with like "
        "results.",
    )  # fmt: skip
    workers: int = option(WORKERS, 0, "Processes, on Dask; 0 computes in this one.")
    out: pathlib.Path = option(
        Path(), pathlib.Path("power"),
        "Where the trials are kept; the same command goes on where it stopped.",
    )  # fmt: skip


@dataclass(frozen=True)
class Calibrate(Checked):
    """Fit the operator to the paper's plain teleoperation, and print its values."""

    trials: int = option(Whole(2, 10_000), 12, "Simulated trials behind every figure.")
    seed: int = like(Trial, "seed")


@dataclass(frozen=True)
class Replay(Checked):
    """Repeat one trial and play it on the page in real time."""

    experiment: str = like(Trial, "experiment", "cutting", "Which of the two.")
    rule: str = like(
        Trial, "rule", "certified",
        "What guards the inner surface; off is plain teleoperation.",
    )  # fmt: skip
    number: int = like(Trial, "number", about="Which trial of the experiment, from 0.")
    seed: int = like(Trial, "seed", about="Of the experiment.")
    rate: float = like(Trial, "rate", about="Ticks per second, as in the experiment.")
    length: float | None = like(
        Trial, "length", 30e-3, "How much of the planned cut, as in the experiment."
    )
    margin: float = like(Trial, "margin")
    trial: pathlib.Path | None = option(
        Maybe(Path()), None, "A trial's file from a study, instead of all the above."
    )
    host: str = like(Options, "host", about="Address the page listens on.")
    port: int = like(Options, "port")


def _compare(options: Experiment) -> int:
    from app.studies.results import published, report

    experiment = "tracing" if isinstance(options, Tracing) else "cutting"
    usual = published.TRACING_TRIALS if experiment == "tracing" else published.CUTTING_TRIALS
    trials = [
        Trial(
            experiment, rule, number, mesh=options.mesh, noise=options.noise, width=options.width,
            seed=options.seed, rate=options.rate, length=options.length,
        )
        for number in range(options.trials or usual)
        for rule in ("off", options.rule)
    ]  # fmt: skip
    return _reported(trials, experiment, options.out, report)


def _margins(options: Margins) -> int:
    from app.studies.results import margins

    trials = [
        Trial(
            "cutting", options.rule, number, mesh=options.mesh, noise=options.noise,
            width=options.width, seed=options.seed, rate=options.rate, length=options.length,
            margin=factor,
        )
        for number in range(options.trials or MARGIN_TRIALS)
        for factor in (0.0, options.factor)
    ]  # fmt: skip
    return _reported(trials, "margins", options.out, margins)


def _reported(trials: list[Trial], experiment: str, out: pathlib.Path, report: Any) -> int:
    """Run pairs of trials, show and write the report of a module with `show` and `write`."""
    from app.studies.results import analysis

    console = new_console()
    outcomes = _shown(trials)
    whole = len(outcomes) == len(trials)
    outcomes = outcomes[: len(outcomes) // 2 * 2]  # complete pairs
    if not outcomes:
        return interrupted(f"{PROGRAM} {experiment}", "before a trial was done in both modes")
    report.show(outcomes, console)
    written = report.write(outcomes, out)
    for path in written:
        console.print(f"written: {escape(str(path))}")
    if not any(path.suffix == ".html" for path in written):
        console.print("no report: matplotlib is missing (pip install 'vf-sandbox[experiments]')")
    if not whole:
        so_far = f"this is of {count(len(outcomes), 'trial')} of {len(trials)}"
        return interrupted(f"{PROGRAM} {experiment}", so_far)
    return BROKEN if analysis.violations(outcomes) else 0


def _shown(trials: list[Trial]) -> list[Outcome]:
    """Run trials one after the other with a progress bar; fewer if it is interrupted."""
    from app.studies.experiments import protocol

    outcomes: list[Outcome] = []
    with contextlib.suppress(KeyboardInterrupt), progress(counted=True) as bar:
        task = bar.add_task("preparing", total=len(trials))
        for trial in trials:
            more = f", margin {trial.margin:g}" if trial.margin else ""
            bar.update(task, description=f"trial {trial.number + 1}, rule {trial.rule}{more}")
            outcomes.append(protocol.run(trial))
            bar.advance(task)
    return outcomes


def _power(options: Power) -> int:
    from app.commands.study import collect
    from app.studies.results import analysis, published

    console = new_console()
    trials = [
        Trial("cutting", rule, number, seed=seed, rate=options.rate)
        for seed in range(options.seeds)
        for number in range(published.CUTTING_TRIALS)
        for rule in ("off", "certified")
    ]
    found = collect(trials, options.out / "trials", options.workers, None)
    each = len(trials) // options.seeds
    by_seed: dict[int, list[Outcome]] = {}
    for outcome in found.outcomes:
        by_seed.setdefault(outcome.trial.seed, []).append(outcome)
    whole = [mine for mine in by_seed.values() if len(mine) == each]
    better = {published.DEVIATION.name: 0, published.PENETRATION.name: 0}
    both = 0
    for mine in whole:
        lines = {line.name: line.comparison for line in analysis.cutting(mine)}
        hits = [
            c is not None and c.significant and c.difference < 0.0
            for c in (lines[name] for name in better)
        ]
        for name, hit in zip(better, hits, strict=True):
            better[name] += hit
        both += all(hits)
    show_table(
        console,
        [Column("fixture significantly better in", left=True), Column("experiments")],
        [(name, f"{hits} of {len(whole)}") for name, hits in (*better.items(), ("both", both))],
        title=f"{count(len(whole), 'experiment')} of 2 + 2 skulls, {found.elapsed:.0f} s",
    )
    broken = analysis.violations(found.outcomes)
    ticks = sum(o.ticks for o in found.outcomes if o.trial.assisted)
    console.print(f"{count(broken, 'violation')} in {count(ticks, 'assisted tick')}")
    if found.stopped is not None:
        return found.end(f"{PROGRAM} power")
    return BROKEN if broken or both < ENOUGH * options.seeds else 0


def _calibrate(options: Calibrate) -> int:
    from app.studies.experiments import calibration, operators

    console = new_console()
    with console.status("fitting") as status:
        found = calibration.calibrate(options.trials, options.seed, status.update)
    show_table(
        console,
        [Column("figure", left=True), Column("paper"), Column("model")],
        [(escape(name), f"{wanted:.4g}", f"{reached:.4g}") for name, wanted, reached in found.rows],
        title="plain teleoperation: the paper's figures and the fitted model's",
    )
    units = {f.name: f.metadata["unit"] for f in dataclasses.fields(operators.Operator)}
    for name in calibration.FITTED:
        console.print(f"{name} = {getattr(found.operator, name):.6g} {units[name]}")
    if not found.finished:
        return interrupted(f"{PROGRAM} calibrate", "this is the nearest so far, not the fit")
    return 0


def _replay(options: Replay) -> int:
    from app.serving import attend, bind_problem
    from app.session import Session
    from app.studies.experiments import playback, protocol
    from app.view.page import Page

    console = new_console()
    if problem := bind_problem(options.host, options.port):
        raise OptionError(problem)
    if options.trial is not None:
        try:
            values = json.loads(options.trial.read_text("utf-8"))
            trial = protocol.Outcome.from_json(values).trial
        except (ValueError, RecursionError) as error:
            raise OptionError(f"{options.trial}: not the file of a trial: {error}") from None
    else:
        trial = Trial(
            options.experiment, options.rule, options.number, seed=options.seed,
            rate=options.rate, length=options.length, margin=options.margin,
        )  # fmt: skip
    with console.status(f"doing trial {escape(trial.key)}"):
        recorded = protocol.record(trial)
        scene = playback.scene(recorded)
    with Session(playback.options(trial), scene=scene, process=True) as session:
        page = Page(session, options.host, options.port)
        try:
            session.set_autopilot(True)
            attend(
                page,
                console,
                f"{trial.key}: {recorded.outcome.duration:.0f} s",
                more="; reset and switch the autopilot on to see it again",
            )
        finally:
            page.close()
    return 0


KINDS = {
    "tracing": (Tracing, _compare),
    "cutting": (Cutting, _compare),
    "margins": (Margins, _margins),
    "power": (Power, _power),
    "calibrate": (Calibrate, _calibrate),
    "replay": (Replay, _replay),
}

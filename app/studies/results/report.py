"""Reports results on the terminal, as CSV files, and as one self-contained HTML page."""

from __future__ import annotations

import csv
import dataclasses
import json
from collections.abc import Callable, Sequence
from html import escape as escaped
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.markup import escape

from app.console import Column, count, show_table
from app.studies.experiments.description import Trial
from app.studies.experiments.operators import Operator
from app.studies.experiments.protocol import Outcome
from app.studies.results import analysis, html
from app.studies.results.analysis import Line
from app.studies.results.published import Value

CAVEAT = (
    "A simulated operator, calibrated on the paper's plain teleoperation. Results with the fixture "
    "are predictions of the model: they show what the geometry of fixture, view and registration "
    "can explain, and are no evidence about surgeons."
)
_COLUMNS = (
    "quantity", "teleoperation", "with fixture", "difference [95 %]", "p", "effect [95 %]", "n",
    "paper: teleop.", "paper: fixture",
)  # fmt: skip


def lines(outcomes: Sequence[Outcome]) -> list[Line]:
    """The comparisons of an experiment."""
    tracing = outcomes[0].trial.experiment == "tracing"
    return analysis.tracing(outcomes) if tracing else analysis.cutting(outcomes)


def show(outcomes: Sequence[Outcome], console: Console) -> None:
    """Print the table with the paper's figures, and the results of the independent tests."""
    show_table(
        console,
        [Column(name, left=k == 0) for k, name in enumerate(_COLUMNS)],
        [[escape(cell) for cell in _cells(line)] for line in lines(outcomes)],
        title=_title(outcomes),
    )
    for verdict in _verdicts(outcomes):
        console.print(verdict)
    console.print(f"[dim]{CAVEAT}[/]")


def write(outcomes: Sequence[Outcome], out: Path) -> list[Path]:
    """Write trials.csv, stations.csv, trajectories.csv and report.html to a directory.

    The report is omitted if matplotlib is not installed.
    """
    return write_with(render, outcomes, out)


def write_with(
    rendered: Callable[[Sequence[Outcome]], str], outcomes: Sequence[Outcome], out: Path
) -> list[Path]:
    """`write` with another report."""
    out.mkdir(parents=True, exist_ok=True)
    written = [_trials(outcomes, out), _stations(outcomes, out), _trajectories(outcomes, out)]
    try:
        text = rendered(outcomes)
    except ImportError:
        return written
    path = out / "report.html"
    path.write_text(text, encoding="utf-8")
    return [*written, path]


def render(outcomes: Sequence[Outcome]) -> str:
    """The report: one page of HTML with the figures in it.

    Raises:
        ImportError: matplotlib is not installed.
    """
    from app.studies.results import figures

    tracing = outcomes[0].trial.experiment == "tracing"
    pictures = (
        [("Over the skull's cross-section (the paper's Fig. 10)", figures.section(outcomes)),
         ("Spectra of the tip's speed", figures.speeds(outcomes))]
        if tracing
        else [("From above (the paper's Fig. 11)", figures.top(outcomes, outcomes[0].trial.width)),
              ("At the stations (the paper's Fig. 12)", figures.boxes(outcomes)),
              ("Over the skull's cross-section", figures.section(outcomes))]
    )  # fmt: skip
    cells = [_cells(line) for line in lines(outcomes)]
    return page(_title(outcomes), _COLUMNS, cells, _verdicts(outcomes), pictures, outcomes[0].trial)


def page(
    title: str,
    columns: Sequence[str],
    cells: Sequence[Sequence[str]],
    verdicts: Sequence[str],
    pictures: Sequence[tuple[str, str]],
    trial: Trial,
) -> str:
    """A report as one page of HTML: a table, sentences, and figures with their titles as SVG."""
    parameters = [
        (f.name, f"{f.default:.4g} {f.metadata['unit']}", f.metadata["about"], f.metadata["source"])
        for f in dataclasses.fields(Operator)
    ]
    drawn = "".join(f"<h2>{escaped(name)}</h2>{svg}" for name, svg in pictures)
    first = json.dumps(dataclasses.asdict(trial))
    return html.document(
        title,
        html.said([CAVEAT], "c") + html.table(columns, cells) + html.said(verdicts) + drawn
        + "<h2>The operator</h2>"
        + html.table(("parameter", "value", "what", "source"), parameters, "p")
        + f"<p>First trial: <code>{escaped(first)}</code></p>",
    )  # fmt: skip


def _title(outcomes: Sequence[Outcome]) -> str:
    off, on = analysis.split(outcomes)
    trial = outcomes[0].trial
    what = "Path tracing" if trial.experiment == "tracing" else "Cutting"
    return f"{what} in silico: {len(off)} + {len(on)} trials, {trial.mesh}, seed {trial.seed}"


def _verdicts(outcomes: Sequence[Outcome]) -> list[str]:
    _off, on = analysis.split(outcomes)
    steps = sum(o.ticks for o in on)
    slowest = min(o.duration / o.driving for o in outcomes)
    found = [
        f"{count(analysis.violations(outcomes), 'violation')} of the registered surface and "
        f"corridor in {count(steps, 'assisted tick')}, tested independently of the fixtures.",
        f"Registration: FRE {1e3 * np.mean([o.fre for o in outcomes]):.2f} mm, "
        f"TRE along the cut {1e3 * np.mean([o.tre for o in outcomes]):.2f} mm on average. "
        f"Slowest trial: {slowest:.1f} times real time, by processor time on one core.",
    ]
    unfinished = [o.trial.key for o in outcomes if not o.finished]
    if unfinished:
        found.append(f"Given up before the end of the cut: {', '.join(unfinished)}.")
    return found


def _cells(line: Line) -> list[str]:
    measure, c = line.measure, line.comparison
    theirs = [_pair(measure.off), _pair(measure.assisted)] if measure else ["", ""]
    name = f"{line.name} [{line.unit}]" if line.unit else line.name
    if c is None:
        return [name, *["too few"] * 5, "", *theirs]
    return [
        name, _pair(Value(*c.off)), _pair(Value(*c.assisted)),
        f"{c.difference:+.2f} [{c.low:+.2f}, {c.high:+.2f}]", f"{c.p:.2g} ({c.test})",
        f"{c.effect:+.2f}"
        + ("" if np.isnan(c.effect_low) else f" [{c.effect_low:+.2f}, {c.effect_high:+.2f}]"),
        f"{c.sizes[0]} + {c.sizes[1]}", *theirs,
    ]  # fmt: skip


def _pair(value: Value) -> str:
    return f"{value.mean:.2f} ± {value.spread:.2f}"


def _trials(outcomes: Sequence[Outcome], out: Path) -> Path:
    path = out / "trials.csv"
    scalars = (
        "duration", "finished", "sal", "sparc", "fre", "tre", "removed", "injured", "deepest",
        "crossings", "outside", "ticks", "submovements", "corrections", "driving",
    )  # fmt: skip
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        described = [f.name for f in dataclasses.fields(outcomes[0].trial)]
        writer.writerow(["key", *described, *scalars, "mean_deviation", "mean_penetration"])
        for o in outcomes:
            writer.writerow(
                [o.trial.key, *dataclasses.astuple(o.trial), *(getattr(o, s) for s in scalars),
                 float(np.nanmean(np.abs(o.deviation))), float(np.nanmean(np.abs(o.penetration)))]
            )  # fmt: skip
    return path


def _stations(outcomes: Sequence[Outcome], out: Path) -> Path:
    path = out / "stations.csv"
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(["key", "station_m", "deviation_m", "penetration_m"])
        for o in outcomes:
            rows = zip(o.stations, o.deviation, o.penetration, strict=True)
            writer.writerows([o.trial.key, *map(float, row)] for row in rows)
    return path


def _trajectories(outcomes: Sequence[Outcome], out: Path) -> Path:
    path = out / "trajectories.csv"
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(["key", "station_m", "aside_m", "height_m", "time_s"])
        for o in outcomes:
            writer.writerows([o.trial.key, *(f"{x:.9g}" for x in row)] for row in o.trajectory)
    return path

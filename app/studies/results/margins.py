"""Compares cuts without and with the margin map of their registration: injuries, and the price.

The same trials in pairs: operator, registration and all random numbers are the same, and the guard
differs in the margins alone. What is injured is the *true* inner surface, of which the guard knows
where the registration puts it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.markup import escape
from scipy.stats import binomtest

from app.console import Column, count, show_table
from app.studies.experiments.protocol import Outcome
from app.studies.results import analysis, report
from app.studies.results.statistics import Comparison, paired

_COLUMNS = ("quantity, mean of the cuts", "without margins", "with margins", "difference [95 %]",
            "p")  # fmt: skip
_Row = tuple[str, list[float], list[float]]
_QUANTITIES: tuple[tuple[str, Callable[[Outcome], float]], ...] = (
    ("deepest point beyond the true inner surface [mm]", lambda o: 1e3 * o.deepest),
    ("injury: that depth, or 0 [mm]", lambda o: 1e3 * max(o.deepest, 0.0)),
    ("injured stations of 1 mm [%]", lambda o: 100.0 * injured_share([o])),
    ("bone left under the cut [mm]", lambda o: -analysis.penetrations([o], signed=True).mean()),
    ("|cutting-path deviation| [mm]", lambda o: analysis.deviations([o]).mean()),
    ("time of a cut [s]", lambda o: o.duration),
)


def injured_share(outcomes: Sequence[Outcome]) -> float:
    """Share of the stations whose cut goes beyond the true inner surface."""
    return float((analysis.penetrations(outcomes, signed=True) > 0.0).mean())


def split(outcomes: Sequence[Outcome]) -> tuple[list[Outcome], list[Outcome]]:
    """Outcomes without and with margins, each sorted by number of the trial.

    Raises:
        ValueError: not every trial is there in both ways.
    """
    ordered = sorted(outcomes, key=lambda o: o.trial.number)
    without = [o for o in ordered if not o.trial.margin]
    with_margins = [o for o in ordered if o.trial.margin]
    if [o.trial.number for o in without] != [o.trial.number for o in with_margins]:
        raise ValueError("margins are compared in pairs: every trial is needed without and with")
    return without, with_margins


def rows(outcomes: Sequence[Outcome]) -> list[_Row]:
    """Each quantity's name, and its values in all cuts without and with margins."""
    without, with_margins = split(outcomes)
    return [
        (name, [value(o) for o in without], [value(o) for o in with_margins])
        for name, value in _QUANTITIES
    ]


def compared(before: Sequence[float], after: Sequence[float]) -> Comparison | None:
    """The paired comparison; None where all pairs differ alike, or there are fewer than two."""
    if len(before) < 2 or np.ptp(np.subtract(after, before)) == 0.0:
        return None
    return paired(before, after)


def verdicts(outcomes: Sequence[Outcome]) -> list[str]:
    """What the comparison shows, in sentences."""
    without, with_margins = split(outcomes)
    hurt = [np.array([o.injured > 0 for o in side]) for side in (without, with_margins)]
    worse, better = int((hurt[1] & ~hurt[0]).sum()), int((hurt[0] & ~hurt[1]).sum())
    p = binomtest(better, worse + better).pvalue if worse + better else 1.0
    deepest = [1e3 * max(o.deepest for o in side) for side in (without, with_margins)]
    ticks = [sum(o.injured for o in side) for side in (without, with_margins)]
    trial = with_margins[0].trial
    said = [
        f"Cuts that injure the true inner surface: {hurt[0].sum()} of {len(without)} without "
        f"margins, {hurt[1].sum()} of {len(with_margins)} with (exact test of pairs that differ, "
        f"p = {p:.2g}). Ticks beyond it: {ticks[0]:,} and {ticks[1]:,}. Deepest point of all: "
        f"{deepest[0]:+.2f} and {deepest[1]:+.2f} mm (negative: bone is left).",
        f"Margins: {trial.margin:g} times the target registration error for a localisation error "
        f"of {1e3 * trial.noise:g} mm, which is {1e3 * np.mean([o.tre for o in without]):.2f} mm "
        "along the cut on average.",
        f"{count(analysis.violations(outcomes), 'violation')} of the registered surface and "
        f"corridor in {count(sum(o.ticks for o in outcomes), 'tick')}, tested independently of the "
        "fixtures.",
    ]
    unfinished = [o.trial.key for o in outcomes if not o.finished]
    if unfinished:
        said.append(f"Given up before the end of the cut: {', '.join(unfinished)}.")
    return said


def show(outcomes: Sequence[Outcome], console: Console) -> None:
    """Print the table and what it shows."""
    show_table(
        console,
        [Column(name, left=k == 0) for k, name in enumerate(_COLUMNS)],
        [[escape(cell) for cell in _cells(row)] for row in rows(outcomes)],
        title=_title(outcomes),
    )
    for line in verdicts(outcomes):
        console.print(line)
    console.print(f"[dim]{report.CAVEAT}[/]")


def write(outcomes: Sequence[Outcome], out: Path) -> list[Path]:
    """Write trials.csv, stations.csv, trajectories.csv and report.html, as `report.write`."""
    return report.write_with(render, outcomes, out)


def render(outcomes: Sequence[Outcome]) -> str:
    """The report: one page of HTML with the figures in it.

    Raises:
        ImportError: matplotlib is not installed.
    """
    from app.studies.results import figures

    without, with_margins = split(outcomes)
    pictures = [("Every cut without and with margins", figures.pairs(without, with_margins))]
    cells = [_cells(row) for row in rows(outcomes)]
    return report.page(
        _title(outcomes), _COLUMNS, cells, verdicts(outcomes), pictures, with_margins[0].trial
    )


def _title(outcomes: Sequence[Outcome]) -> str:
    trial = outcomes[0].trial
    return f"Margins in silico: {len(outcomes) // 2} pairs of cuts, {trial.mesh}, seed {trial.seed}"


def _cells(row: _Row) -> list[str]:
    name, before, after = row
    sides = [
        f"{np.mean(x):.2f} ± {np.std(x, ddof=min(len(x) - 1, 1)):.2f}" for x in (before, after)
    ]
    c = compared(before, after)
    if c is None:
        return [name, *sides, f"{np.mean(after) - np.mean(before):+.2f}", ""]
    return [
        name, *sides, f"{c.difference:+.2f} [{c.low:+.2f}, {c.high:+.2f}]", f"{c.p:.2g} ({c.test})",
    ]  # fmt: skip

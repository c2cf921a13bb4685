"""Compares outcomes with and without the fixture, as in the paper."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from app.studies.experiments.protocol import Outcome
from app.studies.results import published
from app.studies.results.published import Measure
from app.studies.results.statistics import Comparison, independent_values, paired, welch

FloatArray = NDArray[np.float64]

SPARC = "smoothness, SPARC"


@dataclass(frozen=True)
class Line:
    """One comparison of the two modes.

    Attributes:
        name, unit: of the quantity.
        comparison: in that unit; None if a side has fewer than two values.
        measure: the paper's values, if it reports them.
        note: description of the values.
    """

    name: str
    unit: str
    comparison: Comparison | None
    measure: Measure | None
    note: str


def split(outcomes: Sequence[Outcome]) -> tuple[list[Outcome], list[Outcome]]:
    """Outcomes without and with the fixture, each sorted by number of the trial."""
    ordered = sorted(outcomes, key=lambda o: o.trial.number)
    return (
        [o for o in ordered if not o.trial.assisted],
        [o for o in ordered if o.trial.assisted],
    )


def tracing(outcomes: Sequence[Outcome]) -> list[Line]:
    """Smoothness of the two modes, paired by trial."""
    off, on = split(outcomes)
    if [o.trial.number for o in off] != [o.trial.number for o in on]:
        raise ValueError("tracing is compared in pairs: every trial is needed in both modes")
    lines = []
    for name, measure, values in (
        (published.SAL.name, published.SAL, lambda o: o.sal),
        (SPARC, None, lambda o: o.sparc),
        ("time of a trace", None, lambda o: o.duration),
    ):
        a, b = [values(o) for o in off], [values(o) for o in on]
        compared = paired(a, b) if len(a) > 1 else None
        unit = "s" if name.startswith("time") else ""
        lines.append(Line(name, unit, compared, measure, f"{len(a)} pairs of trials"))
    return lines


def cutting(outcomes: Sequence[Outcome]) -> list[Line]:
    """Path deviation and penetration of the two modes over all stations, as in the paper."""
    off, on = split(outcomes)
    lines = []
    for measure, values in (
        (published.DEVIATION, deviations),
        (published.PENETRATION, penetrations),
    ):
        a, b = values(off), values(on)
        worth = sum(independent_values(values([o])) for o in (*off, *on))
        lines.append(
            Line(measure.name, measure.unit, welch(a, b) if len(a) > 1 and len(b) > 1 else None,
                 measure, f"stations of 1 mm, worth {worth:.0f} independent ones")
        )  # fmt: skip
    first, second = ([o.duration for o in side] for side in (off, on))
    compared = welch(first, second) if min(len(first), len(second)) > 1 else None
    lines.append(Line(published.DURATION.name, "s", compared, published.DURATION, "trials"))
    return lines


def deviations(outcomes: Sequence[Outcome]) -> FloatArray:
    """|cutting-path deviation| at all stations of all outcomes (n,) [mm]."""
    return _stations([np.abs(o.deviation) for o in outcomes])


def penetrations(outcomes: Sequence[Outcome], signed: bool = False) -> FloatArray:
    """|penetration depth| (or signed) at all stations of all outcomes (n,) [mm]."""
    return _stations([o.penetration if signed else np.abs(o.penetration) for o in outcomes])


def violations(outcomes: Sequence[Outcome]) -> int:
    """Number of steps through the registered surface and of ticks outside the corridor."""
    return sum(o.crossings + o.outside for o in outcomes)


def _stations(rows: Sequence[FloatArray]) -> FloatArray:
    values = np.concatenate(rows) if rows else np.empty(0)
    return np.asarray(values[np.isfinite(values)] * 1e3)  # [m] -> [mm]

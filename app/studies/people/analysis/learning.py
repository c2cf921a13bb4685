"""Whether participants go on learning during the trials: the trend of a measure over its trials.

Values have the mean of their condition subtracted, as each condition is done in a block of its own.
The slope of each participant over the number of the trial is tested against 0 over participants.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from app.studies.people.analysis.contrasts import EQUAL, holm
from app.studies.people.analysis.data import Data
from app.studies.people.analysis.quantities import MEASURES, Quantity
from app.studies.results.statistics import LEVEL, SIGNIFICANT

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Curve:
    """A measure over the trials of a task; values as in the data.

    Attributes:
        number: (k,) of the trial of this task, from 1, in the order of doing.
        mean, low, high: (k,) over participants with the conditions' means evened out, and the
            interval at `LEVEL`; NaN with fewer than two.
        participants: with three trials or more, whose slopes are tested.
        change: from the first trial to the last, mean of the slopes.
        change_low, change_high: its interval at `LEVEL`.
        p, corrected: of the t-test, and by Holm's correction over all curves; NaN: no test.
    """

    task: str
    quantity: Quantity
    number: FloatArray
    mean: FloatArray
    low: FloatArray
    high: FloatArray
    participants: int
    change: float = math.nan
    change_low: float = math.nan
    change_high: float = math.nan
    p: float = math.nan
    corrected: float = math.nan

    @property
    def significant(self) -> bool:
        return self.corrected < SIGNIFICANT


def curves(data: Data) -> list[Curve]:
    """Those of all tasks and measures, with corrected tests."""
    found = [curve(data, task, one) for task in data.tasks for one in MEASURES]
    corrected = holm([one.p for one in found])
    return [replace(one, corrected=float(p)) for one, p in zip(found, corrected, strict=True)]


def curve(data: Data, task: str, quantity: Quantity) -> Curve:
    """One of them, not corrected."""
    level = _levels(data.means(task, quantity.name))
    ways: list[tuple[FloatArray, FloatArray]] = []
    for person in data.people:
        done = [one for one in person.measured if one.task == task]
        values = np.array([one.measures.get(quantity.name, math.nan) for one in done])
        offs = np.array([level.get(one.condition, math.nan) for one in done])
        numbers = np.arange(1.0, len(done) + 1.0)
        kept = np.isfinite(values - offs) if len(done) else np.zeros(0, dtype=bool)
        if kept.any():
            ways.append((numbers[kept], (values - offs)[kept]))
    last = int(max((way[0].max() for way in ways), default=0))
    middle = float(np.mean(list(level.values()))) if level else 0.0
    rows = np.full((3, last), np.nan)
    for k in range(last):
        at = np.concatenate([y[n == k + 1] for n, y in ways])
        rows[:, k] = np.array(_interval(at)) + middle
    mean_of, low_of, high_of = rows
    found = Curve(task, quantity, np.arange(1.0, last + 1.0), mean_of, low_of, high_of, 0)
    slopes = np.array([np.polyfit(n, y, 1)[0] for n, y in ways if len(n) >= 3])
    found = replace(found, participants=len(slopes))
    size = max((float(np.abs(y + middle).max()) for _, y in ways), default=0.0)
    if len(slopes) < 2 or np.ptp(slopes) <= EQUAL * size:
        return found
    mean, low, high = (bound * (last - 1) for bound in _interval(slopes))
    p = float(stats.ttest_1samp(slopes, 0.0).pvalue)
    return replace(found, change=mean, change_low=low, change_high=high, p=p)


def _levels(means: Mapping[str, Mapping[str, float]]) -> dict[str, float]:
    """Mean of the participants' means, by condition."""
    values: dict[str, list[float]] = {}
    for one in means.values():
        for condition, value in one.items():
            values.setdefault(condition, []).append(value)
    return {condition: math.fsum(v) / len(v) for condition, v in values.items()}


def _interval(values: FloatArray) -> tuple[float, float, float]:
    """Mean of values (n,) and its interval at `LEVEL`; NaN with fewer than two."""
    if not len(values):
        return math.nan, math.nan, math.nan
    mean = float(values.mean())
    if len(values) < 2:
        return mean, math.nan, math.nan
    reach = float(stats.t.ppf(0.5 + 0.5 * LEVEL, len(values) - 1) * stats.sem(values))
    return mean, mean - reach, mean + reach

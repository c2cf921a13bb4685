"""Conditions compared in pairs, within participants.

The value of a participant under a condition is the mean over the repetitions. The two-sided paired
t-test, the effect size d_z and its interval are those of `app.studies.results.statistics`.
Wilcoxon's signed-rank test stands beside it, which does not assume normal differences. All tests of
a study are one family, whose error rate Holm's correction (1979) keeps.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import stats

from app.studies.people.analysis.data import Data
from app.studies.people.analysis.quantities import MEASURES, TLX, WORKLOAD, Quantity
from app.studies.results.statistics import SIGNIFICANT, Comparison, paired

EQUAL = 1e-9  # differences that vary by less than this, of the values, are all the same


@dataclass(frozen=True)
class Contrast:
    """Two conditions compared in one measure of one task; values as in the data, in SI units.

    Attributes:
        task: its name, or `WORKLOAD`.
        quantity: what is compared.
        first, second: names of the conditions; differences are second minus first.
        codes: participants with both.
        without: participants who have a value under one of them only.
        comparison: None: no test is possible.
        why: the reason.
        wilcoxon: p of the signed-rank test; NaN where there is none.
        corrected: p of the t-test by Holm's correction over all of the study; NaN: no test.
    """

    task: str
    quantity: Quantity
    first: str
    second: str
    codes: tuple[str, ...]
    without: tuple[str, ...]
    comparison: Comparison | None
    why: str = ""
    wilcoxon: float = math.nan
    corrected: float = math.nan

    @property
    def significant(self) -> bool:
        """Whether there is a difference, after correction."""
        return self.corrected < SIGNIFICANT


def compare(data: Data) -> list[Contrast]:
    """All pairs of conditions in all tasks, measures, and the workload."""
    subjects = [(task, one) for task in data.tasks for one in MEASURES] + [(WORKLOAD, TLX)]
    found = [
        contrast(task, one, first, second, data.means(task, one.name))
        for task, one in subjects
        for first, second in itertools.combinations(data.conditions, 2)
    ]
    ps = [math.nan if one.comparison is None else one.comparison.p for one in found]
    return [replace(one, corrected=float(p)) for one, p in zip(found, holm(ps), strict=True)]


def contrast(
    task: str, quantity: Quantity, first: str, second: str, means: Mapping[str, Mapping[str, float]]
) -> Contrast:
    """One comparison, not corrected; `means` by participant and condition."""
    both = [code for code, one in means.items() if first in one and second in one]
    single = [code for code, one in means.items() if (first in one) != (second in one)]
    a = np.array([means[code][first] for code in both])
    b = np.array([means[code][second] for code in both])
    blank = Contrast(task, quantity, first, second, tuple(both), tuple(single), None)
    if len(both) < 2:
        have = "nobody has" if not both else "one participant has"
        return replace(blank, why=f"{have} both conditions: a test needs two")
    spread, size = float(np.ptp(b - a)), float(np.abs(np.r_[a, b]).max())
    if spread <= EQUAL * size:
        shown = quantity.scale * float((b - a).mean())
        return replace(blank, why=f"all {len(both)} differences are {shown:.3g}: nothing to test")
    return replace(blank, comparison=paired(a, b), wilcoxon=signed_rank(b - a))


def signed_rank(differences: ArrayLike) -> float:
    """Two-sided p of Wilcoxon's signed-rank test of differences (n,); differences of 0 count half.

    Exact for up to 50 participants without ties, else by the normal approximation.
    """
    return float(stats.wilcoxon(np.asarray(differences), zero_method="zsplit").pvalue)


def holm(ps: Sequence[float] | NDArray[np.float64]) -> NDArray[np.float64]:
    """p-values (n,) by Holm's step-down correction; NaN are no tests and stay NaN."""
    found = np.array(ps, dtype=np.float64)
    tested = np.flatnonzero(np.isfinite(found))
    order = tested[np.argsort(found[tested], kind="stable")]
    steps = found[order] * np.arange(len(order), 0, -1)
    found[order] = np.minimum(np.maximum.accumulate(steps), 1.0)
    return found

"""Statistical comparison of two modes: tests by SciPy, effect sizes, confidence intervals."""

from __future__ import annotations

import warnings
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import stats

FloatArray = NDArray[np.float64]

LEVEL = 0.95  # of every confidence interval
SIGNIFICANT = 0.05
RESAMPLED = 5  # least number of values per side for a bootstrap


@dataclass(frozen=True)
class Comparison:
    """Comparison of two samples: without and with the fixture.

    Attributes:
        test: "paired t" or "Welch".
        off, assisted: mean and standard deviation of each.
        sizes: number of values of each.
        t, degrees, p: of the two-sided test.
        difference: assisted minus off.
        low, high: its confidence interval at `LEVEL`.
        effect: standardised difference: of the pairs (d_z), or by the pooled deviation with
            correction for small samples (Hedges' g).
        effect_low, effect_high: its bootstrap interval at `LEVEL` (percentiles); NaN for
            fewer than `RESAMPLED` values.
    """

    test: str
    off: tuple[float, float]
    assisted: tuple[float, float]
    sizes: tuple[int, int]
    t: float
    degrees: float
    p: float
    difference: float
    low: float
    high: float
    effect: float
    effect_low: float
    effect_high: float

    @property
    def significant(self) -> bool:
        return self.p < SIGNIFICANT


def paired(off: ArrayLike, assisted: ArrayLike) -> Comparison:
    """Paired t-test of values (n,) and (n,).

    Raises:
        ValueError: different numbers of values, or fewer than two pairs.
    """
    a, b = _clean(off), _clean(assisted)
    if len(a) != len(b):
        raise ValueError(f"pairs need as many values on either side, got {len(a)} and {len(b)}")
    result = stats.ttest_rel(b, a)
    interval = result.confidence_interval(LEVEL)
    gains = b - a
    low, high = _bootstrap((gains,), _standardised)
    return Comparison(
        "paired t", _summary(a), _summary(b), (len(a), len(b)),
        float(result.statistic), float(result.df), float(result.pvalue),
        float(gains.mean()), float(interval.low), float(interval.high),
        float(_standardised(gains)), low, high,
    )  # fmt: skip


def welch(off: ArrayLike, assisted: ArrayLike) -> Comparison:
    """Welch's t-test of independent values (n,) and (m,).

    Raises:
        ValueError: fewer than two values on a side.
    """
    a, b = _clean(off), _clean(assisted)
    with warnings.catch_warnings():
        # Durations are multiples of a submovement's: equal values on one side are valid if the
        # other side has a variance.
        if max(np.ptp(a), np.ptp(b)) > 0.0:
            warnings.filterwarnings("ignore", "Precision loss", RuntimeWarning)
        result = stats.ttest_ind(b, a, equal_var=False)
    interval = result.confidence_interval(LEVEL)
    low, high = _bootstrap((b, a), hedges)
    return Comparison(
        "Welch", _summary(a), _summary(b), (len(a), len(b)),
        float(result.statistic), float(result.df), float(result.pvalue),
        float(b.mean() - a.mean()), float(interval.low), float(interval.high),
        float(hedges(b, a)), low, high,
    )  # fmt: skip


def hedges(b: FloatArray, a: FloatArray, axis: int = -1) -> FloatArray:
    """Hedges' g of b over a: difference of means by the pooled deviation, bias corrected."""
    n, m = b.shape[axis], a.shape[axis]
    pooled = np.sqrt(
        ((n - 1) * b.var(axis=axis, ddof=1) + (m - 1) * a.var(axis=axis, ddof=1)) / (n + m - 2)
    )
    correction = 1.0 - 3.0 / (4.0 * (n + m) - 9.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(correction * (b.mean(axis=axis) - a.mean(axis=axis)) / pooled)


def independent_values(values: ArrayLike) -> float:
    """Effective sample size of a series (n,) along the cut, whose neighbours are correlated.

    n / (1 + 2 Σ ρ_k), ρ_k the autocorrelations up to the first that is not positive.
    """
    x = np.asarray(values, dtype=np.float64)
    x = x[np.isfinite(x)] - np.nanmean(x)
    n, power = len(x), float(x @ x)
    if n < 3 or power == 0.0:
        return float(n)
    total = 0.0
    for k in range(1, n - 1):
        rho = float(x[:-k] @ x[k:]) / power
        if rho <= 0.0:
            break
        total += rho
    return float(n / (1.0 + 2.0 * total))


def _standardised(gains: FloatArray, axis: int = -1) -> FloatArray:
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(gains.mean(axis=axis) / gains.std(axis=axis, ddof=1))


def _bootstrap(samples: tuple[FloatArray, ...], statistic: object) -> tuple[float, float]:
    if min(map(len, samples)) < RESAMPLED:
        return np.nan, np.nan
    # A resample may consist of equal values, whose deviation is 0.
    with np.errstate(invalid="ignore", divide="ignore"):
        result = stats.bootstrap(
            samples, statistic, confidence_level=LEVEL, n_resamples=2000, method="percentile",
            rng=np.random.default_rng(0), vectorized=True,
        )  # fmt: skip
    return float(result.confidence_interval.low), float(result.confidence_interval.high)


def _clean(values: ArrayLike) -> FloatArray:
    x = np.asarray(values, dtype=np.float64).ravel()
    x = x[np.isfinite(x)]
    if len(x) < 2:
        raise ValueError(f"a comparison needs two or more values a side, got {len(x)}")
    return x


def _summary(x: FloatArray) -> tuple[float, float]:
    return float(x.mean()), float(x.std(ddof=1))

"""Statistical comparison of two modes: tests by SciPy, effect sizes, confidence intervals."""

from __future__ import annotations

import warnings
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import optimize, special, stats

FloatArray = NDArray[np.float64]

LEVEL = 0.95  # of every confidence interval
SIGNIFICANT = 0.05
LARGE = 100.0  # a t beyond it has an approximate interval of its effect
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
        effect_low, effect_high: its interval at `LEVEL`: of the pairs by the noncentral t; else by
            a bootstrap (percentiles), NaN for fewer than `RESAMPLED` values.
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
    """Paired t-test of values (n,) and (n,). A pair with a value that is not finite is left out.

    Raises:
        ValueError: different numbers of values, or fewer than two pairs.
    """
    first, second = (np.asarray(x, dtype=np.float64).ravel() for x in (off, assisted))
    if len(first) != len(second):
        raise ValueError(
            f"pairs need as many values on either side, got {len(first)} and {len(second)}"
        )
    both = np.isfinite(first) & np.isfinite(second)
    a, b = _clean(first[both]), _clean(second[both])
    result = stats.ttest_rel(b, a)
    interval = result.confidence_interval(LEVEL)
    gains = b - a
    effect = float(_standardised(gains))
    return Comparison(
        "paired t", _summary(a), _summary(b), (len(a), len(b)),
        float(result.statistic), float(result.df), float(result.pvalue),
        float(gains.mean()), float(interval.low), float(interval.high),
        effect, *effect_interval(effect, len(a)),
    )  # fmt: skip


def effect_interval(effect: float, n: int) -> tuple[float, float]:
    """The interval at `LEVEL` of a standardised mean difference of n pairs.

    The noncentralities for which so large a t, or so small a one, is just not unlikely (Steiger and
    Fouladi 1997). NaN for an effect that is not finite.
    """
    t, df = effect * np.sqrt(n), n - 1
    if not np.isfinite(t) or df < 1:
        return np.nan, np.nan
    if abs(t) > LARGE:
        # The series take long; here the t varies by its denominator, and by 1 beside that.
        spread = np.sqrt(stats.chi2.ppf([0.5 - 0.5 * LEVEL, 0.5 + 0.5 * LEVEL], df) / df)
        ends = np.sort(t * spread)
        beside = stats.norm.ppf(0.5 + 0.5 * LEVEL)
        off = np.array([-1.0, 1.0]) * np.hypot(ends - t, beside)
        low, high = (t + off) / np.sqrt(n)
        return float(low), float(high)
    reach = 40.0 * np.sqrt(1.0 + t * t / (2.0 * df))

    def bound(share: float) -> float:
        def miss(noncentrality: float) -> float:
            # Beyond the range of its series the distribution function is 0 or 1.
            value = special.nctdtr(df, noncentrality, t)
            return (value if np.isfinite(value) else float(noncentrality < t)) - share

        return float(optimize.brentq(miss, t - reach, t + reach, xtol=1e-9)) / float(np.sqrt(n))

    return bound(0.5 * (1.0 + LEVEL)), bound(0.5 * (1.0 - LEVEL))


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

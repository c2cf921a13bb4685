"""How many participants the next study needs, by the noncentral t of the paired test."""

from __future__ import annotations

import math

import numpy as np
from scipy import optimize, special

from app.studies.results.statistics import SIGNIFICANT, Comparison

WANTED = 0.8  # power, as is usual
MOST = 10_000  # participants


def power(effect: float, n: int, level: float = SIGNIFICANT) -> float:
    """The probability that a two-sided paired t-test of n pairs finds an effect d_z."""
    df, shift = n - 1, abs(effect) * math.sqrt(n)
    limit = float(special.stdtrit(df, 1.0 - 0.5 * level))
    if shift > limit + 40.0:
        return 1.0
    # What is too small for its series is not a number.
    low, high = np.nan_to_num(special.nctdtr(df, shift, [-limit, limit]))
    return float(low + 1.0 - high)


def needed(effect: float, wanted: float = WANTED, level: float = SIGNIFICANT) -> int | None:
    """The least number of participants for this power; None: more than `MOST`, or no effect."""
    if not math.isfinite(effect) or power(effect, MOST, level) < wanted:
        return None
    low, high = 1, MOST  # too few, enough
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (low, middle) if power(effect, middle, level) >= wanted else (middle, high)
    return high


def detectable(n: int, wanted: float = WANTED, level: float = SIGNIFICANT) -> float:
    """The least effect d_z that n ≥ 2 participants find with this power; NaN: n is less."""
    if n < 2:
        return math.nan
    return float(optimize.brentq(lambda d: power(d, n, level) - wanted, 1e-6, 100.0, xtol=1e-6))


def cautious(comparison: Comparison) -> float:
    """The end of an effect's interval that is nearer to none; 0 where none is within it."""
    ends = np.array([comparison.effect_low, comparison.effect_high])
    if not np.isfinite(ends).all() or ends[0] * ends[1] <= 0.0:
        return 0.0
    return float(ends[np.abs(ends).argmin()])

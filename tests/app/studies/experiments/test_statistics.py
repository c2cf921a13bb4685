"""Tests and effect sizes against their textbook formulas."""

import warnings

import numpy as np
import pytest
from scipy import special

from app.studies.results.statistics import hedges, independent_values, paired, welch

RNG = np.random.default_rng(5)
A, B = RNG.normal(1.0, 0.4, 30), RNG.normal(0.7, 0.2, 24)


def two_sided(t: float, df: float) -> float:
    return float(special.betainc(df / 2, 0.5, df / (df + t * t)))


def test_welch_by_its_formula() -> None:
    c = welch(A, B)
    va, vb = A.var(ddof=1) / len(A), B.var(ddof=1) / len(B)
    df = (va + vb) ** 2 / (va**2 / (len(A) - 1) + vb**2 / (len(B) - 1))
    t = (B.mean() - A.mean()) / np.sqrt(va + vb)
    assert (c.t, c.degrees, c.p) == pytest.approx((t, df, two_sided(t, df)), rel=1e-9)
    assert c.low < c.difference < c.high < 0.0
    assert c.effect_low < c.effect < c.effect_high
    assert c.significant


def test_pairs_by_their_formula() -> None:
    a, b = A[:12], A[:12] - 0.1 + 0.05 * RNG.normal(size=12)
    c, d = paired(a, b), b - a
    t = d.mean() / (d.std(ddof=1) / np.sqrt(12))
    assert (c.t, c.degrees, c.p) == pytest.approx((t, 11, two_sided(t, 11)), rel=1e-9)
    assert c.effect == pytest.approx(d.mean() / d.std(ddof=1))
    assert welch(a, b).p > c.p  # the pairs are what makes it significant


def test_equal_values_on_one_side_are_nothing_to_warn_of() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        c = welch([221.1, 221.1], [120.45, 121.55])
    t = -100.1 / np.sqrt(np.var([120.45, 121.55], ddof=1) / 2)  # one degree of freedom is left
    assert (c.t, c.degrees, c.p) == pytest.approx((t, 1.0, two_sided(t, 1.0)), rel=1e-6)


def test_equal_samples_are_rarely_called_different() -> None:
    rng = np.random.default_rng(0)
    hits = sum(welch(rng.normal(size=9), rng.normal(size=14)).p < 0.05 for _ in range(400))
    assert 6 <= hits <= 36


def test_hedges_corrects_for_small_samples() -> None:
    b, a = np.array([1.0, 2.0, 3.0]), np.array([0.0, 1.0, 2.0])
    assert float(hedges(b, a)) == pytest.approx(1.0 - 3.0 / 15.0)


def test_neighbours_that_are_alike_are_worth_less() -> None:
    rng = np.random.default_rng(2)
    white = rng.normal(size=400)
    smooth = np.convolve(rng.normal(size=420), np.ones(10), "valid")[:400]
    assert independent_values(white) > 250
    assert 15 < independent_values(smooth) < 100


def test_too_few_values_are_refused_and_missing_ones_left_out() -> None:
    with pytest.raises(ValueError, match="two or more"):
        welch([1.0, np.nan], [1.0, 2.0])
    with pytest.raises(ValueError, match="pairs"):
        paired([1.0, 2.0, 3.0], [1.0, 2.0])
    assert welch([*A, np.nan], B).p == welch(A, B).p
    assert np.isnan(welch([1.0, 2.0], [2.0, 3.0]).effect_low)

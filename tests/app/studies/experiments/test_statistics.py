"""Tests and effect sizes against their textbook formulas."""

import warnings

import numpy as np
import pytest
from scipy import special

from app.studies.results.statistics import (
    effect_interval,
    hedges,
    independent_values,
    paired,
    welch,
)

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


def test_the_interval_of_an_effect_of_pairs_by_its_definition() -> None:
    """At either end so extreme a t has a probability of 2.5 %, as drawn."""
    rng = np.random.default_rng(4)
    for effect, n in ((0.85, 10), (0.0, 24), (-2.0, 6), (0.3, 60)):
        low, high = effect_interval(effect, n)
        assert low < effect < high
        t = effect * np.sqrt(n)
        for end, tail in ((low, np.greater), (high, np.less)):
            z, s = rng.normal(size=200_000), np.sqrt(rng.chisquare(n - 1, 200_000) / (n - 1))
            share = tail((z + end * np.sqrt(n)) / s, t).mean()
            assert share == pytest.approx(0.025, abs=2e-3)


@pytest.mark.parametrize("effect", [1e3, -1e6])
def test_the_interval_of_a_huge_effect_is_about_it(effect: float) -> None:
    low, high = effect_interval(effect, 12)
    assert low < effect < high
    # The pairs differ by nothing but their own deviation, which is known as a χ² is.
    ends = sorted(effect * np.sqrt(special.chdtri(11, [0.975, 0.025]) / 11))
    assert (low, high) == pytest.approx(ends, rel=1e-3)


def test_the_interval_goes_on_where_it_is_approximate() -> None:
    exact, approximate = (effect_interval(t / np.sqrt(20), 20) for t in (99.9, 100.1))
    assert exact == pytest.approx(approximate, rel=0.01)


def test_a_pair_with_a_missing_value_is_left_out_as_a_pair() -> None:
    a, b = A[:12].copy(), B[:12].copy()
    a[3], b[7] = np.nan, np.inf
    kept = [k for k in range(12) if k not in (3, 7)]
    assert paired(a, b) == paired(a[kept], b[kept])


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

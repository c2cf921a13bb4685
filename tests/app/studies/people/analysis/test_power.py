"""Power and sample size against statsmodels, simulation and printed tables."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import stats

from app.studies.people.analysis.power import cautious, detectable, needed, power
from app.studies.results.statistics import paired


@pytest.mark.parametrize(("effect", "n"), [(0.2, 199), (0.5, 34), (0.8, 15), (1.2, 8)])
def test_the_usual_sample_sizes(effect: float, n: int) -> None:
    """As G*Power 3.1 has them: means, two dependent groups, two-sided, 5 %, 80 %."""
    assert needed(effect) == n
    assert needed(-effect) == n


def test_power_by_statsmodels() -> None:
    theirs = pytest.importorskip("statsmodels.stats.power").TTestPower()
    for effect, n in ((0.3, 12), (-0.7, 9), (1.5, 5), (0.05, 400)):
        assert power(effect, n) == pytest.approx(theirs.power(abs(effect), n, 0.05), abs=1e-9)


def test_power_by_drawing() -> None:
    x = np.random.default_rng(5).normal(0.6, 1.0, (20_000, 14))
    assert power(0.6, 14) == pytest.approx((stats.ttest_1samp(x, 0.0, 1).pvalue < 0.05).mean(),
                                           abs=0.01)  # fmt: skip


def test_what_n_finds_needs_n() -> None:
    for n in (2, 3, 12, 24, 100):
        assert needed(detectable(n) * (1.0 + 1e-6)) == n
    assert math.isnan(detectable(1))


def test_no_effect_needs_more_than_there_are() -> None:
    assert needed(0.0) is None
    assert needed(0.001) is None
    assert needed(math.nan) is None
    assert needed(1e6) == 2


def test_the_cautious_effect_is_the_end_nearer_to_none() -> None:
    rng = np.random.default_rng(0)
    a = rng.normal(size=20)
    for shift in (1.0, -1.0):
        c = paired(a, a + shift + 0.5 * rng.normal(size=20))
        end = cautious(c)
        assert end in (c.effect_low, c.effect_high)
        assert 0.0 < end / c.effect < 1.0
    assert cautious(paired(a, a + rng.normal(size=20))) == 0.0

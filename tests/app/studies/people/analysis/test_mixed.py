"""Mixed models against the analysis of variance, and against REML computed here."""

from __future__ import annotations

import math
import warnings

import numpy as np
import pytest
from scipy import optimize, stats

from app.studies.people.analysis.mixed import Row, fit
from app.studies.people.analysis.quantities import MEASURES

pytest.importorskip("statsmodels")
TIME = next(one for one in MEASURES if one.name == "time")
CONDITIONS = ("a", "b", "c")


def rows(
    rng: np.random.Generator, people: int = 10, repetitions: int = 3, effect: float = 0.0
) -> list[Row]:
    """Complete data, each condition in each block equally often where people are a multiple of 3.

    Spreads: 3 of participants, 1 of participants under a condition, 0.5 of trials; `effect` is b's.
    """
    made = []
    for k in range(people):
        own = rng.normal(60.0, 3.0)
        for block in range(3):
            condition = CONDITIONS[(block + k) % 3]
            here = own + rng.normal(0.0, 1.0) + effect * (condition == "b")
            for repetition in range(repetitions):
                value = here + rng.normal(0.0, 0.5)
                made.append(Row(f"P{k:02d}", condition, block, repetition, value))
    return made


def flat(data: list[Row]) -> list[Row]:
    """The same without blocks and repetitions."""
    return [Row(r.participant, r.condition, 0, 0, r.value) for r in data]


def test_complete_data_give_the_analysis_of_variance() -> None:
    data = flat(rows(np.random.default_rng(3), 9, effect=1.5))
    found = fit("tracing", TIME, data, CONDITIONS)
    cell = np.array([
        [np.mean([r.value for r in data if (r.participant, r.condition) == (f"P{k:02d}", c)])
         for c in CONDITIONS] for k in range(9)
    ])  # fmt: skip
    means = cell.mean(axis=0)
    off = cell - cell.mean(axis=1, keepdims=True) - means + cell.mean()
    error = (off**2).sum() / 16.0
    f = 9.0 * means.var(ddof=1) / error
    assert found.problem == ""
    assert found.degrees == (2, 16)
    assert found.f == pytest.approx(f, rel=1e-4)
    assert found.p == pytest.approx(stats.f.sf(f, 2, 16), rel=1e-3)
    b, c = found.effects
    assert (b.name, c.name) == ("b", "c")
    assert b.estimate == pytest.approx(means[1] - means[0], rel=1e-6)
    reach = stats.t.ppf(0.975, 16) * math.sqrt(2.0 * error / 9.0)
    assert b.high - b.estimate == pytest.approx(reach, rel=1e-4)
    assert found.spreads[2] == pytest.approx(_within(data), rel=1e-3)


def _within(data: list[Row]) -> float:
    cells = {(r.participant, r.condition) for r in data}
    groups = [[r.value for r in data if (r.participant, r.condition) == one] for one in cells]
    squares = sum(np.var(g) * len(g) for g in groups)
    return math.sqrt(squares / (len(data) - len(cells)))


def test_unbalanced_data_give_the_reml_that_is_computed_here() -> None:
    """Effects, errors and spreads, from the likelihood of the whole covariance."""
    rng = np.random.default_rng(8)
    data = [r for r in rows(rng, 7, effect=-2.0) if rng.random() > 0.25]
    data.append(Row("P00", "a", 0, 1, math.nan))
    found = fit("tracing", TIME, data, CONDITIONS)
    data.pop()
    y = np.array([r.value for r in data])
    x = np.stack([
        np.ones(len(data)), *(np.array([r.condition == c for r in data], float) for c in "bc"),
        *(np.array([getattr(r, n) for r in data], float) for n in ("block", "repetition")),
    ], axis=1)  # fmt: skip
    same = np.array([[r.participant == s.participant for r in data] for s in data], float)
    cell = same * np.array([[r.condition == s.condition for r in data] for s in data])

    def fitted(log_spreads: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
        own, here, trial = np.exp(2.0 * log_spreads)
        v = np.linalg.inv(own * same + here * cell + trial * np.eye(len(y)))
        information = x.T @ v @ x
        beta = np.linalg.solve(information, x.T @ v @ y)
        e = y - x @ beta
        loss = -np.linalg.slogdet(v)[1] + np.linalg.slogdet(information)[1] + e @ v @ e
        return float(loss), beta, np.sqrt(np.diag(np.linalg.inv(information)))

    best = optimize.minimize(
        lambda s: fitted(s)[0], np.log([2.0, 1.0, 0.7]), method="Nelder-Mead",
        options={"xatol": 1e-6, "fatol": 1e-9},
    )  # fmt: skip
    _loss, beta, errors = fitted(best.x)
    assert found.trials == len(data)
    assert found.spreads == pytest.approx(np.exp(best.x), rel=5e-3)
    assert [e.name for e in found.effects] == ["b", "c", "block", "repetition"]
    assert [e.estimate for e in found.effects] == pytest.approx(beta[1:], abs=2e-3)
    reach = stats.t.ppf(0.975, 12)
    assert [(e.high - e.low) / 2 for e in found.effects] == pytest.approx(reach * errors[1:],
                                                                          rel=5e-3)  # fmt: skip


@pytest.mark.slow
def test_without_an_effect_one_in_twenty_is_called_one() -> None:
    rng = np.random.default_rng(12)
    ps = [fit("tracing", TIME, rows(rng, 9, 2), CONDITIONS).p for _ in range(200)]
    assert 2 <= sum(p < 0.05 for p in ps) <= 19
    assert stats.kstest(ps, "uniform").pvalue > 0.01


@pytest.mark.parametrize(
    ("data", "why"),
    [
        ([], "two participants"),
        ([Row("P0", c, 0, k, float(k)) for c in "ab" for k in range(4)], "two participants"),
        ([Row(f"P{k}", "a", 0, 0, float(k)) for k in range(9)], "two conditions"),
        ([Row(f"P{k}", c, 0, 0, 7.0) for k in range(9) for c in "ab"], "equal"),
        ([Row(f"P{k}", c, 0, 0, math.nan) for k in range(9) for c in "ab"], "two participants"),
        ([Row("P0", "a", 0, 0, 1.0), Row("P1", "b", 0, 0, 2.0)], "too few"),
    ],
)
def test_where_no_model_fits_it_says_why(data: list[Row], why: str) -> None:
    found = fit("tracing", TIME, data, CONDITIONS)
    assert found.effects == ()
    assert why in found.problem


def test_values_without_a_spread_of_participants_are_fitted_with_a_word() -> None:
    rng = np.random.default_rng(4)
    data = [Row(f"P{k}", c, 0, j, rng.normal()) for k in range(6) for c in "ab" for j in range(3)]
    shifts = {p: np.mean([r.value for r in data if r.participant == p]) for p in
              {r.participant for r in data}}  # fmt: skip
    data = [Row(r.participant, r.condition, 0, r.repetition, r.value - shifts[r.participant])
            for r in data]  # fmt: skip
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = fit("tracing", TIME, data, CONDITIONS)
    assert found.effects or found.problem
    assert found.spreads[0] == pytest.approx(0.0, abs=0.05) or found.problem

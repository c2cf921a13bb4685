"""Learning curves against slopes that were put in, and by the textbook."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy import special, stats

from app.studies.people.analysis.data import Data, Done, Person, read
from app.studies.people.analysis.learning import curve, curves
from app.studies.people.analysis.quantities import MEASURES
from tests.support import user_studies

TIME = next(one for one in MEASURES if one.name == "time")


def test_a_trend_that_was_put_in_is_found_and_no_other(tmp_path: Path) -> None:
    effects = {("on", "time"): -15.0, ("on", "sal"): 2.0}  # must not pass for learning
    folder = user_studies.make(
        tmp_path, 16, effects=effects, learning={"time": -3.0, "path_deviation": -5e-5}, seed=4
    )
    found = {one.quantity.name: one for one in curves(read(folder))}
    for name, slope in (("time", -3.0), ("path_deviation", -5e-5)):
        one = found[name]
        assert one.change_low < 5 * slope < one.change_high  # six trials
        assert one.significant
        assert one.mean[0] > one.mean[-1]
    assert {name for name, one in found.items() if one.significant} == {"time", "path_deviation"}


def test_the_test_is_of_the_slopes_of_participants() -> None:
    """One condition, so that nothing is evened out but the common mean."""
    rng = np.random.default_rng(1)
    values = rng.normal(50.0, 4.0, (6, 5)) - 1.5 * np.arange(5)
    x = np.arange(5.0) - 2.0
    slopes = values @ x / (x @ x)
    t = slopes.mean() / (slopes.std(ddof=1) / np.sqrt(6))
    found = curve(_data(values), "tracing", TIME)
    assert found.participants == 6
    assert found.change == pytest.approx(4.0 * slopes.mean())
    assert found.p == pytest.approx(special.betainc(2.5, 0.5, 5.0 / (5.0 + t * t)))
    assert found.mean == pytest.approx(values.mean(axis=0))
    reach = stats.t.ppf(0.975, 5) * values.std(axis=0, ddof=1) / np.sqrt(6)
    assert found.high - found.mean == pytest.approx(reach)


@pytest.mark.parametrize(
    "values",
    [np.full((4, 5), 7.0), np.array([[1.0, 2.0, 4.0]]), np.full((3, 4), np.nan), np.empty((3, 0)),
     np.tile([5.0, 4.0, 3.0, 2.0], (4, 1))],
    ids=["equal", "one participant", "NaN", "no trials", "equal slopes"],
)  # fmt: skip
def test_without_a_test_there_is_no_finding(values: np.ndarray) -> None:
    found = curve(_data(values), "tracing", TIME)
    assert np.isnan(found.p)
    assert not found.significant


def test_missing_trials_leave_the_others_in_their_places() -> None:
    values = np.tile(100.0 - 10.0 * np.arange(6), (5, 1)) + np.arange(5.0)[:, None] * 0.1
    values[0, 2:4] = np.nan
    values[1] += np.array([0.0, 0.1, 0.0, -0.1, 0.0, 0.0])
    found = curve(_data(values), "tracing", TIME)
    assert found.change == pytest.approx(-50.0, abs=0.2)
    assert len(found.number) == 6


def _data(values: np.ndarray) -> Data:
    people = []
    for k, row in enumerate(values):
        trials = tuple(
            Done(j, 0, j, "tracing", "a", False, True, "", 1.0, 0, {"time": float(x)})
            for j, x in enumerate(row)
        )
        people.append(Person(f"P{k}", k, ("a",), "thanks", False, "", {}, trials, {}))
    return Data("", "", ("a",), ("tracing",), values.shape[1], tuple(people))

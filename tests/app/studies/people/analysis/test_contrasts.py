"""Comparisons of conditions against closed forms, another library, and studies of known effects."""

from __future__ import annotations

import itertools
import json
import math
from pathlib import Path

import numpy as np
import pytest
from scipy import special

from app.studies.people.analysis.contrasts import Contrast, compare, contrast, holm, signed_rank
from app.studies.people.analysis.data import Data, Done, Person, read
from app.studies.people.analysis.quantities import MEASURES, TLX, WORKLOAD
from tests.support import user_studies
from tests.support.user_studies import SCALES, USUAL

TIME = next(one for one in MEASURES if one.name == "time")


def one_of(found: list[Contrast], name: str, first: str = "off", second: str = "on") -> Contrast:
    (got,) = [c for c in found if (c.quantity.name, c.first, c.second) == (name, first, second)]
    return got


def test_what_was_put_in_is_found_with_its_sign_and_size(tmp_path: Path) -> None:
    effects = {
        ("on", "path_deviation"): -2e-4, ("on", "sparc"): 1.5, ("on", "time"): -12.0,
        ("on", "tlx"): -15.0,
    }  # fmt: skip
    found = compare(read(user_studies.make(tmp_path, 24, effects=effects, seed=4)))
    for (_on, name), size in effects.items():
        c = one_of(found, name).comparison
        assert c is not None
        assert c.low < size < c.high
        assert np.sign(c.difference) == np.sign(size)
    assert {c.quantity.name for c in found if c.significant} == {name for _, name in effects}


def test_a_comparison_is_the_paired_test_of_the_means_of_the_files(tmp_path: Path) -> None:
    """From the numbers of the files by the textbook, with none of the code that reads them."""
    folder = user_studies.make(tmp_path, 7, effects={("on", "time"): -5.0}, seed=3)
    differences = []
    for path in sorted((folder / "participants").iterdir()):
        trials = [json.loads(p.read_text()) for p in (path / "trials").glob("*.json")]
        mean = {
            c: np.mean([t["measures"]["time"] for t in trials
                        if t["condition"] == c and not t["training"]])
            for c in ("off", "on")
        }  # fmt: skip
        differences.append(mean["on"] - mean["off"])
    d = np.array(differences)
    t = d.mean() / (d.std(ddof=1) / math.sqrt(7))
    c = one_of(compare(read(folder)), "time").comparison
    assert c is not None
    assert (c.difference, c.t) == pytest.approx((d.mean(), t), rel=1e-9)
    assert c.p == pytest.approx(special.betainc(3.0, 0.5, 6.0 / (6.0 + t * t)), rel=1e-9)
    assert c.effect == pytest.approx(d.mean() / d.std(ddof=1), rel=1e-9)


def test_the_workload_is_the_mean_of_the_six_ratings(tmp_path: Path) -> None:
    folder = user_studies.make(tmp_path, 5, seed=6)
    by_hand = {}
    for path in (folder / "participants").iterdir():
        rated = json.loads((path / "tlx.json").read_text()).values()
        by_hand[path.name] = {
            one["condition"]: np.mean([one[name] for name in SCALES]) for one in rated
        }
    found = read(folder).means(WORKLOAD, TLX.name)
    assert found == {code: pytest.approx(one) for code, one in by_hand.items()}


@pytest.mark.slow
def test_without_an_effect_few_studies_find_one() -> None:
    """300 studies without effects: at most 5 % of them have a finding after correction."""
    rng = np.random.default_rng(17)
    wrong = bare = 0
    for _ in range(300):
        found = compare(_null(rng))
        assert sum(c.comparison is not None for c in found) == 3 * (7 + 1)
        wrong += any(c.significant for c in found)
        bare += any(c.comparison is not None and c.comparison.p < 0.05 for c in found)
    assert wrong <= 24  # 15 are expected at most; more than 24 have a probability of 1 % then
    assert bare > 120  # without the correction most studies had one


def _null(rng: np.random.Generator, people: int = 10) -> Data:
    """Three conditions, two trials each; measures independent, with spreads on all levels."""
    names, conditions = list(USUAL), ("a", "b", "c")
    made = []
    for k in range(people):
        own = rng.normal(size=len(names))
        trials, tlx = [], {}
        for block, condition in enumerate(conditions):
            here = own + 0.7 * rng.normal(size=len(names))
            for repetition in range(2):
                values = here + 0.5 * rng.normal(size=len(names))
                measures = dict(zip(names, map(float, values), strict=True))
                trials.append(
                    Done(2 * block + repetition, block, repetition, "tracing", condition, False,
                         True, "", 1.0, 0, measures)
                )  # fmt: skip
            rating = rng.normal(50, 10)
            tlx[block] = (condition, dict.fromkeys(SCALES, float(rating)))
        made.append(Person(f"P{k}", k, conditions, "thanks", False, "", {}, tuple(trials), tlx))
    return Data("", "", conditions, ("tracing",), 2, tuple(made))


def test_holm_by_hand_and_by_statsmodels() -> None:
    multitest = pytest.importorskip("statsmodels.stats.multitest")
    ps = [0.01, 0.04, 0.03, 0.005]
    assert holm(ps) == pytest.approx([0.03, 0.06, 0.06, 0.02])
    rng = np.random.default_rng(2)
    for n in (1, 2, 9, 40):
        p = rng.random(n) ** 3
        assert holm(p) == pytest.approx(multitest.multipletests(p, method="holm")[1], abs=1e-15)
    some = holm([0.02, math.nan, 0.03])
    assert np.isnan(some[1])
    assert some[[0, 2]] == pytest.approx([0.04, 0.04])  # what is no test is not of the family
    assert len(holm([])) == 0


def test_signed_ranks_by_all_signs() -> None:
    """Every way to give the differences signs is as likely as any other."""
    d = np.array([1.3, -0.4, 2.2, 0.9, 3.1, -0.2, 1.8])
    ranks = np.argsort(np.argsort(np.abs(d))) + 1.0
    middle = ranks.sum() / 2.0
    seen = abs(ranks[d > 0].sum() - middle)
    sums = [abs(np.dot(signs, ranks) - middle) for signs in itertools.product((0, 1), repeat=7)]
    assert signed_rank(d) == pytest.approx(np.mean(np.array(sums) >= seen - 1e-9))


@pytest.mark.parametrize(
    ("means", "why"),
    [
        ({}, "nobody"),
        ({"P0": {"off": 1.0, "on": 2.0}}, "one participant"),
        ({"P0": {"off": 1.0}, "P1": {"on": 2.0}}, "nobody"),
        ({f"P{k}": {"off": 1.0, "on": 1.0} for k in range(5)}, "all 5 differences are 0"),
        ({f"P{k}": {"off": float(k), "on": k + 2.0} for k in range(5)}, "all 5 differences are 2"),
        ({f"P{k}": {"off": 0.1 * k, "on": 0.1 * k + 0.3} for k in range(5)}, "are 0.3"),
    ],
)
def test_where_no_test_is_possible_it_says_why(means: dict, why: str) -> None:
    found = contrast("tracing", TIME, "off", "on", means)
    assert found.comparison is None
    assert why in found.why
    assert not found.significant


def test_who_has_one_condition_only_is_named_and_not_paired() -> None:
    means = {f"P{k}": {"off": float(k**2), "on": float(k)} for k in range(4)}
    found = contrast("tracing", TIME, "off", "on", means | {"X": {"on": 100.0}})
    assert (found.codes, found.without) == (("P0", "P1", "P2", "P3"), ("X",))
    assert found.comparison == contrast("tracing", TIME, "off", "on", means).comparison

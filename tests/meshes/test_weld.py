"""Joining near vertices and finding repeated faces, against scipy's k-d tree and plain Python."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from meshes.checks.weld import first_of_kind, weld


@given(seed=st.integers(0, 10_000), tolerance=st.sampled_from([0.0, 1e-9, 1e-3, 0.05, 0.4, 3.0]))
@settings(max_examples=60, deadline=None)
def test_greedy_joining_as_a_plain_loop_does_it(seed: int, tolerance: float) -> None:
    rng = np.random.default_rng(seed)
    points = np.round(rng.normal(size=(60, 3)), rng.integers(1, 4))
    points[rng.integers(60, size=20)] = points[rng.integers(60, size=20)]
    stands_for, distance = weld(points, tolerance)
    chosen: list[int] = []
    for v, p in enumerate(points):
        apart = [float(np.linalg.norm(points[w] - p)) for w in chosen]
        if apart and min(apart) <= tolerance:
            assert distance[v] == pytest.approx(min(apart), abs=1e-15)
            assert distance[v] == pytest.approx(np.linalg.norm(points[stands_for[v]] - p))
            assert stands_for[v] in chosen
        else:
            assert stands_for[v] == v
            chosen.append(v)
    assert len(cKDTree(points[chosen]).query_pairs(tolerance)) == 0


def test_a_chain_of_near_points_moves_no_point_farther_than_the_tolerance() -> None:
    chain = np.column_stack([np.arange(100) * 0.9, np.zeros(100), np.zeros(100)])
    stands_for, distance = weld(chain, 1.0)
    assert distance.max() <= 1.0
    assert len(np.unique(stands_for)) == 50


def test_minus_zero_is_zero_and_a_crowd_at_one_place_is_one() -> None:
    stands_for, _ = weld(np.array([[0.0, 1.0, -0.0], [-0.0, 1.0, 0.0], [0.0, 1.0, 1e-9]]), 0.0)
    assert stands_for.tolist() == [0, 0, 2]
    assert set(weld(np.ones((200_000, 3)), 1e-6)[0].tolist()) == {0}


@pytest.mark.parametrize("tolerance", [-1.0, np.nan, np.inf])
def test_impossible_tolerances_are_named(tolerance: float) -> None:
    with pytest.raises(ValueError, match=str(tolerance)):
        weld(np.zeros((1, 3)), tolerance)


def test_first_of_kind_as_a_dictionary_finds_it() -> None:
    rng = np.random.default_rng(4)
    faces = rng.integers(0, 12, size=(2000, 3))
    seen: dict[tuple[int, ...], int] = {}
    wanted = [seen.setdefault(tuple(sorted(f)), row) for row, f in enumerate(faces.tolist())]
    assert first_of_kind(faces).tolist() == wanted

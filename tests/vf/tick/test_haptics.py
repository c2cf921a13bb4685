"""F = K (p_tool − p_proxy), capped."""

from __future__ import annotations

import numpy as np
import pytest

import vf


def test_the_force_pulls_the_proxy_towards_the_tool():
    # 2 mm along z at 150 N/m.
    F = vf.force(np.array([0.0, 0.0, 0.010]), np.array([0.0, 0.0, 0.008]), 150.0, 4.0)
    assert np.allclose(F, [0.0, 0.0, 0.3])


def test_beyond_the_cap_only_the_direction_is_kept():
    tool, proxy = np.array([0.03, 0.0, 0.0]), np.array([0.0, 0.04, 0.0])
    F = vf.force(tool, proxy, 1000.0, 4.0)  # 50 N without the cap
    assert np.allclose(F, [2.4, -3.2, 0.0])


def test_the_cap_is_reached_continuously():
    proxy = np.zeros(3)
    just = vf.force(np.array([4.0 / 150.0, 0.0, 0.0]), proxy, 150.0, 4.0)
    over = vf.force(np.array([4.0 / 150.0 + 1e-12, 0.0, 0.0]), proxy, 150.0, 4.0)
    assert just == pytest.approx(over, abs=1e-9)


def test_no_difference_no_force():
    assert not vf.force(np.ones(3), np.ones(3), 150.0, 4.0).any()


def test_a_cap_of_zero_means_no_force():
    assert not vf.force(np.ones(3), np.zeros(3), 150.0, 0.0).any()

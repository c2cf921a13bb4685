"""The container of half-spaces."""

from __future__ import annotations

import numpy as np

import vf


def test_none_allows_the_whole_ball():
    planes = vf.Planes.none(3e-3)
    assert len(planes) == 0
    assert planes.radius == 3e-3
    assert planes.normals.shape == (0, 3)
    assert planes.slack(np.ones(3)).shape == (0,)


def test_slack_is_the_signed_distance_to_each_plane():
    planes = vf.Planes(
        normals=np.array([[0.0, 0.0, 1.0], [0.6, 0.8, 0.0]]),
        offsets=np.array([2.0, -1.0]),
        points=np.zeros((2, 3)),
        triangles=np.array([4, 7]),
        rules=np.array([vf.Rule.FACE, vf.Rule.RIDGE]),
        radius=1.0,
    )
    assert len(planes) == 2
    # By hand: 5 − 2 above the first; 0.6·1 + 0.8·(−3) + 1 below the second.
    assert np.allclose(planes.slack(np.array([1.0, -3.0, 5.0])), [3.0, -0.8])


def test_the_rules_are_the_papers_conditions():
    assert (vf.Rule.FACE, vf.Rule.RIDGE, vf.Rule.VALLEY) == (1, 2, 3)

"""Margins against registrations with random errors, and against symmetric cases by hand."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import meshes

RNG = np.random.default_rng(7)
SETS = {
    "three": np.array([[0, 0, 0], [0.08, 0, 0], [0.02, 0.05, 0.01]]),
    "four in a plane": np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) * 0.04 + 0.1,
    "six": RNG.normal(size=(6, 3)) * [0.06, 0.03, 0.01],
    "nearly a line": np.array(
        [[0, 0, 0], [0.1, 0.004, 0], [0.05, -0.004, 0.002], [0.02, 0, 0.003]]
    ),
}
TARGETS = np.array([[0, 0, 0], [0.05, 0.01, -0.02], [-0.1, 0.08, 0.03], [0.0, 0.0, 0.15]])


def simulated(fiducials: np.ndarray, fle: float, trials: int = 6000) -> np.ndarray:
    """R.m.s. error [m] at TARGETS of rigid fits (Kabsch) to fiducials with random errors."""
    rng = np.random.default_rng(11)
    sigma = fle / np.sqrt(3.0)  # of each coordinate
    total = np.zeros(len(TARGETS))
    centre = fiducials.mean(axis=0)
    for _ in range(trials):
        seen = fiducials + rng.normal(scale=sigma, size=fiducials.shape)
        turn = Rotation.align_vectors(seen - seen.mean(axis=0), fiducials - centre)[0]
        there = turn.apply(TARGETS - centre) + seen.mean(axis=0)
        total += ((there - TARGETS) ** 2).sum(axis=1)
    return np.sqrt(total / trials)


@pytest.mark.filterwarnings("ignore:Optimal rotation")
@pytest.mark.parametrize("name", list(SETS))
def test_the_margin_is_the_error_of_simulated_registrations(name: str) -> None:
    fle = 5e-4 if name != "nearly a line" else 5e-5  # first order: small against the set
    expected = simulated(SETS[name], fle)
    np.testing.assert_allclose(
        meshes.margins(TARGETS, SETS[name], fle, factor=1.0), expected, rtol=0.04
    )
    np.testing.assert_allclose(meshes.margins(TARGETS, SETS[name], fle), 2 * expected, rtol=0.04)


def test_at_the_centroid_it_is_the_mean_s_error_and_it_grows_with_the_distance() -> None:
    corners = SETS["four in a plane"]
    points = corners.mean(axis=0) + np.linspace(0, 0.2, 9)[:, None] * [0.0, 0.0, 1.0]
    found = meshes.margins(points, corners, 1e-3, factor=1.0)
    assert found[0] == pytest.approx(1e-3 / 2)
    assert (np.diff(found) > 0).all()
    # By hand: square of half side 40 mm; f² = 0.04² from the axes in its plane, 2·0.04² from z.
    z = 0.2
    assert found[-1] == pytest.approx(1e-3 / 2 * np.sqrt(1 + (2 * z**2 / 0.04**2) / 3))


def test_it_does_not_depend_on_the_frame() -> None:
    turn, shift = Rotation.from_euler("xyz", [10, 50, -70], degrees=True), np.array([0.3, -1, 2])
    there = meshes.margins(turn.apply(TARGETS) + shift, turn.apply(SETS["six"]) + shift, 1e-3)
    np.testing.assert_allclose(there, meshes.margins(TARGETS, SETS["six"], 1e-3), rtol=1e-9)


LINE = np.outer(np.arange(5), [0.01, 0.02, -0.01])


@pytest.mark.parametrize(
    ("fiducials", "fle", "factor", "why"),
    [
        (SETS["six"][:2], 1e-3, 2.0, "three fiducials or more, not 2"),
        (LINE, 1e-3, 2.0, "5 fiducials lie on one line"),
        (np.zeros((4, 3)), 1e-3, 2.0, "lie on one line"),
        (SETS["six"], 0.0, 2.0, "a length above 0, not 0.0"),
        (SETS["six"], np.nan, 2.0, "not nan"),
        (SETS["six"], 1e-3, -1.0, "factor must be above 0, not -1.0"),
        (SETS["six"][:, :2], 1e-3, 2.0, r"fiducials must be of shape \(n, 3\), not \(6, 2\)"),
        (SETS["six"] * np.inf, 1e-3, 2.0, "fiducials must be finite"),
    ],
)  # fmt: skip
def test_what_determines_no_registration_is_refused(
    fiducials: np.ndarray, fle: float, factor: float, why: str
) -> None:
    with pytest.raises(meshes.MeshError, match=why):
        meshes.margins(TARGETS, fiducials, fle, factor)

"""The rigid fit against Horn's quaternions, and its errors against Fitzpatrick's formulas."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from app.studies.experiments.registration import fit, measure, target_error


def horn(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """The least squares rotation as the largest eigenvector of Horn's matrix (1987)."""
    s = (a - a.mean(axis=0)).T @ (b - b.mean(axis=0))
    n = np.empty((4, 4))
    n[0, 0] = np.trace(s)
    n[0, 1:] = n[1:, 0] = s[1, 2] - s[2, 1], s[2, 0] - s[0, 2], s[0, 1] - s[1, 0]
    n[1:, 1:] = s + s.T - np.trace(s) * np.eye(3)
    w, x, y, z = np.linalg.eigh(n)[1][:, -1]
    return np.array(
        [
            [w * w + x * x - y * y - z * z, 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), w * w - x * x + y * y - z * z, 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z],
        ]
    )


def some_pose(rng: np.random.Generator) -> np.ndarray:
    T = np.eye(4)
    T[:3, :3] = Rotation.random(random_state=int(rng.integers(2**31))).as_matrix()
    T[:3, 3] = rng.normal(scale=0.1, size=3)
    return T


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("noise", [0.0, 3e-4])
def test_the_fit_is_horns(seed: int, noise: float) -> None:
    rng = np.random.default_rng(seed)
    model, T = rng.normal(scale=0.04, size=(6, 3)), some_pose(rng)
    seen = measure(model @ T[:3, :3].T + T[:3, 3], noise, rng)
    found = fit(model, seen)
    R = horn(model, seen)
    np.testing.assert_allclose(found.T[:3, :3], R, atol=1e-12)
    np.testing.assert_allclose(
        found.T[:3, 3], seen.mean(axis=0) - R @ model.mean(axis=0), atol=1e-12
    )
    if noise == 0.0:
        np.testing.assert_allclose(found.T, T, atol=1e-12)
        assert found.fre < 1e-12
        assert target_error(found, T, rng.normal(scale=0.05, size=(9, 3))) < 1e-12


def test_a_flat_mirror_image_is_turned_and_not_mirrored() -> None:
    model = np.array([[0, 0, 0], [3, 0, 0], [0, 2, 0], [1, 1, 1]], dtype=float)
    found = fit(model, model * [1, 1, -1])
    assert np.linalg.det(found.T[:3, :3]) == pytest.approx(1.0, abs=1e-12)


def test_errors_on_noisy_data_are_those_expected() -> None:
    """FRE² = (1 − 2/N) FLE²; TRE² = FLE²/N (1 + ⅓ Σ d²/f²) (Fitzpatrick, West, Maurer 1998)."""
    rng = np.random.default_rng(7)
    model, T, fle = rng.normal(scale=0.04, size=(6, 3)), some_pose(rng), 4e-4
    target = np.array([[0.01, 0.03, 0.05]])
    true = model @ T[:3, :3].T + T[:3, 3]
    fre2, tre2 = [], []
    for _ in range(3000):
        found = fit(model, measure(true, fle, rng))
        fre2.append(found.fre**2)
        tre2.append(target_error(found, T, target) ** 2)
    centred = model - model.mean(axis=0)
    axes = np.linalg.svd(centred)[2]
    d2 = ((target - model.mean(axis=0)) @ axes.T)[0] ** 2
    f2 = ((centred @ axes.T) ** 2).mean(axis=0)
    share = sum((d2.sum() - d2[k]) / (f2.sum() - f2[k]) for k in range(3)) / 3.0
    assert np.mean(fre2) == pytest.approx((1 - 2 / 6) * fle**2, rel=0.05)
    assert np.mean(tre2) == pytest.approx(fle**2 / 6 * (1.0 + share), rel=0.08)


@pytest.mark.parametrize(
    ("a", "b", "word"),
    [
        (np.eye(3)[:2], np.eye(3)[:2], "three"),
        (np.eye(3), np.eye(4)[:, :3], "three"),
        (np.eye(3) * np.nan, np.eye(3), "finite"),
        (np.arange(3.0)[:, None] * [1, 2, 3], np.eye(3), "line"),
    ],
)
def test_what_cannot_be_fitted_is_refused(a: np.ndarray, b: np.ndarray, word: str) -> None:
    with pytest.raises(ValueError, match=word):
        fit(a, b)

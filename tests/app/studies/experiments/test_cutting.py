"""The cut that a known way of the tip leaves: path deviation and penetration are exact."""

import numpy as np
import pytest

from app.studies.experiments.cutting import Blade, kerf
from app.studies.experiments.site import THICKNESS, PlannedCut


def straight(length: float = 10e-3) -> PlannedCut:
    stations = np.arange(0.0, length + 5e-4, 1e-3)
    one = np.ones((len(stations), 1))
    return PlannedCut(
        stations,
        stations[:, None] * [0.0, 1.0, 0.0] + [0.02, 0.01, -0.1],
        one * [0.0, 1.0, 0.0],
        one * [1.0, 0.0, 0.0],
        one * [0.0, 0.0, 1.0],
    )


def way(aside: object, height: object, n: int = 4001) -> np.ndarray:
    """Tips (n, 3) from before the start to past the end of `straight`."""
    y = np.linspace(-2e-3, 12e-3, n)
    x = aside(y) if callable(aside) else np.full(n, aside)
    z = height(y) if callable(height) else np.full(n, height)
    return np.stack([x + 0.02, y + 0.01, z - 0.1], axis=1)


@pytest.mark.parametrize("n", [3, 50, 4001])
def test_a_straight_cut(n: int) -> None:
    cut = kerf(straight(), way(0.4e-3, -2.3e-3, n))
    np.testing.assert_allclose(cut.stations, np.arange(1, 11) * 1e-3)
    np.testing.assert_allclose(cut.deviation, 0.4e-3, atol=1e-15)
    np.testing.assert_allclose(cut.penetration, 2.3e-3 - THICKNESS, atol=1e-15)
    np.testing.assert_allclose(cut.right - cut.left, Blade().width, atol=1e-15)
    np.testing.assert_allclose(cut.area, Blade().width * THICKNESS, atol=1e-15)


def test_a_slanted_cut() -> None:
    """Aside and depth grow along the cut: the middle is exact, the depth that of the far side."""
    blade = Blade(thickness=0.4e-3)
    cut = kerf(straight(), way(lambda y: 0.1 * y, lambda y: -1e-3 - 0.1 * y), blade)
    np.testing.assert_allclose(cut.deviation, 0.1 * cut.stations, atol=1e-15)
    np.testing.assert_allclose(
        cut.penetration, 1e-3 + 0.1 * (cut.stations + 0.2e-3) - THICKNESS, atol=1e-15
    )
    np.testing.assert_allclose(cut.right - cut.left, blade.width + 0.1 * 0.4e-3, atol=1e-15)


def test_bone_that_is_left_counts_negative_and_air_is_not_cut() -> None:
    cut = kerf(straight(), way(0.0, -1.5e-3))
    np.testing.assert_allclose(cut.penetration, -0.5e-3, atol=1e-15)
    np.testing.assert_allclose(cut.area, Blade().width * 1.5e-3, atol=1e-15)
    above = kerf(straight(), way(0.0, 1e-4))
    assert np.isnan(above.deviation).all()
    assert np.isnan(above.penetration).all()


def test_the_shoulder_stops_the_blade_and_there_and_back_widens_the_cut() -> None:
    cut = kerf(straight(), way(0.0, -9e-3), Blade(limit=3e-3))
    np.testing.assert_allclose(cut.penetration, 3e-3 - THICKNESS, atol=1e-15)
    both = np.vstack([way(-0.5e-3, -2e-3), way(0.7e-3, -2.4e-3)[::-1]])
    cut = kerf(straight(), both)
    np.testing.assert_allclose(cut.deviation, 0.1e-3, atol=1e-15)
    np.testing.assert_allclose(cut.right - cut.left, 1.2e-3 + Blade().width, atol=1e-15)
    np.testing.assert_allclose(cut.penetration, 0.4e-3, atol=1e-15)


def test_a_curved_course_is_measured_along_its_own_normals() -> None:
    angle = np.linspace(0.0, 0.4, 31)
    radius = 75e-3
    outward = np.stack([0.0 * angle, np.sin(angle), np.cos(angle)], axis=1)
    along = np.stack([0.0 * angle, np.cos(angle), -np.sin(angle)], axis=1)
    planned = PlannedCut(
        radius * angle, radius * outward, along, np.tile([1.0, 0, 0], (31, 1)), outward
    )
    fine = np.linspace(-0.02, 0.42, 20001)
    tips = (radius - 2.5e-3) * np.stack([0.0 * fine, np.sin(fine), np.cos(fine)], axis=1)
    tips[:, 0] = 0.3e-3
    cut = kerf(planned, tips, Blade(thickness=1e-5))
    np.testing.assert_allclose(cut.deviation, 0.3e-3, atol=1e-12)
    np.testing.assert_allclose(cut.penetration, 0.5e-3, atol=2e-7)  # frames are interpolated


def test_an_impossible_blade_is_refused() -> None:
    with pytest.raises(ValueError, match="width"):
        Blade(width=0.0)

"""SAL and SPARC against values computed elsewhere (100 Hz, padding level 4)."""

import numpy as np
import pytest

from app.studies.experiments.smoothness import sal, sparc, speed_of


def minimum_jerk(duration: float) -> np.ndarray:
    t = np.linspace(0.0, 1.0, round(duration * 100) + 1)
    return 30.0 * t**2 * (1.0 - t) ** 2 / duration


def pair(gap: float) -> np.ndarray:
    one = minimum_jerk(1.0)
    return np.concatenate([one, np.zeros(round(gap * 100)), one[1:]])


T = np.arange(-1.0, 1.0, 0.01)


@pytest.mark.parametrize(
    ("speed", "sparc_value", "sal_value"),
    [
        (np.exp(-5.0 * T**2), -1.41403, -1.92284),
        (minimum_jerk(1.0), -1.40583, -1.96144),
        (minimum_jerk(10.0), -1.40243, -2.09668),
        (np.ones(100), -2.40199, -3.18790),
        (np.sin(np.pi * np.linspace(0.0, 1.0, 101)), -1.56234, -2.06912),
        (pair(0.0), -2.24455, -2.99629),
        (pair(0.5), -3.11903, -3.91854),
    ],
    ids=["gauss", "jerk 1 s", "jerk 10 s", "rectangle", "half sine", "two", "two with a gap"],
)
def test_reference_values(speed: np.ndarray, sparc_value: float, sal_value: float) -> None:
    assert sparc(speed, 100.0) == pytest.approx(sparc_value, abs=1e-4)
    assert sal(speed, 100.0) == pytest.approx(sal_value, abs=1e-4)


def test_size_does_not_count_and_tremor_does() -> None:
    smooth = minimum_jerk(2.0)
    shaky = smooth + 0.2 * (1.0 + np.sin(2 * np.pi * 9.0 * np.arange(len(smooth)) / 100.0))
    for measure in (sal, sparc):
        assert measure(7.0 * smooth, 100.0) == pytest.approx(measure(smooth, 100.0), rel=1e-12)
        assert measure(shaky, 100.0) < measure(smooth, 100.0)


@pytest.mark.parametrize("speed", [[1.0], [0.0, 0.0], [1.0, np.nan], [[1.0, 2.0]]])
def test_what_has_no_spectrum_is_refused(speed: list) -> None:
    with pytest.raises(ValueError, match="speed profile"):
        sal(speed, 100.0)


def test_sampling_too_slowly_is_refused() -> None:
    with pytest.raises(ValueError, match="40 Hz"):
        sal([1.0, 2.0], 30.0)


def test_speed() -> None:
    points = np.array([[0, 0, 0], [3, 4, 0], [3, 4, 2]]) * 1e-3
    np.testing.assert_allclose(speed_of(points, 100.0), [0.5, 0.2])

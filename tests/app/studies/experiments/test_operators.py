"""The simulated hand: its parts have the sizes they claim."""

import dataclasses

import numpy as np
import pytest
from scipy import signal

from app.studies.experiments.operators import Operator, SlowError, Tremor, minimum_jerk


def test_every_parameter_has_unit_source_and_description() -> None:
    for f in dataclasses.fields(Operator):
        assert f.metadata["unit"], f.name
        assert len(f.metadata["source"]) > 5, f.name
        assert f.metadata["about"], f.name


@pytest.mark.parametrize("rate", [100.0, 1000.0])
def test_tremor_has_its_size_and_its_band(rate: float) -> None:
    tremor = Tremor(14e-6, rate, np.random.default_rng(0))
    x = np.concatenate([tremor(700) for _ in range(round(rate / 5))])
    np.testing.assert_allclose(x.std(axis=0), 14e-6, rtol=0.1)
    f, power = signal.welch(x[:, 0], rate, nperseg=int(4 * rate))
    assert power[(f > 7.0) & (f < 13.0)].sum() > 0.85 * power.sum()


def test_a_slow_error_keeps_its_size_and_forgets() -> None:
    error = SlowError(0.5e-3, 4.0, np.random.default_rng(1))
    x = np.array([error.after(0.5) for _ in range(60_000)])
    assert x.std() == pytest.approx(0.5e-3, rel=0.05)
    assert np.corrcoef(x[:-8], x[8:])[0, 1] == pytest.approx(np.exp(-1.0), abs=0.05)


def test_minimum_jerk_starts_and_ends_at_rest() -> None:
    s = minimum_jerk(1000)
    assert s[-1] == 1.0
    assert (np.diff(s) > 0.0).all()
    assert np.diff(s).max() * 1000 == pytest.approx(1.875, rel=1e-3)  # its known highest speed
    assert np.diff(s)[[0, -1]].max() < 1e-4


def test_others_differ_in_what_was_calibrated_only() -> None:
    mean, other = Operator(), Operator().varied(np.random.default_rng(3), 0.15)
    assert other.depth_bias != mean.depth_bias
    assert other.movement_time == mean.movement_time
    assert other.scale == mean.scale
    with pytest.raises(ValueError, match="tremor"):
        Operator(tremor=-1.0)

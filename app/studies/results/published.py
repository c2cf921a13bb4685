"""Published results of Li et al. (IROS 2020), section V, for comparison."""

from __future__ import annotations

from typing import NamedTuple


class Value(NamedTuple):
    """Mean and standard deviation, in the unit of its `Measure`."""

    mean: float
    spread: float


class Measure(NamedTuple):
    """A quantity the paper reports.

    Attributes:
        name: of the quantity.
        unit: of `off` and `assisted`.
        off: plain teleoperation.
        assisted: with the fixture.
    """

    name: str
    unit: str
    off: Value
    assisted: Value


SAL = Measure("smoothness, SAL", "", Value(-20.98, 0.79), Value(-10.02, 3.7))
DEVIATION = Measure("cutting-path deviation", "mm", Value(0.63, 0.30), Value(0.37, 0.24))
PENETRATION = Measure("|penetration depth|", "mm", Value(0.83, 0.51), Value(0.39, 0.26))
DURATION = Measure("time of a cut", "s", Value(234.0, 3.8), Value(204.0, 11.0))
TRACING_TRIALS = 5  # per mode
CUTTING_TRIALS = 2  # skulls per mode

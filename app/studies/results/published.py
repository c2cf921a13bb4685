"""Figures of Li et al. (IROS 2020), section V: what ours stand beside. Mean and deviation."""

from __future__ import annotations

from typing import NamedTuple


class Value(NamedTuple):
    """Mean and standard deviation, in the unit of `MEASURES`."""

    mean: float
    spread: float


class Measure(NamedTuple):
    """A quantity the paper reports.

    Attributes:
        name: in words.
        unit: what `off` and `assisted` are in.
        scale: from SI to that unit.
        off: plain teleoperation.
        assisted: with the fixture.
    """

    name: str
    unit: str
    scale: float
    off: Value
    assisted: Value


SAL = Measure("smoothness, SAL", "", 1.0, Value(-20.98, 0.79), Value(-10.02, 3.7))
DEVIATION = Measure(
    "cutting-path deviation", "mm", 1e3, Value(0.63, 0.30), Value(0.37, 0.24)
)  # fmt: skip
PENETRATION = Measure(
    "|penetration depth|", "mm", 1e3, Value(0.83, 0.51), Value(0.39, 0.26)
)  # fmt: skip
DURATION = Measure("time of a cut", "s", 1.0, Value(234.0, 3.8), Value(204.0, 11.0))
LARGEST_DEVIATION = (1.27, 0.86)  # [mm] off, assisted
TRACING_TRIALS = 5  # a mode
CUTTING_TRIALS = 2  # skulls a mode

"""Courses of motions in time: from 0 at rest to 1 at the farthest."""

from __future__ import annotations

from collections.abc import Callable
from math import cos, exp, pi, sin, sqrt

Wave = Callable[[float], float]

# Breathing is sin⁶ of half the phase, as A. E. Lujan et al. (Medical Physics 26(5), 1999) fitted
# it: the structure stands nearly still for a third of the cycle, at the end of expiration.
SHARP = 3
# A beat is one bump a period, this wide (standard deviation as a share of the period).
WIDTH = 0.1
SHARPNESS = 1.0 / (2.0 * pi * WIDTH) ** 2


def breathing(phase: float) -> float:
    """Share of the depth of a breath at a phase, whole at each breath."""
    return float(sin(pi * phase) ** (2 * SHARP))


def beat(phase: float) -> float:
    """Share of the way of a beat at a phase, whole at each beat: a von Mises density over it."""
    low = exp(-2.0 * SHARPNESS)
    return (exp(-SHARPNESS * (cos(2.0 * pi * phase) + 1.0)) - low) / (1.0 - low)


def ramp(share: float) -> float:
    """At constant speed from 0 to 1, then at rest."""
    return min(max(share, 0.0), 1.0)


def step(share: float) -> float:
    """From 0 to 1 with the least jerk, then at rest."""
    s = min(max(share, 0.0), 1.0)
    return s * s * s * (10.0 + s * (6.0 * s - 15.0))


def _steepest_beat() -> float:
    """Of exp(κ (cos θ − 1)): where κ sin² θ = cos θ, in turns."""
    cosine = (sqrt(1.0 + 4.0 * SHARPNESS**2) - 1.0) / (2.0 * SHARPNESS)
    sine = sqrt(1.0 - cosine * cosine)
    rise = 2.0 * pi * SHARPNESS * sine * exp(SHARPNESS * (cosine - 1.0))
    return rise / (1.0 - exp(-2.0 * SHARPNESS))


def _steepest_breath() -> float:
    """Of sin²ⁿ(π p): where tan² = 2n − 1."""
    n = 2 * SHARP
    return n * pi * ((n - 1) / n) ** ((n - 1) / 2) * sqrt(1.0 / n)


WAVES: dict[str, tuple[Wave, float]] = {
    "breathing": (breathing, _steepest_breath()),
    "heartbeat": (beat, _steepest_beat()),
    "shift": (ramp, 1.0),
    "knock": (step, 1.875),
}
"""Wave of each kind as a function of time over period, and its largest slope."""

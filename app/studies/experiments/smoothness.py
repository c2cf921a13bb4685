"""Smoothness of a movement: the arc length of the spectrum of its speed.

SAL with a fixed cut-off is the paper's equation 4; SPARC (Balasubramanian et al., "On the analysis
of movement smoothness", J NeuroEng Rehabil 2015) has an adaptive one. Both are negative, nearer to
zero for smoother movements. SAL depends on sampling rate, padding and duration, so only values of
equally recorded movements are comparable.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

FloatArray = NDArray[np.float64]

PADDING = 4  # zero padding to 2^4 times the next power of two
SAMPLED = 100.0  # sampling rate of the positions [Hz]
CUTOFF = 20.0  # of SAL [Hz]
SPARC_CUTOFF = 10.0  # [Hz]
SPARC_LEVEL = 0.05  # SPARC ends at the last frequency with this share of the largest magnitude


def sal(speed: ArrayLike, rate: float) -> float:
    """Spectral arc length of a speed profile (n,) sampled at `rate` [Hz], as in the paper.

    Raises:
        ValueError: fewer than two samples, not finite, all zero, or a rate below twice the cut-off.
    """
    frequencies, magnitude = _spectrum(speed, rate)
    if rate < 2.0 * CUTOFF:
        raise ValueError(f"SAL looks up to {CUTOFF:g} Hz: sample at {2 * CUTOFF:g} Hz or more")
    within = frequencies <= CUTOFF
    return _arc(frequencies[within] / CUTOFF, magnitude[within] / magnitude[0])


def sparc(speed: ArrayLike, rate: float) -> float:
    """SPARC of a speed profile (n,) sampled at `rate` [Hz]. Raises as `sal` does."""
    frequencies, magnitude = _spectrum(speed, rate)
    within = frequencies <= SPARC_CUTOFF
    f, v = frequencies[within], magnitude[within] / magnitude.max()
    above = np.flatnonzero(v >= SPARC_LEVEL)
    f, v = f[above[0] : above[-1] + 1], v[above[0] : above[-1] + 1]
    return _arc((f - f[0]) / (f[-1] - f[0]), v)


def sampled(points: ArrayLike, rate: float) -> tuple[FloatArray, float]:
    """Positions (n, 3), one a tick at `rate` [Hz], at about `SAMPLED`: (m, 3) and their rate [Hz].

    The last tick of every sample counts, as of telemetry.
    """
    every = max(round(rate / SAMPLED), 1)
    return np.asarray(points, dtype=np.float64)[every - 1 :: every], rate / every


def speed_of(points: ArrayLike, rate: float) -> FloatArray:
    """Speed (n − 1,) [m/s] along positions (n, 3) [m] recorded at `rate` [Hz]."""
    steps = np.diff(np.asarray(points, dtype=np.float64), axis=0)
    return np.asarray(np.linalg.norm(steps, axis=1) * rate)


def _spectrum(speed: ArrayLike, rate: float) -> tuple[FloatArray, FloatArray]:
    v = np.asarray(speed, dtype=np.float64)
    if v.ndim != 1 or len(v) < 2 or not np.isfinite(v).all() or not (v > 0.0).any():
        raise ValueError("a speed profile must be two or more finite numbers, not all of them zero")
    size = 2 ** (int(np.ceil(np.log2(len(v)))) + PADDING)
    frequencies = np.fft.rfftfreq(size, 1.0 / rate).astype(np.float64)
    return frequencies, np.abs(np.fft.rfft(v, size)).astype(np.float64)


def _arc(f: FloatArray, v: FloatArray) -> float:
    return -float(np.hypot(np.diff(f), np.diff(v)).sum())

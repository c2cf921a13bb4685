"""How far an arm is off the path that was certified for it."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from robots import Arm

FloatArray = NDArray[np.float64]


class Tracked:
    """The last segments that were certified, from measured joints to the set-point each.

    An arm that lags behind its set-points is on them; one that is pushed aside is not. All joints
    are (n,) [rad or m].
    """

    def __init__(self, arm: Arm, segments: int) -> None:
        """Args:
        arm: the model, for this object's thread.
        segments: how many are kept: as many as may be on their way to the arm and back.
        """
        n = len(arm.lower)
        self._arm = arm
        # A radian counts as a tenth of a metre: about what the joints of an instrument move.
        self._weights = np.where(arm.revolute > 0.0, 0.1, 1.0)
        self._starts = np.zeros((segments, n))
        self._ways = np.zeros((segments, n))
        self._squares = np.ones(segments)
        self._next = self._filled = 0

    def anchor(self, q: FloatArray) -> None:
        """Forget all segments: the arm is to be where it is now."""
        self._next = self._filled = 0
        self.add(q, q)

    def add(self, start: FloatArray, end: FloatArray) -> None:
        """Add a segment."""
        k = self._next
        way = self._weights * (end - start)
        self._starts[k], self._ways[k] = self._weights * start, way
        self._squares[k] = max(float(way @ way), 1e-30)
        self._next = (k + 1) % len(self._squares)
        self._filled = max(self._filled, k + 1)

    def error(self, q: FloatArray) -> float:
        """Distance of the tip from where it would be on the nearest segment [m]; none: 0."""
        m = self._filled
        if m == 0:
            return 0.0
        offsets = self._weights * q - self._starts[:m]
        ways = self._ways[:m]
        share = np.clip((offsets * ways).sum(1) / self._squares[:m], 0.0, 1.0)
        rest = offsets - share[:, None] * ways
        k = int((rest * rest).sum(1).argmin())
        on_path = (self._starts[k] + share[k] * ways[k]) / self._weights
        return math.dist(self._arm.tip(q).translation, self._arm.tip(on_path).translation)

"""How far an arm is off the path that was certified for it."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from robots import Arm
from vf.kernels import njit

FloatArray = NDArray[np.float64]


class Tracked:
    """The last segments that were certified, from measured joints to the set-point each.

    An arm that lags behind its set-points is on them; one that is pushed aside is not. All joints
    are (n,) [rad or m].
    """

    def __init__(self, arm: Arm, segments: int, reach: FloatArray) -> None:
        """Args:
        arm: the model, for this object's thread.
        segments: how many are kept: as many as may be on their way to the arm and back.
        reach: (n,) no segment is longer, by joint [rad or m].
        """
        n = len(arm.lower)
        self._arm = arm
        # A radian counts as a tenth of a metre: about what the joints of an instrument move.
        self._weights = np.where(arm.revolute > 0.0, 0.1, 1.0)
        self._starts = np.zeros((segments, n))
        self._ways = np.zeros((segments, n))
        self._squares = np.ones(segments)
        self._found = np.zeros((3, n))  # joints, the nearest ones on a segment, how far from them
        self._next = self._filled = 0
        self._levers = Levers(arm, reach)
        self.anchor(arm.neutral)
        self.error(arm.neutral, True)  # compiled now
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

    def error(self, q: FloatArray, whole: bool) -> tuple[float, float]:
        """How far the arm is from where it would be on the nearest segment [m]; none: 0.

        Args:
            whole: whether all of the instrument counts.

        Returns:
            Of the tip, exactly; and of what counts: the same, or a bound for the tip and all
            capsules by `Levers`.
        """
        m = self._filled
        if m == 0:
            return 0.0, 0.0
        found = self._found
        found[0] = q
        _nearest(found, self._weights, self._starts, self._ways, self._squares, m)
        on_path = found[1]
        tip = math.dist(self._arm.tip(q).translation, self._arm.tip(on_path).translation)
        return tip, self._levers.bound(q, found[2]) if whole else tip


class Levers:
    """Bounds how far errors of the joints move the tip and every point of an arm's capsules.

    A point of a capsule lies between the ends of its axis, or a radius beside it: it moves no
    farther than the one end that moves farthest. A joint that turns by an angle moves an end by no
    more than the angle times its lever, the end's distance from the joint's axis, which is the
    length of a column of the end's Jacobian. Joint after joint is turned, the outermost first: a
    lever is longer by no more than the end was moved by the joints beyond.
    """

    def __init__(self, arm: Arm, reach: FloatArray) -> None:
        """Args:
        arm: the model, for this object's thread.
        reach: (n,) how far joints may be from where `bound` is asked for [rad or m].
        """
        self._arm, self._reach = arm, reach
        self._turns = np.array(arm.revolute, dtype=np.float64)
        self._asked = np.zeros((2, len(reach)))
        self._at = np.full(len(reach), np.inf)  # joints that the levers were computed at …
        self._levers = np.zeros((1, len(reach)))  # … of each end, those of all joints

    def bound(self, q: FloatArray, error: FloatArray) -> float:
        """No point is farther from where it would be without the error [m].

        It holds at q and at all joints within `reach` of it: so also on the way to a set-point, as
        an arm that is aside of its start gets there ever less aside.

        Args:
            q: (n,) joints.
            error: (n,) of them.
        """
        asked = self._asked
        asked[0], asked[1] = q, error
        bound = _bound(asked, self._at, self._reach, self._turns, self._levers)
        if bound < 0.0:
            self._refresh(q)
            bound = _bound(asked, self._at, self._reach, self._turns, self._levers)
        return float(bound)

    def _refresh(self, q: FloatArray) -> None:
        """The longest levers within twice the reach of q: they serve for a while."""
        J = self._arm.axis_jacobians(q).reshape(-1, 3, len(q))
        levers = np.linalg.norm(np.concatenate([J, self._arm.jacobian(q)[None, :3]]), axis=1)
        moved = np.zeros(len(levers))
        for j in range(len(q) - 1, -1, -1):
            levers[:, j] += self._turns[j] * moved
            moved += 2.0 * self._reach[j] * levers[:, j]
        self._at, self._levers = q.copy(), levers


# Compiled, as they are needed in every tick of an arm that is elsewhere.
@njit(cache=True)
def _nearest(found, weights, starts, ways, squares, m):  # type: ignore[no-untyped-def]
    """Fill rows 1 and 2 of `found` for the joints in row 0, from the first m segments."""
    best = np.inf
    for k in range(m):
        share = 0.0
        for j in range(found.shape[1]):
            share += (weights[j] * found[0, j] - starts[k, j]) * ways[k, j]
        share = min(max(share / squares[k], 0.0), 1.0)
        apart = 0.0
        for j in range(found.shape[1]):
            apart += (weights[j] * found[0, j] - starts[k, j] - share * ways[k, j]) ** 2
        if apart < best:
            best = apart
            for j in range(found.shape[1]):
                found[1, j] = (starts[k, j] + share * ways[k, j]) / weights[j]
                found[2, j] = found[0, j] - found[1, j]


@njit(cache=True)
def _bound(asked, at, reach, turns, levers):  # type: ignore[no-untyped-def]
    """`Levers.bound` of the joints and errors in the rows of `asked`; −1: not near enough."""
    n = asked.shape[1]
    for j in range(n):
        if not abs(asked[0, j] - at[j]) <= reach[j]:
            return -1.0
    most = 0.0
    for i in range(levers.shape[0]):
        moved = 0.0
        for j in range(n - 1, -1, -1):
            moved += abs(asked[1, j]) * (levers[i, j] + turns[j] * moved)
        most = max(most, moved)
    return most

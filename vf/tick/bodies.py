"""What is guarded beside the tip: the capsules of an arm, as the compiled tick reads them."""

from __future__ import annotations

from collections.abc import Sequence
from math import sqrt
from typing import Any, NamedTuple

import numpy as np

from vf import layout as at
from vf.planes import FloatArray, IntArray
from vf.qp.problem import JOINT_RANGE
from vf.tick.chain import TRANSLATION, place_points


class Guarded(NamedTuple):
    """The tip and the ends of the axes, and the bodies that they make.

    Attributes:
        guards: (p, GUARD) see `vf.layout`; the first is the tip.
        bodies: (b, BODY) see `vf.layout`.
    """

    guards: FloatArray
    bodies: IntArray

    @property
    def ends(self) -> int:
        """Number of ends of axes: how often a plane of every body is written down."""
        return int((1 + (self.bodies[:, at.FIRST] != self.bodies[:, at.SECOND])).sum())


def tip_alone(tip_radius: float) -> Guarded:
    """Nothing but the tip, a ball of this radius [m]."""
    guards = np.zeros((1, at.GUARD))
    guards[0, at.THICKNESS] = tip_radius
    return Guarded(guards, np.zeros((0, at.BODY), dtype=np.int64))


def instrument(
    arm: Any, tip_radius: float, trocar: float, middle: FloatArray, searched: bool
) -> Guarded:
    """The tip, and every capsule that is more than the ball at the tip.

    Args:
        arm: its `chain`, `capsules` and `anchors`, see `robots.Arm`.
        tip_radius: of the ball at the tip [m].
        trocar: radius of the zone around the start of a capsule with a `port` [m]; 0: none.
        middle: joint positions (n,) at which the axis of such a capsule has a length.
        searched: whether a fixture guards bodies.

    Raises:
        ValueError: the arm has capsules and no chain, or anchors that do not fit them.
    """
    capsules: Sequence[Any] = getattr(arm, "capsules", ())
    alone = tip_alone(tip_radius)
    if not capsules or not searched:
        return alone
    chain, anchors = getattr(arm, "chain", None), np.asarray(getattr(arm, "anchors", ()))
    if chain is None or anchors.shape != (len(capsules), 2, 4):
        raise ValueError(
            "guard 'tool' needs an arm with a chain and with anchors (c, 2, 4) of its "
            f"{len(capsules)} capsules, see robots.Arm; guard 'tip' does not"
        )
    rows, bodies = [alone.guards[0]], []
    tip = np.array([len(chain) - 1, *chain[-1, TRANSLATION : TRANSLATION + 3]])
    for number, (capsule, (start, end)) in enumerate(zip(capsules, anchors, strict=True)):
        at_tip = np.array_equal(start, tip) and np.array_equal(end, tip)
        if at_tip and capsule.radius <= tip_radius:
            continue
        first, centre = len(rows), -1
        port = getattr(capsule, "port", False) and trocar > capsule.radius
        begin = start
        if port:
            # What is out of the zone is farther than this along the axis.
            begin = _along(chain, middle, start, end, sqrt(trocar**2 - capsule.radius**2))
        rows.append(_row(begin, capsule.radius))
        second = first
        if not np.array_equal(start, end):
            second = len(rows)
            rows.append(_row(end, capsule.radius))
            rows[-1][at.TWIN] = 1.0
        if port:
            centre = len(rows)
            rows.append(_row(start, capsule.radius))
            rows[-1][at.PATH_LIMIT] = rows[-1][at.STEP_LIMIT] = np.inf
        bodies.append([first, second, number, centre])
    return Guarded(np.array(rows), np.array(bodies, dtype=np.int64).reshape(-1, at.BODY))


def _row(anchor: FloatArray, radius: float) -> FloatArray:
    row = np.zeros(at.GUARD)
    row[at.ANCHOR : at.ANCHOR + 4] = anchor
    row[at.THICKNESS] = radius
    return row


def _along(
    chain: FloatArray, q: FloatArray, start: FloatArray, end: FloatArray, length: float
) -> FloatArray:
    """The anchor (4,) that is `length` [m] from one towards another, fixed to the first's frame."""
    guards = np.zeros((6, at.GUARD))
    guards[1:5, :4] = start
    guards[5, :4] = end
    for k in range(3):
        guards[2 + k, 1 + k] += 1.0
    places = np.zeros((6, 3))
    place_points(np.ascontiguousarray(chain), q, guards, places)
    axes = places[2:5] - places[1]  # rows: the axes of the start's frame
    way = places[5] - places[1]
    found = start.copy()
    found[1:] += length * (axes @ way) / np.linalg.norm(way)
    return found


def guards_tool(fixture: Any, guard: str) -> bool:
    """Whether a fixture guards bodies beside the tip, where settings say `guard` of all."""
    search = getattr(fixture, "search", None)
    own = getattr(fixture, "guard", None) or guard
    return search is not None and search.kind == at.MESH and own == "tool"


def check_limits(arm: Any) -> None:
    """ValueError unless all limits are finite, with lower ≤ upper and speeds above zero."""
    lower, upper, speed = (np.asarray(v, float) for v in (arm.lower, arm.upper, arm.velocity))
    most = JOINT_RANGE
    if not ((-most <= lower) & (lower <= upper) & (upper <= most)).all():
        raise ValueError(
            f"an arm's position limits must be numbers within ±{most:g} rad or m, lower ≤ upper,"
            f" got {lower} and {upper}"
        )
    if not ((speed > 0.0) & (speed <= most)).all():
        raise ValueError(
            f"an arm's speed limits must be above zero and at most {most:g} rad/s or m/s, got"
            f" {speed}: a joint that is not to move is no joint"
        )

"""Kinematics of the judges: an arm as the screws of its joints at one posture.

A joint moves everything behind it about or along a line. Pinocchio says, at one posture, where
those lines are and where the ends of the capsules' axes are; any other posture is the product of
the joints' motions from there, the last one first (product of exponentials). Nothing of this is
shared with `vf.tick.chain`.

R. W. Brockett, "Robotic manipulators and the product of exponentials formula", 1984.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

import robots
from robots.instrument import BASE
from vf.kernels import njit

FloatArray = NDArray[np.float64]


class Screws(NamedTuple):
    """The joints of an arm and the ends of its capsules' axes at a posture, base frame.

    Attributes:
        lines: (n, 7) of each joint: direction of its axis, a point of it [m], and 1 where it turns
            about the axis, 0 where it slides along it.
        posture: (n,) where that is [rad or m].
        ends: (e, 3) there [m]: start and end of every axis in turn.
        carried: (e,) how many joints move an end; they are the first ones.
    """

    lines: FloatArray
    posture: FloatArray
    ends: FloatArray
    carried: NDArray[np.int64]


def of(arm: robots.Arm, ball: bool = False) -> Screws:
    """The screws of an arm, with the tip as one more axis without length if `ball`."""
    q = arm.neutral.copy()
    tip, J = arm.kinematics(q)
    lines = np.zeros((len(q), 7))
    for line, column, turns in zip(lines, J.T, arm.revolute, strict=True):
        line[:3] = column[3:] if turns else column[:3]
        if turns:
            line[3:6] = tip.translation + np.cross(column[3:], column[:3])
        line[6] = turns
    ends = arm.axes(q).reshape(-1, 3)
    carried = [
        0 if name == BASE else 1 + arm.joints.index(name)
        for capsule in arm.capsules
        for name in capsule.frames
    ]
    if ball:
        ends = np.concatenate([ends, [tip.translation] * 2])
        carried += [len(q)] * 2
    return Screws(lines, q, np.ascontiguousarray(ends), np.array(carried, dtype=np.int64))


def place(screws: Screws, q: FloatArray) -> FloatArray:
    """Starts and ends of the axes for joints q (n,), (e/2, 2, 3) [m]."""
    found = np.empty((len(screws.ends), 3))
    for i in range(len(found)):
        place_end(screws.lines, screws.posture, screws.ends, screws.carried, i, q, found[i])
    return found.reshape(-1, 2, 3)


@njit(cache=True, nogil=True)
def place_end(lines, posture, ends, carried, i, q, out):  # type: ignore[no-untyped-def]
    """Write where end i is for joints q (n,) to out (3,)."""
    x, y, z = ends[i, 0], ends[i, 1], ends[i, 2]
    for j in range(carried[i] - 1, -1, -1):
        x, y, z = _moved(lines[j], q[j] - posture[j], x, y, z)
    out[0], out[1], out[2] = x, y, z


@njit(cache=True, nogil=True)
def _moved(line, by, x, y, z):  # type: ignore[no-untyped-def]
    """A point after a joint moved by so much [rad or m]: Rodrigues' formula."""
    ux, uy, uz = line[0], line[1], line[2]
    if line[6] == 0.0:
        return x + by * ux, y + by * uy, z + by * uz
    c, s = np.cos(by), np.sin(by)
    wx, wy, wz = x - line[3], y - line[4], z - line[5]
    along = (ux * wx + uy * wy + uz * wz) * (1.0 - c)
    return (
        line[3] + c * wx + s * (uy * wz - uz * wy) + along * ux,
        line[4] + c * wy + s * (uz * wx - ux * wz) + along * uy,
        line[5] + c * wz + s * (ux * wy - uy * wx) + along * uz,
    )


@njit(cache=True, nogil=True)
def fastest(lines, posture, ends, carried, i, q, dq):  # type: ignore[no-untyped-def]
    """Bounds on the way [m] and the bend [m] of end i while the joints go from q to q + dq (n,).

    With q + τ dq, τ from 0 to 1, the first bounds |p′| and the second |p″| of the end's path p(τ),
    anywhere on it. A joint that turns moves the end by as much as it is away from the joint's axis,
    at q; on the way that changes by no more than what the joints behind it move the end. And
    p″ = Σ_i Σ_j dq_i dq_j ∂²p, where for i ≤ j the derivative is as long as the joint j's, if i
    turns, and zero if it slides.
    """
    x, y, z = ends[i, 0], ends[i, 1], ends[i, 2]
    way = 0.0
    bend = 0.0
    for j in range(carried[i] - 1, -1, -1):
        line = lines[j]
        move = abs(dq[j])
        if line[6] == 0.0:
            way += move
        else:
            wx, wy, wz = x - line[3], y - line[4], z - line[5]
            cx = line[1] * wz - line[2] * wy
            cy = line[2] * wx - line[0] * wz
            cz = line[0] * wy - line[1] * wx
            own = move * (np.sqrt(cx * cx + cy * cy + cz * cz) + way)
            bend += move * (own + 2.0 * way)
            way += own
        x, y, z = _moved(line, q[j] - posture[j], x, y, z)
    # For rounding.
    return way * (1.0 + 1e-9) + 1e-15, bend * (1.0 + 1e-9) + 1e-15

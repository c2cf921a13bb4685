"""What moving structures did to a tool, from the true motion: shares no code with `vf`.

A structure moves between two poses, by a constant twist. A point of the tool meets it when, in the
frame of the structure, it comes to a triangle.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pinocchio as pin

from tests.support import naive

TOUCH = 1e-10  # [m]


def between(start: pin.SE3, end: pin.SE3, share: float) -> pin.SE3:
    """The pose of a structure that moves by a constant twist."""
    return start * pin.exp6(share * pin.log6(start.inverse() * end).vector)


def speed(start: pin.SE3, end: pin.SE3, farthest: float) -> float:
    """No point within `farthest` [m] of the structure's origin is moved faster in the tick [m]."""
    twist = pin.log6(start.inverse() * end)
    return float(np.linalg.norm(twist.linear) + np.linalg.norm(twist.angular) * farthest)


def clearance(
    triangles: np.ndarray,
    start: pin.SE3,
    end: pin.SE3,
    place: Callable[[float], np.ndarray],
    reach: float,
    radius: float = 0.0,
) -> float:
    """The least clearance of a point of the tool on its way, at most `TOUCH` below the true one.

    By conservative advancement: no step in time is longer than the clearance divided by a bound on
    the speed. Ends when the tool touches a triangle.

    Args:
        triangles: (m, 3, 3), frame of the structure.
        place: where the point is at a share of the tick, base frame.
        reach: no part of its path is longer than this times its part of the tick [m].
        radius: of the ball around it [m].
    """
    share, least = 0.0, np.inf
    while True:
        pose = between(start, end, share)
        p = pose.actInv(place(share))
        gap = float(naive.closest(triangles, p)[1].min()) - radius
        least = min(least, gap)
        if gap <= TOUCH or share >= 1.0:
            return least
        # Within `gap` of here no point is farther from the origin than this.
        rate = reach + speed(start, end, float(np.linalg.norm(p)) + gap + reach)
        share = min(share + max(gap / rate, 1e-6), 1.0)


def depth(triangles: np.ndarray, p: np.ndarray) -> float:
    """How deep a point (3,) is in a convex body with outward faces [m]; ≤ 0: it is outside."""
    a = triangles[:, 0]
    n = np.cross(triangles[:, 1] - a, triangles[:, 2] - a)
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    return float(-((p - a) * n).sum(axis=1).max())


def axis_gap(triangles: np.ndarray, a: np.ndarray, b: np.ndarray) -> float:
    """Distance of the segment ab to triangles (m, 3, 3) [m]; 0 where it pierces one."""
    best = min(float(naive.closest(triangles, p)[1].min()) for p in (a, b))
    u = b - a
    for k in range(3):
        c, v = triangles[:, k], triangles[:, (k + 1) % 3] - triangles[:, k]
        best = min(best, float(_segments(a, u, c, v).min()))
    n = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    start, rate = ((triangles[:, 0] - a) * n).sum(axis=1), n @ u
    for t in np.flatnonzero(np.abs(rate) > 0.0):
        share = start[t] / rate[t]
        if 0.0 <= share <= 1.0:
            best = min(best, float(naive.closest(triangles[t : t + 1], a + share * u)[1][0]))
    return best


def _segments(a: np.ndarray, u: np.ndarray, c: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Distances of the segment a, a + u to the segments c, c + v (m, 3): the best of the ends'
    feet and of the pair of the two lines."""
    w = c - a
    uu, vv, uv = u @ u, (v * v).sum(axis=1), v @ u
    wu, wv = w @ u, (w * v).sum(axis=1)
    det = np.maximum(uu * vv - uv * uv, 1e-300)
    s = np.clip((wu * vv - wv * uv) / det, 0.0, 1.0)
    found = []
    for s_k in (s, np.zeros(len(c)), np.ones(len(c))):
        t = np.clip((s_k * uv - wv) / vv, 0.0, 1.0)
        s_l = np.clip((t * uv + wu) / uu, 0.0, 1.0)
        t_l = np.clip((s_l * uv - wv) / vv, 0.0, 1.0)
        gap = (a + s_l[:, None] * u) - (c + t_l[:, None] * v)
        found.append(np.linalg.norm(gap, axis=1))
    return np.min(found, axis=0)


def capsules_clearance(
    arm: object,
    q: np.ndarray,
    after: np.ndarray,
    triangles: np.ndarray,
    start: pin.SE3,
    end: pin.SE3,
) -> float:
    """The least clearance of any capsule on the joints' way, by conservative advancement.

    The ends' speed is bounded by what a fine sampling shows, and a quarter more.
    """
    axes = arm.axes  # type: ignore[attr-defined]
    marks = np.linspace(0.0, 1.0, 17)
    ways = np.array([axes(q + s * (after - q)) for s in marks])  # (17, k, 2, 3)
    pace = 1.25 * 16.0 * np.linalg.norm(np.diff(ways, axis=0), axis=3).max() + 1e-9
    least = np.inf
    for k, capsule in enumerate(arm.capsules):  # type: ignore[attr-defined]
        share = 0.0
        while True:
            pose = between(start, end, share)
            a, b = (pose.actInv(p) for p in axes(q + share * (after - q))[k])
            gap = axis_gap(triangles, a, b) - capsule.radius
            least = min(least, gap)
            if gap <= TOUCH or share >= 1.0:
                break
            far = max(float(np.linalg.norm(a)), float(np.linalg.norm(b)))
            rate = pace + speed(start, end, far + gap + pace)
            share = min(share + max(gap / rate, 1e-5), 1.0)
    return least

"""What deforming structures did to a tool, from the true motion: shares no code with `vf`.

Vertices go straight from where they are to where they will be, in the frame of their structure,
which moves by a constant twist.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pinocchio as pin

from tests.support import moving, naive

TOUCH = moving.TOUCH
HERE = pin.SE3.Identity()


def clearance(
    before: np.ndarray,
    after: np.ndarray,
    place: Callable[[float], np.ndarray],
    reach: float,
    radius: float = 0.0,
    start: pin.SE3 = HERE,
    end: pin.SE3 = HERE,
) -> float:
    """The least clearance of a point of the tool on its way, at most `TOUCH` below the true one.

    By conservative advancement: no step in time is longer than the clearance divided by a bound on
    the speed. Ends when the tool touches a triangle.

    Args:
        before, after: (m, 3, 3) corners of the triangles at the start and the end of the tick,
            frame of the structure.
        place: where the point is at a share of the tick, base frame.
        reach: no part of its path is longer than this times its part of the tick [m].
        radius: of the ball around it [m].
        start, end: pose of the structure.
    """
    pace = float(np.linalg.norm(after - before, axis=2).max())
    share, least = 0.0, np.inf
    while True:
        p = moving.between(start, end, share).actInv(place(share))
        triangles = before + share * (after - before)
        gap = float(naive.closest(triangles, p)[1].min()) - radius
        least = min(least, gap)
        if gap <= TOUCH or share >= 1.0:
            return least
        rate = pace + reach + moving.speed(start, end, float(np.linalg.norm(p)) + gap + reach)
        share = min(share + max(gap / rate, 1e-6), 1.0)


def crossings(
    before: np.ndarray, after: np.ndarray, x: np.ndarray, y: np.ndarray
) -> list[tuple[float, int]]:
    """When a point that goes straight from x to y (3,) meets triangles (m, 3, 3), and which.

    The point and the three corners of a triangle are in one plane at the roots of a cubic in time;
    it meets the triangle where it is inside of it then.
    """
    found = []
    for t, (first, last) in enumerate(zip(before, after, strict=True)):
        # Differences to the point, each linear in time: (start, rate).
        corners = [(a - x, (b - a) - (y - x)) for a, b in zip(first, last, strict=True)]
        cubic = np.zeros(4)
        for i in (0, 1):
            for j in (0, 1):
                for k in (0, 1):
                    volume = np.dot(corners[0][i], np.cross(corners[1][j], corners[2][k]))
                    cubic[3 - i - j - k] += volume
        scale = np.abs(cubic).max()
        if scale == 0.0:
            continue
        for root in np.roots(np.trim_zeros(cubic, "f")):
            share = float(root.real)
            if abs(root.imag) > 1e-9 or not 0.0 <= share <= 1.0:
                continue
            a, b, c = (s + share * r for s, r in corners)
            n = np.cross(b - a, c - a)
            parts = [np.dot(n, np.cross(p, q)) for p, q in ((a, b), (b, c), (c, a))]
            if min(parts) >= 0.0:
                found.append((share, t))
    return sorted(found)


def winding(triangles: np.ndarray, p: np.ndarray) -> float:
    """Winding number of triangles (m, 3, 3) around a point: the sum of solid angles."""
    a, b, c = (triangles[:, k] - p for k in range(3))
    la, lb, lc = (np.linalg.norm(v, axis=1) for v in (a, b, c))
    top = (a * np.cross(b, c)).sum(axis=1)
    bottom = (
        la * lb * lc + (a * b).sum(axis=1) * lc + (b * c).sum(axis=1) * la
        + (c * a).sum(axis=1) * lb
    )  # fmt: skip
    return float(2.0 * np.arctan2(top, bottom).sum() / (4.0 * np.pi))


def depth(triangles: np.ndarray, p: np.ndarray, radius: float = 0.0) -> float:
    """How deep a ball is in a closed body [m]; ≤ 0: it is outside."""
    apart = float(naive.closest(triangles, p)[1].min())
    return radius + (apart if abs(winding(triangles, p)) > 0.5 else -apart)


def capsules_clearance(
    arm: object,
    q: np.ndarray,
    to: np.ndarray,
    before: np.ndarray,
    after: np.ndarray,
    start: pin.SE3,
    end: pin.SE3,
) -> float:
    """`clearance` of the nearest capsule of an arm on the joints' way from q to `to`.

    The ends' speed is bounded by what a fine sampling shows, and a quarter more.
    """
    axes = arm.axes  # type: ignore[attr-defined]
    marks = np.linspace(0.0, 1.0, 17)
    ways = np.array([axes(q + s * (to - q)) for s in marks])  # (17, k, 2, 3)
    pace = 1.25 * 16.0 * np.linalg.norm(np.diff(ways, axis=0), axis=3).max() + 1e-9
    pace += float(np.linalg.norm(after - before, axis=2).max())
    least = np.inf
    for k, capsule in enumerate(arm.capsules):  # type: ignore[attr-defined]
        share = 0.0
        while True:
            pose = moving.between(start, end, share)
            a, b = (pose.actInv(p) for p in axes(q + share * (to - q))[k])
            triangles = before + share * (after - before)
            gap = moving.axis_gap(triangles, a, b) - capsule.radius
            least = min(least, gap)
            if gap <= TOUCH or share >= 1.0:
                break
            far = max(float(np.linalg.norm(a)), float(np.linalg.norm(b)))
            rate = pace + moving.speed(start, end, far + gap + pace)
            share = min(share + max(gap / rate, 1e-5), 1.0)
    return least

"""Distances of convex hulls by the Frank-Wolfe algorithm, with a proof of how good they are."""

from __future__ import annotations

import numpy as np


def distance_bounds(P: np.ndarray, Q: np.ndarray, gap: float = 1e-7) -> tuple[float, float]:
    """Upper and lower bound on the distance of the hulls of points P (i, 3) and Q (j, 3) [m].

    The hull of all differences is searched for its point nearest to zero, by Wolfe's fully
    corrective steps over the corners found so far (Wolfe 1976); the lower bound is that of the
    plane across the point found.
    """
    corners = (P[:, None] - Q[None]).reshape(-1, 3)
    kept = [int(np.argmin((corners * corners).sum(axis=1)))]
    while True:
        v = _nearest_of_few(corners[kept])
        size = float(np.linalg.norm(v))
        if size < 1e-12:
            return size, 0.0
        heights = corners @ v / size
        lowest = int(heights.argmin())
        if size - heights[lowest] < gap or lowest in kept:
            return size, max(float(heights[lowest]), 0.0)
        kept.append(lowest)


def _nearest_of_few(points: np.ndarray) -> np.ndarray:
    """Point of the hull of few points nearest to zero: the best of all subsets of up to four."""
    best, found = np.inf, points[0]
    k = len(points)
    for mask in range(1, 1 << k):
        rows = [i for i in range(k) if mask >> i & 1]
        if len(rows) > 4:
            continue
        A = points[rows]
        # Weights that sum to one and make the point as short as possible.
        W = np.vstack([A.T, 1e3 * np.ones(len(rows))])
        weights = np.linalg.lstsq(W, np.array([0, 0, 0, 1e3]), rcond=None)[0]
        if (weights >= -1e-12).all():
            weights = np.maximum(weights, 0.0) / np.maximum(weights, 0.0).sum()
            v = weights @ A
            if v @ v < best:
                best, found = float(v @ v), v
    return found

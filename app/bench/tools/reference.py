"""Reference answers for `bench peers`, independent of `vf`."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls
from scipy.spatial import cKDTree

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


def distances(corners: FloatArray, x: FloatArray) -> FloatArray:
    """Distance of x (3,) to each triangle of corners (k, 3, 3), in their unit.

    To the projection onto the plane if it is in the triangle, else to the nearest edge.
    """
    a, b, c = corners.transpose(1, 0, 2)
    best = np.full(len(corners), np.inf)
    for p, q in ((a, b), (b, c), (c, a)):
        d = q - p
        length2 = np.einsum("ij,ij->i", d, d)
        with np.errstate(divide="ignore", invalid="ignore"):
            t = np.clip(np.einsum("ij,ij->i", x - p, d) / length2, 0.0, 1.0)
        foot = p + np.where(length2 > 0.0, t, 0.0)[:, None] * d
        best = np.minimum(best, np.linalg.norm(x - foot, axis=1))
    normal = np.cross(b - a, c - a)
    area2 = np.einsum("ij,ij->i", normal, normal)
    inside = area2 > 0.0
    for p, q in ((a, b), (b, c), (c, a)):
        inside &= np.einsum("ij,ij->i", np.cross(normal, q - p), x - p) >= 0.0
    height = np.abs(np.einsum("ij,ij->i", normal[inside], x - a[inside]))
    best[inside] = np.minimum(best[inside], height / np.sqrt(area2[inside]))
    return best


class Centroids:
    """A k-d tree over centroids, made exact by widening each query by the largest triangle."""

    def __init__(self, vertices: FloatArray, faces: IntArray) -> None:
        self.corners = np.ascontiguousarray(vertices[faces])
        middle = self.corners.mean(axis=1)
        self._reach = float(np.linalg.norm(self.corners - middle[:, None], axis=2).max())
        self._tree = cKDTree(middle)

    def nearest(self, x: FloatArray) -> tuple[float, int]:
        """Distance and index of the nearest triangle."""
        d, _ = self._tree.query(x)
        near = self._candidates(x, float(d))
        exact = distances(self.corners[near], x)
        k = int(np.argmin(exact))
        return float(exact[k]), int(near[k])

    def within(self, x: FloatArray, radius: float) -> tuple[IntArray, FloatArray]:
        """Triangles cut by the closed ball around x, and their distances."""
        near = self._candidates(x, radius)
        exact = distances(self.corners[near], x)
        keep = exact <= radius
        return near[keep], exact[keep]

    def _candidates(self, x: FloatArray, radius: float) -> IntArray:
        found = self._tree.query_ball_point(x, (radius + self._reach) * (1.0 + 1e-9))
        return np.asarray(found, dtype=np.int64)


def leak(
    corners: FloatArray, x: FloatArray, radius: float, normals: FloatArray, offsets: FloatArray
) -> float:
    """Largest distance by which a sample of triangles (k, 3, 3) is in front of every plane [m].

    Samples are corners, edge midpoints and centroids in the ball; ≤ 0: no leak.
    """
    a, b, c = corners.transpose(1, 0, 2)
    points = np.concatenate([a, b, c, (a + b) / 2, (b + c) / 2, (c + a) / 2, (a + b + c) / 3])
    points = points[np.linalg.norm(points - x, axis=1) <= radius]
    if not len(points):
        return -np.inf
    if not len(offsets):
        return np.inf
    return float((points @ normals.T - offsets).min(axis=1).max())


def least_squares(
    J: FloatArray,
    d: FloatArray,
    damping: float,
    G: FloatArray,
    b: FloatArray,
    lower: FloatArray,
    upper: FloatArray,
) -> FloatArray:
    """The Δq (n,) of `vf.ConstrainedLeastSquares`, by least distance programming.

    C. L. Lawson, R. J. Hanson, "Solving Least Squares Problems", chapter 23: the multipliers are
    the solution of a non-negative least squares problem, found to rounding.

    Raises:
        ValueError: no Δq obeys the rows.
    """
    n = J.shape[1]
    L = np.linalg.cholesky(J.T @ J + damping * np.eye(n))
    u = np.linalg.solve(L, J.T @ d)  # u = Lᵀ Δq, the unconstrained optimum
    rows = np.vstack([G, np.eye(n), -np.eye(n)])
    A = np.linalg.solve(L, rows.T).T
    size = np.linalg.norm(A, axis=1)
    keep = size > 1e-12
    A = A[keep] / size[keep, None]
    h = np.concatenate([b, lower, -upper])[keep] / size[keep] - A @ u
    scale = max(float(np.abs(h).max()), 1e-12)
    E = np.vstack([A.T, h / scale])
    f = np.zeros(n + 1)
    f[n] = 1.0
    weights, _ = nnls(E, f, maxiter=50 * E.shape[1])
    r = E @ weights - f
    if abs(r[n]) < 1e-10:
        raise ValueError("no step obeys the rows")
    v = -scale * r[:n] / r[n]
    return np.linalg.solve(L.T, u + v)

"""An oracle that knows nothing of the fixtures: brute force over the whole mesh, in numpy."""

from __future__ import annotations

import numpy as np


class Oracle:
    """Crossings and winding numbers of a mesh: vertices (n, 3) [m], faces (m, 3)."""

    def __init__(self, vertices: np.ndarray, faces: np.ndarray) -> None:
        self.corners = np.asarray(vertices)[np.asarray(faces)]  # (m, 3, 3)
        self.low, self.high = self.corners.min(axis=1), self.corners.max(axis=1)

    def crossings(self, path: np.ndarray) -> int:
        """How many steps of a path (k, 3) cut a triangle (Möller–Trumbore, double sided)."""
        # Every triangle whose box meets the box of a stretch is tested against each of its steps.
        return sum(self._crossings(path[k : k + 51]) for k in range(0, len(path) - 1, 50))

    def _crossings(self, path: np.ndarray) -> int:
        low, high = path.min(axis=0) - 1e-6, path.max(axis=0) + 1e-6
        near = (self.low <= high).all(axis=1) & (self.high >= low).all(axis=1)
        a, b, c = self.corners[near].transpose(1, 0, 2)
        e1, e2 = b - a, c - a
        count = 0
        for k in np.flatnonzero((np.diff(path, axis=0) != 0.0).any(axis=1)):
            start, move = path[k], path[k + 1] - path[k]
            h = np.cross(move, e2)
            det = (e1 * h).sum(axis=1)
            with np.errstate(divide="ignore", invalid="ignore"):
                s = start - a
                u = (s * h).sum(axis=1) / det
                q = np.cross(s, e1)
                v = (q @ move) / det
                t = (e2 * q).sum(axis=1) / det
                hit = (u >= 0) & (v >= 0) & (u + v <= 1) & (t >= 0) & (t <= 1)
            count += bool(hit.any())
        return count

    def winding(self, x: np.ndarray) -> float:
        """Generalised winding number: the sum of solid angles (Van Oosterom and Strackee)."""
        a, b, c = (self.corners - x).transpose(1, 0, 2)
        la, lb, lc = (np.linalg.norm(v, axis=1) for v in (a, b, c))
        numerator = (a * np.cross(b, c)).sum(axis=1)
        denominator = (
            la * lb * lc + (a * b).sum(axis=1) * lc + (b * c).sum(axis=1) * la
            + (c * a).sum(axis=1) * lb
        )  # fmt: skip
        return float(np.arctan2(numerator, denominator).sum() / (2.0 * np.pi))

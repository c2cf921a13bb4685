"""How a mesh deforms at random: smooth fields of displacements, towards the tool and away."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from meshes.content import Arrays

FloatArray = NDArray[np.float64]

FASTEST = 0.1  # of a vertex [m/s]
FARTHEST = 4e-3  # of a vertex by one field [m]
FIELDS = 3
FRAME = 0.02  # from one shape to the next [s]


class Swelling:
    """A mesh that deforms from frame to frame; between two its vertices go straight.

    Args:
        mesh: at rest, with which it begins.
        period: of the control loop [s].
        fastest: no vertex is faster [m/s].

    Attributes:
        ticks: of a frame.
        vertices: (n, 3) of the shape that the mesh is on its way to [m].
    """

    def __init__(
        self, mesh: Arrays, period: float, rng: np.random.Generator, fastest: float = FASTEST
    ) -> None:
        self._rest, self._faces = mesh
        self._fastest = fastest
        self._known = [self._rest]
        self._rng = rng
        self.ticks = max(1, round(FRAME / period))
        self._duration = self.ticks * period
        size = float(np.ptp(self._rest, axis=0).max())
        fields = []
        for _ in range(FIELDS):
            wave = rng.normal(size=3) * np.pi * rng.uniform(0.5, 4.0) / size
            way = rng.normal(size=3)
            way /= np.linalg.norm(way)
            phase = rng.uniform(0.0, 2.0 * np.pi)
            fields.append(np.sin(self._rest @ wave + phase)[:, None] * way)
        self._fields = np.array(fields)  # (k, n, 3), none longer than 1
        self._amplitudes = np.zeros(FIELDS)
        self._rates = np.zeros(FIELDS)
        self._left = 0
        self.vertices = self._rest

    def go(self, face: int, towards: FloatArray) -> FloatArray:
        """The next shape (n, 3); where it can, the face comes nearer along a direction (3,)."""
        rng = self._rng
        if self._left == 0:
            self._left = int(rng.integers(1, 12))
            shares = rng.dirichlet(np.ones(FIELDS))
            speed = self._fastest * rng.random() ** rng.choice([1.0, 3.0]) * (rng.random() < 0.9)
            there = self._fields[:, self._faces[face, 0]] @ towards
            signs = np.where(there > 0.0, 1.0, -1.0) * (1.0 if rng.random() < 0.7 else -1.0)
            self._rates = 0.999 * speed * shares * signs
        self._left -= 1
        self._amplitudes = np.clip(
            self._amplitudes + self._rates * self._duration, -FARTHEST, FARTHEST
        )
        self.vertices = self._rest + np.tensordot(self._amplitudes, self._fields, axes=1)
        self._known.append(self.vertices)
        return self.vertices

    def at(self, time: float) -> FloatArray:
        """Vertices (n, 3) at a time from 0 to that of the newest shape [s]."""
        k = min(int(time / self._duration), len(self._known) - 2)
        share = time / self._duration - k
        first, last = self._known[k : k + 2]
        return first + min(share, 1.0) * (last - first)

"""What a ball cuts of a mesh, and the kernels of single queries."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from vf.planes import FloatArray, IntArray
from vf.tree.nearest import nearest_face
from vf.tree.within import closest_points, within_ball


class _Compiled:
    """The kernels of single queries, compiled for fixed types at the first use.

    Numba checks every argument of every call, a third of the time of a kernel of microseconds.
    Functions compiled here are not checked: the callers guarantee types and contiguous arrays.
    """

    @cached_property
    def nearest(self) -> Callable[..., tuple[float, int]]:
        return nearest_face.compile("(f8[:, ::1], f8[:, ::1], f8[::1], f8, i8, i8)")

    @cached_property
    def within(self) -> Callable[..., int]:
        return within_ball.compile("(f8[:, ::1], f8[:, ::1], i8[::1], f8[::1], f8, i8[::1])")


COMPILED = _Compiled()


class Contacts:
    """Triangles cut by a closed ball, one row each, in no particular order.

    Closest points, features and distances are computed at their first use.

    Attributes:
        triangles: (k,) faces, the caller's indices.
        points: (k, 3) closest points to the centre [m].
        features: (k,) values of `vf.Feature`.
        distances: (k,) [m].
    """

    def __init__(
        self, vertices: FloatArray, faces: IntArray, x: FloatArray, triangles: IntArray
    ) -> None:
        """Of the ball around x (3,), which must not change any more."""
        self._vertices, self._faces = vertices, faces
        self._x = x
        self.triangles = triangles

    def __len__(self) -> int:
        return len(self.triangles)

    @cached_property
    def _closest(self) -> tuple[FloatArray, NDArray[np.int8], FloatArray]:
        k = len(self.triangles)
        found = np.empty((k, 3)), np.empty(k, dtype=np.int8), np.empty(k)
        closest_points(self._vertices, self._faces, self.triangles, self._x, *found)
        return found

    @property
    def points(self) -> FloatArray:
        return self._closest[0]

    @property
    def features(self) -> NDArray[np.int8]:
        return self._closest[1]

    @property
    def distances(self) -> FloatArray:
        return self._closest[2]

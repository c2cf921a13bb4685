"""The arrays of a mesh, the result of every reader, and the limits that all readers keep."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from meshes.errors import MeshError

Arrays = tuple[NDArray[np.float64], NDArray[np.int64]]
"""Vertices ``(n, 3)`` [m] and faces ``(m, 3)``, the corners anticlockwise seen from outside."""

SIZE_LIMIT = 500_000_000  # [byte] of a file, also uncompressed: ten million triangles
RATIO = 50  # of the uncompressed size to the compressed one; text meshes reach about 10
UNPACKED = 10_000_000  # [byte] uncompressed, allowed to any file
PLACED = 1_000_000  # triangles that any file may place: about 1 s


@dataclass(frozen=True)
class Content:
    """The bodies of a file, each ``(vertices in the file's unit, faces)``, and its metadata."""

    bodies: list[Arrays]
    unit: str | None = None
    frame: str | None = None
    notes: tuple[str, ...] = ()
    """What the user should know, a sentence each."""


def checked(vertices: NDArray[np.float64], faces: NDArray[np.int64]) -> Arrays:
    """The arrays of a body.

    Raises:
        MeshError: wrong shapes, a vertex that is not finite, a corner that is no vertex.
    """
    if vertices.ndim != 2 or vertices.shape[1] != 3:
        raise MeshError(f"vertices of shape {vertices.shape} instead of (n, 3)")
    if faces.ndim != 2 or (len(faces) and faces.shape[1] != 3):
        raise MeshError(f"faces of shape {faces.shape} instead of (m, 3)")
    bad = ~np.isfinite(vertices).all(axis=1)
    if bad.any():
        count = int(bad.sum())
        are = "1 vertex is" if count == 1 else f"{count} vertices are"
        raise MeshError(f"{are} not finite, the first is vertex {bad.argmax()}")
    check_corners(faces, len(vertices))
    return vertices, faces.reshape(-1, 3)


def checked_mesh(vertices: ArrayLike, faces: ArrayLike | None) -> Arrays:
    """The arrays as ``(n, 3)`` float64 and ``(m, 3)`` int64, not copied if they already are.

    Raises:
        MeshError: no faces, wrong shapes, indices out of range, vertices that are not finite.
    """
    v, f = np.asarray(vertices, dtype=np.float64, order="C"), np.asarray(faces)
    if not np.issubdtype(f.dtype, np.integer):
        raise MeshError(f"faces must be integers of shape (m, 3), not {f.dtype} of {f.shape}")
    if len(f) == 0:
        raise MeshError("a mesh without faces")
    return checked(v, np.ascontiguousarray(f, dtype=np.int64))


def check_corners(corners: NDArray[np.int64], vertices: int) -> None:
    """Raise `MeshError` where a corner, in an array of any shape, is not one of the vertices."""
    if corners.size and (corners.min() < 0 or corners.max() >= vertices):
        worst = int(corners.min()) if corners.min() < 0 else int(corners.max())
        raise MeshError(f"a face refers to vertex {worst}, of {vertices} (counted from 0)")


def moved(
    vertices: NDArray[np.float64], faces: NDArray[np.int64], T: NDArray[np.float64]
) -> Arrays:
    """A body moved by an affine transform ``(4, 4)``; a mirror image is wound outwards again.

    Raises:
        MeshError: a vertex that is not finite then.
    """
    if np.array_equal(T, np.eye(4)):  # the product would round the coordinates
        return vertices, faces
    mirrored = np.linalg.det(T[:3, :3]) < 0
    return checked(vertices @ T[:3, :3].T + T[:3, 3], faces[:, ::-1] if mirrored else faces)


def compact(vertices: NDArray[np.float64], faces: NDArray[np.int64]) -> Arrays:
    """Copies with only the vertices that faces use, in their order."""
    used = np.zeros(len(vertices), dtype=bool)
    used[faces] = True
    return vertices[used], (np.cumsum(used) - 1)[faces]


def allowed_unpacked(packed: int) -> int:
    """The uncompressed size [byte] allowed to data of a compressed size."""
    return min(max(UNPACKED, RATIO * packed), SIZE_LIMIT)


def check_unpacked(size: int, packed: int) -> None:
    """Raise `MeshError` where ``size`` exceeds `allowed_unpacked`, before data is decompressed."""
    allowed = allowed_unpacked(packed)
    if size > allowed:
        raise MeshError(
            f"{packed:,} bytes unpack to {size / 1e6:,.0f} MB or more,"
            f" more than the {allowed / 1e6:,.0f} allowed"
        )


def allowed_placed(own: int) -> int:
    """The number of triangles that a file with ``own`` of them may place."""
    return max(PLACED, own)


def check_placed(triangles: int, own: int) -> None:
    """Raise `MeshError` where a scene exceeds `allowed_placed`, before it is built."""
    allowed = allowed_placed(own)
    if triangles > allowed:
        raise MeshError(f"places {triangles:,} triangles, more than the {allowed:,} allowed")


def cut_off(promised: str, found: str = "") -> MeshError:
    """The error of a file that holds less than its header or structure says."""
    less = f"but has {found}" if found else "but ends before"
    return MeshError(f"it promises {promised}, {less}: cut off or damaged")

"""The pose of a mesh in the arm's base frame, and the decimated copy that the page draws."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import fast_simplification
import numpy as np
from numpy.typing import ArrayLike, NDArray

from meshes.errors import MeshError

FloatArray = NDArray[np.float64]

GAP = 0.015  # [m] of free space between the tip and the side to be worked on
FARTHEST_MESH = 2.0  # [m] from the arm's base to a mesh's origin; farther is refused
# Rotations of a mesh's own axis to +z, where tools come from; about x where possible, which keeps
# left and right.
_UP: dict[str, FloatArray] = {
    "z": np.eye(3),
    "-z": np.diag([1.0, -1.0, -1.0]),
    "y": np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]),
    "-y": np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]]),
    "x": np.array([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]]),
    "-x": np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]]),
}
UPS = tuple(_UP)
"""Names of a mesh's own axes that may face the tool."""


class Pose(Protocol):
    """A rigid transform that knows its 4 × 4 matrix, such as ``pinocchio.SE3``."""

    @property
    def homogeneous(self) -> FloatArray: ...


class Display(NamedTuple):
    """What the page draws: vertices ``(n, 3)`` [m], faces ``(m, 3)``, whether decimated."""

    vertices: FloatArray
    faces: NDArray[np.int64]
    decimated: bool


@dataclass(frozen=True)
class Placement:
    """The pose of a mesh in the arm's base frame: rotated first, then translated, never scaled.

    Tools come from above, +z of the base frame. The catalogue's meshes have the side to be worked
    on at +z; anatomy is in head axes, x to the right, y to the front.

    Attributes:
        at: ``(x, y, z)`` [m] of the mesh's own origin in the base frame. None: automatic, the
            middle of the top of the turned bounding box `GAP` below the tip's neutral pose, which
            for a PSM is straight under the remote centre.
        rotate: turns [rad] about the base frame's x, then y, then z axis, after ``up``.
        up: the mesh's own axis that faces the tool, one of `UPS`.

    Raises:
        MeshError: not finite, ``at`` farther than `FARTHEST_MESH`, an unknown axis.
    """

    at: tuple[float, float, float] | None = None
    rotate: tuple[float, float, float] = (0.0, 0.0, 0.0)
    up: str = "z"

    def __post_init__(self) -> None:
        if self.up not in _UP:
            raise MeshError(f"unknown axis {self.up!r}: choose one of {', '.join(UPS)}")
        for name, value in (("at", self.at), ("rotate", self.rotate)):
            if value is None:
                continue
            if len(value) != 3 or not all(math.isfinite(number) for number in value):
                raise MeshError(f"{name} must be three finite numbers, not {value}")
        if self.at is not None and math.hypot(*self.at) > FARTHEST_MESH:
            raise MeshError(
                f"at {', '.join(f'{x:g} m' for x in self.at)} is more than {FARTHEST_MESH:g} m "
                "from the arm's base: is the unit right?"
            )

    @property
    def rotation(self) -> FloatArray:
        """``(3, 3)``, from the mesh's own axes to the base frame's."""
        (cx, cy, cz), (sx, sy, sz) = np.cos(self.rotate), np.sin(self.rotate)
        X = np.array([[1.0, 0.0, 0.0], [0.0, cx, -sx], [0.0, sx, cx]])
        Y = np.array([[cy, 0.0, sy], [0.0, 1.0, 0.0], [-sy, 0.0, cy]])
        Z = np.array([[cz, -sz, 0.0], [sz, cz, 0.0], [0.0, 0.0, 1.0]])
        return np.asarray(Z @ Y @ X @ _UP[self.up])

    def pose(
        self, vertices: ArrayLike, T_base_tip_neutral: Pose | ArrayLike, gap: float = GAP
    ) -> FloatArray:
        """``T_base_mesh`` ``(4, 4)`` of a mesh with these vertices ``(n, 3)`` [m].

        Raises:
            MeshError: no vertices.
            ValueError: the tip's pose is no finite 4 × 4 matrix.
        """
        points = np.asarray(vertices, dtype=np.float64)
        if points.ndim != 2 or points.shape[1] != 3 or len(points) == 0:
            raise MeshError(f"cannot place vertices of shape {points.shape}: give (n, 3), n > 0")
        tip = np.asarray(
            getattr(T_base_tip_neutral, "homogeneous", T_base_tip_neutral), dtype=np.float64
        )
        if tip.shape != (4, 4) or not np.isfinite(tip).all():
            raise ValueError(f"T_base_tip_neutral must be a pose or a finite 4 x 4 matrix: {tip}")
        T_base_mesh = np.eye(4)
        T_base_mesh[:3, :3] = self.rotation
        if self.at is not None:
            T_base_mesh[:3, 3] = self.at
        else:
            turned = transformed(T_base_mesh, points)
            low, high = turned.min(axis=0), turned.max(axis=0)
            top = np.array([(low[0] + high[0]) / 2, (low[1] + high[1]) / 2, high[2]])
            T_base_mesh[:3, 3] = tip[:3, 3] - np.array([0.0, 0.0, gap]) - top
        return T_base_mesh


AUTOMATIC = Placement()


def transformed(T: ArrayLike, points: ArrayLike) -> FloatArray:
    """Points ``(n, 3)`` moved by a rigid transform ``(4, 4)``: a new array.

    A translation is a sum alone, so that no coordinate is rounded twice.
    """
    T, points = np.asarray(T, dtype=np.float64), np.asarray(points, dtype=np.float64)
    if np.array_equal(T[:3, :3], np.eye(3)):
        return points + T[:3, 3]
    return np.asarray(points @ T[:3, :3].T + T[:3, 3])


def placement(
    vertices: ArrayLike, T_base_tip_neutral: Pose | ArrayLike, gap: float = GAP
) -> FloatArray:
    """The translation ``(3,)`` [m] of the automatic `Placement`, which does not rotate."""
    return AUTOMATIC.pose(vertices, T_base_tip_neutral, gap)[:3, 3]


def place(
    vertices: ArrayLike, T_base_tip_neutral: Pose | ArrayLike, gap: float = GAP
) -> FloatArray:
    """The vertices ``(n, 3)`` [m] under the arm's tip, in its base frame, by the automatic
    `Placement`: a new array. Apply it once, before the ``Surface`` is built."""
    return transformed(AUTOMATIC.pose(vertices, T_base_tip_neutral, gap), vertices)


def display(
    vertices: FloatArray, faces: NDArray[np.int64], limit: int = 60_000, exact: int = 100_000
) -> Display:
    """What to draw: the arrays up to ``exact`` triangles, else a decimated copy of ``limit``.

    Control always queries the full mesh. Quadric decimation keeps the shape within a fraction of an
    edge; where it cannot reach the limit (open edges everywhere), triangles are dropped evenly. It
    holds the interpreter lock throughout, seconds for a million triangles: beside a control loop,
    call this in another process.
    """
    if limit < 4:
        raise ValueError(f"limit must be at least 4 triangles, not {limit}")
    if len(faces) <= max(limit, exact):
        return Display(vertices, faces, False)
    thin_vertices, thin_faces = fast_simplification.simplify(
        vertices, faces.astype(np.int32), target_count=limit
    )
    if not 0 < len(thin_faces) <= limit:
        keep = np.linspace(0, len(faces) - 1, limit).astype(np.int64)
        return Display(vertices, faces[keep], True)
    return Display(thin_vertices.astype(np.float64), thin_faces.astype(np.int64), True)

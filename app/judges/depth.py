"""How deep the bodies of an instrument are in a mesh: by distances and winding numbers."""

from __future__ import annotations

from heapq import heappop, heappush

import numpy as np
from numpy.typing import NDArray

from app.judges.boxes import Boxes
from app.judges.nearest import nearest
from vf.kernels import njit

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

ENOUGH = 400  # places of an axis that are looked at


def closed(faces: IntArray) -> bool:
    """Whether every edge of the triangles (m, 3) is walked as often one way as the other."""
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]).astype(np.int64)
    size = int(faces.max(initial=0)) + 1
    one, other = edges[:, 0] * size + edges[:, 1], edges[:, 1] * size + edges[:, 0]
    return bool((np.sort(one) == np.sort(other)).all())


def signed(boxes: Boxes, p: FloatArray, is_closed: bool) -> float:
    """How deep a point p (3,) is in a mesh [m]; minus its distance where it is outside.

    A mesh that is not closed has no inside.
    """
    gap = nearest(boxes, np.stack([p, p]))[0]
    inside = is_closed and abs(winding(boxes.vertices, boxes.faces, p)) > 0.5
    return gap if inside else -gap


def deeper(boxes: Boxes, axis: FloatArray, radius: float, than: float, is_closed: bool) -> bool:
    """Whether a point of a capsule's axis (2, 3) is found that is deeper than that [m].

    The capsule's radius counts. The depth changes along the axis by no more than one does oneself:
    pieces of it that cannot be deeper are left out, and of the others the one that may be deepest
    is halved next, up to `ENOUGH` times. A mesh that is not closed has no inside: a capsule whose
    axis meets it is as deep as its radius.
    """
    need = than - radius
    a, b = axis
    length = float(np.linalg.norm(b - a))
    if max(signed(boxes, a, is_closed), signed(boxes, b, is_closed)) > need:
        return True
    waiting = [(-np.inf, 0.0, 1.0)]
    for _ in range(ENOUGH):
        if not waiting:
            break
        _bound, low, high = heappop(waiting)
        middle, half = 0.5 * (low + high), 0.5 * (high - low) * length
        here = signed(boxes, a + middle * (b - a), is_closed)
        if here > need:
            return True
        if here + half > need:
            heappush(waiting, (-(here + half), low, middle))
            heappush(waiting, (-(here + half), middle, high))
    return False


@njit(cache=True, nogil=True)
def winding(vertices, faces, x):  # type: ignore[no-untyped-def]
    """Winding number of triangles about x (3,).

    A. Van Oosterom, J. Strackee, "The solid angle of a plane triangle", IEEE TBME 30(2), 1983.
    """
    total = 0.0
    for t in range(faces.shape[0]):
        a, b, c = vertices[faces[t, 0]], vertices[faces[t, 1]], vertices[faces[t, 2]]
        ax, ay, az = a[0] - x[0], a[1] - x[1], a[2] - x[2]
        bx, by, bz = b[0] - x[0], b[1] - x[1], b[2] - x[2]
        cx, cy, cz = c[0] - x[0], c[1] - x[1], c[2] - x[2]
        la = np.sqrt(ax * ax + ay * ay + az * az)
        lb = np.sqrt(bx * bx + by * by + bz * bz)
        lc = np.sqrt(cx * cx + cy * cy + cz * cz)
        ab = ax * bx + ay * by + az * bz
        bc = bx * cx + by * cy + bz * cz
        ca = cx * ax + cy * ay + cz * az
        volume = ax * (by * cz - bz * cy) + ay * (bz * cx - bx * cz) + az * (bx * cy - by * cx)
        total += np.arctan2(volume, la * lb * lc + ab * lc + bc * la + ca * lb)
    return total / (2.0 * np.pi)

"""Closed bodies of a mesh: their volumes, which lies inside which, which are inside out."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from meshes.topology import Topology
from vf.kernels import njit

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


@dataclass(frozen=True)
class Bodies:
    """The closed, two-sided patches of a mesh, each wound as most of its faces are.

    Attributes:
        patches: ``(k,)`` their numbers in the `Topology`.
        volumes: ``(k,)`` [m³], negative where the faces look inwards.
        outermost: ``(k,)`` row of the outermost body around each one; its own row if none is.
        inside_out: ``(k,)`` bodies to be turned: outermost ones with negative volume, and what
            lies in them. An inner body keeps its winding relative to the outermost one around it:
            whether it is a cavity or a body of its own is for the file to say.
    """

    patches: IntArray
    volumes: FloatArray
    outermost: IntArray
    inside_out: NDArray[np.bool_]


def bodies(vertices: FloatArray, faces: IntArray, topology: Topology) -> Bodies:
    """The bodies of the mesh ``vertices`` ``(n, 3)`` [m], ``faces`` ``(m, 3)``."""
    patches = np.flatnonzero(topology.closed & ~topology.one_sided)
    row = np.full(len(topology.closed), -1, dtype=np.int64)
    row[patches] = np.arange(len(patches))
    body = row[topology.patches]
    middle = 0.5 * (vertices.min(axis=0) + vertices.max(axis=0)) if len(vertices) else np.zeros(3)
    volumes = np.zeros(len(patches))
    _volumes(vertices, faces, body, topology.minority, middle, volumes)
    outermost = np.arange(len(patches))
    if len(patches) > 1:
        outermost = _outermost(vertices, faces, body, len(patches))
    return Bodies(patches, volumes, outermost, volumes[outermost] < 0.0)


@njit(cache=True, nogil=True)
def _volumes(vertices, faces, body, minority, middle, volumes):  # type: ignore[no-untyped-def]
    for f in range(faces.shape[0]):
        if body[f] < 0:
            continue
        a = vertices[faces[f, 0]] - middle
        b = vertices[faces[f, 1]] - middle
        c = vertices[faces[f, 2]] - middle
        det = (
            a[0] * (b[1] * c[2] - b[2] * c[1])
            + a[1] * (b[2] * c[0] - b[0] * c[2])
            + a[2] * (b[0] * c[1] - b[1] * c[0])
        ) / 6.0
        volumes[body[f]] += -det if minority[f] else det


def _outermost(vertices: FloatArray, faces: IntArray, body: IntArray, count: int) -> IntArray:
    """Row of the outermost body around each: parity of a ray from a point of its first face."""
    first = np.full(count, -1, dtype=np.int64)
    rows = np.flatnonzero(body >= 0)[::-1]
    first[body[rows]] = rows
    # Slanted, and from an odd point of the face, so that drawn parts' straight edges are missed.
    R, _ = np.linalg.qr(np.array([[0.83, 0.21, 0.37], [-0.11, 0.71, 0.43], [0.29, -0.17, 0.91]]))
    turned = vertices @ R
    points = np.einsum("k,nkd->nd", np.array([0.4142, 0.2679, 0.3179]), turned[faces[first]])
    order = np.argsort(points[:, 0])
    sorted_points = np.ascontiguousarray(points[order])
    size = _hits(turned, faces, body, sorted_points, order, np.empty((0, 2), dtype=np.int64))
    hits = np.empty((size, 2), dtype=np.int64)
    _hits(turned, faces, body, sorted_points, order, hits)
    pairs, times = np.unique(hits[:, 0] * count + hits[:, 1], return_counts=True)
    pairs = pairs[times % 2 == 1]
    inner, outer = pairs // count, pairs % count
    depth = np.bincount(inner, minlength=count)
    result = np.arange(count)
    top = depth[outer] == 0
    result[inner[top]] = outer[top]
    return result


@njit(cache=True, nogil=True)
def _hits(points, faces, body, starts, names, hits):  # type: ignore[no-untyped-def]
    """(start, body) for each face of another body above a start; counts past the array's end."""
    found = 0
    xs = starts[:, 0].copy()
    for f in range(faces.shape[0]):
        if body[f] < 0:
            continue
        a, b, c = points[faces[f, 0]], points[faces[f, 1]], points[faces[f, 2]]
        low = min(a[0], min(b[0], c[0]))
        high = max(a[0], max(b[0], c[0]))
        for s in range(np.searchsorted(xs, low), xs.shape[0]):
            if xs[s] > high:
                break
            if names[s] == body[f]:
                continue
            x, y, z = starts[s, 0], starts[s, 1], starts[s, 2]
            u = (b[0] - x) * (c[1] - y) - (b[1] - y) * (c[0] - x)
            v = (c[0] - x) * (a[1] - y) - (c[1] - y) * (a[0] - x)
            w = (a[0] - x) * (b[1] - y) - (a[1] - y) * (b[0] - x)
            total = u + v + w
            if total == 0.0 or not ((u >= 0) == (v >= 0) and (v >= 0) == (w >= 0)):
                continue
            if (u * a[2] + v * b[2] + w * c[2]) / total > z:
                if found < hits.shape[0]:
                    hits[found, 0] = names[s]
                    hits[found, 1] = body[f]
                found += 1
    return found

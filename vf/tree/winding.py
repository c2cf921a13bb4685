"""Generalised winding number by a hierarchy of moments on the PD-tree.

Barill, Dickson, Schmidt, Levin, Jacobson, "Fast winding numbers for soups and clouds"
(SIGGRAPH 2018), to second order: far groups of triangles act as a dipole and a quadrupole. The
second term is for anatomy's sake: the dipoles of a thin shell's two sides cancel.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vf.kernels import njit
from vf.planes import FloatArray
from vf.tree.pdtree import STACK, Tree, children_of, triangles_of

# A node acts through its moments beyond this many of its radii; measured errors stay below 0.01.
FAR = 3.0


class Moments(NamedTuple):
    """Moments of every tree node (k, 13), and which triangles count.

    `nodes`: area vector N, area-weighted centre c, radius around it [m], and the symmetric part
    (xx, yy, zz, xy, xz, yz) of Σ Aᵢ nᵢ (pᵢ − c)ᵀ over the node's triangles with centroids pᵢ.

    `weights` (m,) is 1 for the triangles that count, in tree order, and 0 for repetitions.
    """

    nodes: FloatArray
    weights: FloatArray


def moments(tree: Tree, counts: NDArray[np.bool_]) -> Moments:
    """Moments over the triangles for which `counts` (m,), in the caller's order, holds."""
    weights = counts[tree.order].astype(np.float64)
    nodes = np.zeros((len(tree.nodes), 13))
    _moments(tree, weights, nodes)
    # As all arrays of a surface: a kernel that met both kinds would be compiled for each.
    nodes.flags.writeable = weights.flags.writeable = False
    return Moments(nodes, weights)


@njit(cache=True, nogil=True)
def _moments(tree, weights, nodes):  # type: ignore[no-untyped-def]
    area = np.zeros(nodes.shape[0])
    # Children come after their parents, so a walk from the end finds them done.
    for node in range(nodes.shape[0] - 1, -1, -1):
        link = tree.nodes[node, 15]
        if link > 0.0:
            first, last = children_of(link)
            for child in range(first, last):
                for k in range(3):
                    nodes[node, k] += nodes[child, k]
                    nodes[node, 3 + k] += area[child] * nodes[child, 3 + k]
                area[node] += area[child]
        else:
            first, last = triangles_of(link)
            for t in range(first, last):
                c = tree.corners[t]
                ux, uy, uz = c[3] - c[0], c[4] - c[1], c[5] - c[2]
                vx, vy, vz = c[6] - c[0], c[7] - c[1], c[8] - c[2]
                nx = 0.5 * weights[t] * (uy * vz - uz * vy)
                ny = 0.5 * weights[t] * (uz * vx - ux * vz)
                nz = 0.5 * weights[t] * (ux * vy - uy * vx)
                a = np.sqrt(nx * nx + ny * ny + nz * nz)
                nodes[node, 0] += nx
                nodes[node, 1] += ny
                nodes[node, 2] += nz
                for k in range(3):
                    nodes[node, 3 + k] += a * (c[k] + c[3 + k] + c[6 + k]) / 3.0
                area[node] += a
        box = tree.nodes[node]
        spread = 0.0
        for k in range(3):
            if area[node] > 0.0:
                nodes[node, 3 + k] /= area[node]
            else:
                nodes[node, 3 + k] = box[k]
            spread += (nodes[node, 3 + k] - box[k]) ** 2
        if link > 0.0:
            for child in range(first, last):
                for k in range(6):
                    nodes[node, 7 + k] += nodes[child, 7 + k]
                _add_product(
                    nodes[node],
                    nodes[child, 0],
                    nodes[child, 1],
                    nodes[child, 2],
                    nodes[child, 3] - nodes[node, 3],
                    nodes[child, 4] - nodes[node, 4],
                    nodes[child, 5] - nodes[node, 5],
                )
        else:
            for t in range(first, last):
                c = tree.corners[t]
                ux, uy, uz = c[3] - c[0], c[4] - c[1], c[5] - c[2]
                vx, vy, vz = c[6] - c[0], c[7] - c[1], c[8] - c[2]
                _add_product(
                    nodes[node],
                    0.5 * weights[t] * (uy * vz - uz * vy),
                    0.5 * weights[t] * (uz * vx - ux * vz),
                    0.5 * weights[t] * (ux * vy - uy * vx),
                    (c[0] + c[3] + c[6]) / 3.0 - nodes[node, 3],
                    (c[1] + c[4] + c[7]) / 3.0 - nodes[node, 4],
                    (c[2] + c[5] + c[8]) / 3.0 - nodes[node, 5],
                )
        nodes[node, 6] = np.sqrt(spread) + np.sqrt(box[3] ** 2 + box[4] ** 2 + box[5] ** 2)


@njit(cache=True, nogil=True, inline="always")
def _add_product(node, nx, ny, nz, rx, ry, rz):  # type: ignore[no-untyped-def]
    """Add the symmetric part of n rᵀ to a node's second moment."""
    node[7] += nx * rx
    node[8] += ny * ry
    node[9] += nz * rz
    node[10] += 0.5 * (nx * ry + ny * rx)
    node[11] += 0.5 * (nx * rz + nz * rx)
    node[12] += 0.5 * (ny * rz + nz * ry)


@njit(cache=True, nogil=True)
def winding_number(tree, dipoles, x, y, z):  # type: ignore[no-untyped-def]
    """Winding number of the weighted triangles around a point; solid angles by Van Oosterom."""
    stack = np.empty(STACK, dtype=np.int32)
    stack[0] = 0
    depth = 1
    total = 0.0
    nodes = dipoles.nodes
    while depth > 0:
        depth -= 1
        node = stack[depth]
        dx, dy, dz = nodes[node, 3] - x, nodes[node, 4] - y, nodes[node, 5] - z
        d2 = dx * dx + dy * dy + dz * dz
        if d2 > (FAR * nodes[node, 6]) ** 2:
            c = nodes[node]
            trace = c[7] + c[8] + c[9]
            squeeze = (
                dx * (dx * c[7] + 2.0 * (dy * c[10] + dz * c[11]))
                + dy * (dy * c[8] + 2.0 * dz * c[12])
                + dz * dz * c[9]
            )
            total += (dx * c[0] + dy * c[1] + dz * c[2] + trace - 3.0 * squeeze / d2) / (
                d2 * np.sqrt(d2)
            )
            continue
        link = tree.nodes[node, 15]
        if link > 0.0:
            first, last = children_of(link)
            for child in range(first, last):
                stack[depth] = child
                depth += 1
            continue
        first, last = triangles_of(link)
        for t in range(first, last):
            if dipoles.weights[t] == 0.0:
                continue
            c = tree.corners[t]
            ax, ay, az = c[0] - x, c[1] - y, c[2] - z
            bx, by, bz = c[3] - x, c[4] - y, c[5] - z
            ex, ey, ez = c[6] - x, c[7] - y, c[8] - z
            la = np.sqrt(ax * ax + ay * ay + az * az)
            lb = np.sqrt(bx * bx + by * by + bz * bz)
            le = np.sqrt(ex * ex + ey * ey + ez * ez)
            det = ax * (by * ez - bz * ey) + ay * (bz * ex - bx * ez) + az * (bx * ey - by * ex)
            div = (
                la * lb * le
                + (ax * bx + ay * by + az * bz) * le
                + (bx * ex + by * ey + bz * ez) * la
                + (ex * ax + ey * ay + ez * az) * lb
            )
            total += 2.0 * np.arctan2(det, div)
    return total / (4.0 * np.pi)

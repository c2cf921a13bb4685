"""Building a PD-tree: boxes along the principal directions of what they hold, split at the mean.

After the covariance trees of the paper's section III-A.
"""

from __future__ import annotations

import numpy as np

from vf.kernels import njit
from vf.planes import FloatArray, IntArray
from vf.tree.closest import distance_error
from vf.tree.pdtree import EXACT, STACK, Tree

LEAF = 6


def build(vertices: FloatArray, faces: IntArray, leaf: int = LEAF) -> Tree:
    """PD-tree of the triangles `faces` (m, 3) over `vertices` (n, 3) [m]; leaf < 64."""
    m = len(faces)
    corners = np.ascontiguousarray(vertices[faces].reshape(m, 9))
    centroids = (corners[:, 0:3] + corners[:, 3:6] + corners[:, 6:9]) / 3.0
    boxes = np.empty((2 * m, 15))
    links = np.empty((2 * m, 3), dtype=np.int32)
    order = np.arange(m, dtype=np.int64)
    count = _build(corners, centroids, boxes, links, order, leaf)
    nodes = np.empty((count, 16))
    kept = _quadruple(boxes, links, nodes)
    return Tree(nodes[:kept].copy(), corners, order, _errors(corners))


@njit(cache=True, nogil=True)
def _principal(cov, axes):  # type: ignore[no-untyped-def]
    """Rows of `axes` become the eigenvectors of the symmetric (3, 3) `cov`, largest first.

    Cyclic Jacobi: exact orthogonality matters here, the last digits of the directions do not.
    """
    for i in range(3):
        for j in range(3):
            axes[i, j] = 1.0 if i == j else 0.0
    scale = cov[0, 0] + cov[1, 1] + cov[2, 2]
    for _ in range(8):
        off = abs(cov[0, 1]) + abs(cov[0, 2]) + abs(cov[1, 2])
        if off <= 1e-12 * scale:
            break
        for p in range(2):
            for q in range(p + 1, 3):
                if cov[p, q] == 0.0:
                    continue
                theta = (cov[q, q] - cov[p, p]) / (2.0 * cov[p, q])
                t = 1.0 / (abs(theta) + np.sqrt(theta * theta + 1.0))
                if theta < 0.0:
                    t = -t
                c = 1.0 / np.sqrt(t * t + 1.0)
                s = t * c
                for k in range(3):
                    kp, kq = cov[k, p], cov[k, q]
                    cov[k, p] = c * kp - s * kq
                    cov[k, q] = s * kp + c * kq
                for k in range(3):
                    pk, qk = cov[p, k], cov[q, k]
                    cov[p, k] = c * pk - s * qk
                    cov[q, k] = s * pk + c * qk
                for k in range(3):
                    pk, qk = axes[p, k], axes[q, k]
                    axes[p, k] = c * pk - s * qk
                    axes[q, k] = s * pk + c * qk
    for i in range(2):
        for j in range(i + 1, 3):
            if cov[j, j] > cov[i, i]:
                cov[i, i], cov[j, j] = cov[j, j], cov[i, i]
                for k in range(3):
                    axes[i, k], axes[j, k] = axes[j, k], axes[i, k]


@njit(cache=True, nogil=True)
def _build(corners, centroids, boxes, links, order, leaf):  # type: ignore[no-untyped-def]
    """Binary tree: fill boxes, and links: first child (the second follows) or −1, triangle, count.

    `corners` and `centroids` are permuted along with `order`.
    """
    m = order.shape[0]
    cov = np.empty((3, 3))
    axes = np.empty((3, 3))
    mean = np.empty(3)
    low = np.empty(3)
    high = np.empty(3)
    queue = np.empty(STACK, dtype=np.int64)
    links[0, 1] = 0
    links[0, 2] = m
    nodes = 1
    queue[0] = 0
    waiting = 1
    while waiting > 0:
        waiting -= 1
        node = queue[waiting]
        first = links[node, 1]
        count = links[node, 2]
        last = first + count

        for k in range(3):
            mean[k] = 0.0
        for t in range(first, last):
            for j in range(9):
                mean[j % 3] += corners[t, j]
        for k in range(3):
            mean[k] /= 3.0 * count
        cxx = cxy = cxz = cyy = cyz = czz = 0.0
        for t in range(first, last):
            for j in range(0, 9, 3):
                dx = corners[t, j] - mean[0]
                dy = corners[t, j + 1] - mean[1]
                dz = corners[t, j + 2] - mean[2]
                cxx += dx * dx
                cxy += dx * dy
                cxz += dx * dz
                cyy += dy * dy
                cyz += dy * dz
                czz += dz * dz
        cov[0, 0], cov[0, 1], cov[0, 2] = cxx, cxy, cxz
        cov[1, 0], cov[1, 1], cov[1, 2] = cxy, cyy, cyz
        cov[2, 0], cov[2, 1], cov[2, 2] = cxz, cyz, czz
        _principal(cov, axes)

        low[:] = np.inf
        high[:] = -np.inf
        for t in range(first, last):
            for j in range(0, 9, 3):
                dx = corners[t, j] - mean[0]
                dy = corners[t, j + 1] - mean[1]
                dz = corners[t, j + 2] - mean[2]
                for k in range(3):
                    p = axes[k, 0] * dx + axes[k, 1] * dy + axes[k, 2] * dz
                    low[k] = min(low[k], p)
                    high[k] = max(high[k], p)
        for k in range(3):
            middle0 = 0.5 * (low[0] + high[0]) * axes[0, k]
            middle1 = 0.5 * (low[1] + high[1]) * axes[1, k]
            middle2 = 0.5 * (low[2] + high[2]) * axes[2, k]
            boxes[node, k] = mean[k] + middle0 + middle1 + middle2
            # Rounding of the centre and the axes must not leave a corner outside its box.
            boxes[node, 3 + k] = 0.5 * (high[k] - low[k]) * (1.0 + 1e-12) + 1e-15 * (
                1.0 + abs(mean[0]) + abs(mean[1]) + abs(mean[2])
            )
            for j in range(3):
                boxes[node, 6 + 3 * k + j] = axes[k, j]

        if count <= leaf:
            links[node, 0] = -1
            continue
        dx, dy, dz = axes[0, 0], axes[0, 1], axes[0, 2]
        split = 0.0
        for t in range(first, last):
            split += dx * centroids[t, 0] + dy * centroids[t, 1] + dz * centroids[t, 2]
        split /= count
        i, j = first, last - 1
        while i <= j:
            p = dx * centroids[i, 0] + dy * centroids[i, 1] + dz * centroids[i, 2]
            if p < split:
                i += 1
            else:
                for k in range(9):
                    corners[i, k], corners[j, k] = corners[j, k], corners[i, k]
                for k in range(3):
                    centroids[i, k], centroids[j, k] = centroids[j, k], centroids[i, k]
                order[i], order[j] = order[j], order[i]
                j -= 1
        left = i - first
        if 10 * left < count or 10 * left > 9 * count:
            # An uneven split (equal centroids, a few far triangles): sort, and cut in the middle.
            keys = (
                dx * centroids[first:last, 0]
                + dy * centroids[first:last, 1]
                + dz * centroids[first:last, 2]
            )
            ranks = np.argsort(keys)
            corners[first:last] = corners[first:last][ranks]
            centroids[first:last] = centroids[first:last][ranks]
            order[first:last] = order[first:last][ranks]
            left = count // 2
        links[node, 0] = nodes
        links[nodes, 1] = first
        links[nodes, 2] = left
        links[nodes + 1, 1] = first + left
        links[nodes + 1, 2] = count - left
        queue[waiting] = nodes + 1
        queue[waiting + 1] = nodes
        waiting += 2
        nodes += 2
    return nodes


@njit(cache=True, nogil=True)
def _quadruple(boxes, links, nodes):  # type: ignore[no-untyped-def]
    """Fill `nodes` (see `Tree`) with every other level of a binary tree; returns their number.

    A node comes before its children, and its subtree before its next sibling's.
    """
    source = np.empty(nodes.shape[0], dtype=np.int64)  # the binary tree's node
    waiting = np.empty(STACK, dtype=np.int64)
    children = np.empty(4, dtype=np.int64)
    source[0] = 0
    count = 1
    waiting[0] = 0
    depth = 1
    while depth > 0:
        depth -= 1
        node = waiting[depth]
        old = source[node]
        nodes[node, :15] = boxes[old, :15]
        child = links[old, 0]
        if child < 0:
            nodes[node, 15] = -(64.0 * links[old, 1] + links[old, 2])
            continue
        found = 0
        for half in range(child, child + 2):
            grandchild = links[half, 0]
            if grandchild < 0:
                children[found] = half
                found += 1
            else:
                children[found] = grandchild
                children[found + 1] = grandchild + 1
                found += 2
        nodes[node, 15] = 8.0 * count + found
        for k in range(found - 1, -1, -1):
            source[count + k] = children[k]
            waiting[depth] = count + k
            depth += 1
        count += found
    return count


@njit(cache=True, nogil=True)
def _errors(corners):  # type: ignore[no-untyped-def]
    errors = np.empty(corners.shape[0])
    for t in range(corners.shape[0]):
        c = corners[t]
        error = distance_error(c[0], c[1], c[2], c[3], c[4], c[5], c[6], c[7], c[8])
        errors[t] = error if error > EXACT else 0.0
    return errors

"""Principal-direction tree over triangles: a hierarchy of boxes turned along their content.

A node is a box in the frame of the principal directions of its triangles' corners. It is split at
the mean along the first direction, and each half once more along its own: a node has up to four
children, which is a walk of half as many steps for little more than the same boxes. A leaf holds a
handful of triangles. Everything lies in flat arrays, siblings and their triangles side by side.

Small kernels are left to LLVM to inline: numba's own inlining counts references to arrays at every
use, which made the walk of `vf.rules.certified` a quarter slower.

After the covariance trees of the paper's section III-A.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from vf.kernels import njit
from vf.planes import FloatArray, IntArray
from vf.tree.closest import closest_on_triangle, distance2_to_triangle, distance_error

LEAF = 6
# More than ever waits in a walk: three for each two splits, none of which is worse than 1 : 9.
STACK = 256
# Nodes that `Surface.nearest` visits before it lets other threads have the interpreter. Few walks
# take as many (some 10 µs), and to hand it over costs a tenth of a walk, far more if it is wanted.
PATIENCE = 500
UNFINISHED = -3
# A computed distance that exceeds the true one by no more than this counts as exact [m].
EXACT = 1e-12


class Tree(NamedTuple):
    """Flat arrays of a PD-tree with k nodes over m triangles.

    A node's record is 128 bytes: all that a walk needs of it comes with two cache lines.

    Attributes:
        nodes: (k, 16) centre (3), half sizes (3), rows of the rotation world → box (9), link:
            8 · first child + count, or for a leaf −(64 · first triangle + count).
        corners: (m, 9) corners of the triangles in tree order.
        order: (m,) the caller's index of each triangle in tree order.
        errors: (m,) how much the computed distance to a triangle can exceed the true one, in tree
            order, 0 where that is at most `EXACT` [m]: large for slivers only.
    """

    nodes: FloatArray
    corners: FloatArray
    order: IntArray
    errors: FloatArray


@njit(cache=True, nogil=True)
def children_of(link):  # type: ignore[no-untyped-def]
    """First child of an inner node and the one after its last, from the link of the node."""
    code = int(link)
    first = code >> 3
    return first, first + (code & 7)


@njit(cache=True, nogil=True)
def triangles_of(link):  # type: ignore[no-untyped-def]
    """First triangle of a leaf and the one after its last, from the link of its node."""
    code = int(-link)
    first = code >> 6
    return first, first + (code & 63)


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
            # A lopsided mean (equal centroids, a few far triangles): sort, and cut in the middle.
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
    """Leave every other level of a binary tree out: fill `nodes`, see `Tree`; their number.

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
def _errors(corners):  # type: ignore[no-untyped-def]
    errors = np.empty(corners.shape[0])
    for t in range(corners.shape[0]):
        c = corners[t]
        error = distance_error(c[0], c[1], c[2], c[3], c[4], c[5], c[6], c[7], c[8])
        errors[t] = error if error > EXACT else 0.0
    return errors


@njit(cache=True, nogil=True)
def box_distance2(nodes, node, x, y, z):  # type: ignore[no-untyped-def]
    """Squared distance of a point to the box of a node (0 inside)."""
    dx, dy, dz = x - nodes[node, 0], y - nodes[node, 1], z - nodes[node, 2]
    d2 = 0.0
    for k in range(3):
        p = nodes[node, 6 + 3 * k] * dx + nodes[node, 7 + 3 * k] * dy + nodes[node, 8 + 3 * k] * dz
        e = abs(p) - nodes[node, 3 + k]
        if e > 0.0:
            d2 += e * e
    return d2


@njit(cache=True, nogil=True)
def triangle_at(corners, t, x, y, z):  # type: ignore[no-untyped-def]
    """`closest_on_triangle` for row t of tree-ordered corners."""
    return closest_on_triangle(
        corners[t, 0],
        corners[t, 1],
        corners[t, 2],
        corners[t, 3],
        corners[t, 4],
        corners[t, 5],
        corners[t, 6],
        corners[t, 7],
        corners[t, 8],
        x,
        y,
        z,
    )


@njit(cache=True, nogil=True)
def triangle_distance2(corners, t, x, y, z):  # type: ignore[no-untyped-def]
    """`distance2_to_triangle` for row t of tree-ordered corners."""
    return distance2_to_triangle(
        corners[t, 0],
        corners[t, 1],
        corners[t, 2],
        corners[t, 3],
        corners[t, 4],
        corners[t, 5],
        corners[t, 6],
        corners[t, 7],
        corners[t, 8],
        x,
        y,
        z,
    )


@njit(cache=True, nogil=True)
def box_distances2(nodes, node, x, y, z):  # type: ignore[no-untyped-def]
    """Squared distance of a point to the box of a node (0 inside), and to its farthest corner."""
    dx, dy, dz = x - nodes[node, 0], y - nodes[node, 1], z - nodes[node, 2]
    near2 = far2 = 0.0
    for k in range(3):
        p = nodes[node, 6 + 3 * k] * dx + nodes[node, 7 + 3 * k] * dy + nodes[node, 8 + 3 * k] * dz
        half = nodes[node, 3 + k]
        far2 += (abs(p) + half) ** 2
        e = abs(p) - half
        if e > 0.0:
            near2 += e * e
    return near2, far2


@njit(cache=True, nogil=True)
def triangles_below(nodes, node):  # type: ignore[no-untyped-def]
    """First triangle of a subtree and the one after its last: its leaves lie side by side."""
    left = right = node
    while nodes[left, 15] > 0.0:
        left = children_of(nodes[left, 15])[0]
    while nodes[right, 15] > 0.0:
        right = children_of(nodes[right, 15])[1] - 1
    return triangles_of(nodes[left, 15])[0], triangles_of(nodes[right, 15])[1]


@njit(cache=True, nogil=True)
def within(nodes, corners, order, x, y, z, radius, triangles):  # type: ignore[no-untyped-def]
    """Every triangle cut by the closed ball, the caller's indices, as far as the array has room.

    Returns their number, which may exceed the array's length: then call again with a longer one.
    Triangles come out in tree order.
    """
    waiting = np.empty(STACK, dtype=np.int32)
    r2 = radius * radius
    # Boxes within a hair of the sphere are opened: the exact test is the triangle's.
    reach2 = r2 * (1.0 + 1e-9) + 1e-30
    sure2 = r2 * (1.0 - 1e-9) - 1e-30
    waiting[0] = 0
    depth = 1
    found = 0
    room = triangles.shape[0]
    while depth > 0:
        depth -= 1
        node = waiting[depth]
        near2, far2 = box_distances2(nodes, node, x, y, z)
        if near2 > reach2:
            continue
        link = nodes[node, 15]
        if far2 <= sure2:
            first, last = triangles_below(nodes, node)
            for t in range(first, last):
                if found < room:
                    triangles[found] = order[t]
                found += 1
        elif link > 0.0:
            first, last = children_of(link)
            for child in range(last - 1, first - 1, -1):
                waiting[depth] = child
                depth += 1
        else:
            first, last = triangles_of(link)
            for t in range(first, last):
                cut = False
                for j in range(0, 9, 3):
                    dx, dy, dz = corners[t, j] - x, corners[t, j + 1] - y, corners[t, j + 2] - z
                    cut |= dx * dx + dy * dy + dz * dz <= r2
                if cut or triangle_distance2(corners, t, x, y, z) <= r2:
                    if found < room:
                        triangles[found] = order[t]
                    found += 1
    return found


@njit(cache=True, nogil=True)
def within_ball(nodes, corners, order, p, radius, triangles):  # type: ignore[no-untyped-def]
    """`within` for one call from Python; −1 where p (3,) is not finite."""
    if not np.isfinite(p[0] + p[1] + p[2]):
        return -1
    return within(nodes, corners, order, p[0], p[1], p[2], radius, triangles)


@njit(cache=True, nogil=True)
def closest_points(vertices, faces, triangles, p, points, features, distances):  # type: ignore[no-untyped-def]
    """`closest_on_triangle` for each of the triangles (k,), into arrays of k rows."""
    for i in range(triangles.shape[0]):
        a, b, c = faces[triangles[i], 0], faces[triangles[i], 1], faces[triangles[i], 2]
        points[i, 0], points[i, 1], points[i, 2], features[i], d2 = closest_on_triangle(
            vertices[a, 0],
            vertices[a, 1],
            vertices[a, 2],
            vertices[b, 0],
            vertices[b, 1],
            vertices[b, 2],
            vertices[c, 0],
            vertices[c, 1],
            vertices[c, 2],
            p[0],
            p[1],
            p[2],
        )
        distances[i] = np.sqrt(d2)


@njit(cache=True, nogil=True)
def nearest(nodes, corners, x, y, z, limit, guess, patience):  # type: ignore[no-untyped-def]
    """Nearest triangle within `limit`: squared distance and row in tree order (−1: none).

    `guess` is a row to look at first, or −1: a tool that moves by micrometres stays near the same
    triangle, and knowing its distance halves the walk. The answer does not depend on it: of several
    triangles at the same distance the first row counts.

    The walk is given up after `patience` nodes; the row is then `UNFINISHED`.
    """
    waiting = np.empty((STACK, 2))  # node and squared distance of its box
    best = limit * limit if limit < 1e150 else np.inf
    row = -1
    if 0 <= guess < corners.shape[0]:
        d2 = triangle_distance2(corners, guess, x, y, z)
        if d2 <= best:
            best = d2
            row = guess
    waiting[0, 0] = waiting[0, 1] = 0.0
    depth = 1
    while depth > 0:
        depth -= 1
        if waiting[depth, 1] > best:
            continue
        if patience == 0:
            return best, UNFINISHED
        patience -= 1
        link = nodes[int(waiting[depth, 0]), 15]
        if link > 0.0:
            first, last = children_of(link)
            bottom = depth
            for child in range(first, last):
                d2 = box_distance2(nodes, child, x, y, z)
                if d2 > best:
                    continue
                place = depth  # the nearest on top
                while place > bottom and waiting[place - 1, 1] < d2:
                    waiting[place, 0] = waiting[place - 1, 0]
                    waiting[place, 1] = waiting[place - 1, 1]
                    place -= 1
                waiting[place, 0] = child
                waiting[place, 1] = d2
                depth += 1
            continue
        first, last = triangles_of(link)
        for t in range(first, last):
            d2 = triangle_distance2(corners, t, x, y, z)
            if d2 < best or (d2 == best and (row < 0 or t < row)):
                best = d2
                row = t
    return best, row


@njit(cache=True)
def nearest_face(nodes, corners, p, limit, guess, patience):  # type: ignore[no-untyped-def]
    """`nearest` for one call from Python: distance and row; p (3,) becomes the closest point.

    p is left alone where the row is −1 (nothing within `limit`), −2 (p is not finite) or
    `UNFINISHED` (patience was not enough).
    """
    x, y, z = p[0], p[1], p[2]
    if not np.isfinite(x + y + z):
        return np.inf, -2
    _d2, row = nearest(nodes, corners, x, y, z, limit, guess, patience)
    if row < 0:
        return np.inf, row
    p[0], p[1], p[2], _feature, d2 = triangle_at(corners, row, x, y, z)
    return np.sqrt(d2), row


@njit(cache=True, nogil=True)
def nearest_face_freely(nodes, corners, p, limit, guess):  # type: ignore[no-untyped-def]
    """`nearest_face` to the end, while other threads have the interpreter."""
    return nearest_face(nodes, corners, p, limit, guess, -1)

"""Bounding volume hierarchy: the judges' candidate triangles near a segment.

Axis-aligned boxes over the triangles in Morton order. It is built from vertices and faces alone and
shares no code with `vf` except the decorator that compiles and caches, so that a defect of the
PD-tree cannot hide a triangle here.

G. M. Morton, "A computer oriented geodetic data base and a new technique in file sequencing", IBM
1966; C. Lauterbach et al., "Fast BVH construction on GPUs", Eurographics 2009.
"""

from __future__ import annotations

from typing import NamedTuple
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

import vf
from vf.kernels import njit

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

FAN = 4  # children of a box
BITS = 21  # of each coordinate in a Morton code
ROOM = 256  # initial capacity of the list of triangles near a segment


class Boxes(NamedTuple):
    """Triangles and their hierarchy of boxes.

    Attributes:
        vertices, faces: (n, 3) [m] and (m, 3), as given.
        order: (m,) the triangles in Morton order: the lowest level, whose boxes are not stored.
        boxes: (k, 6) lowest and highest corner [m] of the levels above, each around up to `FAN`
            consecutive boxes of the level below.
        levels: (l, 2) number of boxes of a level, and the row of its first; the last level has one.
    """

    vertices: FloatArray
    faces: IntArray
    order: IntArray
    boxes: FloatArray
    levels: IntArray


def build(vertices: FloatArray, faces: IntArray) -> Boxes:
    """Boxes over the triangles `faces` (m, 3), m ≥ 1, of finite `vertices` (n, 3) [m]."""
    vertices = np.ascontiguousarray(vertices, dtype=np.float64)
    faces = np.ascontiguousarray(faces, dtype=np.int64)
    order = np.argsort(_morton_codes(vertices, faces), kind="stable")
    levels = [(len(faces), 0)]
    rows = 0
    while len(levels) == 1 or levels[-1][0] > 1:
        count = -(-levels[-1][0] // FAN)
        levels.append((count, rows))
        rows += count
    boxes = np.empty((rows, 6))
    table = np.array(levels, dtype=np.int64)
    _fill(vertices, faces, order, boxes, table)
    return Boxes(vertices, faces, order, boxes, table)


def refitted(known: Boxes, vertices: FloatArray, boxes: FloatArray) -> Boxes:
    """Boxes of the same triangles in the same order, whose `vertices` (n, 3) are elsewhere [m].

    They are written to `boxes`, as large as those that are known.
    """
    vertices = np.ascontiguousarray(vertices, dtype=np.float64)
    _fill(vertices, known.faces, known.order, boxes, known.levels)
    return Boxes(vertices, known.faces, known.order, boxes, known.levels)


def near(boxes: Boxes, a: FloatArray, b: FloatArray, reach: float) -> IntArray:
    """Triangles whose box, grown by `reach` [m] on every side, meets the segment from a to b (3,).

    A superset of the triangles within `reach` of the segment: touching counts, and rounding errors
    only add triangles.
    """
    found = np.empty(ROOM, dtype=np.int64)
    while True:
        count = list_near(*boxes, a, b, reach, found)
        if count <= len(found):
            return found[:count]
        found = np.empty(count, dtype=np.int64)


_known: WeakKeyDictionary[vf.Surface, Boxes] = WeakKeyDictionary()


def of(surface: vf.Surface) -> Boxes:
    """The boxes of a surface, built at the first call and cached as long as the surface exists."""
    boxes = _known.get(surface)
    if boxes is None:
        boxes = _known[surface] = build(surface.vertices, surface.faces)
    return boxes


@njit(cache=True, nogil=True)
def _box(vertices, faces, t, box):  # type: ignore[no-untyped-def]
    """Lowest and highest corner of a triangle, into box (6,)."""
    i, j, k = faces[t, 0], faces[t, 1], faces[t, 2]
    for axis in range(3):
        p, q, r = vertices[i, axis], vertices[j, axis], vertices[k, axis]
        box[axis] = min(p, min(q, r))
        box[3 + axis] = max(p, max(q, r))


@njit(cache=True, nogil=True)
def _morton_codes(vertices, faces):  # type: ignore[no-untyped-def]
    """Morton code of the centre of each triangle's box (m,)."""
    m = faces.shape[0]
    box = np.empty(6)
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for t in range(m):
        _box(vertices, faces, t, box)
        for axis in range(3):
            low[axis] = min(low[axis], box[axis])
            high[axis] = max(high[axis], box[3 + axis])
    codes = np.empty(m, dtype=np.int64)
    for t in range(m):
        _box(vertices, faces, t, box)
        code = 0
        for axis in range(3):
            size = high[axis] - low[axis]
            share = (0.5 * (box[axis] + box[3 + axis]) - low[axis]) / size if size > 0.0 else 0.0
            cell = int(share * (2**BITS - 1))
            for bit in range(BITS):
                code |= ((cell >> bit) & 1) << (3 * bit + axis)
        codes[t] = code
    return codes


@njit(cache=True, nogil=True)
def _fill(vertices, faces, order, boxes, levels):  # type: ignore[no-untyped-def]
    """Compute the boxes of all levels, from the lowest upwards."""
    box = np.empty(6)
    boxes[:, :3] = np.inf
    boxes[:, 3:] = -np.inf
    for level in range(1, levels.shape[0]):
        below, above = levels[level - 1, 1], levels[level, 1]
        for i in range(levels[level - 1, 0]):
            if level == 1:
                _box(vertices, faces, order[i], box)
            else:
                box[:] = boxes[below + i]
            row = boxes[above + i // FAN]
            for axis in range(3):
                row[axis] = min(row[axis], box[axis])
                row[3 + axis] = max(row[3 + axis], box[3 + axis])


@njit(cache=True, nogil=True)
def _reaches(box, a, b, reach, slack):  # type: ignore[no-untyped-def]
    """Whether the segment ab meets a box (6,) grown by `reach`, or passes it within `slack`."""
    first, last = 0.0, 1.0
    for axis in range(3):
        start, end = a[axis], b[axis]
        grown = reach + slack
        low, high = box[axis] - grown, box[3 + axis] + grown
        if max(start, end) < low or min(start, end) > high:
            return False
        way = end - start
        if abs(way) > slack:  # else the interval test above is sufficient
            u, v = (low - start) / way, (high - start) / way
            first, last = max(first, min(u, v)), min(last, max(u, v))
            if first > last:
                return False
    return True


@njit(cache=True, nogil=True)
def list_near(vertices, faces, order, boxes, levels, a, b, reach, found):  # type: ignore[no-untyped-def]
    """`near` into `found`; returns the number of triangles, which may exceed its capacity."""
    top = levels.shape[0] - 1
    whole = boxes[levels[top, 1]]
    size = reach
    for axis in range(3):
        size = max(size, max(abs(a[axis]), abs(b[axis])))
        size = max(size, max(abs(whole[axis]), abs(whole[3 + axis])))
    slack = 1e-14 * size  # bounds the rounding error: a few dozen ulps of the largest coordinate
    box = np.empty(6)
    count = 0
    level, i = top, 0
    while True:
        if level > 0:
            if _reaches(boxes[levels[level, 1] + i], a, b, reach, slack):
                level -= 1
                i *= FAN
                continue
        else:
            _box(vertices, faces, order[i], box)
            if _reaches(box, a, b, reach, slack):
                if count < found.shape[0]:
                    found[count] = order[i]
                count += 1
        i += 1
        # After the last sibling continue with the next box of the level above.
        while level < top and (i % FAN == 0 or i == levels[level, 0]):
            i = (i + FAN - 1) // FAN
            level += 1
        if level == top:
            return count

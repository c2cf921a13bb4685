"""The planes of a tick: one walk through the tree of every fixture."""

from __future__ import annotations

import numba
import numpy as np

from vf import layout as at
from vf.kernels import bytes_at, floats_at, integers_at, njit
from vf.qp.problem import farthest, room
from vf.rules.certified import CORNERS, EASE, HEAP, YIELD, walk
from vf.rules.corridor import between
from vf.rules.walls import WALL


@njit(cache=True)
def sides_known(words, x):  # type: ignore[no-untyped-def]
    """Whether it is known for every fixture if x (3,) is inside: the last look-up was there."""
    sides = numba.carray(floats_at(words[at.SIDES]), (words[at.FIXTURES], at.SIDE))
    for f in range(words[at.FIXTURES]):
        for k in range(3):
            if sides[f, at.SEEN + k] != x[k]:
                return False
    return True


@njit(cache=True)
def set_radius(words, numbers, J, speed):  # type: ignore[no-untyped-def]
    """Set INSIDE, the radius of the motion sphere, and that of the ball to search.

    The ball is larger than the motion sphere by the standoff, since a step to the rim of the sphere
    could end right at a triangle outside, and by the sagitta of the path, up to a quarter of the
    radius: beyond that the additional planes cost more than a longer step gains.
    """
    sides = numba.carray(floats_at(words[at.SIDES]), (words[at.FIXTURES], at.SIDE))
    words[at.INSIDE] = 0
    for f in range(words[at.FIXTURES]):
        if sides[f, at.WITHIN] > 0.0:
            words[at.INSIDE] = 1
    radius = numbers[at.ASKED]
    if not radius > 0.0:
        radius = max(farthest(J, speed), 2.0 * numbers[at.STANDOFF])
    numbers[at.RADIUS] = radius
    numbers[at.SEARCHED] = radius + min(numbers[at.SAGITTA], 0.25 * radius) + numbers[at.BEYOND]


@njit(cache=True)
def search_planes(words, numbers, planes, x):  # type: ignore[no-untyped-def]
    """Write the planes of all fixtures for a tip at x (3,); False: Python has to compute them."""
    fixtures = words[at.FIXTURES]
    searches = numba.carray(integers_at(words[at.SEARCHES]), (fixtures, at.SEARCH))
    queue = numba.carray(floats_at(words[at.QUEUE]), (HEAP, 3))
    polygons = numba.carray(floats_at(words[at.POLYGONS]), (2, CORNERS, 3))
    for f in range(fixtures):
        if searches[f, at.KIND] == at.GIVEN:
            return False
    radius, tip_radius = numbers[at.SEARCHED], numbers[at.TIP_RADIUS]
    standoff = numbers[at.STANDOFF]
    while True:
        m = 0
        reach = radius
        close = 0
        least = np.inf
        for f in range(fixtures):
            search = searches[f]
            nodes = numba.carray(floats_at(search[at.NODES]), (search[at.NODE_COUNT], 16))
            corners = numba.carray(floats_at(search[at.CORNERS]), (search[at.TRIANGLES], 9))
            order = numba.carray(integers_at(search[at.ORDER]), (search[at.TRIANGLES],))
            slivers = numba.carray(floats_at(search[at.SLIVERS]), (search[at.TRIANGLES],))
            edges = numba.carray(bytes_at(search[at.EDGES]), (search[at.TRIANGLES], 3))
            if search[at.KIND] == at.MESH:
                found, valid = walk(
                    nodes, corners, order, slivers, edges, False, (x[0], x[1], x[2]), radius,
                    standoff, tip_radius, EASE, planes, m, queue, polygons,
                )  # fmt: skip
            else:
                walls = numba.carray(floats_at(search[at.WALLS]), (search[at.WALL_COUNT], WALL))
                frame = numba.carray(floats_at(search[at.FRAME]), (8,))
                found, valid = between(
                    walls, frame[:6].reshape((2, 3)), frame[6], frame[7], nodes, corners, order,
                    slivers, edges, x, radius, standoff, tip_radius, planes, m, queue, polygons,
                )  # fmt: skip
            if valid == 0.0:
                # The tip is on the surface: `fixtures` decides that in Python.
                return False
            space = np.inf
            for i in range(m, m + found):
                planes[i, at.FIXTURE] = f
                space = min(space, room(planes[i], x))
            if space - tip_radius < standoff:
                close += 1
            least = min(least, space - tip_radius)
            m += found
            reach = min(reach, valid)
        words[at.COUNT] = m
        numbers[at.REACH] = reach
        # Closer than the standoff to two fixtures: the tool may come as close to the farther one as
        # it is to the nearer one, as between two walls of one fixture (`certified.walk`).
        if standoff < numbers[at.STANDOFF] or close < 2:
            return True
        standoff = least
        if not standoff > YIELD:
            return True

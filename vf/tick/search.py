"""The planes of a tick: one walk through the tree of every fixture, for the tip and every body."""

from __future__ import annotations

import numba
import numpy as np

from vf import layout as at
from vf.kernels import bytes_at, floats_at, integers_at, njit
from vf.qp.problem import farthest, height, sagitta, widest
from vf.rules.certified import AXIS_EASE, CORNERS, EASE, HEAP, YIELD, walk
from vf.rules.corridor import between
from vf.rules.walls import WALL
from vf.tick.moving import bend, form, into, more_reach, put, shape_of, shift, shift_of
from vf.tree.axis import lowest, out_of_reach


@njit(cache=True)
def sides_known(words, x):  # type: ignore[no-untyped-def]
    """Whether it is known for every fixture if x (3,) is inside: the last look-up was there.

    If not, SEEN is where it has to be looked up, in the frame of the fixture.
    """
    fixtures = words[at.FIXTURES]
    sides = numba.carray(floats_at(words[at.SIDES]), (fixtures, at.SIDE))
    known = True
    if words[at.MOVING] == 0 and words[at.DEFORMS] == 0:
        for f in range(fixtures):
            for k in range(3):
                known &= sides[f, at.SEEN + k] == x[k]
        if not known:
            for f in range(fixtures):
                for k in range(3):
                    sides[f, at.SEEN + k] = x[k]
        return known
    searches = numba.carray(integers_at(words[at.SEARCHES]), (fixtures, at.SEARCH))
    motions = numba.carray(floats_at(words[at.MOTIONS]), (fixtures, at.MOTION))
    for f in range(fixtures):
        px, py, pz = x[0], x[1], x[2]
        blend = 0.0
        if searches[f, at.MOVES] > 0:
            px, py, pz = into(motions[f], at.FROM, px, py, pz)
            blend = motions[f, at.BLEND]
        seen = sides[f, at.SEEN : at.SEEN + 3]
        known &= seen[0] == px and seen[1] == py and seen[2] == pz
        seen[0], seen[1], seen[2] = px, py, pz
        shape, blend = form(searches[f], blend)
        known &= sides[f, at.SEEN_FORM] == shape and sides[f, at.SEEN_BLEND] == blend
        sides[f, at.SEEN_FORM], sides[f, at.SEEN_BLEND] = shape, blend
    return known


@njit(cache=True)
def set_radius(words, numbers, J, speed, x):  # type: ignore[no-untyped-def]
    """Set INSIDE, the radius of the motion sphere, and that of the ball to search around x (3,).

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
    if words[at.MOVING] > 0:
        searches = numba.carray(integers_at(words[at.SEARCHES]), (words[at.FIXTURES], at.SEARCH))
        motions = numba.carray(floats_at(words[at.MOTIONS]), (words[at.FIXTURES], at.MOTION))
        for f in range(words[at.FIXTURES]):
            if searches[f, at.MOVES] > 0:
                more = more_reach(motions[f], x, numbers[at.SEARCHED])
                motions[f, at.SHIFT :] = 0.0
                if searches[f, at.FACES] != 0:
                    reach = numbers[at.SEARCHED] + numbers[at.TIP_RADIUS] + more
                    reach += sides[f, at.MARGIN] + motions[f, at.ADDED]
                    here = into(motions[f], at.FROM, x[0], x[1], x[2])
                    far, dx, dy, dz, wx, wy, wz = shift_of(searches[f], motions[f], here, reach)
                    motion = motions[f]
                    motion[at.SHIFT], motion[at.SHIFT + 1], motion[at.SHIFT + 2] = dx, dy, dz
                    motion[at.SPREAD], motion[at.SPREAD + 1], motion[at.SPREAD + 2] = wx, wy, wz
                    _note_most(motion, far, wx, wy, wz)
                    more += far
                motions[f, at.MORE] = more


@njit(cache=True)
def _note_most(motion, far, wx, wy, wz):  # type: ignore[no-untyped-def]
    """Keep the largest displacement, and the largest difference of displacements, of a tick."""
    motion[at.MOST_SHIFT] = max(motion[at.MOST_SHIFT], far)
    wide = np.sqrt(wx * wx + wy * wy + wz * wz)
    motion[at.MOST_SPREAD] = max(motion[at.MOST_SPREAD], wide)


@njit(cache=True)
def search_planes(words, numbers, planes, x):  # type: ignore[no-untyped-def]
    """Write the planes of all fixtures for a tip at x (3,); False: Python has to compute them."""
    searches = numba.carray(integers_at(words[at.SEARCHES]), (words[at.FIXTURES], at.SEARCH))
    for f in range(words[at.FIXTURES]):
        if searches[f, at.KIND] == at.GIVEN:
            return False
    words[at.COUNT], numbers[at.REACH], met = _search(
        words, numbers, planes, 0, (x[0], x[1], x[2]), numbers[at.SEARCHED],
        numbers[at.TIP_RADIUS], True,
    )  # fmt: skip
    # On a surface: `fixtures` decides that in Python.
    return not met


@njit(cache=True)
def search_bodies(words, numbers, planes, places, jacobians, guards, table):  # type: ignore[no-untyped-def]
    """Add the planes of every body after those of the tip, and set how far its ends may go.

    Each body has a motion sphere of its own: what its ends can do in a tick. Only meshes guard
    bodies. A plane of an axis is written twice, for its start and, after all of these, for its end.

    While the tip is inside of something, bodies that meet the mesh are left out: they have to come
    out with it. Otherwise such a body is STUCK, and the tool holds.
    """
    bodies = numba.carray(integers_at(words[at.BODY_TABLE]), (words[at.BODIES], at.BODY))
    words[at.STUCK] = 0
    for b in range(words[at.BODIES]):
        first, second = bodies[b, at.FIRST], bodies[b, at.SECOND]
        _set_ball(numbers, jacobians, guards, table, first, second)
        radius, thickness = guards[first, at.BALL], guards[first, at.THICKNESS]
        start = words[at.COUNT]
        m, reach = start, radius
        if not _in_port(places, guards, bodies[b]):
            p, q = places[first], places[second]
            if first == second:
                m, reach, met = _search(
                    words, numbers, planes, start, (p[0], p[1], p[2]), radius, thickness, False
                )
            else:
                m, reach, met = _search(
                    words, numbers, planes, start, (p[0], p[1], p[2], q[0], q[1], q[2]), radius,
                    thickness, False,
                )  # fmt: skip
            if met and words[at.INSIDE] == 0:
                words[at.STUCK] = 1
        count = m - start
        for i in range(start, m):
            planes[i, at.CAPSULE] = bodies[b, at.NUMBER]
            planes[i, at.POINT] = first
            if first != second:
                planes[i + count] = planes[i]
                planes[i + count, at.POINT] = second
        words[at.COUNT] = m + count if first != second else m
        # As for the tip: the step ends within the motion sphere, its path within what was searched.
        whole = reach >= radius
        for end in (first, second):
            guards[end, at.PATH_LIMIT] = reach - numbers[at.BEYOND] if whole else reach
            guards[end, at.STEP_LIMIT] = min(reach, guards[first, at.STEP_RADIUS])


@njit(cache=True)
def _search(words, numbers, planes, start, ends, radius, thickness, tip):  # type: ignore[no-untyped-def]
    """Write the planes of all fixtures for one body, from row `start` on.

    Args:
        ends: of its axis, or the centre of a ball, see `certified.walk`.
        radius: of the ball to search [m].
        thickness: radius of the body [m].
        tip: whether it is the tip, which corridors guard too.

    Returns:
        The row after the last plane, the radius they are valid in [m], and whether the body meets a
        surface. The search for the tip ends there; a surface that another body meets has no planes
        while the tip is inside of something, and a radius of 0 otherwise.
    """
    fixtures = words[at.FIXTURES]
    searches = numba.carray(integers_at(words[at.SEARCHES]), (fixtures, at.SEARCH))
    queue = numba.carray(floats_at(words[at.QUEUE]), (HEAP, 3))
    polygons = numba.carray(floats_at(words[at.POLYGONS]), (2, CORNERS, 3))
    sides = numba.carray(floats_at(words[at.SIDES]), (fixtures, at.SIDE))
    motions = numba.carray(floats_at(words[at.MOTIONS]), (fixtures, at.MOTION))
    standoff = numbers[at.STANDOFF]
    ease = EASE if len(ends) == 3 else AXIS_EASE
    lowered = 0.0
    while True:
        m = start
        most = lowered
        reach = radius
        close = 0
        least = np.inf
        met = False
        for f in range(fixtures):
            search = searches[f]
            nodes = numba.carray(floats_at(search[at.NODES]), (search[at.NODE_COUNT], 16))
            corners = numba.carray(floats_at(search[at.CORNERS]), (search[at.TRIANGLES], 9))
            order = numba.carray(integers_at(search[at.ORDER]), (search[at.TRIANGLES],))
            slivers = numba.carray(floats_at(search[at.SLIVERS]), (search[at.TRIANGLES],))
            edges = numba.carray(bytes_at(search[at.EDGES]), (search[at.TRIANGLES], 3))
            margin = 0.0
            low = 0.0
            here = ends
            more = 0.0
            wider = 1.0
            blend = 0.0
            dx = dy = dz = wx = wy = wz = 0.0
            if searches[f, at.MOVES] > 0:
                here = _ends_into(motions[f], ends)
                wider = _wider(motions[f], ends, numbers[at.STANDOFF])
                blend = motions[f, at.BLEND]
                # `set_radius` has looked at the same ball.
                more = motions[f, at.MORE] if tip else _more(motions[f], ends, radius)
            if search[at.KIND] == at.MESH:
                if not tip and search[at.TOOL] == 0:
                    continue
                margin = sides[f, at.MARGIN]
                if search[at.MOVES] > 0:
                    margin += motions[f, at.ADDED]
                    if search[at.FACES] != 0 and tip:
                        way = motions[f, at.SHIFT : at.SPREAD + 3]
                        dx, dy, dz, wx, wy, wz = way[0], way[1], way[2], way[3], way[4], way[5]
                    elif search[at.FACES] != 0:
                        wide = radius + thickness + margin + more
                        far, dx, dy, dz, wx, wy, wz = shift_of(search, motions[f], here, wide)
                        _note_most(motions[f], far, wx, wy, wz)
                        more += far
                wide = radius + more + thickness + margin
                # Of a mesh that deforms the box is where the last walk left it.
                known = search[at.FACES] == 0 and search[at.VARIED] == 0
                if known and not tip and out_of_reach(nodes, here, wide):
                    continue
                nodes_too = search[at.NODE_COUNT] if search[at.VARIED] > 0 else 0
                highest = numba.carray(floats_at(search[at.NODE_MARGINS]), (nodes_too,))
                own = numba.carray(floats_at(search[at.OWN_MARGINS]), (search[at.VARIED],))
                found, valid, low = walk(
                    nodes, corners, order, slivers, edges, shape_of(search, blend), margin, highest,
                    own, lowered, False, here, radius + more, wider * standoff, thickness, ease,
                    planes, m, queue, polygons,
                )  # fmt: skip
            elif tip and len(ends) == 3:
                walls = numba.carray(floats_at(search[at.WALLS]), (search[at.WALL_COUNT], WALL))
                frame = numba.carray(floats_at(search[at.FRAME]), (8,))
                found, valid = between(
                    walls, frame[:6].reshape((2, 3)), frame[6], frame[7], nodes, corners, order,
                    slivers, edges, here[:3], radius + more, wider * standoff, thickness, planes, m,
                    queue, polygons,
                )  # fmt: skip
            else:
                continue
            if valid == 0.0:
                met = True
                if tip:
                    return m, 0.0, met
                if words[at.INSIDE] > 0:
                    continue
            space = np.inf
            for i in range(m, m + found):
                planes[i, at.FIXTURE] = f
                planes[i, at.KEEP] = wider * numbers[at.STANDOFF] + planes[i, at.PUSH]
                space = min(space, _room(planes[i], here) - max(planes[i, at.PUSH] - low, 0.0))
                planes[i, at.PUSH] = 0.0
                if search[at.MOVES] > 0:
                    planes[i, at.CARRY] = 0.0
                    if search[at.FACES] != 0:
                        shift(planes[i], dx, dy, dz, wx, wy, wz)
                    put(planes[i], motions[f])
            if space - thickness < wider * standoff or low > lowered:
                close += 1
            most = max(most, low)
            least = min(least, (space - thickness) / wider)
            m += found
            if more > 0.0:
                valid = radius if valid >= radius + more else max(valid - more, 0.0)
            reach = min(reach, valid)
        # Closer than standoff and margin to two fixtures: the tool may come as close to the farther
        # one as it is to the nearer one, as between two walls of one fixture (`certified.walk`).
        # Margins are lowered first, by the same length.
        if close < 2:
            break
        if most > lowered:
            lowered = most
            continue
        if standoff < numbers[at.STANDOFF]:
            break
        standoff = least
        if not standoff > YIELD:
            break
    return m, reach, met


@njit(cache=True)
def _ends_into(motion, ends):  # type: ignore[no-untyped-def]
    """The ends in the frame of a structure at the start of the tick."""
    a = into(motion, at.FROM, ends[0], ends[1], ends[2])
    if len(ends) == 3:
        return a
    b = into(motion, at.FROM, ends[-3], ends[-2], ends[-1])
    return a[0], a[1], a[2], b[0], b[1], b[2]


@njit(cache=True)
def _more(motion, ends, radius):  # type: ignore[no-untyped-def]
    """By how much the ball around all ends has to be larger for the motion of a structure [m]."""
    more = more_reach(motion, ends[:3], radius)
    if len(ends) == 6:
        more = max(more, more_reach(motion, ends[-3:], radius))
    return more


@njit(cache=True)
def _wider(motion, ends, standoff):  # type: ignore[no-untyped-def]
    """How many times the standoff has to be as wide for the motion of a structure.

    From the standoff a plane leaves a quarter for what a path bends: four times that which comes of
    the motion of the structure alone is kept for it.
    """
    bent = bend(motion, ends[:3], 0.0)
    if len(ends) == 6:
        bent = max(bent, bend(motion, ends[-3:], 0.0))
    return max(1.0, 8.0 * bent / standoff)


@njit(cache=True)
def _room(plane, ends):  # type: ignore[no-untyped-def]
    """Least distance of the ends to the plane through the FOOT of a plane, before it was moved."""
    nx, ny, nz = plane[at.NORMAL], plane[at.NORMAL + 1], plane[at.NORMAL + 2]
    return lowest(nx, ny, nz, ends) - height(plane, plane[at.FOOT : at.FOOT + 3])


@njit(cache=True)
def _set_ball(numbers, jacobians, guards, table, first, second):  # type: ignore[no-untyped-def]
    """Set how far the ends of a body can go in a tick [m], and the ball to search."""
    far = 0.0
    bulge = 0.0
    for p in (first, second):
        bend = sagitta(jacobians[p], table[at.SPEED], 1.0, table[at.TURNS])
        # A path leaves its tangent by four times as much as its chord.
        far = max(far, widest(jacobians[p], table[at.SPEED]) + 4.0 * bend)
        bulge = max(bulge, bend)
    if numbers[at.ASKED] > 0.0:
        far = min(far, numbers[at.ASKED])
    radius = max(far, 2.0 * numbers[at.STANDOFF])
    guards[first, at.STEP_RADIUS] = radius
    guards[first, at.BALL] = radius + min(bulge, 0.25 * radius) + numbers[at.BEYOND]


@njit(cache=True)
def _in_port(places, guards, body):  # type: ignore[no-untyped-def]
    """Whether a body stays in the trocar zone for this tick, where nothing of it is guarded.

    Its axis begins where it leaves the zone, and all of it is in the zone while its end has not
    come as far as that from the centre.
    """
    centre = body[at.CENTRE]
    if centre < 0:
        return False
    first, second = body[at.FIRST], body[at.SECOND]
    edge = 0.0
    end = 0.0
    for k in range(3):
        out = places[first, k] - places[centre, k]
        edge += out * out
        end += out * (places[second, k] - places[centre, k])
    edge = np.sqrt(edge)
    return end < (edge - guards[first, at.BALL]) * edge

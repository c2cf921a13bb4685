"""The axes of bodies beside structures that move: what asks them to yield, and a certificate.

A plane has both ends of an axis in front of it. A structure that comes to the middle of a shaft
takes its plane along past the remote centre, where the shaft cannot follow: it yields by turning,
and no plane that moves with the structure is between the two all the while. So what asks for motion
is where the plane touches the axis, and steps that miss planes of bodies are judged by the
distances themselves: an axis with a clearance c to what is around it, none of whose ends moves
faster than v relative to that, meets nothing for the next c/v.
"""

from __future__ import annotations

import numba
import numpy as np

from vf import layout as at
from vf.kernels import floats_at, integers_at, njit
from vf.qp.problem import height
from vf.rules.certified import HEAP
from vf.tick.moving import bend, distance, into, shape_of, shift_of
from vf.tree.axis import box_gap2, triangle_gap2
from vf.tree.pdtree import children_of, triangles_of
from vf.tree.shapes import place_boxes, place_corners, place_errors

# A body on its way is never this close, as a share of the standoff.
CLEAR = 0.1
ADVANCES = 200  # steps of the way at most; then it counts as not clear
# Nearer to the start of an axis than this share of it, what touches it asks nothing of its end.
LEVER = 0.02


@njit(cache=True)
def contact_share(plane, a, b):  # type: ignore[no-untyped-def]
    """Where on an axis, from a (0) to b (1), the FOOT of a plane is."""
    along = 0.0
    length2 = 0.0
    for k in range(3):
        d = b[k] - a[k]
        along += (plane[at.FOOT + k] - a[k]) * d
        length2 += d * d
    return min(max(along / length2, 0.0), 1.0) if length2 > 0.0 else 0.0


@njit(cache=True)
def run_of(planes, m, i):  # type: ignore[no-untyped-def]
    """How many planes from row i on are of the same point."""
    count = 1
    while i + count < m and planes[i + count, at.POINT] == planes[i, at.POINT]:
        count += 1
    return count


@njit(cache=True)
def is_start(guards, p):  # type: ignore[no-untyped-def]
    """Whether point p is the start of an axis, whose end is the next point."""
    return p > 0 and p + 1 < guards.shape[0] and guards[p + 1, at.TWIN] > 0.0


@njit(cache=True)
def ask_at_contacts(planes, m, places, guards, rows, bounds):  # type: ignore[no-untyped-def]
    """Let planes that structures take along ask for motion where they touch an axis."""
    i = 0
    while i < m:
        p = int(planes[i, at.POINT])
        count = run_of(planes, m, i)
        if is_start(guards, p):
            for k in range(i, i + count):
                other = k + count
                fixed = not rows[k].any()
                share = contact_share(planes[k], places[p], places[p + 1])
                if not at_contact(planes, k, other, rows, share):
                    continue
                begin = bounds[k] + (planes[k, at.CARRY] if fixed else 0.0)
                bounds[k] = (1.0 - share) * begin + share * bounds[other]
                for j in range(rows.shape[1]):
                    rows[k, j] = (1.0 - share) * rows[k, j] + share * rows[other, j]
                # Of the end by itself only what it has to keep to while the structure stands.
                bounds[other] -= max(planes[other, at.CARRY], 0.0)
            i += count
        i += count


@njit(cache=True)
def at_contact(planes, k, other, rows, share):  # type: ignore[no-untyped-def]
    """Whether row k, of the start of an axis, is that of where the plane touches it."""
    comes = planes[k, at.CARRY] > 0.0 or planes[other, at.CARRY] > 0.0
    return comes and (share >= LEVER or rows[k].any())


@njit(cache=True)
def bodies_clear(words, numbers, places, trials, bulges, guards):  # type: ignore[no-untyped-def]
    """Whether all bodies keep clear of the meshes they are guarded from, by their distances."""
    bodies = numba.carray(integers_at(words[at.BODY_TABLE]), (words[at.BODIES], at.BODY))
    fixtures = words[at.FIXTURES]
    searches = numba.carray(integers_at(words[at.SEARCHES]), (fixtures, at.SEARCH))
    motions = numba.carray(floats_at(words[at.MOTIONS]), (fixtures, at.MOTION))
    queue = numba.carray(floats_at(words[at.QUEUE]), (HEAP, 3))
    hair = CLEAR * numbers[at.STANDOFF]
    for b in range(words[at.BODIES]):
        # Its axis begins where it leaves the trocar zone, which stands still.
        if bodies[b, at.CENTRE] >= 0 and _stays_in_port(places, trials, bodies[b]):
            continue
        for f in range(fixtures):
            if searches[f, at.KIND] != at.MESH or searches[f, at.TOOL] == 0:
                continue
            if not _clear(
                searches[f], motions[f], places, trials, bulges, guards, bodies[b], hair, queue
            ):
                return False
    return True


@njit(cache=True)
def _stays_in_port(places, trials, body):  # type: ignore[no-untyped-def]
    """Whether the end of a body's axis stays nearer to the centre than its start is."""
    first, second, centre = body[at.FIRST], body[at.SECOND], body[at.CENTRE]
    edge = distance(places[first], places[centre])
    return (
        distance(places[second], places[centre]) < edge
        and distance(trials[second], trials[centre]) < edge
    )


@njit(cache=True)
def _clear(search, motion, places, trials, bulges, guards, body, hair, queue):  # type: ignore[no-untyped-def]
    nodes = numba.carray(floats_at(search[at.NODES]), (search[at.NODE_COUNT], 16))
    corners = numba.carray(floats_at(search[at.CORNERS]), (search[at.TRIANGLES], 9))
    slivers = numba.carray(floats_at(search[at.SLIVERS]), (search[at.TRIANGLES],))
    start, end = np.empty((2, 3)), np.empty((2, 3))
    bulge = 0.0
    pace = 0.0
    for k in range(2):
        p = body[at.FIRST] if k == 0 else body[at.SECOND]
        x, y, more = places[p], trials[p], bulges[p]
        if search[at.MOVES] > 0:
            more += bend(motion, x, distance(x, y) + 4.0 * more)
            start[k, 0], start[k, 1], start[k, 2] = into(motion, at.FROM, x[0], x[1], x[2])
            end[k, 0], end[k, 1], end[k, 2] = into(motion, at.TO, y[0], y[1], y[2])
        else:
            start[k], end[k] = x, y
        bulge = max(bulge, more)
        pace = max(pace, distance(start[k], end[k]))
    rim = guards[body[at.FIRST], at.THICKNESS] + bulge
    first_blend = last_blend = 0.0
    if search[at.MOVES] > 0 and search[at.FACES] != 0:
        first_blend, last_blend = motion[at.BLEND], motion[at.BLEND_AFTER]
        a, b = start[0], start[1]
        ends = (a[0], a[1], a[2], b[0], b[1], b[2])
        # What is farther than the axis goes does not come to it, and the rest is no faster.
        pace += shift_of(search, motion, ends, rim + pace + hair)[0]
    limit = rim + pace + hair
    done = 0.0
    here = np.empty((2, 3))
    for _ in range(ADVANCES):
        for k in range(2):
            for c in range(3):
                here[k, c] = start[k, c] + done * (end[k, c] - start[k, c])
        shape = shape_of(search, (1.0 - done) * first_blend + done * last_blend)
        room = gap(nodes, corners, slivers, shape, here, limit, queue) - rim
        if not room > hair:
            return False
        if done >= 1.0 or room >= pace:
            return room >= pace or done >= 1.0
        done = min(1.0, done + room / pace)
    return False


@njit(cache=True)
def overlapped(words, planes, guards, unsure):  # type: ignore[no-untyped-def]
    """Whether a structure is in any part of the tool when the tick begins.

    `unsure`: whether it may be, as it is known to within what is added to its margins.
    """
    fixtures = words[at.FIXTURES]
    searches = numba.carray(integers_at(words[at.SEARCHES]), (fixtures, at.SEARCH))
    motions = numba.carray(floats_at(words[at.MOTIONS]), (fixtures, at.MOTION))
    places = numba.carray(floats_at(words[at.PLACES]), (words[at.POINTS], 3))
    for i in range(words[at.COUNT]):
        plane = planes[i]
        p, f = int(plane[at.POINT]), int(plane[at.FIXTURE])
        room = height(plane, places[p]) + plane[at.CARRY] - height(plane, plane[at.FOOT :])
        added = motions[f, at.ADDED] if unsure and searches[f, at.MOVES] > 0 else 0.0
        if room < guards[p, at.THICKNESS] + added:
            return True
    return False


@njit(cache=True)
def is_unsure(words):  # type: ignore[no-untyped-def]
    """Whether something is added to the margins of a structure in this tick."""
    searches = numba.carray(integers_at(words[at.SEARCHES]), (words[at.FIXTURES], at.SEARCH))
    motions = numba.carray(floats_at(words[at.MOTIONS]), (words[at.FIXTURES], at.MOTION))
    for f in range(words[at.FIXTURES]):
        if searches[f, at.MOVES] > 0 and motions[f, at.ADDED] > 0.0:
            return True
    return False


@njit(cache=True)
def deepest(words, guards, spots, pose, unsure, missed):  # type: ignore[no-untyped-def]
    """How deep any part of the tool is in a mesh, or may be if `unsure` [m]; 0: not.

    Args:
        spots: (p, 3) guarded points [m].
        pose: at.FROM or at.TO: where structures are when the tick begins or ends.
        missed: what the centre or an axis missed its planes by [m].
    """
    bodies = numba.carray(integers_at(words[at.BODY_TABLE]), (words[at.BODIES], at.BODY))
    fixtures = words[at.FIXTURES]
    searches = numba.carray(integers_at(words[at.SEARCHES]), (fixtures, at.SEARCH))
    motions = numba.carray(floats_at(words[at.MOTIONS]), (fixtures, at.MOTION))
    queue = numba.carray(floats_at(words[at.QUEUE]), (HEAP, 3))
    axis = np.empty((2, 3))
    most = 0.0
    for b in range(-1, words[at.BODIES]):  # -1: the tip
        first, second = 0, 0
        if b >= 0:
            first, second = bodies[b, at.FIRST], bodies[b, at.SECOND]
            if bodies[b, at.CENTRE] >= 0 and _stays_in_port(spots, spots, bodies[b]):
                continue
        for f in range(fixtures):
            search = searches[f]
            if search[at.KIND] != at.MESH or (b >= 0 and search[at.TOOL] == 0):
                continue
            moves = search[at.MOVES] > 0
            thickness = guards[first, at.THICKNESS]
            if unsure:
                if not (moves and motions[f, at.ADDED] > 0.0):
                    continue
                thickness += motions[f, at.ADDED]
                if pose == at.FROM:
                    thickness -= motions[f, at.GROWTH]
            blend = 0.0
            if moves:
                blend = motions[f, at.BLEND if pose == at.FROM else at.BLEND_AFTER]
            for k in range(2):
                x = spots[first] if k == 0 else spots[second]
                axis[k] = x
                if moves:
                    axis[k, 0], axis[k, 1], axis[k, 2] = into(motions[f], pose, x[0], x[1], x[2])
            nodes = numba.carray(floats_at(search[at.NODES]), (search[at.NODE_COUNT], 16))
            corners = numba.carray(floats_at(search[at.CORNERS]), (search[at.TRIANGLES], 9))
            slivers = numba.carray(floats_at(search[at.SLIVERS]), (search[at.TRIANGLES],))
            shape = shape_of(search, blend)
            apart = gap(nodes, corners, slivers, shape, axis, thickness, queue)
            # Where the axis meets the mesh, what it missed its planes by comes on top.
            most = max(most, thickness - apart + (missed if apart == 0.0 else 0.0))
    return most


@njit(cache=True)
def gap(nodes, corners, slivers, shape, axis, limit, queue):  # type: ignore[no-untyped-def]
    """Distance of an axis (2, 3) to the mesh [m], or a little less; `limit` if it is farther."""
    ends = (axis[0, 0], axis[0, 1], axis[0, 2], axis[1, 0], axis[1, 1], axis[1, 2])
    best = limit * limit
    if shape[0] != 0:
        place_boxes(shape, 0, 1)
    queue[0, 0] = 0.0
    size = 1
    while size > 0:
        size -= 1
        node = int(queue[size, 0])
        if size > 0 and queue[size, 1] >= best:
            continue
        link = nodes[node, 15]
        if link > 0.0:
            first, last = children_of(link)
            if shape[0] != 0:
                place_boxes(shape, first, last)
            if size + last - first >= HEAP:
                return 0.0
            for child in range(first, last):
                d2 = box_gap2(nodes, child, ends)
                if d2 < best:
                    queue[size, 0], queue[size, 1] = child, d2
                    size += 1
        else:
            first, last = triangles_of(link)
            if shape[0] != 0:
                place_corners(shape, first, last)
                place_errors(shape, first, last)
            for t in range(first, last):
                best = min(best, triangle_gap2(corners, t, slivers, ends))
    return np.sqrt(best)

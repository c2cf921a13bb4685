"""Structures that move during a tick: their frames, and what their motion adds to a path.

The walk works in the frame of the structure, where it stands still and the tool moves from
x̂ = T0⁻¹x to ŷ = T1⁻¹y; its planes are then put to where they stand at the end of the tick. A plane
that carries the tool along by n·(T1 T0⁻¹x − x) asks for that much more than one that stands still.

Between the ends of the tick a point p of the tool is at p̂ = Rᵀ(p − c) in that frame, c its origin.
With a constant turn ω and |c′| the speed of the origin, both in a tick,

    |p̂″| ≤ |ω|²|p − c| + 2|ω|(|p′| + |c′|) + |p″|,

so p̂ leaves its chord by an eighth of the first two terms more than p does. For a constant twist the
middle term has |ω||c′|, where |c′| ≤ |c1 − c0|(1 + |ω|²/4) up to half a turn: less.
"""

from __future__ import annotations

import numba
import numpy as np

from vf import layout as at
from vf.kernels import floats_at, integers_at, njit
from vf.qp.problem import height
from vf.tree.shapes import RIGID, shift_near


@njit(cache=True)
def into(motion, pose, x, y, z):  # type: ignore[no-untyped-def]
    """A point of the base frame in that of a structure (at.FROM or at.TO), three numbers [m]."""
    x, y, z = x - motion[pose + 9], y - motion[pose + 10], z - motion[pose + 11]
    return (
        motion[pose] * x + motion[pose + 3] * y + motion[pose + 6] * z,
        motion[pose + 1] * x + motion[pose + 4] * y + motion[pose + 7] * z,
        motion[pose + 2] * x + motion[pose + 5] * y + motion[pose + 8] * z,
    )


@njit(cache=True)
def turned(motion, pose, x, y, z):  # type: ignore[no-untyped-def]
    """A vector of a structure's frame in the base frame, three numbers."""
    return (
        motion[pose] * x + motion[pose + 1] * y + motion[pose + 2] * z,
        motion[pose + 3] * x + motion[pose + 4] * y + motion[pose + 5] * z,
        motion[pose + 6] * x + motion[pose + 7] * y + motion[pose + 8] * z,
    )


@njit(cache=True)
def carried(motion, x):  # type: ignore[no-untyped-def]
    """How far a structure takes the place x (3,) along in the tick, three numbers [m]."""
    px, py, pz = into(motion, at.FROM, x[0], x[1], x[2])
    px, py, pz = turned(motion, at.TO, px, py, pz)
    return (
        px + (motion[at.TO + 9] - x[0]),
        py + (motion[at.TO + 10] - x[1]),
        pz + (motion[at.TO + 11] - x[2]),
    )


@njit(cache=True)
def bend(motion, x, moved):  # type: ignore[no-untyped-def]
    """By how much more a path leaves its chord in the frame of a moving structure [m].

    Args:
        x: (3,) where it starts, base frame.
        moved: how fast the point moves at most, in a tick [m].
    """
    far = 0.0
    for k in range(3):
        far += (x[k] - motion[at.FROM + 9 + k]) ** 2
    spin, pace = motion[at.SPIN], moved + motion[at.DRIFT]
    return 0.125 * spin * (spin * (np.sqrt(far) + pace) + 2.0 * pace)


@njit(cache=True)
def more_reach(motion, x, radius):  # type: ignore[no-untyped-def]
    """By how much the ball around x (3,) is larger in the frame of a moving structure [m].

    Of a path within `radius` of x, base frame: in that frame it is within the radius and this.
    """
    cx, cy, cz = carried(motion, x)
    # Of a path whose chord and sagitta are within the radius, no speed is above five times it.
    return np.sqrt(cx * cx + cy * cy + cz * cz) + bend(motion, x, 5.0 * radius)


@njit(cache=True)
def put(plane, motion):  # type: ignore[no-untyped-def]
    """Move a plane's record from the frame of a structure to where it stands after the tick."""
    n = plane[at.NORMAL : at.NORMAL + 3]
    n[0], n[1], n[2] = turned(motion, at.TO, n[0], n[1], n[2])
    foot = plane[at.FOOT : at.FOOT + 3]
    foot[0], foot[1], foot[2] = turned(motion, at.TO, foot[0], foot[1], foot[2])
    rise = 0.0
    for k in range(3):
        rise += n[k] * motion[at.TO + 9 + k]
        foot[k] += motion[at.TO + 9 + k]
    plane[at.OFFSET] += rise
    plane[at.FLOOR] += rise


@njit(cache=True)
def form(search, blend):  # type: ignore[no-untyped-def]
    """Which shape a surface has at a blend: the number of a form, and a blend if it is between."""
    if search[at.FACES] == 0:
        return 0.0, 0.0
    if blend == 0.0:
        return float(search[at.FORM]), 0.0
    if blend == 1.0:
        return float(search[at.FORM_AFTER]), 0.0
    return float(search[at.FORM_BETWEEN]), blend


@njit(cache=True)
def shape_of(search, blend):  # type: ignore[no-untyped-def]
    """What `certified.walk` needs to know of the shape of a surface at a blend."""
    if search[at.FACES] == 0:
        return RIGID
    return (
        search[at.FACES], search[at.BEFORE], search[at.AFTER], search[at.CORNERS],
        search[at.SLIVERS], search[at.BOXES], search[at.BOXES_AFTER], search[at.NODES], blend,
    )  # fmt: skip


@njit(cache=True)
def shift_of(search, motion, ends, reach):  # type: ignore[no-untyped-def]
    """`shapes.shift_near` of a surface that deforms in this tick."""
    nodes = numba.carray(floats_at(search[at.NODES]), (search[at.NODE_COUNT], 16))
    shifts = numba.carray(floats_at(search[at.SHIFTS]), (search[at.NODE_COUNT], 6))
    shape = shape_of(search, motion[at.BLEND])
    share = motion[at.BLEND_AFTER] - motion[at.BLEND]
    return shift_near(nodes, shifts, shape, ends, reach, share)


@njit(cache=True)
def shift(plane, dx, dy, dz, wx, wy, wz):  # type: ignore[no-untyped-def]
    """Move a plane's record to where it has to be for a surface that deforms, and set its CARRY.

    What it covers is displaced by (dx, dy, dz), give or take (wx, wy, wz), so the plane moves by
    the most that is along its normal.
    """
    nx, ny, nz = plane[at.NORMAL], plane[at.NORMAL + 1], plane[at.NORMAL + 2]
    wide = wx * abs(nx) + wy * abs(ny) + wz * abs(nz)
    along = nx * dx + ny * dy + nz * dz + wide
    plane[at.OFFSET] += along
    plane[at.FLOOR] += along
    plane[at.FOOT] += dx + wide * nx
    plane[at.FOOT + 1] += dy + wide * ny
    plane[at.FOOT + 2] += dz + wide * nz
    plane[at.CARRY] = along


@njit(cache=True)
def set_carries(words, planes, places):  # type: ignore[no-untyped-def]
    """Complete the CARRY of all planes, which is that of their surfaces' deformation so far."""
    fixtures = words[at.FIXTURES]
    searches = numba.carray(integers_at(words[at.SEARCHES]), (fixtures, at.SEARCH))
    motions = numba.carray(floats_at(words[at.MOTIONS]), (fixtures, at.MOTION))
    point = fixture = -1
    x = y = z = 0.0
    for i in range(words[at.COUNT]):
        plane = planes[i]
        p, f = int(plane[at.POINT]), int(plane[at.FIXTURE])
        if searches[f, at.MOVES] == 0:
            plane[at.CARRY] = 0.0
            continue
        if p != point or f != fixture:  # those of a point and a fixture stand side by side
            point, fixture = p, f
            x, y, z = carried(motions[f], places[p])
        n = plane[at.NORMAL : at.NORMAL + 3]
        plane[at.CARRY] += n[0] * x + n[1] * y + n[2] * z


@njit(cache=True)
def shortfall(words, planes, m, places, trials, bulges, guards):  # type: ignore[no-untyped-def]
    """By how much the steps from `places` to `trials` (p, 3) miss a plane at the worst [m].

    Of the tip, and of the bodies beside it. 0 or less: they and their paths keep to all planes and
    balls; inf: not to a ball.
    """
    fixtures = words[at.FIXTURES]
    searches = numba.carray(integers_at(words[at.SEARCHES]), (fixtures, at.SEARCH))
    motions = numba.carray(floats_at(words[at.MOTIONS]), (fixtures, at.MOTION))
    tip = -np.inf
    others = -np.inf
    for p in range(places.shape[0]):
        d = distance(places[p], trials[p])
        if not (d + bulges[p] <= guards[p, at.PATH_LIMIT] and d <= guards[p, at.STEP_LIMIT]):
            if p == 0:
                tip = np.inf
            else:
                others = np.inf
    point = fixture = -1
    bulge = 0.0
    for i in range(m):
        plane = planes[i]
        p, f = int(plane[at.POINT]), int(plane[at.FIXTURE])
        x, y = places[p], trials[p]
        if p != point or f != fixture:  # those of a point and a fixture stand side by side
            point, fixture = p, f
            bulge = bulge_beside(searches, motions, f, x, y, bulges[p])
        start, end = height(plane, x) + plane[at.CARRY], height(plane, y)
        worst = max(plane[at.OFFSET] - end, plane[at.FLOOR] - (min(start, end) - bulge))
        if p == 0:
            tip = max(tip, worst)
        else:
            others = max(others, worst)
    return tip, others


@njit(cache=True)
def distance(x, y):  # type: ignore[no-untyped-def]
    """Of two points (3,) [m]."""
    return np.sqrt((y[0] - x[0]) ** 2 + (y[1] - x[1]) ** 2 + (y[2] - x[2]) ** 2)


@njit(cache=True)
def bulge_beside(searches, motions, f, x, y, bulge):  # type: ignore[no-untyped-def]
    """How far the path of a step from x to y leaves its chord, relative to a structure [m].

    Args:
        f: number of the fixture that the structure is of.
        bulge: how far it leaves its chord in the base frame [m].
    """
    if searches[f, at.MOVES] > 0:
        bulge += bend(motions[f], x, distance(x, y) + 4.0 * bulge)
    return bulge


@njit(cache=True)
def ways(searches, motions, plane, x, y, bulge):  # type: ignore[no-untyped-def]
    """Heights at start and end of a step, and how far its path leaves its chord [m].

    All of them relative to the structure of the plane, whose CARRY is known.
    """
    bulge = bulge_beside(searches, motions, int(plane[at.FIXTURE]), x, y, bulge)
    return height(plane, x) + plane[at.CARRY], height(plane, y), bulge


@njit(cache=True)
def violation(words, planes, m, places, trials, bulges, guards, clear):  # type: ignore[no-untyped-def]
    """How deep the anatomy may be in the tool after a step that could not obey it, at most [m].

    Bodies beside the tip that are known to be `clear` do not count.

    Some place within this distance of where the tool ends has all of the anatomy on the side where
    it was: along the worst plane's normal, if that place obeys all floors, or else back along the
    way, relative to the structure.
    """
    fixtures = words[at.FIXTURES]
    searches = numba.carray(integers_at(words[at.SEARCHES]), (fixtures, at.SEARCH))
    motions = numba.carray(floats_at(words[at.MOTIONS]), (fixtures, at.MOTION))
    back = 0.0  # share of the way
    far = 0.0  # longest way, relative to a structure that moves
    deepest = 0.0
    unsure = 0.0  # planes of surfaces that deform may be this much higher than what they cover
    worst = -1
    for f in range(fixtures):
        if searches[f, at.MOVES] > 0:
            unsure = max(unsure, motions[f, at.MOST_SPREAD])
    for p in range(places.shape[0]):
        if guards[p, at.PATH_LIMIT] == np.inf or (clear and p > 0):
            continue  # the centre of a trocar zone is no part of the tool
        d = distance(places[p], trials[p]) + bulges[p]
        if not d <= guards[p, at.PATH_LIMIT]:
            back = 1.0
        far = max(far, d)
        for f in range(fixtures):
            if searches[f, at.MOVES] > 0:
                far = max(far, d + more_reach(motions[f], places[p], d) + motions[f, at.MOST_SHIFT])
    for i in range(m):
        p = int(planes[i, at.POINT])
        if clear and p > 0:
            continue
        start, end, bulge = ways(searches, motions, planes[i], places[p], trials[p], bulges[p])
        below = planes[i, at.FLOOR] - (min(start, end) - bulge)
        if below > 0.0:
            room = max(start - planes[i, at.FLOOR], 0.0)
            back = max(back, below / (below + room))
            if below > deepest:
                deepest = below
                worst = i
    if back == 0.0:
        return 0.0
    depth = back * far + unsure
    if back < 1.0 and worst >= 0 and deepest < depth:
        for i in range(m):
            p = int(planes[i, at.POINT])
            if clear and p > 0:
                continue
            start, end, bulge = ways(searches, motions, planes[i], places[p], trials[p], bulges[p])
            along = 0.0
            for k in range(3):
                along += planes[i, at.NORMAL + k] * planes[worst, at.NORMAL + k]
            if not min(start, end) - bulge + along * deepest >= planes[i, at.FLOOR] - 1e-12:
                return depth
        return deepest
    return depth

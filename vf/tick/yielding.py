"""A tick in which structures move: the step that misses the planes least where none obeys them."""

from __future__ import annotations

import numba
import numpy as np

from vf import layout as at
from vf.kernels import floats_at, integers_at, njit
from vf.qp.problem import EXIT, LED_OUT, TIGHTENING, height, sagitta
from vf.qp.solver import Solver
from vf.tick.attempts import ask, shortened
from vf.tick.moving import shortfall, violation
from vf.tick.sweep import (
    LEVER,
    at_contact,
    bodies_clear,
    contact_share,
    deepest,
    is_start,
    is_unsure,
    run_of,
)

HALVINGS = 10  # of the length that rows are relaxed by
# Share of what a row can do by itself that it is asked for at most.
WITHIN_REACH = 0.9
# A plane may touch an axis along a part of it: the nearest to the start is this share of the way.
ALONG = 0.9
INFEASIBLE = int(Solver.INFEASIBLE)


@njit(cache=True)
def bound_speed(planes, m, bounds, table):  # type: ignore[no-untyped-def]
    """Let no joint be asked for more than a tick allows, where a structure asks for motion.

    A step that is longer than that is shortened as a whole, which rows that ask for motion do not
    survive.
    """
    for i in range(m):
        if planes[i, at.CARRY] > 0.0 and bounds[i] > 0.0:
            for j in range(table.shape[1]):
                table[at.LOWER, j] = max(table[at.LOWER, j], -table[at.SPEED, j])
                table[at.UPPER, j] = min(table[at.UPPER, j], table[at.SPEED, j])
            return


@njit(cache=True)
def lead_out(words, planes, m, places, guards, rows, bounds, table):  # type: ignore[no-untyped-def]
    """Ask for the growth of margins in this tick, and of what is missing to them for as much again.

    An axis is led out where a plane touches it: what one of its ends cannot do, such as the remote
    centre, is asked of the other. No row is asked for more than it can do by itself. `rows` and
    `bounds` are those of `ask_at_contacts`.
    """
    fixtures = words[at.FIXTURES]
    searches = numba.carray(integers_at(words[at.SEARCHES]), (fixtures, at.SEARCH))
    motions = numba.carray(floats_at(words[at.MOTIONS]), (fixtures, at.MOTION))
    grows = False
    for f in range(fixtures):
        grows |= searches[f, at.MOVES] > 0 and motions[f, at.GROWTH] > 0.0
    if not grows:
        return
    led = False
    i = 0
    while i < m:
        p = int(planes[i, at.POINT])
        count = run_of(planes, m, i)
        axis = is_start(guards, p)
        for k in range(i, i + count):
            f = int(planes[k, at.FIXTURE])
            growth = motions[f, at.GROWTH] if searches[f, at.MOVES] > 0 else 0.0
            if growth == 0.0 or planes[k, at.RULE] == EXIT:
                continue
            keep = planes[k, at.KEEP] + guards[p, at.THICKNESS]
            most = 2.0 * growth + LED_OUT
            if axis:
                led |= _lead_axis(planes, k, k + count, places, rows, bounds, table, keep, most)
            else:
                asked = _missing(planes[k], places[p], keep, most)
                led |= _ask_of(planes[k], rows[k], bounds, k, asked, table)
        i += 2 * count if axis else count
    if led:
        for j in range(table.shape[1]):
            table[at.LOWER, j] = max(table[at.LOWER, j], -table[at.SPEED, j])
            table[at.UPPER, j] = min(table[at.UPPER, j], table[at.SPEED, j])


@njit(cache=True)
def _missing(plane, x, keep, most):  # type: ignore[no-untyped-def]
    """How far x (3,) has to go along a plane's normal in the tick, to have what it has to keep."""
    gap = height(plane, x) + plane[at.CARRY] - height(plane, plane[at.FOOT :])
    return min(keep - gap, most) + TIGHTENING + plane[at.CARRY]


@njit(cache=True)
def _ask_of(plane, row, bounds, k, asked, table):  # type: ignore[no-untyped-def]
    """Ask a row for a motion, as far as it can do that; whether it asks for more than it did."""
    asked = min(asked, WITHIN_REACH * _most(row, table))
    if asked <= plane[at.CARRY] or asked <= bounds[k]:
        return False
    bounds[k] = asked
    return True


@njit(cache=True)
def _most(row, table):  # type: ignore[no-untyped-def]
    """The largest value of a row n·J Δq in a tick [m]."""
    most = 0.0
    for j in range(row.shape[0]):
        if row[j] > 0.0:
            most += row[j] * min(table[at.UPPER, j], table[at.SPEED, j])
        else:
            most += row[j] * max(table[at.LOWER, j], -table[at.SPEED, j])
    return most


@njit(cache=True)
def _lead_axis(planes, k, other, places, rows, bounds, table, keep, most):  # type: ignore[no-untyped-def]
    """`lead_out` for rows k and other, of the start and the end of an axis."""
    p, q = int(planes[k, at.POINT]), int(planes[other, at.POINT])
    share = contact_share(planes[k], places[p], places[q])
    first = _missing(planes[k], places[p], keep, most)
    last = _missing(planes[other], places[q], keep, most)
    gap = 0.0
    carry = (1.0 - share) * planes[k, at.CARRY] + share * planes[other, at.CARRY]
    for c in range(3):
        x = places[p, c] + share * (places[q, c] - places[p, c])
        gap += planes[k, at.NORMAL + c] * (x - planes[k, at.FOOT + c])
    asked = min(keep - gap - carry, most) + TIGHTENING + carry
    if at_contact(planes, k, other, rows, share):
        return _ask_of(planes[k], rows[k], bounds, k, asked, table)
    first = min(first, WITHIN_REACH * _most(rows[k], table))
    last = min(last, WITHIN_REACH * _most(rows[other], table))
    nearest = ALONG * share
    lacking = asked - (1.0 - nearest) * max(first, planes[k, at.CARRY])
    lacking -= nearest * max(last, planes[other, at.CARRY])
    if lacking > 0.0 and share > LEVER:
        last = max(last, planes[other, at.CARRY]) + lacking / nearest
    led = _ask_of(planes[k], rows[k], bounds, k, first, table) if rows[k].any() else False
    return _ask_of(planes[other], rows[other], bounds, other, last, table) or led


@njit(cache=True)
def begin_to_yield(words, numbers, table, scratch, multipliers):  # type: ignore[no-untyped-def]
    """Ask for a step that misses all rows by half of what standing still does."""
    bounds = numba.carray(floats_at(words[at.BOUNDS]), (words[at.ROOM],))
    numbers[at.LOW], numbers[at.HIGH] = 0.0, 0.0
    for i in range(words[at.COUNT]):
        numbers[at.HIGH] = max(numbers[at.HIGH], bounds[i])
    table[at.STEP] = 0.0
    words[at.RECOVERS] = 0
    words[at.STAGE] = at.YIELDING
    words[at.TRIES] = 0
    _ask_half(words, numbers, table, scratch, multipliers)


@njit(cache=True)
def yield_more(words, numbers, table, planes, J, scratch, multipliers):  # type: ignore[no-untyped-def]
    """Go on with the bisection; False: it ended, and STEP is the step of the least relaxation."""
    if words[at.SOLVER] == INFEASIBLE:
        numbers[at.LOW] = numbers[at.GIVEN_UP]
    else:
        numbers[at.HIGH] = numbers[at.GIVEN_UP]
        words[at.FOUND_BY] = words[at.SOLVER]
        shortened(numbers, table, J, scratch, at.STEP)
        for i in range(words[at.COUNT]):
            planes[i, at.PUSH] = multipliers[i]
    words[at.TRIES] += 1
    if words[at.TRIES] < HALVINGS:
        _ask_half(words, numbers, table, scratch, multipliers)
        return True
    numbers[at.GIVEN_UP] = numbers[at.HIGH]
    return False


@njit(cache=True)
def _ask_half(words, numbers, table, scratch, multipliers):  # type: ignore[no-untyped-def]
    bounds = numba.carray(floats_at(words[at.BOUNDS]), (words[at.ROOM],))
    other = numba.carray(floats_at(words[at.OTHER_BOUNDS]), (words[at.ROOM],))
    numbers[at.GIVEN_UP] = 0.5 * (numbers[at.LOW] + numbers[at.HIGH])
    for i in range(words[at.COUNT]):
        other[i] = bounds[i] - numbers[at.GIVEN_UP]
    ask(words, numbers, table, other, scratch, multipliers)


@njit(cache=True)
def keep_least(words, numbers, table, tip, short):  # type: ignore[no-untyped-def]
    """Keep the step just tried if it misses the planes less than those before."""
    if short < numbers[at.LEAST]:
        numbers[at.LEAST] = short
        best = numba.carray(floats_at(words[at.BEST]), (3, 4))
        best[:] = tip
        table[at.CHOSEN] = table[at.TRIAL]
        numbers[at.BEST_SHARE] = numbers[at.SHARE]


@njit(cache=True)
def obeys_all(words, numbers, planes, places, trials, bulges, guards):  # type: ignore[no-untyped-def]
    """Whether a step is allowed, and by how much it misses at the worst [m].

    The tip keeps to the planes; so do bodies beside it, or they keep clear by their distances.
    """
    m = words[at.COUNT]
    tip, others = shortfall(words, planes, m, places, trials, bulges, guards)
    allowed = tip <= 0.0 and (
        others <= 0.0
        or (
            bodies_clear(words, numbers, places, trials, bulges, guards)
            and _keeps_away(words, guards, places, trials)
        )
    )
    if others > 0.0:
        tip = max(tip, _at_contacts(planes, m, places, trials, guards))
    return allowed, tip


@njit(cache=True)
def _keeps_away(words, guards, places, trials):  # type: ignore[no-untyped-def]
    """Whether the tool ends no farther in what is added to margins than if it stood still."""
    if not is_unsure(words):
        return True
    deep = deepest(words, guards, trials, at.TO, True, 0.0)
    return deep == 0.0 or deep <= deepest(words, guards, places, at.TO, True, 0.0)


@njit(cache=True)
def _at_contacts(planes, m, places, trials, guards):  # type: ignore[no-untyped-def]
    """By how much steps miss planes of bodies where these touch them, at the worst [m]."""
    worst = -np.inf
    i = 0
    while i < m:
        p = int(planes[i, at.POINT])
        count = run_of(planes, m, i)
        for k in range(i, i + count):
            short = planes[k, at.OFFSET] - height(planes[k], trials[p])
            if is_start(guards, p):
                share = contact_share(planes[k], places[p], places[p + 1])
                other = planes[k, at.OFFSET] - height(planes[k], trials[p + 1])
                short = (1.0 - share) * short + share * other
            if p > 0:
                worst = max(worst, short)
        i += 2 * count if is_start(guards, p) else count
    return worst


@njit(cache=True)
def still_obeys(words, numbers, planes, places, guards, bulges):  # type: ignore[no-untyped-def]
    """Whether standing still is allowed; clears `bulges`."""
    bulges[:] = 0.0
    return obeys_all(words, numbers, planes, places, places, bulges, guards)[0]


@njit(cache=True)
def choose_least(words, numbers, table, start, tip, planes, places, guards, bulges):  # type: ignore[no-untyped-def]
    """Set the joints to try, and the pose of the tip, to the step kept, or to standing still.

    From inside of a structure only a step that is known to lead out is taken, none that was kept.
    """
    words[at.YIELDS] = at.MISSES
    bulges[:] = 0.0
    still = obeys_all(words, numbers, planes, places, places, bulges, guards)[1]
    if numbers[at.LEAST] < still and words[at.INSIDE] == 0:
        best = numba.carray(floats_at(words[at.BEST]), (3, 4))
        tip[:] = best
        table[at.TRIAL] = table[at.CHOSEN]
        numbers[at.SHARE] = numbers[at.BEST_SHARE]
    else:
        tip[:] = start
        table[at.TRIAL] = table[at.POSITION]
        numbers[at.SHARE] = 0.0


@njit(cache=True)
def measure_violation(  # type: ignore[no-untyped-def]
    words, numbers, table, start, tip, planes, places, trials, jacobians, guards, bulges
):  # fmt: skip
    """Set VIOLATION of the joints at TRIAL, or stand still if that is less deep."""
    m = words[at.COUNT]
    for j in range(table.shape[1]):
        table[at.OTHER, j] = table[at.TRIAL, j] - table[at.POSITION, j]
    for p in range(bulges.shape[0]):
        bulges[p] = sagitta(jacobians[p], table[at.OTHER], 1.0, table[at.TURNS])
    clear = bodies_clear(words, numbers, places, trials, bulges, guards)
    depth = violation(words, planes, m, places, trials, bulges, guards, clear)
    if depth > 0.0 and numbers[at.SHARE] > 0.0:
        bulges[:] = 0.0
        clear = bodies_clear(words, numbers, places, places, bulges, guards)
        still = violation(words, planes, m, places, places, bulges, guards, clear)
        if still < depth:
            depth = still
            numbers[at.SHARE] = 0.0
            tip[:] = start
            table[at.TRIAL] = table[at.POSITION]
            trials[:] = places
    numbers[at.VIOLATION] = depth

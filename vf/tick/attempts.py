"""The steps that a tick tries one after the other, until one passes the check.

In this order: the optimum; a shorter part of it, if the true tip moved farther than the linear
prediction and only that is wrong; the optimum with the rows moved by the linearisation error just
measured; parts of the first, by bisection; standing still.

Below the standoff a step passes only if it gains a share of what recovery asks for. A step is bent,
so the longest part of one that just obeys the planes has lost to the bend what it would recover,
and a tool that takes such steps tick by tick is carried into the mesh by its actuation errors.
Where the optimum and its correction gain too little, the bisection therefore begins at the least
step that recovers instead of at standing still.
"""

from __future__ import annotations

import numba
import numpy as np

from vf import layout as at
from vf.kernels import floats_at, integers_at, njit
from vf.qp.active_set import answer, attempt, finish
from vf.qp.problem import RECOVERY, TIGHTENING, height, pace, sagitta
from vf.qp.solver import Solver

BISECTIONS = 12
# How often a step is shortened to where the true tip keeps to the motion sphere and to its speed.
SHORTENINGS = 4
# Share of what recovery asks for that a step has to gain. With `RECOVERY` it is a third of what is
# missing, so that no number of actuation errors in a row adds up to more than three of them.
GAINED = 2.0 / 3.0
# Of what leads out of a margin that grows a step may lack this much [m], which the next one catches
# up with: less than `LED_OUT`.
LEFT_BEHIND = 5e-6
# A deficit below this share of the standoff is rounding: it asks for nothing, and is not reported.
NEGLIGIBLE = 0.1
# A step that gains less than this share of what is asked for at every plane does not count.
LITTLE = 0.05
# Damping of the step that recovers as much as it can [m²], against rows of up to 1 m².
SOFT = 1e-6
INFEASIBLE, EXACT = int(Solver.INFEASIBLE), int(Solver.SOLVED)


@njit(cache=True)
def ask(words, numbers, table, bounds, scratch, multipliers):  # type: ignore[no-untyped-def]
    """Solve the problem with these bounds if no solver is needed for it; True: one is needed."""
    rows = numba.carray(floats_at(words[at.ROWS]), (words[at.ROOM], words[at.JOINTS]))
    words[at.SOLVER], words[at.LEFT] = attempt(
        table[at.TASK : at.TASK + 6], numbers[at.DESIRED : at.DESIRED + 6], numbers[at.DAMPING],
        rows, bounds, table[at.LOWER], table[at.UPPER], table[at.HORIZON], words[at.COUNT],
        scratch, multipliers,
    )  # fmt: skip
    return words[at.LEFT] > 0


@njit(cache=True)
def settle(words, n, table, scratch, multipliers):  # type: ignore[no-untyped-def]
    """Take over the answer of the solver."""
    words[at.SOLVER] = words[at.ANSWER]
    if words[at.SOLVER] != INFEASIBLE:
        u = numba.carray(floats_at(words[at.SOLUTION]), (n,))
        duals = numba.carray(floats_at(words[at.DUALS]), (words[at.LEFT],))
        if finish(u, duals, words[at.LEFT], table[at.LOWER], table[at.UPPER], scratch, multipliers):
            words[at.SOLVER] = EXACT
    words[at.LEFT] = 0


@njit(cache=True)
def shortened(numbers, table, J, scratch, row):  # type: ignore[no-untyped-def]
    """Write the solver's step, shortened to what a tick allows, to a row; False: the step is zero.

    All joints are shortened by the same factor, so that the step obeys the rows and keeps its
    direction.
    """
    n = table.shape[1]
    dq = answer(scratch, n)
    numbers[at.PACED] = pace(dq, table[at.SPEED], J, numbers[at.TIP_REACH])
    moves = False
    for j in range(n):
        table[row, j] = numbers[at.PACED] * dq[j]
        moves |= table[row, j] != 0.0
    return moves


@njit(cache=True)
def set_trial(numbers, table, jacobians, row, share, bulges):  # type: ignore[no-untyped-def]
    """Set the joints to try: a share of a step, no joint farther beyond its limits than it is."""
    for j in range(table.shape[1]):
        q = table[at.POSITION, j]
        # The sum may round to just beyond a limit.
        high, low = max(table[at.HIGHEST, j], q), min(table[at.LOWEST, j], q)
        table[at.TRIAL, j] = min(max(q + share * table[row, j], low), high)
    for p in range(bulges.shape[0]):
        bulges[p] = 0.0
        if numbers[at.GUARDED] > 0.0:
            bulges[p] = sagitta(jacobians[p], table[row], share, table[at.TURNS])
    numbers[at.SHARE] = share


@njit(cache=True)
def bisect(words, numbers, table, start, jacobians, bulges):  # type: ignore[no-untyped-def]
    """Begin the bisection: the first part is half of the step; none of it is always allowed."""
    words[at.STAGE] = at.PART
    words[at.RECOVERS] = words[at.TRIES] = 0
    numbers[at.LOW], numbers[at.HIGH], numbers[at.BEST_SHARE] = 0.0, 1.0, 0.0
    best = numba.carray(floats_at(words[at.BEST]), (3, 4))
    best[:] = start
    table[at.CHOSEN] = table[at.POSITION]
    set_trial(numbers, table, jacobians, at.STEP, 0.5, bulges)


@njit(cache=True)
def next_attempt(  # type: ignore[no-untyped-def]
    words, numbers, table, planes, places, trials, jacobians, guards, bulges, scratch, multipliers,
    allowed, start, tip,
):  # fmt: skip
    """Choose the next attempt, given whether the last one was allowed.

    Returns:
        TRIED: there are joints to try; SOLVED: there is a problem to solve; DONE.
    """
    stage = words[at.STAGE]
    if stage <= at.YIELDING:
        _miss(words, table, places, trials, jacobians)
        words[at.TRIES] = 0
        if _too_far(numbers, table, places, trials, jacobians, guards, bulges):
            words[at.STAGE] = at.SHORTER
            return at.TRIED
        return _correct(words, numbers, table, planes, scratch, multipliers)
    if stage == at.SHORTER:
        for j in range(table.shape[1]):
            table[at.STEP, j] *= numbers[at.SHARE]
        words[at.TRIES] += 1
        if words[at.TRIES] < SHORTENINGS and _too_far(
            numbers, table, places, trials, jacobians, guards, bulges
        ):
            return at.TRIED
        return _correct(words, numbers, table, planes, scratch, multipliers)
    if stage == at.CORRECTED:
        if words[at.RECOVERS] > 0:
            ask_to_recover(words, numbers, table, scratch, multipliers)
            return at.SOLVED
        bisect(words, numbers, table, start, jacobians, bulges)
        return at.TRIED
    if stage == at.RECOVERY:
        if allowed and take_gains(words, planes, places, trials):
            begin_between(words, numbers, table, tip, jacobians, bulges)
        elif not halve_recovery(words, numbers, table, jacobians, bulges):
            bisect(words, numbers, table, start, jacobians, bulges)
        return at.TRIED
    best = numba.carray(floats_at(words[at.BEST]), (3, 4))
    if allowed:
        best[:] = tip
        table[at.CHOSEN] = table[at.TRIAL]
        numbers[at.LOW] = numbers[at.BEST_SHARE] = numbers[at.SHARE]
    else:
        numbers[at.HIGH] = numbers[at.SHARE]
    words[at.TRIES] += 1
    if words[at.TRIES] < BISECTIONS:
        set_part(words, numbers, table, jacobians, bulges)
        return at.TRIED
    tip[:] = best
    table[at.TRIAL] = table[at.CHOSEN]
    numbers[at.SHARE] = numbers[at.BEST_SHARE]
    if words[at.RECOVERS] > 0:
        numbers[at.SHARE] = max(numbers[at.SHARE], 0.5**BISECTIONS)  # the tool does not stand still
    return at.DONE


@njit(cache=True)
def _miss(words, table, places, trials, jacobians):  # type: ignore[no-untyped-def]
    """Write the linearisation error of the step at every guarded point [m]."""
    errors = numba.carray(floats_at(words[at.ERRORS]), (words[at.POINTS], 3))
    for p in range(words[at.POINTS]):
        for k in range(3):
            moved = 0.0
            for j in range(table.shape[1]):
                moved += jacobians[p, k, j] * table[at.STEP, j]
            errors[p, k] = trials[p, k] - places[p, k] - moved


@njit(cache=True)
def _too_far(numbers, table, places, trials, jacobians, guards, bulges):  # type: ignore[no-untyped-def]
    """If a true point moved too far, set a shorter step as the trial; whether one did."""
    least = np.inf
    for p in range(places.shape[0]):
        x, y = places[p], trials[p]
        d2 = (y[0] - x[0]) ** 2 + (y[1] - x[1]) ** 2 + (y[2] - x[2]) ** 2
        length = np.sqrt(d2)
        if length > guards[p, at.STEP_LIMIT]:
            least = min(least, (1.0 - 1e-9) * guards[p, at.STEP_LIMIT] / length)
    if not least < np.inf:
        return False
    set_trial(numbers, table, jacobians, at.STEP, least, bulges)
    return True


@njit(cache=True)
def _correct(words, numbers, table, planes, scratch, multipliers):  # type: ignore[no-untyped-def]
    """Solve again, with the rows moved by the linearisation error just measured; SOLVED."""
    bounds = numba.carray(floats_at(words[at.BOUNDS]), (words[at.ROOM],))
    other = numba.carray(floats_at(words[at.OTHER_BOUNDS]), (words[at.ROOM],))
    errors = numba.carray(floats_at(words[at.ERRORS]), (words[at.POINTS], 3))
    for i in range(words[at.COUNT]):
        plane = planes[i]
        missed = height(plane, errors[int(plane[at.POINT])])
        other[i] = (bounds[i] - numbers[at.GIVEN_UP] - missed) / numbers[at.PACED]
    words[at.STAGE] = at.CORRECTED
    ask(words, numbers, table, other, scratch, multipliers)
    return at.SOLVED


@njit(cache=True)
def note_gains(words, numbers, planes, bounds):  # type: ignore[no-untyped-def]
    """Note in GAINS what planes ask a step to recover, and in RECOVERS whether any does.

    In NEEDED is what it has to gain at least: a share, but nearly all of it where a margin grows.
    From inside of something only the way out counts.
    """
    searches = numba.carray(integers_at(words[at.SEARCHES]), (words[at.FIXTURES], at.SEARCH))
    motions = numba.carray(floats_at(words[at.MOTIONS]), (words[at.FIXTURES], at.MOTION))
    needed = numba.carray(floats_at(words[at.NEEDED]), (words[at.ROOM],))
    gains = numba.carray(floats_at(words[at.GAINS]), (words[at.ROOM],))
    words[at.RECOVERS] = 0
    if words[at.INSIDE] > 0 or not numbers[at.DEFICIT] > NEGLIGIBLE * numbers[at.STANDOFF]:
        return
    least = RECOVERY * (NEGLIGIBLE * numbers[at.STANDOFF] + TIGHTENING)
    for i in range(words[at.COUNT]):
        gains[i] = bounds[i] if bounds[i] > least else 0.0
        needed[i] = GAINED * gains[i]
        if gains[i] > 0.0:
            words[at.RECOVERS] = 1
            f = int(planes[i, at.FIXTURE])
            if searches[f, at.MOVES] > 0 and motions[f, at.GROWTH] > 0.0:
                needed[i] = max(needed[i], gains[i] - LEFT_BEHIND)


@njit(cache=True)
def recovers(words, planes, places, trials):  # type: ignore[no-untyped-def]
    """Whether the step tried gains at every plane what is NEEDED."""
    gains = numba.carray(floats_at(words[at.GAINS]), (words[at.ROOM],))
    needed = numba.carray(floats_at(words[at.NEEDED]), (words[at.ROOM],))
    for i in range(words[at.COUNT]):
        if gains[i] > 0.0:
            p = int(planes[i, at.POINT])
            gained = height(planes[i], trials[p]) - height(planes[i], places[p])
            if not gained >= needed[i]:
                return False
    return True


@njit(cache=True)
def ask_to_recover(words, numbers, table, scratch, multipliers):  # type: ignore[no-untyped-def]
    """Ask for the least joint step that recovers what the planes ask for.

    Where there is none, a second call asks for the step that recovers most in the sense of least
    squares, while no plane is approached beyond what the rows allow.
    """
    n, m = words[at.JOINTS], words[at.COUNT]
    rows = numba.carray(floats_at(words[at.ROWS]), (words[at.ROOM], n))
    bounds = numba.carray(floats_at(words[at.BOUNDS]), (words[at.ROOM],))
    other = numba.carray(floats_at(words[at.OTHER_BOUNDS]), (words[at.ROOM],))
    gains = numba.carray(floats_at(words[at.GAINS]), (words[at.ROOM],))
    soft = words[at.STAGE] == at.RECOVERY
    words[at.STAGE] = at.RECOVERY
    words[at.TRIES] = 1 if soft else 0
    task = numba.carray(floats_at(words[at.SOUGHT]), (words[at.ROOM], n))
    asked = numba.carray(floats_at(words[at.SOUGHT_GAINS]), (words[at.ROOM],))
    count = 0
    for i in range(m):
        other[i] = min(bounds[i], 0.0) if soft else max(bounds[i], gains[i])
        if soft and gains[i] > 0.0:
            task[count] = rows[i]
            asked[count] = gains[i]
            count += 1
    words[at.SOLVER], words[at.LEFT] = attempt(
        task[:count], asked[:count], SOFT if soft else 1.0, rows, other, table[at.LOWER],
        table[at.UPPER], table[at.HORIZON], m, scratch, multipliers,
    )  # fmt: skip


@njit(cache=True)
def set_recovery(words, numbers, table, J, jacobians, bulges, scratch):  # type: ignore[no-untyped-def]
    """Set the step that recovers as the trial; False: there is none."""
    words[at.TRIES] = 0
    if words[at.SOLVER] == INFEASIBLE or not shortened(numbers, table, J, scratch, at.OTHER):
        return False
    set_trial(numbers, table, jacobians, at.OTHER, 1.0, bulges)
    return True


@njit(cache=True)
def halve_recovery(words, numbers, table, jacobians, bulges):  # type: ignore[no-untyped-def]
    """Set half of the step that recovers as the trial; False: it was halved often enough."""
    words[at.TRIES] += 1
    if words[at.TRIES] > SHORTENINGS:
        return False
    for j in range(table.shape[1]):
        table[at.OTHER, j] *= 0.5
    set_trial(numbers, table, jacobians, at.OTHER, 1.0, bulges)
    return True


@njit(cache=True)
def take_gains(words, planes, places, trials):  # type: ignore[no-untyped-def]
    """Ask for no more than the step just tried gains, where that is too little; False: nothing."""
    gains = numba.carray(floats_at(words[at.GAINS]), (words[at.ROOM],))
    needed = numba.carray(floats_at(words[at.NEEDED]), (words[at.ROOM],))
    some = False
    for i in range(words[at.COUNT]):
        if gains[i] > 0.0:
            p = int(planes[i, at.POINT])
            gained = height(planes[i], trials[p]) - height(planes[i], places[p])
            some |= gained > LITTLE * gains[i]
            if gained < needed[i]:
                gains[i] = max(gained, 0.0)
                needed[i] = GAINED * gains[i]
    return some


@njit(cache=True)
def begin_between(words, numbers, table, tip, jacobians, bulges):  # type: ignore[no-untyped-def]
    """Begin the bisection between the step that recovers, which was just tried, and the optimum."""
    words[at.STAGE] = at.PART
    words[at.TRIES] = 0
    numbers[at.LOW], numbers[at.HIGH], numbers[at.BEST_SHARE] = 0.0, 1.0, 0.0
    best = numba.carray(floats_at(words[at.BEST]), (3, 4))
    best[:] = tip
    table[at.CHOSEN] = table[at.TRIAL]
    set_part(words, numbers, table, jacobians, bulges)


@njit(cache=True)
def set_part(words, numbers, table, jacobians, bulges):  # type: ignore[no-untyped-def]
    """Set the next trial of the bisection."""
    share = 0.5 * (numbers[at.LOW] + numbers[at.HIGH])
    if words[at.RECOVERS] == 0:
        set_trial(numbers, table, jacobians, at.STEP, share, bulges)
        return
    for j in range(table.shape[1]):
        base = table[at.OTHER, j]
        table[at.MIX, j] = base + share * (table[at.STEP, j] - base)
    set_trial(numbers, table, jacobians, at.MIX, 1.0, bulges)
    numbers[at.SHARE] = share

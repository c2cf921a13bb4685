"""The steps that a tick tries one after the other, until one passes the check.

In this order: the optimum; a shorter part of it, if the true tip moved farther than the linear
prediction and only that is wrong; the optimum with the rows moved by the linearisation error just
measured; parts of the first, by bisection; standing still.
"""

from __future__ import annotations

import numba
import numpy as np

from vf import layout as at
from vf.kernels import floats_at, njit
from vf.qp.active_set import answer, attempt, finish
from vf.qp.problem import height, pace, sagitta
from vf.qp.solver import Solver

BISECTIONS = 12
# How often a step is shortened to where the true tip keeps to the motion sphere and to its speed.
SHORTENINGS = 4
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
    words[at.TRIES] = 0
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
        share = 0.5 * (numbers[at.LOW] + numbers[at.HIGH])
        set_trial(numbers, table, jacobians, at.STEP, share, bulges)
        return at.TRIED
    tip[:] = best
    table[at.TRIAL] = table[at.CHOSEN]
    numbers[at.SHARE] = numbers[at.BEST_SHARE]
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

"""A tick in one compiled call: from measured joints and target to checked joints, planes and force.

`tick` runs until it is done or needs an answer from Python: from an arm or a fixture that only has
Python methods, whether a tip is inside (where no checked step led to it), or from a solver. It then
returns which answer it needs, and continues from there when it is called again. Its memory is one
block (`vf.tick.block`), described in `vf.layout`.
"""

from __future__ import annotations

import numba
import numpy as np

from vf import layout as at
from vf.kernels import floats_at, integers_at, njit, now
from vf.planes import LARGEST
from vf.qp.problem import JOINT_RANGE, desired_step, fill_rows, obeys, usable
from vf.qp.solver import Solver
from vf.tick.attempts import (
    ask,
    ask_to_recover,
    bisect,
    next_attempt,
    note_gains,
    recovers,
    set_recovery,
    set_trial,
    settle,
    shortened,
)
from vf.tick.chain import LINK, jacobian, place_points, point_jacobian, tip_pose
from vf.tick.moving import set_carries, shortfall
from vf.tick.report import write_report
from vf.tick.search import search_bodies, search_planes, set_radius, sides_known
from vf.tick.sweep import ask_at_contacts, deepest, is_unsure, overlapped
from vf.tick.yielding import (
    begin_to_yield,
    bound_speed,
    choose_least,
    keep_least,
    lead_out,
    measure_violation,
    obeys_all,
    still_obeys,
    yield_more,
)

INFEASIBLE, EXACT = int(Solver.INFEASIBLE), int(Solver.SOLVED)


@njit(cache=True)
def tick(address, q, goal, phase):  # type: ignore[no-untyped-def]
    """Begin a tick, or continue it.

    Args:
        address: of the words (at.WORDS,) of the block.
        q: joint positions [rad or m], the same throughout a tick.
        goal: (4, 4) pose of the target, base frame, likewise.
        phase: BEGIN, or the phase that the last call returned.

    Returns:
        The number of planes in the report: the tick is done. Or less than zero: minus the phase to
        continue with when its question is answered, or minus the reason why there is no step.
    """
    words = numba.carray(integers_at(address), (at.WORDS,))
    n = words[at.JOINTS]
    numbers = numba.carray(floats_at(words[at.NUMBERS]), (at.SCALARS,))
    table = numba.carray(floats_at(words[at.TABLE]), (at.JOINT_ROWS, n))
    start = numba.carray(floats_at(words[at.START]), (3, 4))
    J = numba.carray(floats_at(words[at.JACOBIAN]), (6, n))
    if phase == at.BEGIN:
        if q.shape[0] != n:
            return -at.NO_JOINTS
        total = 0.0
        for j in range(n):
            table[at.POSITION, j] = q[j]
            total += abs(q[j])
        # Rounding of the sines of larger angles would be as large as what is guarded.
        if not total <= JOINT_RANGE:
            return -at.NO_JOINTS
        if words[at.LINKS] == 0:
            return -at.PLACED
        _place(words, table[at.POSITION], start)
        axes = numba.carray(floats_at(words[at.AXES]), (words[at.LINKS], 6))
        chain = numba.carray(floats_at(words[at.CHAIN]), (words[at.LINKS], LINK))
        jacobian(chain, axes, start[0, 3], start[1, 3], start[2, 3], J)
        phase = at.PLACED
    points = words[at.POINTS]
    places = numba.carray(floats_at(words[at.PLACES]), (points, 3))
    jacobians = numba.carray(floats_at(words[at.JACOBIANS]), (points, 3, n))
    guards = numba.carray(floats_at(words[at.GUARDS]), (points, at.GUARD))
    if phase == at.PLACED:
        numbers[at.MARKS] = now()
        if words[at.LINKS] == 0 and not _placed(start, J):
            return -at.NO_JOINTS
        if not usable(goal):
            return -at.NO_TARGET
        for k in range(3):
            places[0, k] = start[k, 3]
            for j in range(n):
                jacobians[0, k, j] = J[k, j]
        if points > 1:
            _place_bodies(words, table[at.POSITION], guards, places, jacobians)
        words[at.YIELDS] = 0
        numbers[at.GIVEN_UP] = numbers[at.VIOLATION] = 0.0
        numbers[at.LEAST] = np.inf
        if not sides_known(words, places[0]):
            return -at.SIDED
        phase = at.SIDED
    planes = numba.carray(floats_at(words[at.PLANES]), (words[at.ROOM], at.PLANE))
    if phase == at.SIDED:
        set_radius(words, numbers, J, table[at.SPEED], places[0])
        if words[at.INSIDE] > 0 or not search_planes(words, numbers, planes, places[0]):
            return -at.FOUND
        phase = at.FOUND

    if phase == at.FOUND and words[at.BODIES] > 0:
        search_bodies(words, numbers, planes, places, jacobians, guards, table)
    m = words[at.COUNT]
    bounds = numba.carray(floats_at(words[at.BOUNDS]), (words[at.ROOM],))
    multipliers = numba.carray(floats_at(words[at.MULTIPLIERS]), (words[at.ROOM],))
    scratch = numba.carray(floats_at(words[at.SCRATCH]), (words[at.SCRATCH_SIZE],))
    if phase == at.FOUND:
        # The step ends within the motion sphere, and its path within what was searched for it.
        radius, reach = numbers[at.RADIUS], numbers[at.REACH]
        numbers[at.ALLOWED] = min(reach, radius)
        whole = reach >= numbers[at.SEARCHED]
        numbers[at.FARTHEST] = reach - numbers[at.BEYOND] if whole else reach
        numbers[at.LONGEST] = min(numbers[at.ALLOWED], numbers[at.TIP_REACH])
        if words[at.STUCK] > 0:
            numbers[at.ALLOWED] = 0.0
        guards[0, at.PATH_LIMIT] = numbers[at.FARTHEST]
        guards[0, at.STEP_LIMIT] = numbers[at.LONGEST]
        numbers[at.MARKS + 1] = now()
        desired_step(
            start,
            goal,
            numbers[at.ALLOWED],
            numbers[at.LENGTH],
            numbers[at.DESIRED : at.DESIRED + 6],
        )
        for j in range(n):
            for k in range(3):
                table[at.TASK + k, j] = J[k, j]
                table[at.TASK + 3 + k, j] = numbers[at.LENGTH] * J[3 + k, j]
            # A joint pushed beyond its limit may stay or come back, so that zero is allowed.
            table[at.LOWER, j] = min(table[at.LOWEST, j] - table[at.POSITION, j], 0.0)
            table[at.UPPER, j] = max(table[at.HIGHEST, j] - table[at.POSITION, j], 0.0)
        rows = numba.carray(floats_at(words[at.ROWS]), (words[at.ROOM], n))
        moving = words[at.MOVING] > 0
        if moving:
            set_carries(words, planes, places)
        numbers[at.DISTANCE], numbers[at.DEFICIT] = fill_rows(
            planes,
            m,
            places,
            jacobians,
            numbers[at.STANDOFF],
            guards,
            moving,
            numbers[at.APPROACH],
            rows,
            bounds,
        )
        if moving:
            if points > 1:
                ask_at_contacts(planes, m, places, guards, rows, bounds)
            lead_out(words, planes, m, places, guards, rows, bounds, table)
            bound_speed(planes, m, bounds, table)
        note_gains(words, numbers, planes, bounds)
        words[at.STAGE] = at.WHOLE
        if ask(words, numbers, table, bounds, scratch, multipliers):
            return -at.SOLVED
        phase = at.SOLVED

    trials = numba.carray(floats_at(words[at.TRIALS]), (points, 3))
    bulges = numba.carray(floats_at(words[at.BULGES]), (points,))
    tip = numba.carray(floats_at(words[at.TIP]), (3, 4))
    allowed = False
    while True:
        if phase == at.SOLVED:
            if words[at.LEFT] > 0:
                settle(words, n, table, scratch, multipliers)
            if words[at.STAGE] == at.YIELDING:
                if yield_more(words, numbers, table, planes, J, scratch, multipliers):
                    if words[at.LEFT] > 0:
                        return -at.SOLVED
                    continue
                set_trial(numbers, table, jacobians, at.STEP, 1.0, bulges)
            elif words[at.STAGE] <= at.RELAXED:
                infeasible = words[at.SOLVER] == INFEASIBLE
                if infeasible and numbers[at.DEFICIT] > 0.0 and words[at.STAGE] == at.WHOLE:
                    # The joints may not be able to recover that fast: zero motion obeys these rows,
                    # or would if the structures stood still.
                    for i in range(m):
                        bounds[i] = min(bounds[i], planes[i, at.CARRY])
                    words[at.STAGE] = at.RELAXED
                    if ask(words, numbers, table, bounds, scratch, multipliers):
                        return -at.SOLVED
                    continue
                words[at.FOUND_BY] = words[at.SOLVER]
                for i in range(m):
                    planes[i, at.PUSH] = multipliers[i]
                if infeasible and words[at.MOVING] > 0 and words[at.STUCK] == 0:
                    begin_to_yield(words, numbers, table, scratch, multipliers)
                    if words[at.LEFT] > 0:
                        return -at.SOLVED
                    continue
                moves = shortened(numbers, table, J, scratch, at.STEP)
                numbers[at.MARKS + 2] = now()
                stays = not moves and words[at.MOVING] == 0 and words[at.RECOVERS] == 0
                if stays or words[at.STUCK] > 0:
                    numbers[at.SHARE] = 0.0 if words[at.STUCK] > 0 else 1.0
                    table[at.TRIAL] = table[at.POSITION]
                    tip[:] = start
                    return _end(words, numbers, table, goal, tip, planes, places, guards)
                set_trial(numbers, table, jacobians, at.STEP, 1.0, bulges)
            elif words[at.STAGE] == at.RECOVERY:
                infeasible = words[at.SOLVER] == INFEASIBLE
                if infeasible and words[at.TRIES] == 0:
                    ask_to_recover(words, numbers, table, scratch, multipliers)
                    if words[at.LEFT] > 0:
                        return -at.SOLVED
                    continue
                if not set_recovery(words, numbers, table, J, jacobians, bulges, scratch):
                    bisect(words, numbers, table, start, jacobians, bulges)
            elif words[at.SOLVER] == INFEASIBLE:
                if words[at.MOVING] > 0 and not still_obeys(
                    words, numbers, planes, places, guards, bulges
                ):
                    return _end_yielding(
                        words, numbers, table, goal, start, tip, planes, places, trials, jacobians,
                        guards, bulges,
                    )  # fmt: skip
                if words[at.RECOVERS] > 0:
                    ask_to_recover(words, numbers, table, scratch, multipliers)
                    if words[at.LEFT] > 0:
                        return -at.SOLVED
                    continue
                bisect(words, numbers, table, start, jacobians, bulges)
            else:
                shortened(numbers, table, J, scratch, at.OTHER)
                set_trial(numbers, table, jacobians, at.OTHER, 1.0, bulges)
            if words[at.LINKS] == 0:
                return -at.TRIED
            _place(words, table[at.TRIAL], tip)
            phase = at.TRIED
        if phase == at.TRIED:
            for k in range(3):
                trials[0, k] = tip[k, 3]
            if points > 1:
                chain = numba.carray(floats_at(words[at.CHAIN]), (words[at.LINKS], LINK))
                place_points(chain, table[at.TRIAL], guards, trials)
            if words[at.MOVING] == 0:
                allowed = obeys(planes, m, places, trials, bulges, guards)
            else:
                allowed, short = obeys_all(words, numbers, planes, places, trials, bulges, guards)
                if not allowed and words[at.STAGE] < at.PART:
                    keep_least(words, numbers, table, tip, short)
            if allowed and words[at.INSIDE] > 0:
                return -at.JUDGED
            if allowed and words[at.RECOVERS] > 0:
                allowed = _recovers(words, numbers, planes, places, trials, guards, bulges)
        else:
            allowed = words[at.ANSWER] > 0
        if allowed and words[at.STAGE] < at.PART:
            # The optimum within the tick's bounds, of the first or the corrected problem.
            numbers[at.SHARE] = 1.0
            return _end(words, numbers, table, goal, tip, planes, trials, guards)
        if (
            words[at.MOVING] > 0
            and words[at.STAGE] == at.CORRECTED
            and not still_obeys(words, numbers, planes, places, guards, bulges)
        ):
            return _end_yielding(
                words, numbers, table, goal, start, tip, planes, places, trials, jacobians, guards,
                bulges,
            )  # fmt: skip
        phase = next_attempt(
            words, numbers, table, planes, places, trials, jacobians, guards, bulges, scratch,
            multipliers, allowed, start, tip,
        )  # fmt: skip
        if phase == at.SOLVED:
            if words[at.LEFT] > 0:
                return -at.SOLVED
            continue
        if phase == at.DONE:
            for k in range(3):
                trials[0, k] = tip[k, 3]
            return _end(words, numbers, table, goal, tip, planes, trials, guards)
        if words[at.LINKS] == 0:
            return -at.TRIED
        _place(words, table[at.TRIAL], tip)


@njit(cache=True)
def _end_yielding(  # type: ignore[no-untyped-def]
    words, numbers, table, goal, start, tip, planes, places, trials, jacobians, guards, bulges
):  # fmt: skip
    """Take the step that misses the planes least, which is no worse than standing still."""
    choose_least(words, numbers, table, start, tip, planes, places, guards, bulges)
    for k in range(3):
        trials[0, k] = tip[k, 3]
    if words[at.POINTS] > 1:
        chain = numba.carray(floats_at(words[at.CHAIN]), (words[at.LINKS], LINK))
        place_points(chain, table[at.TRIAL], guards, trials)
    measure_violation(
        words, numbers, table, start, tip, planes, places, trials, jacobians, guards, bulges
    )
    return _end(words, numbers, table, goal, tip, planes, trials, guards)


@njit(cache=True)
def _end(words, numbers, table, goal, tip, planes, ends, guards):  # type: ignore[no-untyped-def]
    """Write the report of a step to `ends` (p, 3). Returns the number of planes.

    A tool that a structure is in has been overtaken until it is out of it again, although its
    centre and its axes obey their planes. So has one that a structure may be in, for it is known
    only to within what is added to its margins.
    """
    if words[at.MOVING] > 0:
        deep = numbers[at.VIOLATION]
        if overlapped(words, planes, guards, False):
            deep = max(deep, deepest(words, guards, ends, at.TO, False, deep))
            if deep > 0.0:
                words[at.YIELDS] = at.MISSES
        if is_unsure(words) and _may_be_met(words, planes, guards, ends):
            places = numba.carray(floats_at(words[at.PLACES]), (words[at.POINTS], 3))
            before = deepest(words, guards, places, at.FROM, True, 0.0)
            after = deepest(words, guards, ends, at.TO, True, deep)
            if max(before, after) > 0.0 and deep == 0.0:
                words[at.YIELDS] = at.AT_RISK
            deep = max(deep, max(before, after))
        numbers[at.VIOLATION] = deep
    return write_report(words, numbers, table, goal, tip, planes, ends[0])


@njit(cache=True)
def _may_be_met(words, planes, guards, ends):  # type: ignore[no-untyped-def]
    """Whether planes leave it open that the tool keeps what is added to margins in the tick."""
    if overlapped(words, planes, guards, True):
        return True
    places = numba.carray(floats_at(words[at.PLACES]), (words[at.POINTS], 3))
    bulges = numba.carray(floats_at(words[at.BULGES]), (words[at.POINTS],))
    tip, others = shortfall(words, planes, words[at.COUNT], places, ends, bulges, guards)
    return max(tip, others) > 0.0


@njit(cache=True)
def _recovers(words, numbers, planes, places, trials, guards, bulges):  # type: ignore[no-untyped-def]
    """Whether a step that is allowed may be taken below the standoff, see `attempts`."""
    if words[at.STAGE] == at.RECOVERY or recovers(words, planes, places, trials):
        return True
    # Where standing still is not allowed any step that is will do: a structure is coming.
    return words[at.MOVING] > 0 and not still_obeys(words, numbers, planes, places, guards, bulges)


@njit(cache=True)
def _place(words, q, pose):  # type: ignore[no-untyped-def]
    """Pose (3, 4) of the tip for joints q (n,), by the chain."""
    chain = numba.carray(floats_at(words[at.CHAIN]), (words[at.LINKS], LINK))
    axes = numba.carray(floats_at(words[at.AXES]), (words[at.LINKS], 6))
    tip_pose(chain, q, pose, axes)


@njit(cache=True)
def _place_bodies(words, q, guards, places, jacobians):  # type: ignore[no-untyped-def]
    """Guarded points but the tip, and their Jacobians, for joints q (n,) that `_place` was for."""
    chain = numba.carray(floats_at(words[at.CHAIN]), (words[at.LINKS], LINK))
    axes = numba.carray(floats_at(words[at.AXES]), (words[at.LINKS], 6))
    place_points(chain, q, guards, places)
    for p in range(1, places.shape[0]):
        joints = int(guards[p, at.ANCHOR])
        point_jacobian(chain, axes, joints, places[p, 0], places[p, 1], places[p, 2], jacobians[p])


@njit(cache=True)
def _placed(start, J):  # type: ignore[no-untyped-def]
    """Whether pose (3, 4) and Jacobian (6, n) that an arm computed in Python are usable numbers."""
    total = 0.0
    for k in range(3):
        if not abs(start[k, 3]) <= LARGEST:
            return False
        for j in range(J.shape[1]):
            total += abs(J[k, j]) + abs(J[3 + k, j])
    return total <= LARGEST

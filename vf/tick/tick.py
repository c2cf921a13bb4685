"""A tick in one compiled call: from measured joints and target to checked joints, planes and force.

`tick` goes on until it is done or has a question that only Python can answer: an arm or a fixture
of the user's own, the side of a tip that no step led to, a problem that is left to a solver. It
then says which, and goes on from there when it is called again. All it works with is in a block
(`vf.tick.block`), described in `vf.layout`.
"""

from __future__ import annotations

import numba
import numpy as np

from vf.kernels import bytes_at, floats_at, integers_at, njit, now
from vf.layout import (
    ALLOWED,
    ANSWER,
    ASKED,
    AXES,
    BEGIN,
    BEST,
    BEST_SHARE,
    BEYOND,
    BOUNDS,
    BULGES,
    CAP,
    CHAIN,
    CHOSEN,
    CORNERS,
    CORRECTED,
    COUNT,
    DAMPING,
    DEFICIT,
    DESIRED,
    DISTANCE,
    DONE,
    DUALS,
    EDGES,
    ERRORS,
    FARTHEST,
    FIXTURE,
    FIXTURES,
    FOUND,
    FOUND_BY,
    FRAME,
    GAIN,
    GIVEN,
    GUARDED,
    HEAD,
    HIGH,
    HIGHEST,
    HORIZON,
    INSIDE,
    JACOBIAN,
    JACOBIANS,
    JOINT_ROWS,
    JOINTS,
    JUDGED,
    KEEPS,
    KIND,
    LEFT,
    LENGTH,
    LINKS,
    LONGEST,
    LOW,
    LOWER,
    LOWEST,
    MARKS,
    MESH,
    MULTIPLIERS,
    NO_JOINTS,
    NO_TARGET,
    NODE_COUNT,
    NODES,
    NUMBERS,
    ORDER,
    OTHER,
    OTHER_BOUNDS,
    PACED,
    PART,
    PLACED,
    PLACES,
    PLANE,
    PLANES,
    POINT,
    POINTS,
    POLYGONS,
    POSITION,
    PUSH,
    QUEUE,
    RADIUS,
    REACH,
    RELAXED,
    REPORT,
    REPORT_ALLOWED,
    REPORT_DISTANCE,
    REPORT_FORCE,
    REPORT_MARKS,
    REPORT_RADIUS,
    REPORT_SOLVER,
    REPORT_STATUS,
    REPORT_TIP,
    ROOM,
    ROWS,
    SAGITTA,
    SCALARS,
    SCRATCH,
    SCRATCH_SIZE,
    SEARCH,
    SEARCHED,
    SEARCHES,
    SEEN,
    SHARE,
    SHORTER,
    SIDE,
    SIDED,
    SIDES,
    SLIVERS,
    SOLUTION,
    SOLVED,
    SOLVER,
    SPEED,
    STAGE,
    STANDOFF,
    START,
    STEP,
    TABLE,
    TASK,
    TIP,
    TIP_RADIUS,
    TIP_REACH,
    TRIAL,
    TRIALS,
    TRIANGLES,
    TRIED,
    TRIES,
    TURNS,
    UPPER,
    WALL_COUNT,
    WALLS,
    WHOLE,
    WITHIN,
    WORDS,
)
from vf.planes import LARGEST
from vf.qp.active_set import answer, attempt, finish
from vf.qp.problem import (
    JOINT_RANGE,
    desired_step,
    farthest,
    fill_rows,
    height,
    obeys,
    pace,
    room,
    sagitta,
    usable,
)
from vf.qp.solver import Solver
from vf.rules.certified import CORNERS as CLIPPED
from vf.rules.certified import EASE, HEAP, YIELD, walk
from vf.rules.corridor import WALL, between
from vf.status import Status
from vf.tick.chain import LINK, jacobian, tip_pose
from vf.tick.haptics import master_force

# Missing less than this share of the standoff is rounding, not a state to report.
NEGLIGIBLE = 0.1
BISECTIONS = 12
# How often a step is shortened to where the true tip keeps to the motion sphere and to its speed.
SHORTENINGS = 4
INFEASIBLE, EXACT = int(Solver.INFEASIBLE), int(Solver.SOLVED)
IS_SOLVED, IS_SHORTENED, IS_HELD = int(Status.SOLVED), int(Status.SHORTENED), int(Status.HELD)
IS_RECOVERING, IS_INSIDE = int(Status.RECOVERING), int(Status.INSIDE)


@njit(cache=True)
def tick(address, q, goal, phase):  # type: ignore[no-untyped-def]
    """Begin a tick, or go on with it.

    Args:
        address: of the words (WORDS,) of the block.
        q: joint positions [rad or m], the same throughout a tick.
        goal: (4, 4) pose of the target, base frame, likewise.
        phase: BEGIN, or what the last call asked for.

    Returns:
        How many planes the report has: the tick is done. Or less than zero: minus the phase to go
        on with when its question is answered, or minus the reason why there is nothing to do.
    """
    words = numba.carray(integers_at(address), (WORDS,))
    n = words[JOINTS]
    numbers = numba.carray(floats_at(words[NUMBERS]), (SCALARS,))
    table = numba.carray(floats_at(words[TABLE]), (JOINT_ROWS, n))
    start = numba.carray(floats_at(words[START]), (3, 4))
    J = numba.carray(floats_at(words[JACOBIAN]), (6, n))
    if phase == BEGIN:
        if q.shape[0] != n:
            return -NO_JOINTS
        total = 0.0
        for j in range(n):
            table[POSITION, j] = q[j]
            total += abs(q[j])
        # Rounding of the sines of larger angles would be as large as what is guarded.
        if not total <= JOINT_RANGE:
            return -NO_JOINTS
        if words[LINKS] == 0:
            return -PLACED
        _place(words, table[POSITION], start)
        axes = numba.carray(floats_at(words[AXES]), (words[LINKS], 6))
        chain = numba.carray(floats_at(words[CHAIN]), (words[LINKS], LINK))
        jacobian(chain, axes, start[0, 3], start[1, 3], start[2, 3], J)
        phase = PLACED
    points = words[POINTS]
    places = numba.carray(floats_at(words[PLACES]), (points, 3))
    jacobians = numba.carray(floats_at(words[JACOBIANS]), (points, 3, n))
    if phase == PLACED:
        numbers[MARKS] = now()
        if words[LINKS] == 0 and not _placed(start, J):
            return -NO_JOINTS
        if not usable(goal):
            return -NO_TARGET
        for k in range(3):
            places[0, k] = start[k, 3]
            for j in range(n):
                jacobians[0, k, j] = J[k, j]
        if not _sides_known(words, places[0]):
            return -SIDED
        phase = SIDED
    planes = numba.carray(floats_at(words[PLANES]), (words[ROOM], PLANE))
    if phase == SIDED:
        _set_radius(words, numbers, J, table[SPEED])
        if words[INSIDE] > 0 or not _search(words, numbers, planes, places[0]):
            return -FOUND
        phase = FOUND

    m = words[COUNT]
    bounds = numba.carray(floats_at(words[BOUNDS]), (words[ROOM],))
    multipliers = numba.carray(floats_at(words[MULTIPLIERS]), (words[ROOM],))
    scratch = numba.carray(floats_at(words[SCRATCH]), (words[SCRATCH_SIZE],))
    if phase == FOUND:
        # The step ends within the motion sphere, and its path within what was searched for it.
        radius, reach = numbers[RADIUS], numbers[REACH]
        numbers[ALLOWED] = min(reach, radius)
        whole = reach >= numbers[SEARCHED]
        numbers[FARTHEST] = reach - numbers[BEYOND] if whole else reach
        numbers[LONGEST] = min(numbers[ALLOWED], numbers[TIP_REACH])
        numbers[MARKS + 1] = now()
        desired_step(start, goal, numbers[ALLOWED], numbers[LENGTH], numbers[DESIRED : DESIRED + 6])
        for j in range(n):
            for k in range(3):
                table[TASK + k, j] = J[k, j]
                table[TASK + 3 + k, j] = numbers[LENGTH] * J[3 + k, j]
            # A joint pushed beyond its limit may stay or come back, so that zero is allowed.
            table[LOWER, j] = min(table[LOWEST, j] - table[POSITION, j], 0.0)
            table[UPPER, j] = max(table[HIGHEST, j] - table[POSITION, j], 0.0)
        rows = numba.carray(floats_at(words[ROWS]), (words[ROOM], n))
        numbers[DISTANCE], numbers[DEFICIT] = fill_rows(
            planes, m, places, jacobians, numbers[STANDOFF], numbers[TIP_RADIUS], rows, bounds
        )
        words[STAGE] = WHOLE
        if _ask(words, numbers, table, bounds, scratch, multipliers):
            return -SOLVED
        phase = SOLVED

    trials = numba.carray(floats_at(words[TRIALS]), (points, 3))
    bulges = numba.carray(floats_at(words[BULGES]), (points,))
    tip = numba.carray(floats_at(words[TIP]), (3, 4))
    allowed = False
    while True:
        if phase == SOLVED:
            if words[LEFT] > 0:
                _settle(words, n, table, scratch, multipliers)
            if words[STAGE] <= RELAXED:
                infeasible = words[SOLVER] == INFEASIBLE
                if infeasible and numbers[DEFICIT] > 0.0 and words[STAGE] == WHOLE:
                    # Recovery may be more than the joints can do; standing still never is.
                    for i in range(m):
                        bounds[i] = min(bounds[i], 0.0)
                    words[STAGE] = RELAXED
                    if _ask(words, numbers, table, bounds, scratch, multipliers):
                        return -SOLVED
                    continue
                words[FOUND_BY] = words[SOLVER]
                for i in range(m):
                    planes[i, PUSH] = multipliers[i]
                moves = _shortened(numbers, table, J, scratch, STEP)
                numbers[MARKS + 2] = now()
                if not moves:
                    numbers[SHARE] = 1.0
                    table[TRIAL] = table[POSITION]
                    tip[:] = start
                    return _report(words, numbers, table, goal, tip, planes, places[0])
                _try(numbers, table, jacobians, STEP, 1.0, bulges)
            elif words[SOLVER] == INFEASIBLE:
                _bisect(words, numbers, table, start, jacobians, bulges)
            else:
                _shortened(numbers, table, J, scratch, OTHER)
                _try(numbers, table, jacobians, OTHER, 1.0, bulges)
            if words[LINKS] == 0:
                return -TRIED
            _place(words, table[TRIAL], tip)
            phase = TRIED
        if phase == TRIED:
            for k in range(3):
                trials[0, k] = tip[k, 3]
            allowed = obeys(planes, m, places, trials, bulges, numbers[FARTHEST], numbers[LONGEST])
            if allowed and words[INSIDE] > 0:
                return -JUDGED
        else:
            allowed = words[ANSWER] > 0
        if allowed and words[STAGE] < PART:
            # The optimum in the tick's bounds, whichever way it was had.
            numbers[SHARE] = 1.0
            return _report(words, numbers, table, goal, tip, planes, trials[0])
        phase = _next(
            words, numbers, table, planes, places, trials, jacobians, bulges, scratch, multipliers,
            allowed, start, tip,
        )  # fmt: skip
        if phase == SOLVED:
            if words[LEFT] > 0:
                return -SOLVED
            continue
        if phase == DONE:
            for k in range(3):
                trials[0, k] = tip[k, 3]
            return _report(words, numbers, table, goal, tip, planes, trials[0])
        if words[LINKS] == 0:
            return -TRIED
        _place(words, table[TRIAL], tip)


@njit(cache=True)
def _place(words, q, pose):  # type: ignore[no-untyped-def]
    """Pose (3, 4) of the tip for joints q (n,), by the chain."""
    chain = numba.carray(floats_at(words[CHAIN]), (words[LINKS], LINK))
    axes = numba.carray(floats_at(words[AXES]), (words[LINKS], 6))
    tip_pose(chain, q, pose, axes)


@njit(cache=True)
def _placed(start, J):  # type: ignore[no-untyped-def]
    """Whether an arm that answers itself said where its tip (3, 4) is and how it moves (6, n)."""
    total = 0.0
    for k in range(3):
        if not abs(start[k, 3]) <= LARGEST:
            return False
        for j in range(J.shape[1]):
            total += abs(J[k, j]) + abs(J[3 + k, j])
    return total <= LARGEST


@njit(cache=True)
def _sides_known(words, x):  # type: ignore[no-untyped-def]
    """Whether it is known of every fixture on which side of it x (3,) is, in its own frame."""
    sides = numba.carray(floats_at(words[SIDES]), (words[FIXTURES], SIDE))
    for f in range(words[FIXTURES]):
        for k in range(3):
            if sides[f, SEEN + k] != x[k]:
                return False
    return True


@njit(cache=True)
def _set_radius(words, numbers, J, speed):  # type: ignore[no-untyped-def]
    """Whether the tip is inside of something, the motion sphere, and the ball to search.

    That ball reaches a standoff beyond the motion sphere, or a step to its rim could end right at a
    triangle outside, and as far as the path may leave the chord; more than a quarter of the radius
    would cost more planes than a longer step is worth.
    """
    sides = numba.carray(floats_at(words[SIDES]), (words[FIXTURES], SIDE))
    words[INSIDE] = 0
    for f in range(words[FIXTURES]):
        if sides[f, WITHIN] > 0.0:
            words[INSIDE] = 1
    radius = numbers[ASKED]
    if not radius > 0.0:
        radius = max(farthest(J, speed), 2.0 * numbers[STANDOFF])
    numbers[RADIUS] = radius
    numbers[SEARCHED] = radius + min(numbers[SAGITTA], 0.25 * radius) + numbers[BEYOND]


@njit(cache=True)
def _search(words, numbers, planes, x):  # type: ignore[no-untyped-def]
    """The planes of all fixtures for a tip at x (3,); False: Python has to be asked for them."""
    fixtures = words[FIXTURES]
    searches = numba.carray(integers_at(words[SEARCHES]), (fixtures, SEARCH))
    queue = numba.carray(floats_at(words[QUEUE]), (HEAP, 3))
    polygons = numba.carray(floats_at(words[POLYGONS]), (2, CLIPPED, 3))
    for f in range(fixtures):
        if searches[f, KIND] == GIVEN:
            return False
    radius, tip_radius = numbers[SEARCHED], numbers[TIP_RADIUS]
    standoff = numbers[STANDOFF]
    while True:
        m = 0
        reach = radius
        close = 0
        least = np.inf
        for f in range(fixtures):
            search = searches[f]
            nodes = numba.carray(floats_at(search[NODES]), (search[NODE_COUNT], 16))
            corners = numba.carray(floats_at(search[CORNERS]), (search[TRIANGLES], 9))
            order = numba.carray(integers_at(search[ORDER]), (search[TRIANGLES],))
            slivers = numba.carray(floats_at(search[SLIVERS]), (search[TRIANGLES],))
            edges = numba.carray(bytes_at(search[EDGES]), (search[TRIANGLES], 3))
            if search[KIND] == MESH:
                found, valid = walk(
                    nodes, corners, order, slivers, edges, False, x, radius, standoff, tip_radius,
                    EASE, planes, m, queue, polygons,
                )  # fmt: skip
            else:
                walls = numba.carray(floats_at(search[WALLS]), (search[WALL_COUNT], WALL))
                frame = numba.carray(floats_at(search[FRAME]), (8,))
                found, valid = between(
                    walls, frame[:6].reshape((2, 3)), frame[6], frame[7], nodes, corners, order,
                    slivers, edges, x, radius, standoff, tip_radius, planes, m, queue, polygons,
                )  # fmt: skip
            if valid == 0.0:
                # On a surface one walk of the tree does not answer.
                return False
            space = np.inf
            for i in range(m, m + found):
                planes[i, FIXTURE] = f
                space = min(space, room(planes[i], x))
            if space - tip_radius < standoff:
                close += 1
            least = min(least, space - tip_radius)
            m += found
            reach = min(reach, valid)
        words[COUNT] = m
        numbers[REACH] = reach
        # Between two fixtures, below the standoff of both: as near to the farther one as to the
        # nearer one, like between two walls of one fixture.
        if standoff < numbers[STANDOFF] or close < 2:
            return True
        standoff = least
        if not standoff > YIELD:
            return True


@njit(cache=True)
def _ask(words, numbers, table, bounds, scratch, multipliers):  # type: ignore[no-untyped-def]
    """Solve the planes' rows with these bounds as far as no solver is needed; whether one is."""
    rows = numba.carray(floats_at(words[ROWS]), (words[ROOM], words[JOINTS]))
    words[SOLVER], words[LEFT] = attempt(
        table[TASK : TASK + 6], numbers[DESIRED : DESIRED + 6], numbers[DAMPING], rows, bounds,
        table[LOWER], table[UPPER], table[HORIZON], words[COUNT], scratch, multipliers,
    )  # fmt: skip
    return words[LEFT] > 0


@njit(cache=True)
def _settle(words, n, table, scratch, multipliers):  # type: ignore[no-untyped-def]
    """Take the answer of the solver that was asked."""
    words[SOLVER] = words[ANSWER]
    if words[SOLVER] != INFEASIBLE:
        u = numba.carray(floats_at(words[SOLUTION]), (n,))
        duals = numba.carray(floats_at(words[DUALS]), (words[LEFT],))
        if finish(u, duals, words[LEFT], table[LOWER], table[UPPER], scratch, multipliers):
            words[SOLVER] = EXACT
    words[LEFT] = 0


@njit(cache=True)
def _shortened(numbers, table, J, scratch, row):  # type: ignore[no-untyped-def]
    """The solver's step, shortened to what a tick allows, to a row of the table; whether it is any.

    All joints are shortened alike: so it obeys the rows, and the tip heads for where it will end.
    """
    n = table.shape[1]
    dq = answer(scratch, n)
    numbers[PACED] = pace(dq, table[SPEED], J, numbers[TIP_REACH])
    moves = False
    for j in range(n):
        table[row, j] = numbers[PACED] * dq[j]
        moves |= table[row, j] != 0.0
    return moves


@njit(cache=True)
def _try(numbers, table, jacobians, row, share, bulges):  # type: ignore[no-untyped-def]
    """Joints to try: a share of a step, no joint farther beyond its limits than it is."""
    for j in range(table.shape[1]):
        q = table[POSITION, j]
        # The sum may round to just beyond a limit.
        high, low = max(table[HIGHEST, j], q), min(table[LOWEST, j], q)
        table[TRIAL, j] = min(max(q + share * table[row, j], low), high)
    for p in range(bulges.shape[0]):
        bulges[p] = 0.0
        if numbers[GUARDED] > 0.0:
            bulges[p] = sagitta(jacobians[p], table[row], share, table[TURNS])
    numbers[SHARE] = share


@njit(cache=True)
def _bisect(words, numbers, table, start, jacobians, bulges):  # type: ignore[no-untyped-def]
    """Begin with the parts of the step: the first is half of it, the least is none."""
    words[STAGE] = PART
    words[TRIES] = 0
    numbers[LOW], numbers[HIGH], numbers[BEST_SHARE] = 0.0, 1.0, 0.0
    best = numba.carray(floats_at(words[BEST]), (3, 4))
    best[:] = start
    table[CHOSEN] = table[POSITION]
    _try(numbers, table, jacobians, STEP, 0.5, bulges)


@njit(cache=True)
def _next(  # type: ignore[no-untyped-def]
    words, numbers, table, planes, places, trials, jacobians, bulges, scratch, multipliers,
    allowed, start, tip,
):  # fmt: skip
    """What is tried after a step that may not be made, or after a part that may.

    Tried in this order: the optimum; the same a little shorter, where only the true tip went
    farther than the linear one; the optimum with the rows moved by the linearisation error just
    seen; ever shorter parts of the first; standing still.

    Returns:
        TRIED: there are joints to try; SOLVED: there is a problem to solve; DONE.
    """
    stage = words[STAGE]
    if stage <= RELAXED:
        _miss(words, table, places, trials, jacobians)
        words[TRIES] = 0
        if _too_far(numbers, table, places[0], trials[0], jacobians, bulges):
            words[STAGE] = SHORTER
            return TRIED
        return _correct(words, numbers, table, planes, scratch, multipliers)
    if stage == SHORTER:
        for j in range(table.shape[1]):
            table[STEP, j] *= numbers[SHARE]
        words[TRIES] += 1
        if words[TRIES] < SHORTENINGS and _too_far(
            numbers, table, places[0], trials[0], jacobians, bulges
        ):
            return TRIED
        return _correct(words, numbers, table, planes, scratch, multipliers)
    if stage == CORRECTED:
        _bisect(words, numbers, table, start, jacobians, bulges)
        return TRIED
    best = numba.carray(floats_at(words[BEST]), (3, 4))
    if allowed:
        best[:] = tip
        table[CHOSEN] = table[TRIAL]
        numbers[LOW] = numbers[BEST_SHARE] = numbers[SHARE]
    else:
        numbers[HIGH] = numbers[SHARE]
    words[TRIES] += 1
    if words[TRIES] < BISECTIONS:
        _try(numbers, table, jacobians, STEP, 0.5 * (numbers[LOW] + numbers[HIGH]), bulges)
        return TRIED
    tip[:] = best
    table[TRIAL] = table[CHOSEN]
    numbers[SHARE] = numbers[BEST_SHARE]
    return DONE


@njit(cache=True)
def _miss(words, table, places, trials, jacobians):  # type: ignore[no-untyped-def]
    """By what the linear motion of the step missed the true one, for every guarded point [m]."""
    errors = numba.carray(floats_at(words[ERRORS]), (words[POINTS], 3))
    for p in range(words[POINTS]):
        for k in range(3):
            moved = 0.0
            for j in range(table.shape[1]):
                moved += jacobians[p, k, j] * table[STEP, j]
            errors[p, k] = trials[p, k] - places[p, k] - moved


@njit(cache=True)
def _too_far(numbers, table, x, y, jacobians, bulges):  # type: ignore[no-untyped-def]
    """Where the true tip went farther than it may, from x to y (3,): try what does not."""
    d2 = (y[0] - x[0]) ** 2 + (y[1] - x[1]) ** 2 + (y[2] - x[2]) ** 2
    length = np.sqrt(d2)
    if not length > numbers[LONGEST]:
        return False
    share = (1.0 - 1e-9) * numbers[LONGEST] / length
    _try(numbers, table, jacobians, STEP, share, bulges)
    return True


@njit(cache=True)
def _correct(words, numbers, table, planes, scratch, multipliers):  # type: ignore[no-untyped-def]
    """Solve again, with the rows moved by the linearisation error just seen: SOLVED."""
    bounds = numba.carray(floats_at(words[BOUNDS]), (words[ROOM],))
    other = numba.carray(floats_at(words[OTHER_BOUNDS]), (words[ROOM],))
    errors = numba.carray(floats_at(words[ERRORS]), (words[POINTS], 3))
    for i in range(words[COUNT]):
        plane = planes[i]
        other[i] = (bounds[i] - height(plane, errors[int(plane[POINT])])) / numbers[PACED]
    words[STAGE] = CORRECTED
    _ask(words, numbers, table, other, scratch, multipliers)
    return SOLVED


@njit(cache=True)
def _report(words, numbers, table, goal, tip, planes, x):  # type: ignore[no-untyped-def]
    """Write what became of the tick, its tip being at x (3,); how many planes there are."""
    n = words[JOINTS]
    report = numba.carray(floats_at(words[REPORT]), (HEAD + 2 * n,))
    if words[INSIDE] > 0:
        status = IS_INSIDE
    elif numbers[SHARE] == 0.0 or words[FOUND_BY] == INFEASIBLE:
        status = IS_HELD
    elif numbers[DEFICIT] > NEGLIGIBLE * numbers[STANDOFF]:
        status = IS_RECOVERING
    elif numbers[SHARE] < 1.0:
        status = IS_SHORTENED
    else:
        status = IS_SOLVED
    report[REPORT_STATUS] = status
    report[REPORT_SOLVER] = words[FOUND_BY]
    report[REPORT_RADIUS] = numbers[RADIUS]
    report[REPORT_ALLOWED] = numbers[ALLOWED]
    report[REPORT_DISTANCE] = numbers[DISTANCE]
    master_force(tip[:, 3], goal[:3, 3], numbers[GAIN], numbers[CAP], report[REPORT_FORCE:])
    for i in range(3):
        for k in range(4):
            report[REPORT_TIP + 4 * i + k] = tip[i, k]
    for j in range(n):
        value = table[TRIAL, j]
        report[HEAD + j] = value
        report[HEAD + n + j] = 0.0
        if value >= table[HIGHEST, j]:
            report[HEAD + n + j] = 1.0
        elif value <= table[LOWEST, j]:
            report[HEAD + n + j] = -1.0
    # A checked step stays on its side: the side need not be looked up where the next tick starts.
    searches = numba.carray(integers_at(words[SEARCHES]), (words[FIXTURES], SEARCH))
    sides = numba.carray(floats_at(words[SIDES]), (words[FIXTURES], SIDE))
    for f in range(words[FIXTURES]):
        if searches[f, KEEPS] > 0 and sides[f, WITHIN] == 0.0:
            for k in range(3):
                sides[f, SEEN + k] = x[k]
    numbers[MARKS + 3] = now()
    for k in range(4):
        report[REPORT_MARKS + k] = numbers[MARKS + k]
    return words[COUNT]

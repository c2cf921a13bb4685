"""The report of a tick: what it did, for its caller."""

from __future__ import annotations

import numba
import numpy as np

from vf import layout as at
from vf.kernels import floats_at, integers_at, njit, now
from vf.qp.solver import Solver
from vf.status import Status
from vf.tick.attempts import NEGLIGIBLE
from vf.tick.haptics import master_force
from vf.tick.moving import form, into

INFEASIBLE, EXACT = int(Solver.INFEASIBLE), int(Solver.SOLVED)
IS_SOLVED, IS_SHORTENED, IS_HELD = int(Status.SOLVED), int(Status.SHORTENED), int(Status.HELD)
IS_RECOVERING, IS_INSIDE = int(Status.RECOVERING), int(Status.INSIDE)
IS_OVERTAKEN = int(Status.OVERTAKEN)


@njit(cache=True)
def write_report(words, numbers, table, goal, tip, planes, x):  # type: ignore[no-untyped-def]
    """Write the report; x (3,) is where the tip ends. Returns the number of planes."""
    n = words[at.JOINTS]
    report = numba.carray(floats_at(words[at.REPORT]), (at.HEAD + 2 * n,))
    if words[at.INSIDE] > 0:
        status = IS_INSIDE
    elif words[at.YIELDS] > 0:
        # Nothing is met as long as the floors are kept: the tool is then only below the standoff.
        status = IS_OVERTAKEN if numbers[at.VIOLATION] > 0.0 else IS_RECOVERING
    elif numbers[at.SHARE] == 0.0 or words[at.FOUND_BY] == INFEASIBLE:
        status = IS_HELD
    elif numbers[at.DEFICIT] > NEGLIGIBLE * numbers[at.STANDOFF]:
        status = IS_RECOVERING
    elif numbers[at.SHARE] < 1.0:
        status = IS_SHORTENED
    else:
        status = IS_SOLVED
    report[at.REPORT_STATUS] = status
    report[at.REPORT_SOLVER] = words[at.FOUND_BY]
    report[at.REPORT_RADIUS] = numbers[at.RADIUS]
    report[at.REPORT_ALLOWED] = numbers[at.ALLOWED]
    report[at.REPORT_DISTANCE] = numbers[at.DISTANCE]
    report[at.REPORT_VIOLATION] = numbers[at.VIOLATION] if status == IS_OVERTAKEN else 0.0
    master_force(
        tip[:, 3], goal[:3, 3], numbers[at.GAIN], numbers[at.CAP], report[at.REPORT_FORCE :]
    )
    for i in range(3):
        for k in range(4):
            report[at.REPORT_TIP + 4 * i + k] = tip[i, k]
    for j in range(n):
        value = table[at.TRIAL, j]
        report[at.HEAD + j] = value
        report[at.HEAD + n + j] = 0.0
        if value >= table[at.HIGHEST, j]:
            report[at.HEAD + n + j] = 1.0
        elif value <= table[at.LOWEST, j]:
            report[at.HEAD + n + j] = -1.0
    # A checked step does not change sides: at its end the side is known without a look-up.
    searches = numba.carray(integers_at(words[at.SEARCHES]), (words[at.FIXTURES], at.SEARCH))
    sides = numba.carray(floats_at(words[at.SIDES]), (words[at.FIXTURES], at.SIDE))
    motions = numba.carray(floats_at(words[at.MOTIONS]), (words[at.FIXTURES], at.MOTION))
    for f in range(words[at.FIXTURES]):
        if searches[f, at.KEEPS] > 0 and sides[f, at.WITHIN] == 0.0:
            px, py, pz = x[0], x[1], x[2]
            blend = 0.0
            if words[at.MOVING] > 0 and searches[f, at.MOVES] > 0:
                px, py, pz = into(motions[f], at.TO, px, py, pz)
                blend = motions[f, at.BLEND_AFTER]
            sides[f, at.SEEN_FORM], sides[f, at.SEEN_BLEND] = form(searches[f], blend)
            if words[at.YIELDS] == at.MISSES and numbers[at.VIOLATION] > 0.0:
                px = np.nan
            sides[f, at.SEEN], sides[f, at.SEEN + 1], sides[f, at.SEEN + 2] = px, py, pz
    count = words[at.COUNT]
    if words[at.BODIES] > 0:
        count = _without_twins(words, planes)
    numbers[at.MARKS + 3] = now()
    for k in range(4):
        report[at.REPORT_MARKS + k] = numbers[at.MARKS + k]
    return count


@njit(cache=True)
def _without_twins(words, planes):  # type: ignore[no-untyped-def]
    """Leave each plane of an axis once, with what it pushed at both ends; their number."""
    guards = numba.carray(floats_at(words[at.GUARDS]), (words[at.POINTS], at.GUARD))
    kept = 0
    run = 0  # of the last block of planes of one point
    twins = 0
    for i in range(words[at.COUNT]):
        point = planes[i, at.POINT]
        if guards[int(point), at.TWIN] > 0.0:
            # The block before it, just as long, holds the same planes.
            planes[kept - run + twins, at.PUSH] += planes[i, at.PUSH]
            twins += 1
            continue
        if twins > 0 or kept == 0 or planes[kept - 1, at.POINT] != point:
            run = 0
            twins = 0
        planes[kept] = planes[i]
        kept += 1
        run += 1
    return kept

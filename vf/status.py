"""Outcomes of a tick."""

from __future__ import annotations

from enum import IntEnum


class Status(IntEnum):
    """Outcome of a tick. With none of them is a motion made that was not checked."""

    SOLVED = 0  # the optimum was checked and taken
    SHORTENED = 1  # only a part of the step passed the check
    HELD = 2  # no step passed the check, or there was none: the tool stays
    RECOVERING = 3  # below the standoff: moved out again, never deeper
    INSIDE = 4  # the tool is inside the anatomy
    REFUSED = 5  # the target or the joint vector is not usable: the tool stays
    OVERTAKEN = 6  # the anatomy came faster than the arm can yield, see `Step.violation`

"""The order of the conditions is balanced; the plan has every trial once."""

from __future__ import annotations

from collections import Counter
from itertools import pairwise

import pytest

from app.studies.people import plan, reading


@pytest.mark.parametrize("n", range(1, 9))
def test_every_condition_is_everywhere_and_after_every_other_equally_often(n: int) -> None:
    rows = plan.balanced(n)
    assert len(rows) == (n if n % 2 == 0 or n == 1 else 2 * n)
    assert all(sorted(row) == list(range(n)) for row in rows)
    for place in range(n):
        assert set(Counter(row[place] for row in rows).values()) == {len(rows) // n}
    after = Counter(pair for row in rows for pair in pairwise(row))
    if n > 1:
        assert len(after) == n * (n - 1)
        assert len(set(after.values())) == 1


def test_a_plan_has_every_repetition_of_every_task_in_every_condition_once() -> None:
    protocol = reading.read("fixture-under-delay")
    for number in range(6):
        order = plan.order(protocol, number)
        trials = plan.trials(protocol, number, order)
        done = Counter((one.task, one.condition, one.repetition) for one in trials)
        assert len(done) == len(trials) == 3 * 3 * 2
        assert [one.block for one in trials] == sorted(one.block for one in trials)
        assert all(order[one.block] == one.condition for one in trials)
        assert len({one.seed for one in trials}) == len(trials)
    assert plan.trials(protocol, 1, plan.order(protocol, 1)) == plan.trials(
        protocol, 1, plan.order(protocol, 1)
    )


def test_blinded_participants_see_letters_in_their_own_order() -> None:
    protocol = reading.read("fixture-under-delay")
    order = plan.order(protocol, 1)
    assert [plan.shown_name(protocol, order, name) for name in order] == ["A", "B", "C"]

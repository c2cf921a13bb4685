"""What a hand orders arrives after its delay, in order, and not at all while it is closed."""

from __future__ import annotations

from typing import Any, cast

import numpy as np
import pinocchio as pin
import pytest

from app.session import Session
from app.studies.people.hand import Hand
from app.words import Refused


class Driven:
    """Notes what it is told."""

    def __init__(self) -> None:
        self.told: list[tuple[float, bool]] = []
        self.recalled = 0
        self.handle = pose(0.0)

    def drive(self, target: pin.SE3, held: bool) -> None:
        if target.translation[0] > 1.0:
            raise Refused("too far")
        self.handle = target
        self.told.append((float(target.translation[0]), held))

    def recall(self) -> None:
        self.recalled += 1


def pose(x: float) -> pin.SE3:
    return pin.SE3(np.eye(3), np.array([x, 0.0, 0.0]))


@pytest.fixture
def driven() -> Driven:
    return Driven()


@pytest.fixture
def time() -> list[float]:
    return [0.0]


@pytest.fixture
def hand(driven: Any, time: list[float]) -> Hand:
    return Hand(cast(Session, driven), lambda: time[0])


def test_without_delay_it_is_the_session(hand: Hand, driven: Driven) -> None:
    hand.drive(pose(0.1), held=True)
    assert driven.told == [(0.1, True)]
    with pytest.raises(Refused, match="too far"):
        hand.drive(pose(2.0))


def test_orders_arrive_late_and_the_handle_is_where_the_hand_is(
    hand: Hand, driven: Driven, time: list[float]
) -> None:
    hand.delay = 0.4
    for k in range(5):
        time[0] = 0.1 * k
        hand.drive(pose(0.1 * k), held=k < 4)
        hand.pump()
    assert [x for x, _ in driven.told] == [0.0], "of 0.4 s ago"
    assert hand.handle.translation[0] == pytest.approx(0.4)
    for k in range(5, 10):
        time[0] = 0.1 * k
        hand.pump()
    assert driven.told == [(pytest.approx(0.1 * k), k < 4) for k in range(5)]
    assert hand.handle is driven.handle


def test_what_is_refused_late_is_dropped_and_the_rest_goes_on(
    hand: Hand, driven: Driven, time: list[float]
) -> None:
    hand.delay = 0.1
    for x in (2.0, 0.3):
        hand.drive(pose(x))
    time[0] = 0.2
    hand.pump()
    assert driven.told == [(0.3, False)]


def test_a_delay_that_is_taken_away_overtakes_nothing(
    hand: Hand, driven: Driven, time: list[float]
) -> None:
    hand.delay = 0.1
    hand.drive(pose(0.1))
    hand.delay = 0.0
    hand.drive(pose(0.2))
    assert driven.told == []
    time[0] = 0.2
    hand.pump()
    assert [x for x, _ in driven.told] == [0.1, 0.2]


def test_a_closed_hand_moves_nothing(hand: Hand, driven: Driven, time: list[float]) -> None:
    hand.delay = 0.1
    hand.drive(pose(0.1))
    hand.closed = "Press the button first"
    for order in (lambda: hand.drive(pose(0.2)), hand.recall):
        with pytest.raises(Refused, match="button"):
            order()
    hand.drop()
    time[0] = 1.0
    hand.pump()
    assert driven.told == []
    hand.closed = ""
    hand.recall()
    assert driven.recalled == 1

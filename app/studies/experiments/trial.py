"""Simulates one trial: an operator moves the tool along the planned cut."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from app.studies.experiments.follower import Follower
from app.studies.experiments.operators import Operator, SlowError, Tremor, minimum_jerk
from app.studies.experiments.site import THICKNESS, PlannedCut

FloatArray = NDArray[np.float64]

PATIENCE = 1200.0  # largest simulated duration of a trial [s]


@dataclass(frozen=True)
class Run:
    """The ticks of a trial.

    Attributes:
        rate: ticks per second [Hz].
        goals: (n, 3) goals of the tip, base frame [m].
        tips: (n, 3) actual positions of the tip, base frame [m].
        submovements: number of submovements.
        corrections: number of submovements that did not advance along the cut.
        finished: whether the end of the cut was reached.
    """

    rate: float
    goals: FloatArray
    tips: FloatArray
    submovements: int
    corrections: int
    finished: bool

    @property
    def duration(self) -> float:
        """[s]"""
        return len(self.tips) / self.rate


def perform(
    operator: Operator,
    planned: PlannedCut,
    start: FloatArray,
    follower: Follower,
    *,
    assisted: bool,
    stroke: float,
    rate: float,
    rng: np.random.Generator,
) -> Run:
    """Let the operator cut (or trace) along a planned cut.

    Args:
        planned: the planned cut at the true pose of the skull, which the operator sees.
        start: (3,) the tip at the start, base frame [m].
        follower: moves the tip to the goals.
        assisted: the fixture is on, and the operator relies on it for depth.
        stroke: advance of a submovement along the cut [m].
        rate: ticks per second [Hz].
        rng: not shared with other trials.
    """
    eye = _Perception(operator, planned, rng)
    tremor = Tremor(operator.tremor * operator.scale, rate, rng)
    moving = max(round(operator.movement_time * rate), 1)
    waiting = max(round(operator.visual_delay * rate), 1)
    shape = minimum_jerk(moving)[:, None]
    period = (moving + waiting) / rate
    hand, tip = np.array(start), np.array(start)
    station, reached = 0.0, False
    goals, tips = [], []
    submovements = corrections = 0
    while not reached and submovements * period < PATIENCE:
        move, aside, deep = eye.wanted(station, tip, period)
        seen = aside if assisted else max(aside, deep)
        if seen > operator.tolerance:
            corrections += 1
        else:
            reached = station >= planned.length
            going = min(station + stroke, planned.length)
            move = move + eye.goal(going) - eye.goal(station)
            station = going
        if assisted:
            move = eye.on_surface(move, hand, tip, station)
        move = move + operator.movement_noise * float(np.linalg.norm(move)) * rng.normal(size=3)
        wanted = np.concatenate([hand + shape * move, np.tile(hand + move, (waiting, 1))])
        hand = hand + move
        wanted += tremor(len(wanted))
        done = follower(wanted)
        goals.append(wanted)
        tips.append(done)
        # The perceived tip: its mean over the visual delay, without tremor.
        tip = done[-waiting:].mean(axis=0)
        submovements += 1
    return Run(
        rate, np.concatenate(goals), np.concatenate(tips), submovements, corrections, reached
    )


class _Perception:
    """The operator's perception, and the hand movement that follows from it."""

    def __init__(self, operator: Operator, planned: PlannedCut, rng: np.random.Generator) -> None:
        self._operator, self._planned, self._rng = operator, planned, rng
        _, along, aside, outward = planned.at(0.5 * planned.length)
        angle = operator.view_angle
        # Viewing direction, tilted to one side of the cut.
        self._sight = np.cos(angle) * -outward + np.sin(angle) * aside
        self._across = np.cross(self._sight, along)  # lateral in the image
        self._along = along
        self._bias = operator.depth_bias * (1.0 + operator.session_spread * rng.normal())
        self._depth = SlowError(operator.depth_error, operator.slow, rng)
        self._image = SlowError(operator.image_error, operator.slow, rng)

    def goal(self, station: float) -> FloatArray:
        """Goal of the tip: the bottom of the planned cut."""
        point, _, _, outward = self._planned.at(station)
        return np.asarray(point - THICKNESS * outward)

    def wanted(
        self, station: float, tip: FloatArray, elapsed: float
    ) -> tuple[FloatArray, float, float]:
        """The perceived error (3,), and its lateral size and size along the line of sight [m]."""
        # The tip is perceived nearer to the camera than it is, so the tool goes too deep.
        error = -(self._bias + self._depth.after(elapsed))
        believed = tip + error * self._sight + self._image.after(elapsed) * self._across
        move = self.goal(station) - believed
        return move, abs(float(move @ self._across)), abs(float(move @ self._sight))

    def on_surface(
        self, move: FloatArray, hand: FloatArray, tip: FloatArray, station: float
    ) -> FloatArray:
        """The movement along the fixture with the same effect in the image, plus the pressing."""
        operator = self._operator
        _, along, aside, outward = self._planned.at(station)
        effect = np.array(
            [
                [aside @ self._across, along @ self._across],
                [aside @ self._along, along @ self._along],
            ]
        )
        share = np.linalg.solve(effect, [move @ self._across, move @ self._along])
        force = operator.press * (1.0 + operator.press_noise * self._rng.normal())
        inwards = (tip - hand) @ outward - force / operator.stiffness
        return np.asarray(share[0] * aside + share[1] * along + inwards * outward)

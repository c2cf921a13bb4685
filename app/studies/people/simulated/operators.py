"""Simulated participants: operators of the experiments, each with errors of their own."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from app.studies.experiments.follower import Follower
from app.studies.experiments.operators import Operator, SlowError, Tremor, minimum_jerk
from app.studies.experiments.trial import perform
from app.studies.people.progress import Progress
from app.studies.people.protocol import Condition

FloatArray = NDArray[np.float64]

SPREAD = 0.15  # log-normal, of the calibrated values among participants, as in the experiments
ERRORS = ("depth_bias", "depth_error", "image_error", "movement_noise", "tremor")
"""What an effect multiplies."""
ABOVE = 1e-3  # height over the beginning of a path to which the tool is brought first [m]
APPROACH = 1.5  # how long that takes [s]
LEAP = 8e-3  # longest submovement towards a target [m]


def operator_of(seed: int, number: int) -> Operator:
    """Participant `number`: the same in every condition."""
    entropy = np.random.SeedSequence((seed, 1 << 21, number))
    return Operator().varied(np.random.default_rng(entropy), SPREAD)


def under(operator: Operator, condition: Condition, effects: Mapping[str, float]) -> Operator:
    """The operator under a condition.

    With a delay it moves and waits (Sheridan, Ferrell, IEEE Trans Human Factors 1963): what is seen
    of a movement arrives later.

    Args:
        effects: factor of `ERRORS` by name of the condition.
    """
    factor = effects.get(condition.name, 1.0)
    return replace(
        operator,
        scale=condition.scale,
        visual_delay=operator.visual_delay + condition.delay,
        **{name: factor * getattr(operator, name) for name in ERRORS},
    )


def act(
    operator: Operator,
    progress: Progress,
    condition: Condition,
    start: FloatArray,
    follower: Follower,
    rate: float,
    seed: int,
) -> None:
    """Do a trial: move the tool by the follower until it raises, or the path is done.

    Args:
        start: (3,) the tip, base frame [m].
        rate: ticks per second [Hz].
        seed: of everything random in it.
    """
    rng = np.random.default_rng(seed)
    planned = progress.goal.planned
    if planned is None:
        _touch(operator, progress, start, follower, rate, rng)
        return
    tracing = progress.goal.task == "tracing"
    point, _, _, outward = planned.at(0.0)
    above = point + ABOVE * outward
    away = above - start
    away = away + operator.movement_noise * float(np.linalg.norm(away)) * rng.normal(size=3)
    follower(start + minimum_jerk(max(round(APPROACH * rate), 1))[:, None] * away)
    perform(
        operator, planned, start + away, follower, assisted=condition.rule != "off",
        stroke=operator.tracing_stroke if tracing else operator.stroke, rate=rate, rng=rng,
    )  # fmt: skip
    # The end as the operator sees it may be short of the goal: go on there until it is over.
    while True:
        point, along, _, outward = planned.at(planned.length)
        end = point - progress.goal.depth * outward + 1e-3 * along
        follower(np.tile(end, (max(round(0.1 * rate), 1), 1)))


def _touch(
    operator: Operator,
    progress: Progress,
    start: FloatArray,
    follower: Follower,
    rate: float,
    rng: np.random.Generator,
) -> None:
    """Move to the target that is shown, and to the next one, until the follower raises."""
    tremor = Tremor(operator.tremor * operator.scale, rate, rng)
    moving = max(round(operator.movement_time * rate), 1)
    waiting = max(round(operator.visual_delay * rate), 1)
    shape = minimum_jerk(moving)[:, None]
    # The endoscope looks down, and obliquely from one side.
    sight = np.array([np.sin(operator.view_angle), 0.0, -np.cos(operator.view_angle)])
    across = np.array([np.cos(operator.view_angle), 0.0, np.sin(operator.view_angle)])
    bias = operator.depth_bias * (1.0 + operator.session_spread * rng.normal())
    depth = SlowError(operator.depth_error, operator.slow, rng)
    image = SlowError(operator.image_error, operator.slow, rng)
    period = (moving + waiting) / rate
    hand, tip = np.array(start), np.array(start)
    while True:
        believed = tip - (bias + depth.after(period)) * sight + image.after(period) * across
        move = progress.aim - believed
        move *= min(1.0, LEAP / max(float(np.linalg.norm(move)), LEAP))
        move = move + operator.movement_noise * float(np.linalg.norm(move)) * rng.normal(size=3)
        wanted = np.concatenate([hand + shape * move, np.tile(hand + move, (waiting, 1))])
        hand = hand + move
        tip = follower(wanted + tremor(len(wanted)))[-waiting:].mean(axis=0)

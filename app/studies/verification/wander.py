"""How a structure moves at random: towards the tool and away, smoothly, in jerks and reversals."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from app.studies.verification.swelling import Swelling

FloatArray = NDArray[np.float64]

FASTEST = 0.2  # of a structure at the tool [m/s]
FASTEST_TURN = 2.0  # [rad/s]
FAR = 8e-3  # from the tool, from where a structure comes back [m]
KINDS = ("steady", "smooth", "jerky", "reversing", "halting")


@dataclass
class Aim:
    """What a structure may move towards, kept by the caller.

    Attributes:
        place: (3,) of the tool [m].
        towards: (3,) unit vector from the structure to there.
        distance: between them [m].
        face: of the structure, the nearest.
    """

    place: FloatArray
    towards: FloatArray
    distance: float
    face: int


def twists(
    rng: np.random.Generator, aim: Aim, period: float
) -> Iterator[tuple[FloatArray, FloatArray]]:
    """Endless velocities of the structure at the aim's place [m/s] and turns [rad/s], base frame.

    They are constant for a tick of `period` [s].
    """
    while True:
        kind = KINDS[rng.integers(len(KINDS))]
        length = max(1, int(rng.uniform(0.02, 0.25) / period))
        rate = rng.uniform(1.0, 10.0)  # of what is smooth [Hz]
        every = int(rng.integers(1, 6))
        phase = rng.uniform(0.0, 2.0 * np.pi)
        velocity, turn = _random(rng, aim)
        for k in range(length):
            if kind == "jerky":
                velocity, turn = _random(rng, aim)
            share = 1.0
            if kind == "smooth":
                share = np.sin(2.0 * np.pi * rate * k * period + phase)
            elif kind == "reversing":
                share = 1.0 if (k // every) % 2 == 0 else -1.0
            elif kind == "halting":
                share = 1.0 if (k // (2 * every)) % 2 == 0 else 0.0
            yield share * velocity, share * turn


def _random(rng: np.random.Generator, aim: Aim) -> tuple[FloatArray, FloatArray]:
    heading = rng.normal(size=3)
    heading /= np.linalg.norm(heading)
    choice = rng.random()
    if aim.distance > FAR or choice < 0.5:
        heading = aim.towards + 0.4 * heading
    elif choice < 0.7:
        heading = -aim.towards + 0.4 * heading
    heading /= max(float(np.linalg.norm(heading)), 1e-12)
    turn = rng.normal(size=3)
    turn *= FASTEST_TURN * rng.random() * (rng.random() < 0.8) / np.linalg.norm(turn)
    # Mostly slow: a tool that is overtaken in every episode is not tried otherwise.
    return FASTEST * rng.random() ** rng.choice([1.0, 3.0]) * heading, turn


class Truth:
    """Where a structure is: from knot to knot it moves with a constant twist.

    Attributes:
        time: of the last knot [s].
        now: T_base_structure then.
        form: how it deforms; None: it keeps its shape.
    """

    def __init__(self, pose: pin.SE3) -> None:
        self.form: Swelling | None = None
        self.time, self.now = 0.0, pose
        self._times, self._poses = [0.0], [pose]
        self._twists: list[FloatArray] = []

    def go(self, twist: FloatArray, duration: float) -> pin.SE3:
        """Move on with a twist (6,) of its own frame, linear before angular; returns the pose."""
        self._twists.append(twist)
        self.time += duration
        self.now = self.now * pin.exp6(twist * duration)
        self._times.append(self.time)
        self._poses.append(self.now)
        return self.now

    def pose(self, time: float) -> pin.SE3:
        """The pose at a time from 0 to the last knot [s]; a later one is that of the last knot."""
        k = bisect_right(self._times, time) - 1
        if k >= len(self._twists):
            return self._poses[-1]
        return self._poses[k] * pin.exp6(self._twists[k] * (time - self._times[k]))


def body_twist(
    pose: pin.SE3, place: FloatArray, velocity: FloatArray, turn: FloatArray
) -> FloatArray:
    """The twist (6,) in the frame of a pose of a body that moves so at a place, base frame."""
    origin = velocity + np.cross(turn, pose.translation - place)
    R = pose.rotation
    return np.concatenate([R.T @ origin, R.T @ turn])


def slowed(twist: FloatArray, radius: float, bound: float) -> FloatArray:
    """The twist, slower where points within `radius` [m] of the origin would exceed a speed."""
    fastest = float(np.linalg.norm(twist[:3]) + radius * np.linalg.norm(twist[3:]))
    return twist * min(1.0, bound / max(fastest, 1e-12))

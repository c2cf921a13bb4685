"""What a control loop is told of its masters and arms."""

from __future__ import annotations

import math
from dataclasses import dataclass

import pinocchio as pin

from app.kinds.links import Address, Link, parse_address
from app.settings import Options

OF_SESSION = ("page", "igtl")  # masters that give their orders to the session
MOVE_SPEED = 0.05, 0.5  # of the tool in a move of its own [m/s, rad/s]


@dataclass(frozen=True)
class Spec:
    """What a station is made of; it can be pickled.

    Attributes:
        arm, master: their addresses, see `app.kinds.links`.
        link: disturbances of the master's link, where its address has none.
        robot: name of the arm's model.
        dt: length of a tick [s].
        horizon: how far ahead of the measured joints a set-point may be [s].
        enable: whether to enable the arm as soon as it is heard of.
    """

    arm: str
    master: str
    link: Link
    robot: str
    dt: float
    horizon: float
    enable: bool

    @staticmethod
    def of(options: Options) -> Spec | None:
        """What the options ask for; None: arm and master of the sandbox itself."""
        link = Link(options.delay, options.jitter, options.loss)
        master = parse_address("master", options.master, link)
        if options.arm == "sim" and master.scheme in OF_SESSION and master.link.clear:
            return None
        return Spec(
            options.arm, options.master, link, options.robot, options.dt, options.horizon,
            options.enable or options.arm == "sim",
        )  # fmt: skip

    @property
    def leads(self) -> bool:
        """Whether the master reaches the control loop without the session."""
        return self.addresses()[1].scheme not in OF_SESSION

    def addresses(self) -> tuple[Address, Address]:
        """Those of arm and master."""
        return parse_address("arm", self.arm), parse_address("master", self.master, self.link)


def move_time(start: pin.SE3, end: pin.SE3) -> float:
    """How long a move from one pose to another takes, from rest to rest [s]."""
    way = math.dist(start.translation, end.translation) / MOVE_SPEED[0]
    turn = math.hypot(*pin.log3(start.rotation.T @ end.rotation)) / MOVE_SPEED[1]
    return max(way, turn) * 15.0 / 8.0  # minimum jerk is so much faster than its mean

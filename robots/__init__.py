"""Arms: Pinocchio models with inverse kinematics and drawings."""

from robots.arm import Arm, Unreachable
from robots.catalogue import load, names
from robots.drawing import Body
from robots.instrument import Capsule

__all__ = ["Arm", "Body", "Capsule", "Unreachable", "load", "names"]

"""What drives the app without a browser: patience, displaced poses, mailboxes that remember."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
import pinocchio as pin

from app.control.mailbox import Mailbox


def wait_until(condition: Callable[[], object], timeout: float = 20.0) -> None:
    """Poll until the condition holds; fails when it does not in time [s]."""
    deadline = time.monotonic() + timeout
    while not condition():
        if time.monotonic() > deadline:
            raise AssertionError("the condition did not become true in time")
        time.sleep(2e-3)


def moved(pose: pin.SE3, dx: float = 0.0, dy: float = 0.0, dz: float = 0.0) -> pin.SE3:
    """A pose displaced along the base frame's axes [m]."""
    return pin.SE3(pose.rotation, pose.translation + np.array([dx, dy, dz]))


class Tape(Mailbox):
    """A mailbox that remembers everything put into it."""

    __slots__ = ("items",)

    def __init__(self, value: object = None) -> None:
        super().__init__(value)
        self.items: list = []

    def put(self, value: object) -> None:
        self.items.append(value)
        super().put(value)

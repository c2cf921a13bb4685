"""An arm of your own: one class in one file, checked at the border as any arm is.

    vf-sandbox guard --mesh sphere --arm python:docs/examples/10_own_device.py:MyArm --enable

A device is a class with `receive`, `send`, `close`, `peer` and `refused`, see
`app.devices.remote.messages.Transport`. The control thread calls them in every tick, so none may
wait: a driver that has to wait for its hardware does that in a thread of its own. This one is a PSM
that is as slow as its motors; run as a script, it is pushed into a sphere.
"""

import time
from pathlib import Path

import numpy as np
import pinocchio as pin

from app.devices.remote.messages import Message
from app.session import Session
from app.settings import Options


class MyArm:
    """Takes a hundredth of a second to follow a set-point."""

    peer = "the example's arm"

    def __init__(self) -> None:
        self.refused: dict[str, int] = {}
        self.q = np.array([0.0, 0.0, 0.12, 0.0, 0.0, 0.0])  # rad, the third in metres
        self.goal = self.q
        self.then: float | None = None

    def receive(self, now: float) -> list[Message]:
        """What the arm says: in each tick where its joints are."""
        if self.then is not None:
            self.q = self.q + (1.0 - np.exp(-(now - self.then) / 0.01)) * (self.goal - self.q)
        self.then = now
        return [Message("measured_js", numbers=self.q.tolist(), stamp=now, at=now)]

    def send(self, message: Message, now: float) -> None:
        """What is asked of the arm; by the names of CRTK."""
        if message.name == "servo_jp":
            self.goal = np.array(message.numbers)

    def close(self) -> None:
        pass


if __name__ == "__main__":
    options = Options(
        mesh="sphere", robot="psm", standoff=1e-4, arm=f"python:{Path(__file__)}:MyArm?age=1s"
    )
    with Session(options) as session:
        while session.devices is None or not session.devices.arm.rate:
            time.sleep(0.01)
        print(f"before: {session.devices.state}")
        session.state_command("enable")  # nothing moves it before
        while session.devices.state != "ENABLED":
            time.sleep(0.01)

        start = session.handle
        foot = session.scene.surface.nearest(start.translation)[2]
        for share in np.linspace(0.0, 1.3, 60):  # to 30 % behind the surface
            position = start.translation + share * (foot - start.translation)
            session.drive(pin.SE3(start.rotation, position))
            time.sleep(0.02)
        time.sleep(1.0)

        step = session.latest().step
        gap = session.scene.surface.nearest(step.tip.translation)[0]
        print(f"now: {session.devices.state}, {session.devices.sent > 500} set-points were sent")
        print(f"rests {gap * 1e3:.1f} mm off the surface, force {np.linalg.norm(step.force):.1f} N")
        print(f"crossed the mesh: {'yes' if session.crossing else 'no'}")

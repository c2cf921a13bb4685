"""Passes a console's goals on to an arm and does nothing else, at the rate of a guard.

What it takes from a goal to a set-point is what sockets, processes and the machine take: it looks
at its sockets once a period, as a guard does, on a clock as that of the control loop. Nothing of
the devices' code is used.

    python -m app.bench.counterparts.relay 127.0.0.1 48051 --console 48060
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import select
import socket
import sys
import time
from typing import Any

from app.bench.counterparts import wire
from app.bench.counterparts.arm import START
from app.control.loop import SPIN, request_realtime

FEEDBACK = 5  # periods between two poses for the console


class Relay:
    """What it does in a period."""

    def __init__(self, host: str, arm: int, console: int) -> None:
        self.arm, self.console = wire.udp(), wire.udp()
        self.arm.bind((host, arm))
        self.there = host, console
        self.peer: tuple[str, int] | None = None
        self.top: float | None = None  # height of the first goal [m]
        self.count = 0

    def step(self) -> None:
        """Look at both sockets; a goal's height becomes the insertion."""
        for _data, sender, _ in wire.heard(self.arm):
            self.peer = sender
        for data, _, _ in wire.heard(self.console):
            goal = json.loads(data).get("servo_cp")
            if goal is None or self.peer is None:
                continue
            height = goal["Goal"]["Translation"][2]
            self.top = height if self.top is None else self.top
            q = [*START[:2], START[2] + self.top - height, *START[3:]]
            _send(self.arm, {"servo_jp": {"Goal": q}}, self.peer)
        self.count += 1
        if self.count % FEEDBACK == 0:
            pose = {"Rotation": [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
                    "Translation": [0.0, 0.0, -0.1]}  # fmt: skip
            _send(self.console, {"setpoint_cp": {"Position": pose}}, self.there)
            _send(self.console, {"operating_state": {"State": "ENABLED"}}, self.there)


def _send(on: socket.socket, content: dict[str, Any], there: tuple[str, int]) -> None:
    with contextlib.suppress(OSError):
        on.sendto(json.dumps(content).encode(), there)


def main() -> None:
    """Pass on until told to quit."""
    parser = argparse.ArgumentParser()
    parser.add_argument("host")
    parser.add_argument("port", type=int, help="that the arm sends to")
    parser.add_argument("--console", type=int, required=True)
    parser.add_argument("--period", type=float, default=1e-3)
    said = parser.parse_args()
    relay = Relay(said.host, said.port, said.console)
    request_realtime()
    os.set_blocking(0, False)
    print("ready", flush=True)
    due, looks = time.perf_counter(), 0
    while True:
        due = max(due + said.period, time.perf_counter())
        pause = due - SPIN - time.perf_counter()
        if pause > 0.0:
            time.sleep(pause)
        while time.perf_counter() < due:
            pass
        relay.step()
        looks += 1
        if looks % 100 == 0 and select.select([0], [], [], 0)[0]:
            break
    print("done", flush=True)


if __name__ == "__main__":
    main()
    sys.exit(0)

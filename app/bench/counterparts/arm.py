"""A stand-in for an arm behind the dVRK's socket streamer, for a process of its own.

It speaks the streamer's dialect: one JSON object a datagram, sent to a port, commands read from
where they come back to, no more than 1024 bytes of them; nulls and denormals where a value is not
valid. Its joints follow the set-points with a first-order lag. Nothing of the program is used.

    python -m app.bench.counterparts.arm 127.0.0.1 48051 --log arm.npz

Lines on stdin: a fault to make once (see `FAULTS`), ``push`` with six numbers, ``state WORD``,
``restart``, or ``quit``. What was made is answered with a line: ``made FAULT BEFORE AFTER``, times
of the monotonic clock [s].
"""

from __future__ import annotations

import argparse
import contextlib
import json
import math
import random
import sys
import time
from array import array
from typing import Any

import numpy as np

from app.bench.counterparts import wire

START = (0.0, 0.0, 0.12, 0.0, 0.0, 0.0)
# Five micrometres at the tip: the joints' levers are about 0.12, 0.12, 1, 0.01, 0.01, 0.02 m.
NOISE = (2e-5, 2e-5, 2.5e-6, 1e-4, 1e-4, 1e-4)
NAMES = ["outer_yaw", "outer_pitch", "outer_insertion", "outer_roll", "outer_wrist_pitch",
         "outer_wrist_yaw"]  # fmt: skip
FAULTS = (
    "nan", "null", "denormal", "invalid", "count", "range", "jump", "back", "frame", "huge",
    "silence", "aside", "far", "repeat", "swap", "garbage", "long", "array",
)  # fmt: skip
ASIDE = 4.8e-3  # how far the instrument is pulled out, off its path: a fault "aside" [m]
FAR = 12e-3  # the same where it is not heard meanwhile: a fault "far" [m]
UNHEARD = 0.025  # for so long [s]


class StandIn:
    """An arm: `step` at its rate."""

    def __init__(self, said: argparse.Namespace) -> None:
        self.socket = wire.udp()
        self.there = (said.host, said.port)
        self.dt, self.lag, self.loss = 1.0 / said.rate, said.lag, said.loss
        self.silence = said.silence
        self.q = np.array(said.start)
        self.setpoint, self.home = self.q.copy(), float(self.q[2])
        self.noise = said.noise * np.array(NOISE)
        self.random = random.Random(7)
        self.rng = np.random.default_rng(7)
        self.count = 0
        self.silent_until = 0.0
        self.pulled = 0.0  # by what the instrument is pulled out when it is heard again [m]
        self.state = "ENABLED"
        self.words: list[str] = []
        # An hour of lists of objects would not fit.
        self.truth, self.told, self.times, self.goals = (array("d") for _ in range(4))
        self.injected: list[tuple[float, str]] = []
        self.push = np.zeros(6)
        self.fault = ""

    def send(self, content: dict[str, Any], now: float) -> None:
        """Send one object."""
        self.put((json.dumps(content) + "\n").encode(), now)

    def put(self, data: bytes, now: float) -> None:
        """Send a datagram, unless it is lost."""
        if now < self.silent_until or self.random.random() < self.loss:
            return
        with contextlib.suppress(OSError):
            self.socket.sendto(data, self.there)

    def hear(self) -> None:
        """Take the commands that have come."""
        for data, _, at in wire.heard(self.socket):
            if self.random.random() < self.loss:
                continue
            if len(data) >= wire.LARGEST:
                print("too long", flush=True)
                continue
            for name, value in json.loads(data).items():
                if name == "servo_jp":
                    goal = value["Goal"]
                    assert len(goal) == 6
                    assert all(math.isfinite(x) for x in goal)
                    self.setpoint = np.array(goal)
                    self.goals.extend((at, *goal))
                else:
                    self.words.append(f"{name} {value}")

    def step(self, now: float) -> None:
        """A period: hear, move, tell."""
        self.hear()
        appears = False
        share = 1.0 - math.exp(-self.dt / self.lag) if self.lag else 1.0
        self.q = self.q + share * (self.setpoint - self.q) + self.push
        if self.pulled and now >= self.silent_until:
            self.q[2] -= self.pulled
            self.setpoint, self.pulled = self.q.copy(), 0.0
            appears = True
        fault, self.fault = self.fault, ""
        if fault == "aside":
            self.q[2] -= ASIDE
        told = self.q + self.noise * self.rng.standard_normal(6)
        self.count += 1
        stamp = 20.0 + self.count * self.dt
        js = {
            "AutomaticTimestamp": False, "Effort": [0.0] * 6, "Name": NAMES,
            "Position": told.tolist(), "Timestamp": stamp, "Valid": True, "Velocity": [0.0] * 6,
        }  # fmt: skip
        if fault:
            self.injected.append((now, fault))
            self.make(fault, js, now)
            if fault != "far":
                print(f"made {fault} {now!r} {time.monotonic()!r}", flush=True)
        else:
            self.send({"measured_js": js}, now)
            if appears:
                print(f"made far {now!r} {time.monotonic()!r}", flush=True)
        self.truth.extend(self.q)
        self.told.extend(told)
        self.times.append(now)
        if self.count % 15 == 0:
            self.send(
                {
                    "jaw/measured_js": {
                        "AutomaticTimestamp": True, "Effort": None, "Name": ["jaw"],
                        "Position": [4.6701996844274162e-310], "Timestamp": stamp, "Valid": False,
                        "Velocity": None,
                    }
                },
                now,
            )  # fmt: skip
            self.send(
                {"operating_state": {"State": self.state, "SubState": "", "IsHomed": True,
                                     "IsBusy": False, "Timestamp": stamp, "Valid": True}},
                now,
            )  # fmt: skip

    def make(self, fault: str, js: dict[str, Any], now: float) -> None:
        """Send a measurement with a fault."""
        position = js["Position"]
        keep = json.dumps({"measured_js": js}).encode()
        if fault == "silence":
            self.silent_until = now + self.silence
            return
        if fault == "far":
            # Again and again it must not be pulled out of its range: then it is put back.
            self.silent_until = now + UNHEARD
            self.pulled = FAR if self.q[2] > self.home - 2.0 * FAR else -FAR
            return
        if fault == "nan":
            position[1] = math.nan
        elif fault == "null":
            js["Position"] = None
        elif fault == "denormal":
            position[2] = 4.67e-310
        elif fault == "invalid":
            js["Valid"] = False
        elif fault == "count":
            js["Position"] = [*position, 0.0]
        elif fault == "range":
            position[2] = 3.0
        elif fault == "jump":
            position[0] += 0.5
        elif fault == "back":
            js["Timestamp"] -= 10.0
        elif fault == "frame":
            js["ReferenceFrame"] = "elsewhere"
        elif fault == "huge":
            js["Position"] = [10**400] * 6
        data = json.dumps({"measured_js": js}).encode()
        if fault == "garbage":
            data = b"\xff\xfe{not json"
        elif fault == "array":
            data = b"[[[1, 2], 3]]"
        elif fault == "long":
            data = b'{"measured_js":{"Name":["' + b"x" * 9000 + b'"]}}'
        elif fault == "repeat":
            self.put(keep, now)
        elif fault == "swap":
            later = dict(js, Timestamp=js["Timestamp"] + 0.5 * self.dt)
            self.put(json.dumps({"measured_js": later}).encode(), now)
        self.put(data, now)

    def obey(self, line: str) -> None:
        """A line of stdin."""
        word, *rest = line.split()
        if word == "push":
            self.push = np.array([float(x) for x in rest])
        elif word == "state":
            self.state = rest[0]
        elif word == "restart":
            self.count = 0
        else:
            self.fault = word

    def save(self, path: str) -> None:
        """Write what was seen: joints (k, 6) as they are and as they were told, and so on."""
        np.savez(
            path, truth=np.array(self.truth).reshape(-1, 6),
            told=np.array(self.told).reshape(-1, 6), times=np.array(self.times),
            goals=np.array(self.goals).reshape(-1, 7), words=np.array(self.words),
            injected_at=np.array([at for at, _ in self.injected]),
            injected=np.array([what for _, what in self.injected]),
        )  # fmt: skip


def main() -> None:
    """Be an arm until told to quit."""
    parser = argparse.ArgumentParser()
    parser.add_argument("host")
    parser.add_argument("port", type=int)
    parser.add_argument("--rate", type=float, default=1500.0)
    parser.add_argument("--lag", type=float, default=0.008)
    parser.add_argument("--loss", type=float, default=0.0)
    parser.add_argument("--noise", type=float, default=1.0)
    parser.add_argument("--silence", type=float, default=0.5)
    parser.add_argument("--start", type=float, nargs=6, default=START)
    parser.add_argument("--log")
    said = parser.parse_args()
    arm = StandIn(said)
    wire.paced(arm.dt, arm.step, arm.obey)
    if said.log:
        arm.save(said.log)
    print("done", flush=True)


if __name__ == "__main__":
    main()
    sys.exit(0)

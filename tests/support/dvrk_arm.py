"""A stand-in for an arm behind the dVRK's socket streamer, for a process of its own.

It speaks the streamer's dialect: one JSON object a datagram, sent to a port, commands read from
where they come back to, no more than 1024 bytes of them; nulls and denormals where a value is not
valid. Its joints follow the set-points with a first-order lag. Nothing of the application is used.

    python -m tests.support.dvrk_arm 127.0.0.1 48051 --log arm.npz

Lines on stdin: a fault to make once (see `FAULTS`), or ``quit``.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import math
import os
import random
import select
import socket
import sys
import time

import numpy as np

START = (0.0, 0.0, 0.12, 0.0, 0.0, 0.0)
# Five micrometres at the tip: the joints' levers are about 0.12, 0.12, 1, 0.01, 0.01, 0.02 m.
NOISE = (2e-5, 2e-5, 2.5e-6, 1e-4, 1e-4, 1e-4)
FAULTS = (
    "nan", "null", "denormal", "invalid", "count", "range", "jump", "back", "repeat", "swap",
    "silence", "garbage", "long", "array", "huge",
)  # fmt: skip


class StandIn:
    def __init__(self, host: str, port: int, rate: float, lag: float, loss: float, noise: float):
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.setblocking(False)
        self.there = (host, port)
        self.dt, self.lag, self.loss = 1.0 / rate, lag, loss
        self.q = np.array(START)
        self.setpoint = self.q.copy()
        self.noise = noise * np.array(NOISE)
        self.random = random.Random(7)
        self.rng = np.random.default_rng(7)
        self.count = 0
        self.silent_until = 0.0
        self.state = "ENABLED"
        self.words: list[str] = []
        self.truth: list[np.ndarray] = []
        self.told: list[np.ndarray] = []
        self.times: list[float] = []
        self.goals: list[tuple[float, ...]] = []
        self.injected: list[tuple[float, str]] = []
        self.kept: bytes | None = None
        self.push = np.zeros(6)
        self.fault = ""

    def send(self, content: dict, now: float) -> None:
        self.put((json.dumps(content) + "\n").encode(), now)

    def put(self, data: bytes, now: float) -> None:
        if now < self.silent_until or self.random.random() < self.loss:
            return
        with contextlib.suppress(OSError):
            self.socket.sendto(data, self.there)

    def hear(self, now: float) -> None:
        while True:
            try:
                data = self.socket.recv(1024)
            except BlockingIOError:
                return
            except OSError:
                continue
            if self.random.random() < self.loss:
                continue
            if len(data) >= 1024:
                print("too long", flush=True)
                continue
            for name, value in json.loads(data).items():
                if name == "servo_jp":
                    goal = value["Goal"]
                    assert len(goal) == 6
                    assert all(math.isfinite(x) for x in goal)
                    self.setpoint = np.array(goal)
                    self.goals.append((now, *goal))
                else:
                    self.words.append(f"{name} {value}")

    def step(self, now: float) -> None:
        self.hear(now)
        share = 1.0 - math.exp(-self.dt / self.lag)
        self.q = self.q + share * (self.setpoint - self.q) + self.push
        told = self.q + self.noise * self.rng.standard_normal(6)
        self.count += 1
        stamp = 20.0 + self.count * self.dt
        js = {
            "AutomaticTimestamp": False, "Effort": [0.0] * 6,
            "Name": ["outer_yaw", "outer_pitch", "outer_insertion", "outer_roll",
                     "outer_wrist_pitch", "outer_wrist_yaw"],
            "Position": told.tolist(), "Timestamp": stamp, "Valid": True, "Velocity": [0.0] * 6,
        }  # fmt: skip
        fault, self.fault = self.fault, ""
        if fault:
            self.injected.append((now, fault))
            self.make(fault, js, now)
        else:
            self.send({"measured_js": js}, now)
        self.truth.append(self.q)
        self.told.append(told)
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

    def make(self, fault: str, js: dict, now: float) -> None:
        position = js["Position"]
        keep = json.dumps({"measured_js": js}).encode()
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
        elif fault == "silence":
            self.silent_until = now + 0.5
            return
        if fault == "garbage":
            self.put(b"\xff\xfe{not json", now)
        elif fault == "array":
            self.put(b"[[[1, 2], 3]]", now)
        elif fault == "long":
            self.put(b'{"measured_js":{"Name":["' + b"x" * 9000 + b'"]}}', now)
        elif fault == "huge":
            js["Position"] = [10**400] * 6
            self.put(json.dumps({"measured_js": js}).encode(), now)
        elif fault == "repeat":
            self.put(keep, now)
            self.put(keep, now)
        elif fault == "swap":
            later = dict(js, Timestamp=js["Timestamp"] + 0.5 * self.dt)
            self.put(json.dumps({"measured_js": later}).encode(), now)
            self.put(keep, now)
        else:
            self.put(json.dumps({"measured_js": js}).encode(), now)


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("host")
    parser.add_argument("port", type=int)
    parser.add_argument("--rate", type=float, default=1500.0)
    parser.add_argument("--lag", type=float, default=0.008)
    parser.add_argument("--loss", type=float, default=0.0)
    parser.add_argument("--noise", type=float, default=1.0)
    parser.add_argument("--start", type=float, nargs=6, default=START)
    parser.add_argument("--log")
    said = parser.parse_args()
    arm = StandIn(said.host, said.port, said.rate, said.lag, said.loss, said.noise)
    arm.q = np.array(said.start)
    arm.setpoint = arm.q.copy()
    os.set_blocking(0, False)
    print("ready", flush=True)
    due = time.monotonic()
    typed = b""
    while True:
        due = max(due + arm.dt, time.monotonic() - 0.01)
        pause = due - time.monotonic()
        if pause > 0:
            time.sleep(pause)
        arm.step(time.monotonic())
        if select.select([0], [], [], 0)[0]:
            read = os.read(0, 4096)
            typed += read
            if not read:
                break
            *lines, typed = typed.split(b"\n")
            words = [line.decode().split() for line in lines]
            if ["quit"] in words:
                break
            for word, *rest in words:
                if word == "push":
                    arm.push = np.array([float(x) for x in rest])
                elif word == "state":
                    arm.state = rest[0]
                elif word == "restart":
                    arm.count = 0
                else:
                    arm.fault = word
    if said.log:
        np.savez(
            said.log, truth=np.array(arm.truth), told=np.array(arm.told),
            times=np.array(arm.times), goals=np.array(arm.goals), words=np.array(arm.words),
            injected_at=np.array([at for at, _ in arm.injected]),
            injected=np.array([what for _, what in arm.injected]),
        )  # fmt: skip
    print("done", flush=True)


if __name__ == "__main__":
    main()
    sys.exit(0)

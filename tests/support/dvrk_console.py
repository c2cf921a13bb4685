"""A stand-in for a console that uses the guard as an arm, or for a hand, for a process of its own.

As a console it listens on a port, and answers to where feedback came from: it enables the arm,
takes its pose, and then commands `servo_cp` goals. As a hand (``--hand``) it sends `measured_cp` to
the port, as the streamer of a master does. Nothing of the application is used.

    python -m tests.support.dvrk_console 127.0.0.1 48060 --log console.npz

Lines on stdin: a fault to make once, ``send JSON``, ``enable``, ``follow``, ``still``, ``quit``.
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
import time

import numpy as np


class StandIn:
    def __init__(self, said: argparse.Namespace) -> None:
        self.said = said
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.setblocking(False)
        self.there = (said.host, said.port) if said.hand else None
        if not said.hand:
            self.socket.bind((said.host, said.port))
        self.random = random.Random(3)
        self.start: tuple[np.ndarray, np.ndarray] | None = None
        if said.hand:
            self.start = np.eye(3), np.array([0.1, 0.2, -0.3])
        self.heard: dict[str, int] = {}
        self.newest: dict[str, dict] = {}
        self.states: list[str] = []
        self.sentences: list[str] = []
        self.forces: list[list[float]] = []
        self.sent: list[tuple[float, ...]] = []
        self.injected: list[tuple[float, str]] = []
        self.follows = said.follow
        self.began = math.nan
        self.count = 0
        self.fault = ""

    def send(self, content: dict) -> None:
        self.put(json.dumps(content).encode())

    def put(self, data: bytes) -> None:
        if self.there is None or self.random.random() < self.said.loss:
            return
        with contextlib.suppress(OSError):
            self.socket.sendto(data, self.there)

    def hear(self) -> None:
        while True:
            try:
                data, self.there = self.socket.recvfrom(1024)
            except BlockingIOError:
                return
            except OSError:
                continue
            for name, value in json.loads(data).items():
                self.heard[name] = self.heard.get(name, 0) + 1
                self.newest[name] = value
                if name == "operating_state" and self.states[-1:] != [value["State"]]:
                    self.states.append(value["State"])
                elif name in ("warning", "error", "status"):
                    self.sentences.append(f"{name}: {value['Message']}")
                    if "first goal" in value["Message"]:  # take the arm where it is
                        self.start, self.began = None, math.nan
                elif name == "body/servo_cf":
                    self.forces.append(value["Force"])

    def offset(self, t: float) -> np.ndarray:
        """Where the goal is from the start at this time since the start [m]."""
        said = self.said
        if said.step:  # back and forth, at once
            return np.array([0.0, 0.0, said.step * (int(t / 0.05) % 2)])
        share = min(t / 2.0, 1.0)  # begins slowly
        side = np.array([math.sin(2.1 * t) + 0.6 * math.sin(5.3 * t), math.sin(1.7 * t + 1.0), 0.0])
        down = 0.5 * (1.0 - math.cos(0.9 * t)) + 0.1 * math.sin(7.0 * t)
        return share * np.array([said.side * side[0], said.side * side[1], -said.down * down])

    def step(self, now: float) -> None:
        self.hear()
        pose = self.newest.get("setpoint_cp")
        state = self.newest.get("operating_state", {}).get("State")
        if self.start is None and pose is not None and state == "ENABLED":
            self.start = (
                np.array(pose["Position"]["Rotation"]), np.array(pose["Position"]["Translation"]),
            )  # fmt: skip
        if self.start is None or not self.follows:
            return
        if math.isnan(self.began):
            self.began = now
        R, p = self.start
        p = p + self.offset(now - self.began)
        self.count += 1
        fault, self.fault = self.fault, ""
        if fault:
            self.injected.append((now, fault))
        goal = {"Rotation": R.tolist(), "Translation": p.tolist()}
        stamp = 5.0 + self.count * self.said.period
        if fault == "nan":
            goal["Translation"][0] = math.nan
        elif fault == "rotation":
            goal["Rotation"][0][0] = 2.0
        elif fault == "mirror":
            goal["Rotation"] = (R @ np.diag([1.0, 1.0, -1.0])).tolist()
        elif fault == "jump":
            goal["Translation"][1] += 0.3
        elif fault == "far":
            goal["Translation"][1] += 50.0
        elif fault == "null":
            goal["Translation"] = None
        elif fault == "back":
            stamp -= 10.0
        frame = "elsewhere" if fault == "frame" else "base"
        if self.said.hand:
            content = {
                "measured_cp": {
                    "Position": goal, "ReferenceFrame": frame, "MovingFrame": "hand",
                    "Timestamp": stamp, "Valid": True, "AutomaticTimestamp": False,
                }
            }  # fmt: skip
        else:
            content = {"servo_cp": {"Goal": goal, "ReferenceFrame": frame, "Timestamp": stamp}}
        self.send(content)
        if fault == "repeat":
            self.send(content)
        self.sent.append((now, *p))


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("host")
    parser.add_argument("port", type=int)
    parser.add_argument("--hand", action="store_true")
    parser.add_argument("--follow", action="store_true")
    parser.add_argument("--enable", action="store_true")
    parser.add_argument("--period", type=float, default=1e-3)
    parser.add_argument("--loss", type=float, default=0.0)
    parser.add_argument("--side", type=float, default=0.012)
    parser.add_argument("--down", type=float, default=0.05)
    parser.add_argument("--step", type=float, default=0.0)
    parser.add_argument("--log")
    said = parser.parse_args()
    console = StandIn(said)
    os.set_blocking(0, False)
    print("ready", flush=True)
    due, asked, typed = time.monotonic(), 0.0, b""
    while True:
        due = max(due + said.period, time.monotonic() - 0.01)
        pause = due - time.monotonic()
        if pause > 0:
            time.sleep(pause)
        now = time.monotonic()
        console.step(now)
        state = console.newest.get("operating_state", {}).get("State")
        if said.enable and state == "DISABLED" and now - asked > 0.2:
            asked = now
            console.send({"state_command": "enable"})
        if said.enable and state == "FAULT" and now - asked > 0.2:
            asked = now
            console.send({"state_command": "disable"})
        if not select.select([0], [], [], 0)[0]:
            continue
        read = os.read(0, 1 << 16)
        typed += read
        if not read:
            break
        *lines, typed = typed.split(b"\n")
        if b"quit" in lines:
            break
        for line in lines:
            word, _, rest = line.decode().partition(" ")
            if word == "send":
                console.put(rest.encode())
            elif word == "enable":
                console.send({"state_command": {"Data": "enable"}})
            elif word in ("follow", "still"):
                console.follows = word == "follow"
                console.began = math.nan
                console.start = console.start if said.hand else None
            elif word == "tell":
                told = {"newest": console.newest, "heard": console.heard,
                        "states": console.states, "sentences": console.sentences}  # fmt: skip
                print(json.dumps(told), flush=True)
            else:
                console.fault = word
    if said.log:
        np.savez(
            said.log, forces=np.array(console.forces), sent=np.array(console.sent),
            states=np.array(console.states), sentences=np.array(console.sentences),
            injected_at=np.array([at for at, _ in console.injected]),
            injected=np.array([what for _, what in console.injected]),
            names=np.array(sorted(console.heard)),
        )  # fmt: skip
    print("done", flush=True)


if __name__ == "__main__":
    main()

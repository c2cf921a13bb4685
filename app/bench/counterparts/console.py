"""A stand-in for a console that uses the guard as an arm, or for a hand, for a process of its own.

As a console it listens on a port, and answers to where feedback came from: it enables the arm,
takes its pose, and then commands `servo_cp` goals. As a hand (``--hand``) it sends `measured_cp` to
the port, as the streamer of a master does. Nothing of the program is used.

    python -m app.bench.counterparts.console 127.0.0.1 48060 --log console.npz

Lines on stdin: a fault to make once (see `FAULTS`), ``send JSON``, ``enable``, ``follow``,
``still``, ``tell``, ``quit``. What was made is answered with a line: ``made FAULT BEFORE AFTER``,
times of the monotonic clock [s].
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
from numpy.typing import NDArray

from app.bench.counterparts import wire

FAULTS = (
    "nan", "null", "rotation", "mirror", "far", "jump", "back", "frame", "silence", "repeat",
    "swap",
)  # fmt: skip
ASKED = 0.05  # period of asking for a state [s]
BACK = 1.0  # so long it takes from where the arm is back to the course [s]
TURN = 0.05  # period of steps back and forth [s]


class StandIn:
    """A console or a hand: `step` at its rate."""

    def __init__(self, said: argparse.Namespace) -> None:
        self.said = said
        self.socket = wire.udp()
        self.there: tuple[str, int] | None = (said.host, said.port) if said.hand else None
        if not said.hand:
            self.socket.bind((said.host, said.port))
        self.random = random.Random(3)
        self.start: tuple[NDArray[np.float64], NDArray[np.float64]] | None = None
        if said.hand:
            self.start = np.eye(3), np.array([0.1, 0.2, -0.3])
        self.heard: dict[str, int] = {}
        self.newest: dict[str, dict[str, Any]] = {}
        self.states: list[str] = []
        self.sentences: list[str] = []
        self.forces, self.sent = array("d"), array("d")
        self.injected: list[tuple[float, str]] = []
        self.follows = said.follow
        self.began = math.nan
        self.strayed = np.zeros(3)  # from the course when it was left last [m] …
        self.since = -math.inf  # … and when
        self.lost = False  # whether goals must begin at the arm anew
        self.count = 0
        self.fault = ""
        self.silent_until = 0.0
        self.asked = 0.0

    def send(self, content: dict[str, Any]) -> None:
        """Send one object."""
        self.put(json.dumps(content).encode())

    def put(self, data: bytes) -> None:
        """Send a datagram, unless it is lost."""
        if self.there is None or self.random.random() < self.said.loss:
            return
        with contextlib.suppress(OSError):
            self.socket.sendto(data, self.there)

    def hear(self) -> None:
        """Take the feedback that has come."""
        for data, sender, _ in wire.heard(self.socket):
            self.there = sender
            for name, value in json.loads(data).items():
                self.heard[name] = self.heard.get(name, 0) + 1
                self.newest[name] = value
                if name == "operating_state" and self.states[-1:] != [value["State"]]:
                    self.states.append(value["State"])
                elif name in ("warning", "error", "status"):
                    self.sentences.append(f"{name}: {value['Message']}")
                    self.lost = self.lost or "first goal" in value["Message"]
                elif name == "body/servo_cf":
                    self.forces.extend(value["Force"])

    def offset(self, t: float) -> NDArray[np.float64]:
        """Where the goal is from the start at this time since the start [m]."""
        said = self.said
        if said.step:  # back and forth, at once
            return np.array([0.0, 0.0, said.step * (int(t / TURN) % 2)])
        share = min(t / 2.0, 1.0)  # begins slowly
        side = np.array([math.sin(2.1 * t) + 0.6 * math.sin(5.3 * t), math.sin(1.7 * t + 1.0), 0.0])
        down = 0.5 * (1.0 - math.cos(0.9 * t)) + 0.1 * math.sin(7.0 * t)
        return share * np.array([said.side * side[0], said.side * side[1], -said.down * down])

    def goal(self, now: float) -> NDArray[np.float64]:
        """The goal now (3,): on the course, or on the way back to it [m]."""
        assert self.start is not None
        on_course = self.start[1] + self.offset(now - self.began)
        if self.lost:
            self.lost = False
            pose = self.newest["setpoint_cp"]["Position"]
            self.start = np.array(pose["Rotation"]), self.start[1]
            self.strayed, self.since = np.array(pose["Translation"]) - on_course, now
        return on_course + self.strayed * max(0.0, 1.0 - (now - self.since) / BACK)

    def step(self, now: float) -> None:
        """A period: hear, and send a goal."""
        self.hear()
        pose = self.newest.get("setpoint_cp")
        state = self.newest.get("operating_state", {}).get("State")
        if self.said.enable and state in ("DISABLED", "FAULT") and now - self.asked > ASKED:
            self.asked = now
            self.send({"state_command": "enable" if state == "DISABLED" else "disable"})
        if self.start is None and pose is not None and state == "ENABLED":
            position = pose["Position"]
            self.start = np.array(position["Rotation"]), np.array(position["Translation"])
        if self.start is None or not self.follows:
            return
        if math.isnan(self.began):
            self.began = now
        p = self.goal(now)
        R = self.start[0]
        self.count += 1
        fault, self.fault = self.fault, ""
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
        elif fault == "silence":
            self.silent_until = now + self.said.silence
        data = self.datagram(goal, stamp, "elsewhere" if fault == "frame" else "base")
        if now >= self.silent_until:
            if fault == "swap":
                self.put(self.datagram(goal, stamp + 0.5 * self.said.period, "base"))
            at = time.monotonic()
            self.put(data)
            if fault == "repeat":
                self.put(data)
            self.sent.extend((at, *p))
        if fault:
            self.injected.append((now, fault))
            print(f"made {fault} {now!r} {time.monotonic()!r}", flush=True)

    def datagram(self, goal: dict[str, Any], stamp: float, frame: str) -> bytes:
        """A goal, or where the hand is."""
        if not self.said.hand:
            content: dict[str, Any] = {
                "servo_cp": {"Goal": goal, "ReferenceFrame": frame, "Timestamp": stamp}
            }
        else:
            content = {
                "measured_cp": {
                    "Position": goal, "ReferenceFrame": frame, "MovingFrame": "hand",
                    "Timestamp": stamp, "Valid": True, "AutomaticTimestamp": False,
                }
            }  # fmt: skip
        return json.dumps(content).encode()

    def obey(self, line: str) -> None:
        """A line of stdin."""
        word, _, rest = line.partition(" ")
        if word == "send":
            self.put(rest.encode())
        elif word == "enable":
            self.send({"state_command": {"Data": "enable"}})
        elif word in ("follow", "still"):
            self.follows = word == "follow"
            self.began = math.nan
            self.start = self.start if self.said.hand else None
        elif word == "tell":
            told = {"newest": self.newest, "heard": self.heard, "states": self.states,
                    "sentences": self.sentences}  # fmt: skip
            print(json.dumps(told), flush=True)
        else:
            self.fault = word

    def save(self, path: str) -> None:
        """Write what was seen and sent: forces (k, 3), time and goal (k, 4), and so on."""
        np.savez(
            path, forces=np.array(self.forces).reshape(-1, 3),
            sent=np.array(self.sent).reshape(-1, 4), states=np.array(self.states),
            sentences=np.array(self.sentences),
            injected_at=np.array([at for at, _ in self.injected]),
            injected=np.array([what for _, what in self.injected]),
            names=np.array(sorted(self.heard)),
        )  # fmt: skip


def main() -> None:
    """Be a console until told to quit."""
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
    parser.add_argument("--silence", type=float, default=0.5)
    parser.add_argument("--log")
    said = parser.parse_args()
    console = StandIn(said)
    wire.paced(said.period, console.step, console.obey)
    if said.log:
        console.save(said.log)
    print("done", flush=True)


if __name__ == "__main__":
    main()
    sys.exit(0)

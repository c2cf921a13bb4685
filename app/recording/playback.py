"""Telemetry of any row of a recording, for drawing; planes are computed again."""

from __future__ import annotations

import functools
import time
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

import robots
import vf
from app.control.engine import Plant
from app.control.messages import LoopStats, Telemetry
from app.motion.movement import Movement, checksum, streamed
from app.motion.refits import Guide
from app.recording import rerun
from app.recording.format import MEASURED, Recording
from app.recording.write import as_json
from app.scene import scene as scenes
from app.scene import structures, worker
from app.scene.moment import Moment, places_at
from app.scene.scene import Progress, Scene


def build_scenes(
    recording: Recording,
    version: int,
    like: Scene | None = None,
    progress: Progress | None = None,
    stop: worker.Stop | None = None,
) -> tuple[Scene, ...]:
    """A recording's scenes, numbered from `version`; `like` is reused if it is equal to one.

    They are built in another process, see `worker`.

    Args:
        progress: called with a short text before each step.
        stop: stops the work.

    Raises:
        ValueError: what `rerun.build`, `worker.Ended` and `worker.Stopped` raise.
    """
    built = []
    for k, place in enumerate(recording.places):
        same = (
            like is not None
            and streamed(like.courses) is None  # which goes on
            and as_json(place.options) == as_json(like.options)
            and [place.checksum, *(one.checksum for one in place.structures)]
            == [surface.checksum for surface in like.surfaces]
            and place.poses == checksum(like.courses)
            and place.start.tobytes() == like.start.tobytes()
        )
        if same:
            assert like is not None
            built.append(like)
        else:
            work = functools.partial(rerun.build, place, version + k, warm=False)
            arm = robots.load(place.options.robot)
            built.append(
                worker.build_scene(work, structures.files_of(place.options), arm, progress, stop)
            )
    return tuple(built)


class Player:
    """Gives the rows of a recording in any order. Not thread-safe (it owns a controller)."""

    def __init__(self, recording: Recording, built: Sequence[Scene]) -> None:
        """`built` are the scenes of the recording, in its order."""
        self.recording = recording
        self._scenes = tuple(built)
        for place, scene in enumerate(self._scenes):
            rerun.reshape(recording, place, scene)
        self._index = -1
        self._plant: Plant | None = None
        self._movement: Movement | None = None
        self._guide: Guide | None = None

    def __len__(self) -> int:
        return len(self.recording.rows)

    def moment(self, row: int) -> Moment:
        """The state after row 0 … len − 1: numbers as recorded, planes computed again."""
        recording = self.recording
        noted = recording.rows[row]
        order = recording.orders[noted["order"]]
        place, options = recording.plants[order["plant"]]
        scene = self._scenes[place]
        if self._plant is None or self._index != order["plant"]:
            self._index = int(order["plant"])
            self._plant = scenes.plant(scene, options)
            self._movement = self._plant.movement()
            self._guide = self._plant.guide()
        q = recording.joints(row)
        target = None
        if noted["driven"]:
            # The autopilot keeps the orientation of the start.
            by_hand = order["driven"] and not order["autopilot"]
            turn = order["rotation"] if by_hand else scene.T_base_start.rotation
            target = pin.SE3(turn, noted["target"])
        step = self._step(row, q, target) if noted["stepped"] else None
        telemetry = Telemetry(
            tick=int(noted["tick"]),
            time=float(noted["tick"]) * recording.dt,
            q=q,
            target=target,
            step=step,
            stats=LoopStats(),
            scene=scene.version,
            sequence=int(order["sequence"]),
            paused=bool(order["paused"]),
            autopilot=bool(order["autopilot"]),
            stale=bool(noted["stale"]),
            phase=float(noted["phase"]),
            phase_before=self._phase_before(row),
            lost=bool(noted["lost"]),
        )
        seen = replace(options, scale=float(order["scale"]), lock_orientation=bool(order["lock"]))
        force = np.zeros(3) if step is None else step.force
        assert self._movement is not None
        places = places_at(self._movement, telemetry.phase)
        return Moment(scene, seen, telemetry, bool(order["clutch"]), force, places=places)

    def _step(self, row: int, q: np.ndarray, target: pin.SE3 | None) -> vf.Step:
        """The step of a row, from the joints before it."""
        assert self._plant is not None
        arm, controller = self._plant.arm, self._plant.controller
        noted = self.recording.rows[row]
        before = self._before(row, q)
        motions = None
        if self._movement is not None and self._movement.moves:
            assert self._guide is not None
            told = self._plant.told(self._guide, self._phase_before(row), float(noted["phase"]))
            motions = self._plant.motions(told.motions)
        step = controller.step(before, arm.tip(before) if target is None else target, motions)
        return replace(
            step,
            q=q,
            tip=arm.tip(q),
            force=noted["force"].copy(),
            status=vf.Status(int(noted["status"])),
            distance=float(noted["distance"]),
        )

    def _phase_before(self, row: int) -> float:
        """The phase before a row: that of the row before, or 0 after a reset or a new scene."""
        if self._jumped(row) and not self._goes_on(row):
            return 0.0
        rows = self.recording.rows
        return float(rows["phase"][row - 1]) if row else self.recording.state.phase

    def _goes_on(self, row: int) -> bool:
        """Whether the phase goes on at a reset: shapes come from elsewhere, in the same scene."""
        before, now = (self._place(max(k, 0)) for k in (row - 1, row))
        return before == now and streamed(self._scenes[now].courses) is not None

    def _place(self, row: int) -> int:
        recording = self.recording
        return recording.plants[recording.orders["plant"][recording.rows["order"][row]]][0]

    def _before(self, row: int, q: np.ndarray) -> np.ndarray:
        """Joints before the tick of a row; those after it if a reset or a new scene moved them."""
        noted = self.recording.rows[row]
        if noted["sensed"] == MEASURED:
            return np.array(noted["measured"][: len(q)])
        return q if self._jumped(row) else self.recording.joints(row - 1)

    def _jumped(self, row: int) -> bool:
        """Whether a reset or a new scene came before the tick of a row."""
        rows, orders = self.recording.rows, self.recording.orders
        now = orders[rows["order"][row]]
        then = orders[rows["order"][row - 1] if row else 0]
        plants = self.recording.plants
        return bool(
            now["resets"] != then["resets"] or plants[now["plant"]][0] != plants[then["plant"]][0]
        )


class Transport:
    """Position of a replay: a row that advances with time, or rests. Any thread may write."""

    def __init__(self, times: NDArray[np.float64]) -> None:
        """Times (n,) of the rows, non-decreasing [s]."""
        self._times = times
        self._began = time.monotonic()
        self._from = float(times[0])
        self.speed = 1.0
        self.playing = False

    def row(self) -> int:
        """The row that is due now; the replay stops at the last one."""
        due = self._due()
        if self.playing and due >= self._times[-1]:
            self.seek(due)
        return int(np.clip(np.searchsorted(self._times, due, "right") - 1, 0, len(self._times) - 1))

    def play(self, on: bool) -> None:
        """Play from here, or from the beginning if at the end; or stop."""
        due = self._due()
        if on and due >= self._times[-1]:
            due = float(self._times[0])
        self._from, self._began, self.playing = due, time.monotonic(), on

    def pace(self, speed: float) -> None:
        """Set the speed: seconds of the recording per second."""
        self._from, self._began = self._due(), time.monotonic()
        self.speed = speed

    def move(self, moments: int) -> None:
        """Stop and move by a number of distinct times, forwards or backwards."""
        times = np.unique(self._times)
        now = np.searchsorted(times, self._times[self.row()])
        self.playing = False
        self._from = float(times[np.clip(now + moments, 0, len(times) - 1)])

    def seek(self, at: float) -> None:
        """Stop at the row nearest to a time [s], which the caller may have rounded."""
        self.playing = False
        times = self._times
        after = min(int(np.searchsorted(times, at)), len(times) - 1)
        before = max(after - 1, 0)
        self._from = float(times[after if times[after] - at <= at - times[before] else before])

    def _due(self) -> float:
        gone = (time.monotonic() - self._began) * self.speed if self.playing else 0.0
        return self._from + gone

"""Where a moving structure is at any time."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from app.motion.declared import Motion
from app.motion.forms import Form
from app.motion.poses import Poses, read
from app.motion.waves import WAVES

FloatArray = NDArray[np.float64]


class Course:
    """The pose of a structure over time, relative to where it rests, arm base frame.

    Args:
        motions: rigid ones; the first acts last, on what the others have moved.
        centre: (3,) of the structure, about which it turns [m].
        form: its shapes; None: it keeps its shape.
        whole: (3,) about which those turn that move all structures (`Motion.of` is None) [m];
            None: the centre.

    Raises:
        OptionError: a file of poses that cannot be used.
    """

    def __init__(
        self,
        motions: Sequence[Motion],
        centre: FloatArray,
        whole: FloatArray | None = None,
        form: Form | None = None,
    ) -> None:
        self.form = form
        self._centre = np.array(centre, dtype=np.float64)
        self._whole = self._centre if whole is None else np.array(whole, dtype=np.float64)
        self._motions = tuple(motions)
        self._ways = [(np.array(motion.move), np.array(motion.turn)) for motion in motions]
        self._recorded: dict[str, Poses] = {
            motion.file: read(Path(motion.file)) for motion in motions if motion.file is not None
        }

    def pose(self, time: float) -> pin.SE3:
        """T_rest_now at a time ≥ 0 [s]: a point at x in rest is at T·x."""
        T = pin.SE3.Identity()
        for motion, way in zip(self._motions, self._ways, strict=True):
            T = T * self._one(motion, way, time - motion.after)
        return T

    def _one(self, motion: Motion, way: tuple[FloatArray, FloatArray], time: float) -> pin.SE3:
        if motion.file is not None:
            move, R = self._recorded[motion.file].at(time)
        else:
            wave, _ = WAVES[motion.kind]
            share = wave(time / motion.duration) if time > 0.0 else 0.0
            move, R = share * way[0], pin.exp3(share * way[1])
        centre = self._whole if motion.of is None else self._centre
        return pin.SE3(R, centre + move - R @ centre)

    @property
    def recorded(self) -> bytes:
        """What comes from its files; empty: it has none."""
        tables = (poses for _, poses in sorted(self._recorded.items()))
        known = b"".join(
            array.tobytes() for poses in tables for array in (poses.times, poses.moves, poses.turns)
        )
        return known if self.form is None else known + self.form.content

    def radius(self, vertices: FloatArray) -> float:
        """Distance of the farthest of the vertices (n, 3) from the centre [m]."""
        return float(np.linalg.norm(vertices - self._centre, axis=1).max(initial=0.0))

    def speed(self, radius: float) -> float:
        """Bound on the speed [m/s] of points up to `radius` [m] from the centre."""
        total = 0.0 if self.form is None else self.form.fastest()
        far = radius + float(np.linalg.norm(self._whole - self._centre))
        for motion in reversed(self._motions):
            if motion.file is not None:
                poses = self._recorded[motion.file]
                along, turned = poses.speeds
                reach = float(np.linalg.norm(poses.moves, axis=1).max())
            else:
                slope = WAVES[motion.kind][1] / motion.duration
                reach = float(np.linalg.norm(motion.move))
                along, turned = slope * reach, slope * float(np.linalg.norm(motion.turn))
            total += along + turned * far
            far += reach
        return total

"""Poses recorded over time, from a table.

A CSV file with a head line. Columns `t` [s], `x`, `y`, `z` [mm]: displacement of the structure from
where it rests, along the axes of the arm's base frame. Columns `qw`, `qx`, `qy`, `qz` may follow: a
unit quaternion that turns it about its centre. Other columns are refused.
"""

from __future__ import annotations

import csv
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from app.words import OptionError

FloatArray = NDArray[np.float64]

PLACE = ("t", "x", "y", "z")
TURN = ("qw", "qx", "qy", "qz")
MOST = 1_000_000  # lines
UNIT = 1e-2  # how far a quaternion's length may be from one; it is made one


@dataclass(frozen=True)
class Poses:
    """Poses at increasing times; between them on a line, with a steady turn.

    Attributes:
        times: (k,) from 0 on [s].
        moves: (k, 3) [m].
        turns: (k, 4) unit quaternions x, y, z, w.
    """

    times: FloatArray
    moves: FloatArray
    turns: FloatArray

    def at(self, time: float) -> tuple[FloatArray, FloatArray]:
        """Displacement (3,) [m] and rotation (3, 3) at a time [s]: the first before, the last
        after what was recorded."""
        t = self.times
        k = int(np.clip(np.searchsorted(t, time, side="right") - 1, 0, len(t) - 2))
        share = float(np.clip((time - t[k]) / (t[k + 1] - t[k]), 0.0, 1.0))
        move = (1.0 - share) * self.moves[k] + share * self.moves[k + 1]
        turn = pin.Quaternion(self.turns[k]).slerp(share, pin.Quaternion(self.turns[k + 1]))
        return move, turn.toRotationMatrix()

    @property
    def speeds(self) -> tuple[float, float]:
        """Largest speed [m/s] and largest rate of turn [rad/s]."""
        passed = np.diff(self.times)
        along = np.linalg.norm(np.diff(self.moves, axis=0), axis=1) / passed
        alike = np.abs(np.einsum("ij,ij->i", self.turns[:-1], self.turns[1:]))
        turned = 2.0 * np.arccos(np.clip(alike, 0.0, 1.0)) / passed
        return float(along.max()), float(turned.max())


def read(path: Path) -> Poses:
    """The poses of a file.

    Raises:
        OptionError: it cannot be read, or a line is not as described above; one line, with the
            file, the line and the value.
    """
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            lines = csv.reader(file)
            head = [word.strip().lower() for word in next(lines, [])]
            if head not in ([*PLACE], [*PLACE, *TURN]):
                raise OptionError(
                    f"{path}: its columns must be {', '.join(PLACE)} and maybe {', '.join(TURN)}, "
                    f"not {', '.join(head)[:60] or 'nothing'}"
                )
            rows = [_numbers(path, lines.line_num, line, len(head)) for line in lines if line]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise OptionError(f"{path}: {reason}") from None
    if not 2 <= len(rows) <= MOST:
        raise OptionError(f"{path}: {len(rows):,} poses; there must be 2 to {MOST:,}")
    table = np.array(rows)
    times = table[:, 0]
    back = np.flatnonzero(np.diff(times) <= 0.0)
    if len(back):
        raise OptionError(
            f"{path}: the time {times[back[0] + 1]:g} s does not follow the one before"
        )
    turns = np.tile([0.0, 0.0, 0.0, 1.0], (len(table), 1))
    if len(head) > len(PLACE):
        turns = table[:, [5, 6, 7, 4]]
        lengths = np.linalg.norm(turns, axis=1)
        off = np.flatnonzero(np.abs(lengths - 1.0) > UNIT)
        if len(off):
            raise OptionError(
                f"{path}: pose {off[0] + 1} has a quaternion of length {lengths[off[0]]:g}"
            )
        turns = turns / lengths[:, None]
    return Poses(times, 1e-3 * table[:, 1:4], turns)


def _numbers(path: Path, number: int, line: list[str], count: int) -> list[float]:
    if len(line) != count:
        raise OptionError(f"{path}, line {number}: {len(line)} values, not {count}")
    values = []
    for word in line:
        try:
            value = float(word)
        except ValueError:
            value = np.nan
        if not abs(value) <= 1e9:
            raise OptionError(
                f"{path}, line {number}: '{word.strip()[:30]}' is not a finite number"
            )
        values.append(value)
    return values

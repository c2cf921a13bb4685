"""Vertices recorded over time, from a file of NumPy.

An `.npz` with `vertices` (frames, n, 3) and `times` (frames,) [s], or an `.npy` of the vertices
alone, one every `USUAL` seconds. The vertices are in the order of the mesh, in any frame and unit:
the first shape is the mesh at rest, and says how it is turned, moved and scaled.
"""

from __future__ import annotations

import zipfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from app.words import OptionError

FloatArray = NDArray[np.float64]

ALL = slice(None)
USUAL = 0.02  # between two shapes of an .npy [s]
MOST = 2 * 10**8  # numbers in a file


@dataclass(frozen=True)
class Vertices:
    """Shapes at increasing times; between two of them every vertex goes straight.

    Attributes:
        times: (f,) [s].
        shapes: (f, n, 3).
        after: when the first is left [s].
    """

    times: FloatArray
    shapes: FloatArray
    after: float = 0.0

    @property
    def rest(self) -> FloatArray:
        """The first shape (n, 3)."""
        return self.shapes[0]

    def at(self, time: float, rows: slice = ALL) -> FloatArray:
        """The shape (n, 3) at a time [s], or some rows of it: the first before, the last after what
        was recorded.
        """
        t = self.times - self.times[0]
        time -= self.after
        k = int(np.clip(np.searchsorted(t, time, side="right") - 1, 0, len(t) - 2))
        share = float(np.clip((time - t[k]) / (t[k + 1] - t[k]), 0.0, 1.0))
        return (1.0 - share) * self.shapes[k, rows] + share * self.shapes[k + 1, rows]

    def fastest(self) -> float:
        """The largest speed of a vertex, in units of the file a second."""
        most = 0.0
        for k, passed in enumerate(np.diff(self.times)):
            way = np.linalg.norm(self.shapes[k + 1] - self.shapes[k], axis=1).max()
            most = max(most, float(way) / float(passed))
        return most

    def content(self) -> bytes:
        """All numbers, for a checksum."""
        return self.times.tobytes() + self.shapes.tobytes()


def read(path: Path, after: float = 0.0) -> Vertices:
    """The shapes of a file.

    Raises:
        OptionError: it cannot be read, or is not as described above; one line, with the file and
            what is wrong.
    """
    try:
        found = np.load(path, allow_pickle=False)
        if isinstance(found, np.lib.npyio.NpzFile):
            with found:
                missing = [name for name in ("times", "vertices") if name not in found.files]
                if missing:
                    raise OptionError(
                        f"{path}: there is no '{missing[0]}', only {', '.join(found.files)[:60]}"
                    )
                times, shapes = found["times"], found["vertices"]
        else:
            shapes = found
            times = USUAL * np.arange(len(shapes) if shapes.ndim else 0)
    except (OSError, ValueError, EOFError, zipfile.BadZipFile, zipfile.LargeZipFile) as error:
        if isinstance(error, OptionError):
            raise
        reason = getattr(error, "strerror", None) or str(error).partition("\n")[0]
        raise OptionError(f"{path}: {reason}") from None
    return Vertices(*_checked(path, times, shapes), after)


def _checked(path: Path, times: NDArray[np.generic], shapes: NDArray[np.generic]) -> tuple[
    FloatArray, FloatArray
]:  # fmt: skip
    for name, array in (("times", times), ("vertices", shapes)):
        if array.dtype.kind not in "fiu":
            raise OptionError(f"{path}: {name} are of the type {array.dtype}, not numbers")
    if shapes.ndim != 3 or shapes.shape[2] != 3:
        raise OptionError(f"{path}: vertices must be (frames, n, 3), not {shapes.shape}")
    if times.shape != shapes.shape[:1]:
        raise OptionError(
            f"{path}: there must be a time for each of {len(shapes)} shapes, not {times.shape}"
        )
    if not len(shapes) >= 2 or not 1 <= shapes.size <= MOST:
        raise OptionError(f"{path}: there must be 2 shapes or more, and {MOST:,} numbers at most")
    t, v = times.astype(np.float64), shapes.astype(np.float64)
    bad = np.flatnonzero(~(np.abs(t) <= 1e9))
    if len(bad):
        raise OptionError(f"{path}: the time of shape {bad[0]} is {t[bad[0]]:g}")
    back = np.flatnonzero(np.diff(t) <= 0.0)
    if len(back):
        raise OptionError(f"{path}: the time {t[back[0] + 1]:g} s does not follow the one before")
    wrong = np.argwhere(~(np.abs(v) <= 1e6))
    if len(wrong):
        k, i, _axis = (int(x) for x in wrong[0])
        raise OptionError(f"{path}: vertex {i} of shape {k} is {v[k, i].tolist()}")
    return t, v

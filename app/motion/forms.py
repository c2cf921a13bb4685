"""What shape a structure has at any time: shapes one after the other, straight between two.

A structure that deforms has a shape every `FRAME` seconds, or every ten ticks where these are
longer, or as often as it can be made where there are many vertices. Between two shapes every vertex
rests for two ticks and then goes straight and steadily to its next place. So a tick never is on
both sides of a shape: one that begins before it and ends after it ends while the vertices rest.
What a tick promises of a structure that deforms holds for such motion.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from functools import lru_cache
from math import floor
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

import meshes
from app.motion.declared import Motion
from app.motion.vertices import ALL, Vertices, read
from app.words import OptionError
from meshes.builtin.deforming import deforming_names
from vf.tree.memory import Memory

FloatArray = NDArray[np.float64]
Placement = tuple[float, FloatArray, FloatArray]

FRAME = 0.02  # from one shape to the next, at least [s]
TICKS = 10  # of a frame, at least
EACH = 2e-7  # of a frame for each vertex, at least: two or three times what a shape takes [s]
RESTS = 2  # ticks in which the vertices rest at a shape; the structures' speed is 2 at most
FIT = 1e-6  # by how much a catalogue mesh may be off its rest shape, as a share of its size
FIT_FILE = 1e-3  # the same of the first shape of a file
KEPT = 8  # shapes
SPARE = 2  # arrays that are kept for others
BLOCK = 8192  # vertices that are moved at a time


class Source(Protocol):
    """Vertices over time, in the frame of the file or of the catalogue."""

    @property
    def rest(self) -> FloatArray: ...
    def at(self, time: float, rows: slice = ALL) -> FloatArray: ...
    def fastest(self) -> float: ...
    def content(self) -> bytes: ...


class Modes:
    """The modes of a mesh of `meshes.deforming`, from a time on.

    Args:
        name: of the mesh.
        amplitude: share of the usual amplitude.
        period: of a cycle [s]; None: as usual.
        after: when the first cycle begins [s].
    """

    def __init__(self, name: str, amplitude: float, period: float | None, after: float) -> None:
        self._name, self._amplitude, self._after = name, amplitude, after
        self._period = period or meshes.deforming(name).period

    @property
    def rest(self) -> FloatArray:
        return meshes.deforming(self._name).vertices

    def at(self, time: float, rows: slice = ALL) -> FloatArray:
        if time <= self._after:
            return self.rest[rows]
        one = meshes.deforming(self._name)
        amplitudes = self._amplitude * one.amplitudes((time - self._after) / self._period)
        found = one.vertices[rows].copy()
        for amplitude, mode in zip(amplitudes, one.modes, strict=True):
            found += amplitude * mode[rows]
        return found

    def fastest(self) -> float:
        return self._amplitude * meshes.deforming(self._name).fastest(self._period)

    def content(self) -> bytes:
        return b""


def frame_of(vertices: int, dt: float) -> float:
    """From one shape of so many vertices to the next [s], for ticks of `dt` [s]."""
    return max(FRAME, TICKS * dt, EACH * vertices)


class Form:
    """The shapes of one structure, arm base frame, where it rests.

    Args:
        source: of the vertices; None: a subclass has them.
        vertices: (n, 3) vertices of the structure at rest [m].
        dt: of a tick [s].
        fit: by how much the first shape may be off, as a share of its size.
        placement: scale, rotation and translation from the source; None: found from its first
            shape.

    Attributes:
        frame: from one shape to the next [s].
        count: of the vertices.

    Raises:
        ValueError: the structure is not at the first shape of its source.
    """

    def __init__(
        self,
        source: Source | None,
        vertices: FloatArray,
        dt: float,
        fit: float = FIT,
        placement: Placement | None = None,
    ) -> None:
        if placement is None:
            assert source is not None
            placement = _placement(source.rest, vertices, fit)
        self._source = source
        self._scale, self._R, self._t = placement
        self.frame = frame_of(len(vertices), dt)
        self._pause = RESTS * dt
        self.count = len(vertices)
        self._begin()

    def _begin(self) -> None:
        self._known = lru_cache(KEPT)(self._made)
        self._memory = Memory(KEPT + SPARE)

    def interval(self, time: float) -> tuple[int, float]:
        """Between which shapes a structure is at a time ≥ 0 [s]: the number of the first, and the
        share of the way to the next."""
        number = max(floor(time / self.frame), 0)
        gone = time - number * self.frame - self._pause
        return number, min(max(gone / (self.frame - self._pause), 0.0), 1.0)

    def during(self, start: float, end: float) -> tuple[int, tuple[float, float]]:
        """The first of the two shapes of a tick between two times [s], and the shares of the way
        to the second at its start and its end.

        A tick that comes to the next shape ends while the vertices rest there. After a jump in time
        it begins at the first shape.
        """
        (first, since), (last, until) = self.interval(start), self.interval(end)
        if last == first:
            return first, (since, until)
        if last == first + 1 and until == 0.0:
            return first, (since, 1.0)
        return last, (0.0, until)

    def shape(self, number: int) -> FloatArray:
        """Vertices (n, 3) of a shape [m]; not to be changed."""
        return self._known(number)

    def vertices(self, time: float) -> FloatArray:
        """Vertices (n, 3) at a time [s]."""
        number, share = self.interval(time)
        if share == 0.0:
            return self.shape(number)
        return (1.0 - share) * self.shape(number) + share * self.shape(number + 1)

    def fastest(self) -> float:
        """Bound on the speed of a vertex [m/s]."""
        assert self._source is not None
        return self._scale * self._source.fastest() * self.frame / (self.frame - self._pause)

    @property
    def content(self) -> bytes:
        """What comes from a file; empty: nothing does."""
        assert self._source is not None
        return self._source.content()

    def _made(self, number: int) -> FloatArray:
        assert self._source is not None
        source, time = self._source, number * self.frame
        return self._in_place(lambda rows: source.at(time, rows))

    def _in_place(self, part: Callable[[slice], NDArray[np.floating]]) -> FloatArray:
        """Vertices (n, 3), read-only, from those of the source in any rows.

        A block and a column at a time, which numpy does without the interpreter lock, in memory
        that was used before: to give large arrays back to the system takes milliseconds with the
        lock. A product of matrices would start threads of a library of linear algebra, which wait
        for work on cores that others need.
        """
        found = self._memory.array((self.count, 3))
        R, t = self._scale * self._R, self._t
        for first in range(0, self.count, BLOCK):
            rows = slice(first, first + BLOCK)
            x, y, z = (np.ascontiguousarray(column, dtype=np.float64) for column in part(rows).T)
            for k in range(3):
                total = R[k, 0] * x
                total += R[k, 1] * y
                total += R[k, 2] * z
                np.add(total, t[k], out=found[rows, k])
        found.flags.writeable = False
        return found

    def __getstate__(self) -> dict[str, object]:
        own = {"_known", "_memory"}
        return {key: value for key, value in self.__dict__.items() if key not in own}

    def __setstate__(self, state: dict[str, object]) -> None:
        self.__dict__.update(state)
        self._begin()


def form_of(
    motions: Sequence[Motion], name: str, vertices: FloatArray, dt: float
) -> tuple[Form | None, list[Motion]]:
    """The shapes of a structure, None if none of its motions deforms it, and the other motions.

    Raises:
        OptionError: two motions that deform it, or a mesh that is not the one they deform.
    """
    own = [motion for motion in motions if motion.kind in ("deforming", "vertices")]
    rest = [motion for motion in motions if motion not in own]
    if not own:
        return None, rest
    if len(own) > 1:
        raise OptionError(f"'{name}' is deformed by {len(own)} motions: one is allowed")
    motion = own[0]
    if motion.file is not None:
        found: Vertices = read(Path(motion.file), motion.after)
        if found.rest.shape != vertices.shape:
            raise OptionError(
                f"{motion.file} has {len(found.rest):,} vertices, '{name}' has {len(vertices):,}"
            )
        form = _formed(found, vertices, dt, FIT_FILE)
        if form is None:
            raise OptionError(f"{motion.file}: its first shape is not that of '{name}'")
        return form, rest
    for one in deforming_names():
        source = Modes(one, motion.amplitude, motion.period, motion.after)
        if source.rest.shape == vertices.shape:
            form = _formed(source, vertices, dt, FIT)
            if form is not None:
                return form, rest
    return None, rest


def _formed(source: Source, vertices: FloatArray, dt: float, fit: float) -> Form | None:
    try:
        return Form(source, vertices, dt, fit)
    except ValueError:
        return None


def checksum(form: Form) -> str:
    """SHA-256 of what comes from a file."""
    return hashlib.sha256(form.content).hexdigest()


def _placement(rest: FloatArray, vertices: FloatArray, fit: float) -> Placement:
    """Scale, rotation and translation that take rest (n, 3) to vertices (n, 3).

    S. Umeyama, "Least-squares estimation of transformation parameters between two point patterns",
    IEEE TPAMI 13(4), 1991.

    Raises:
        ValueError: they leave more than `fit` of the size.
    """
    a, b = rest.mean(axis=0), vertices.mean(axis=0)
    x, y = rest - a, vertices - b
    u, s, vt = np.linalg.svd(y.T @ x)
    sign = np.array([1.0, 1.0, np.sign(np.linalg.det(u @ vt))])
    R = (u * sign) @ vt
    scale = float((s * sign).sum() / (x * x).sum())
    # A scale of one is exact.
    scale = 1.0 if abs(scale - 1.0) < 1e-9 else scale
    off = float(np.abs(scale * x @ R.T - y).max())
    if not off <= fit * float(np.ptp(vertices, axis=0).max()):
        raise ValueError(f"off by {off:g} m")
    return scale, R, b - scale * R @ a

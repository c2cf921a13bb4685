"""Shapes of a structure that come from elsewhere while a session runs.

A shape that arrives becomes that of the structure from the next number on that no tick was told of
yet (`app.motion.forms` numbers shapes by their time). So where the structure is remains a function
of the phase and of the shapes with their numbers: a recording has both, and repeats bit for bit.

As with a tracker the guard adds a margin for what is not known: the declared bound times the age of
the shape, from its arrival and by the declared latency.
"""

from __future__ import annotations

import threading
import uuid
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any
from weakref import WeakValueDictionary

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from app.motion.declared import Tracker
from app.motion.forms import KEPT, Form
from app.motion.tracking import Belief

FloatArray = NDArray[np.float64]
Single = NDArray[np.float32]

FIRST = 2  # number of the first shape that may be another: ticks begin between 0 and 1
RECENT = 64  # frames that are kept while they come; a second or more of them
MOST = 1_300_000  # vertices
FARTHEST = 10.0  # of a vertex along an axis from the origin [m]


@dataclass(frozen=True)
class Frame:
    """A shape that came.

    Attributes:
        number: of the frame, counted from 1.
        shape: number of the shape, see `Form.shape`, from which on it is the structure's.
        seen: phase at which the structure had it, as declared [s].
        vertices: (n, 3), in the scene's mesh's own frame [m].
    """

    number: int
    shape: int
    seen: float
    vertices: Single


class Stream:
    """The frames of a structure. Thread-safe; there is one of a key in a process.

    Args:
        address: where they come from, for people.
        tracker: its latency, bound and limit of the age are declared for the frames.
        key: None: a new one.

    Attributes:
        now: phase of the tick that was told last [s].
        bound: declared: no vertex is ever faster [m/s].
        number: of the newest frame; 0: none came.
    """

    def __init__(self, address: str, tracker: Tracker | None, key: str | None = None) -> None:
        self.key = key or uuid.uuid4().hex
        self.address = address
        self.now = 0.0
        self.number = 0
        self._tracker = tracker
        declared = tracker or Tracker()
        self.bound = declared.bound
        self._latency, self._stale = declared.latency, declared.stale
        self._frames: list[Frame] = []  # by increasing shape
        self._asked = FIRST - 1  # the highest number of a shape that was asked for
        self._lock = threading.Lock()
        self._all = False  # whether all frames are kept
        with _REGISTERING:
            _REGISTERED[self.key] = self

    def hear(self, vertices: Single, late: float = 0.0) -> Frame:
        """Take a shape that has just come; for the process that the ticks are in.

        Args:
            vertices: (n, 3), checked; not to be changed any more.
            late: by how much it came later than usual [s].
        """
        with self._lock:
            seen = max(self.now - self._latency - late, 0.0)
            frame = Frame(self.number + 1, self._asked + 1, seen, vertices)
            self._add(frame)
        return frame

    def put(self, frame: Frame) -> None:
        """Add a frame that was heard elsewhere."""
        with self._lock:
            self._add(frame)

    def fill(self, frames: Iterable[Frame]) -> None:
        """Add all frames of a recording, and keep them."""
        with self._lock:
            self._all = True
            for frame in frames:
                self._add(frame)

    def at(self, shape: int) -> Frame | None:
        """The frame of a shape; None: it is at rest."""
        with self._lock:
            self._asked = max(self._asked, shape)
            return next((one for one in reversed(self._frames) if one.shape <= shape), None)

    def since(self, number: int) -> list[Frame]:
        """The frames that are kept and came after that number."""
        with self._lock:
            return sorted(
                (one for one in self._frames if one.number > number), key=lambda one: one.number
            )

    def belief(self, phase: float, interval: tuple[int, float]) -> Belief:
        """What the guard is told at a phase, between which shapes it is there, and the share."""
        shape, share = interval
        first, last = self.at(shape), self.at(shape + 1)
        before, after = (0.0 if frame is None else frame.seen for frame in (first, last))
        age = max(phase - ((1.0 - share) * before + share * after), 0.0)
        # The tool holds when it is too old: the margin grows no more.
        margin = self.bound * min(age, self._stale)
        number = -1 if last is None else last.number
        return Belief(
            pin.SE3.Identity(), age, margin, margin, age > self._stale, number=number
        )  # fmt: skip

    def _add(self, frame: Frame) -> None:
        frames = self._frames
        while frames and frames[-1].shape >= frame.shape:
            frames.pop()
        frames.append(frame)
        self.number = max(self.number, frame.number)
        if not self._all:
            del frames[:-RECENT]

    def __reduce__(self) -> tuple[Any, ...]:
        return _same, (self.key, self.address, self._tracker, self.since(0))


class StreamForm(Form):
    """The shapes of a structure that come from elsewhere.

    Args:
        stream: of the frames.
        vertices: (n, 3) at rest, arm base frame [m].
        T_base_mesh: (4, 4) pose of the scene's mesh's own frame, in which frames are.
        dt: of a tick [s].
    """

    def __init__(
        self, stream: Stream, vertices: FloatArray, T_base_mesh: FloatArray, dt: float
    ) -> None:
        R, t = T_base_mesh[:3, :3], T_base_mesh[:3, 3]
        super().__init__(None, vertices, dt, placement=(1.0, R, t))
        self.stream = stream
        self._rest = np.array(vertices)
        self._rest.flags.writeable = False
        self._placed: dict[int, FloatArray] = {}

    def shape(self, number: int) -> FloatArray:
        frame = self.stream.at(number)
        if frame is None:
            return self._rest
        known = self._placed.get(frame.number)
        if known is None:
            vertices = frame.vertices
            known = self._in_place(lambda rows: vertices[rows])
            kept = dict(list(self._placed.items())[1 - KEPT :])
            kept[frame.number] = known
            self._placed = kept
        return known

    def fastest(self) -> float:
        """The declared bound [m/s]."""
        return self.stream.bound

    @property
    def content(self) -> bytes:
        return b""

    def belief(self, phase: float) -> Belief:
        """What the guard is told at a phase."""
        return self.stream.belief(phase, self.interval(phase))

    def __getstate__(self) -> dict[str, object]:
        return {**super().__getstate__(), "_placed": {}}


_REGISTERED: WeakValueDictionary[str, Stream] = WeakValueDictionary()
_REGISTERING = threading.RLock()


def known(key: str) -> Stream | None:
    """The stream of a key in this process."""
    return _REGISTERED.get(key)


def _same(key: str, address: str, tracker: Tracker | None, frames: list[Frame]) -> Stream:
    """The stream of a key, for pickles: the one that is there, else an equal one."""
    with _REGISTERING:
        stream = _REGISTERED.get(key)
        if stream is None:
            stream = Stream(address, tracker, key)
            for frame in frames:
                stream.put(frame)
        return stream

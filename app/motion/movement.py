"""How the structures of a scene move: truly, and as the guard believes."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

import vf
from app.motion.course import Course
from app.motion.declared import DEFORMING, Motion, Tracker
from app.motion.forms import Form, form_of
from app.motion.stream import MOST, Stream, StreamForm
from app.motion.tracking import Belief, Tracking
from app.words import OptionError
from meshes.builtin.deforming import deforming_names

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Guarded:
    """What the guard is told of a tick.

    Attributes:
        motions: one for each structure, from the tick's start to its end; None: it stands still.
        stale: whether a structure was last seen too long ago: the tool holds.
        shapes: for each structure the pair of shapes it is between, see `Movement.ends`; None: it
            keeps its shape.
    """

    motions: tuple[vf.Motion | None, ...]
    stale: bool
    shapes: tuple[int | None, ...] = ()


class Movement:
    """Where all structures of a scene are, and where the guard believes them to be.

    All of it depends on the phase alone, the time of the patient's motion [s], so it can be asked
    for any phase in any order. Not thread-safe: it keeps what it computed.

    Args:
        courses: one for each structure; None: it stands still.
        tracker: None: the guard knows the truth.

    Attributes:
        moves: whether any structure moves.
    """

    def __init__(self, courses: Sequence[Course | None], tracker: Tracker | None) -> None:
        self._courses = tuple(courses)
        self.tracker = tracker
        self._different = tuple({id(c): c for c in self._courses if c is not None}.values())
        self._tracked = {
            id(course): Tracking(course.pose, tracker)
            for course in self._different
            if tracker is not None and not isinstance(course.form, StreamForm)
        }
        self._truth: tuple[float, dict[int, pin.SE3]] = (-1.0, {})

    @property
    def moves(self) -> bool:
        return bool(self._different)

    @property
    def streams(self) -> bool:
        """Whether the shapes of a structure come from elsewhere."""
        return streamed(self._courses) is not None

    def truth(self, phase: float) -> list[pin.SE3 | None]:
        """T_rest_now of every structure, arm base frame; None: it stands still."""
        poses = self._poses(phase)
        return [None if course is None else poses[id(course)] for course in self._courses]

    def beliefs(self, phase: float) -> list[Belief | None]:
        """Where the guard believes every structure to be; None: it stands still, or it knows."""
        found = {key: tracking.belief(phase) for key, tracking in self._tracked.items()}
        for course in self._different:
            if isinstance(course.form, StreamForm):
                found[id(course)] = course.form.belief(phase)
        return [None if course is None else found.get(id(course)) for course in self._courses]

    @property
    def forms(self) -> tuple[Form | None, ...]:
        """The shapes of every structure over time; None: it keeps its shape."""
        return tuple(None if course is None else course.form for course in self._courses)

    def truths(self, phase: float) -> list[FloatArray | None]:
        """Vertices (n, 3) of every structure that deforms, where it rests [m]."""
        return [None if form is None else form.vertices(phase) for form in self.forms]

    def believed(self, phase: float) -> list[FloatArray | None]:
        """The same as the guard believes; None also where it knows."""
        if self.tracker is None:
            return [None] * len(self._courses)
        rate, found = self.tracker.rate, list[FloatArray | None]()
        for form, belief in zip(self.forms, self.beliefs(phase), strict=True):
            seen = 0 if belief is None else max(belief.number, 0)
            known = form is None or isinstance(form, StreamForm)
            found.append(None if known or form is None else form.vertices(seen / rate))
        return found

    def ends(self, structure: int, pair: int) -> tuple[FloatArray, FloatArray]:
        """Vertices (n, 3) of a pair of shapes [m]: where one pair ends the next begins.

        The guard that knows the truth is told of the shapes of the form, one that has a tracker of
        those at two sightings.
        """
        form = self.forms[structure]
        assert form is not None
        if self.tracker is None or isinstance(form, StreamForm):
            return form.shape(pair), form.shape(pair + 1)
        first, last = (max(number, 0) / self.tracker.rate for number in (pair - 1, pair))
        return form.vertices(first), form.vertices(last)

    def margin(self, phase: float) -> float:
        """The largest margin for what is not known of a structure [m]; it stops with staleness."""
        known = [belief for belief in self.beliefs(phase) if belief is not None]
        return max((self._margin(belief) for belief in known), default=0.0)

    def during(self, start: float, end: float) -> Guarded:
        """What the guard is told of the tick between two phases.

        The margin is the larger one of start and end: in between the structure is no farther from
        where it is believed.
        """
        made: dict[int, vf.Motion] = {}
        pairs: dict[int, int] = {}
        stale = False
        before = self._poses(start) if self.tracker is None else {}
        after = self._poses(end) if self.tracker is None else {}
        for course in self._different:
            key, form = id(course), course.form
            if isinstance(form, StreamForm):
                form.stream.now = end
                pairs[key], blend = form.during(start, end)
                known, last = form.belief(start), form.belief(end)
                stale |= last.stale
                growth = max(last.margin - known.margin, 0.0)
                margin = max(known.margin, last.margin)
                made[key] = _motion(known.pose, last.pose, margin, growth, blend)
                continue
            if self.tracker is None:
                blend = (0.0, 0.0)
                if course.form is not None:
                    pairs[key], blend = course.form.during(start, end)
                made[key] = _motion(before[key], after[key], 0.0, 0.0, blend)
                continue
            first, last = self._tracked[key].during(start, end)
            stale |= last.stale
            low, high = self._margin(first), self._margin(last)
            margin, growth = max(low, high), max(high - low, 0.0)
            blend = (0.0, 0.0)
            if course.form is not None:
                # The later of two shapes that were seen; it is believed to keep it.
                pairs[key], blend = last.number, (1.0, 1.0)
            made[key] = _motion(first.pose, last.pose, margin, growth, blend)
        motions = [None if course is None else made[id(course)] for course in self._courses]
        shapes = [None if course is None else pairs.get(id(course)) for course in self._courses]
        return Guarded(tuple(motions), stale, tuple(shapes))

    def _margin(self, belief: Belief) -> float:
        """That of a belief; where the tool holds because of its age it grows no more [m]."""
        return belief.margin if self.tracker is None else min(belief.margin, self.tracker.most)

    def _poses(self, phase: float) -> dict[int, pin.SE3]:
        if self._truth[0] != phase:
            self._truth = phase, {id(c): c.pose(phase) for c in self._different}
        return self._truth[1]


def _motion(
    start: pin.SE3, end: pin.SE3, margin: float, growth: float, blend: tuple[float, float]
) -> vf.Motion:
    return vf.Motion(start, end, margin, growth, blend)


def courses(
    motions: Sequence[Motion],
    names: Sequence[str],
    surfaces: Sequence[vf.Surface],
    dt: float = 1e-3,
    tracker: Tracker | None = None,
    T_base_mesh: FloatArray | None = None,
) -> tuple[Course | None, ...]:
    """The course of every structure; None: nothing moves it.

    Structures that are moved alike share one.

    Args:
        names, surfaces: of the structures, the scene's mesh first; surfaces in the base frame.
        dt: of a tick [s].
        tracker: its latency and bound are declared for shapes that come from elsewhere.
        T_base_mesh: (4, 4) pose of the mesh's own frame, in which those are; None: the base frame.

    Raises:
        OptionError: a motion of a structure that is not there, or a file that cannot be used.
    """
    for motion in motions:
        if motion.of is not None and motion.of not in names:
            raise OptionError(
                f"a motion of '{motion.of}': there is no such structure: choose from "
                f"{', '.join(dict.fromkeys(names))}"
            )
    whole = _middle(surfaces[0])
    found: list[Course | None] = []
    together: Course | None = None
    deformed: set[str | None] = set()
    for name, surface in zip(names, surfaces, strict=True):
        own = [motion for motion in motions if motion.of in (None, name)]
        form: Form | None
        rigid: list[Motion] = []
        if any(motion.stream is not None for motion in own):
            form = _streamed(own, names, name, surface, dt, tracker, T_base_mesh)
        else:
            form, rigid = form_of(own, name, surface.vertices, dt)
        if form is not None:
            deformed |= {motion.of for motion in own if motion.kind in DEFORMING}
        if form is not None or any(motion.of is not None for motion in rigid):
            found.append(Course(rigid, _middle(surface), whole, form))
        elif rigid:
            together = together or Course(rigid, whole)
            found.append(together)
        else:
            found.append(None)
    for motion in motions:
        if motion.kind in DEFORMING and motion.of not in deformed:
            raise OptionError(
                f"the motion {motion.kind} is of {', '.join(deforming_names())}, as the "
                f"catalogue has them, not of {', '.join(dict.fromkeys(names))}"
            )
    return tuple(found)


def _streamed(
    own: Sequence[Motion],
    names: Sequence[str],
    name: str,
    surface: vf.Surface,
    dt: float,
    tracker: Tracker | None,
    T_base_mesh: FloatArray | None,
) -> StreamForm:
    """The form of a structure whose shapes come from elsewhere.

    Raises:
        OptionError: it has another motion, too many vertices, or it is not said which one it is.
    """
    motion = next(motion for motion in own if motion.stream is not None)
    assert motion.stream is not None
    if motion.of is None and len(names) > 1:
        raise OptionError(
            f"the vertices from {motion.stream} are of one structure: name it with --of, one of "
            f"{', '.join(dict.fromkeys(names))}"
        )
    if len(own) > 1:
        raise OptionError(
            f"'{name}' is where the vertices from {motion.stream} say: it takes no other motion"
        )
    n = len(surface.vertices)
    if n > MOST:
        raise OptionError(
            f"'{name}' has {n:,} vertices: from a stream a structure may have {MOST:,}"
        )
    T = np.eye(4) if T_base_mesh is None else T_base_mesh
    return StreamForm(Stream(motion.stream, tracker), surface.vertices, T, dt)


def streamed(courses: Sequence[Course | None]) -> StreamForm | None:
    """The form whose shapes come from elsewhere while the session runs; None: there is none."""
    forms = (course.form for course in courses if course is not None)
    return next((form for form in forms if isinstance(form, StreamForm)), None)


def checksum(courses: Sequence[Course | None]) -> str:
    """SHA-256 of the poses and shapes that come from files; empty: there are none."""
    different = {id(course): course for course in courses if course is not None}
    content = [course.recorded for course in different.values()]
    return hashlib.sha256(b"".join(content)).hexdigest() if any(content) else ""


def too_fast(
    tracker: Tracker | None, courses: Sequence[Course | None], surfaces: Sequence[vf.Surface]
) -> list[str]:
    """A note for the user where a structure can be faster than the tracker's declared bound."""
    if tracker is None:
        return []
    fastest = 0.0
    for course, surface in zip(courses, surfaces, strict=True):
        if course is not None:
            fastest = max(fastest, course.speed(course.radius(surface.vertices)))
    if fastest <= tracker.bound:
        return []
    return [
        f"Points of the structures may reach {fastest * 1e3:.0f} mm/s; the tracker's bound is "
        f"declared as {tracker.bound * 1e3:g} mm/s: the margin may not cover what it does not know."
    ]


def _middle(surface: vf.Surface) -> FloatArray:
    """(3,) of a surface's box [m]."""
    vertices = surface.vertices
    return np.asarray(0.5 * (vertices.min(axis=0) + vertices.max(axis=0)))

"""Validated JSON entries of a recording.

Types and sizes are checked by msgspec while decoding, other conditions here.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from typing import Annotated, Any, NoReturn, TypeVar

import msgspec
import numpy as np
import pinocchio as pin
from msgspec import Meta, Struct

from app.control import messages
from app.control.autopilot import Course
from app.kinds import FARTHEST
from app.options import plain
from app.recording.format import (
    ADDED,
    CHUNK,
    FORMAT,
    JOINTS,
    MAX_ORDERS,
    MAX_PLANTS,
    MAX_ROWS,
    MAX_WAYPOINTS,
    MOTION_ADDED,
    RECORDED,
    Place,
    RecordingError,
    Shape,
)
from app.scenarios.values import LONGEST
from app.settings import DECLARED, MOST, Options
from app.words import OptionError

COURSE_FARTHEST = 2.0 * FARTHEST  # of a waypoint: its place in the mesh plus the mesh's place [m]
COURSE_LONGEST = LONGEST  # [s]

T = TypeVar("T")
Count = Annotated[int, Meta(ge=0, le=(1 << 62) - 1)]
Size = Annotated[int, Meta(ge=1, le=1 << 40)]
Finite = Annotated[float, Meta(ge=-sys.float_info.max, le=sys.float_info.max)]
Joints = Annotated[list[Finite], Meta(min_length=1, max_length=JOINTS)]
Row = tuple[Finite, Finite, Finite]
PoseRow = tuple[Finite, Finite, Finite, Finite]


class CourseEntry(Struct):
    """A scenario's script."""

    rotation: tuple[Row, Row, Row]
    times: Annotated[list[Finite], Meta(min_length=1, max_length=MAX_WAYPOINTS)]
    points: list[Row]


class ShapeEntry(Struct):
    """A surface."""

    vertices: Size
    triangles: Size
    checksum: Annotated[str, Meta(pattern="^[0-9a-f]{64}$")]


class PlaceEntry(ShapeEntry):
    """A scene; the surface is that of its mesh."""

    options: dict[str, Any]
    start: Joints
    structures: Annotated[list[ShapeEntry], Meta(max_length=MOST)] = []
    poses: Annotated[str, Meta(pattern="^([0-9a-f]{64})?$")] = ""


class PlantEntry(Struct):
    """A plant: which scene, and its options."""

    place: Count
    options: dict[str, Any]
    course: CourseEntry | None = None


class StateEntry(Struct):
    """The engine's state; the target is a pose."""

    q: Joints
    tick: Count
    steps: Count
    silent: Count
    autopilot_since: Count | None = None
    target: tuple[PoseRow, PoseRow, PoseRow, PoseRow] | None = None
    stale: bool = False
    phase: Annotated[float, Meta(ge=0.0, le=1e9)] = 0.0


class Head(Struct):
    """What a recording begins with."""

    state: StateEntry
    packages: dict[str, str]


class Part(Struct):
    """The JSON of a part: scenes and plants that are new in it."""

    places: Annotated[list[PlaceEntry], Meta(max_length=MAX_PLANTS)]
    plants: Annotated[list[PlantEntry], Meta(max_length=MAX_PLANTS)]
    orders: Annotated[int, Meta(ge=0, le=CHUNK + 1)]


class Archive(Head):
    """The header of a recording of version 1."""

    places: Annotated[list[PlaceEntry], Meta(min_length=1, max_length=MAX_PLANTS)]
    plants: Annotated[list[PlantEntry], Meta(min_length=1, max_length=MAX_PLANTS)]
    orders: Annotated[int, Meta(ge=1, le=MAX_ORDERS)]
    chunks: Annotated[list[Annotated[int, Meta(ge=1, le=CHUNK)]], Meta(max_length=MAX_ROWS)]
    note: str


class End(Struct):
    """What a recording ends with."""

    note: str


class _Version(Struct):
    format: Any = None
    version: Any = None


def read(data: bytes, kind: type[T], name: str) -> T:
    """An entry from its JSON; `name` is used in errors.

    Decoded by `json`, as msgspec's decoder refuses file names that are not UTF-8.
    """
    try:
        return msgspec.convert(json.loads(data, parse_constant=_no_constant), kind)
    except (msgspec.MsgspecError, ValueError, OverflowError, RecursionError) as error:
        raise RecordingError(f"{name} is damaged: {str(error)[:120]}") from None


def header(data: bytes, kind: type[T], version: int) -> T:
    """The header of a recording of this version of the format."""
    found = read(data, _Version, "the header")
    if found.format != FORMAT:
        raise RecordingError(f"not a recording: the format is not '{FORMAT}'")
    if found.version != version:
        raise RecordingError(
            f"version {str(found.version)[:20]} of the format: this program reads version {version}"
        )
    return read(data, kind, "the header")


def text(value: str, name: str) -> str:
    """A short text without control characters; `name` is used in errors."""
    if len(value) > 4096 or not value.isprintable():
        raise RecordingError(f"the {name} in the header is no text")
    return value


def packages(head: Head) -> dict[str, str]:
    """The versions of packages, by name."""
    return {text(n, "package"): text(v, "version") for n, v in head.packages.items()}


def places(entries: Sequence[PlaceEntry], version: int) -> tuple[Place, ...]:
    """The scenes."""
    return tuple(_place(entry, version) for entry in entries)


def _place(entry: PlaceEntry, version: int) -> Place:
    options = _options(entry.options, version)
    if len(entry.structures) != len(options.structures):
        raise RecordingError(
            f"{len(entry.structures)} structures in the header, {len(options.structures)} in "
            "the options"
        )
    shapes = tuple(Shape(one.vertices, one.triangles, one.checksum) for one in entry.structures)
    return Place(
        options, entry.vertices, entry.triangles, entry.checksum, np.array(entry.start), shapes,
        entry.poses,
    )  # fmt: skip


def plants(
    entries: Sequence[PlantEntry], places: Sequence[Place], version: int
) -> tuple[tuple[tuple[int, Options], ...], tuple[Course | None, ...]]:
    """The plants of these scenes and their courses."""
    found = []
    for entry in entries:
        if entry.place >= len(places):
            raise RecordingError(f"the place of a plant is {entry.place:,}, of {len(places):,}")
        options = _options(entry.options, version)
        if len(options.structures) != len(places[entry.place].structures):
            raise RecordingError(f"a plant has {len(options.structures)} structures, not its scene")
        found.append((entry.place, options))
    return (
        tuple(found),
        tuple(None if entry.course is None else _course(entry.course) for entry in entries),
    )


def state(entry: StateEntry, joints: int) -> messages.State:
    """The engine's state; `joints` is the number of the arm's joints."""
    if len(entry.q) != joints:
        raise RecordingError(f"{len(entry.q)} joints in the header's state, not {joints}")
    target = None
    if entry.target is not None:
        pose = np.array(entry.target)
        if np.abs(pose[:3, :3] @ pose[:3, :3].T - np.eye(3)).max() > 1e-3:
            raise RecordingError("the target in the header is no pose")
        target = pin.SE3(pose[:3, :3], pose[:3, 3])
    return messages.State(
        q=np.array(entry.q),
        tick=entry.tick,
        steps=entry.steps,
        silent=entry.silent,
        autopilot_since=entry.autopilot_since,
        target=target,
        stale=entry.stale,
        phase=entry.phase,
    )


def _options(values: dict[str, Any], version: int) -> Options:
    """The options, with those that this version did not have yet as they were then."""
    for since, added in ADDED.items():
        if version < since and not set(values) & set(added):
            values = values | added
    for since, added in MOTION_ADDED.items():
        if version < since and isinstance(values.get("motions"), list):
            values = values | {
                "motions": [
                    one if not isinstance(one, dict) or set(one) & set(added) else one | added
                    for one in values["motions"]
                ]
            }
    if set(values) != set(RECORDED):
        odd = sorted(set(values) ^ set(RECORDED))[0][:40]
        raise RecordingError(f"the options in the header are not those of a session ({odd!a})")
    try:
        return Options(
            **{name: plain(value, DECLARED[name].kind) for name, value in values.items()}
        )
    except OptionError as error:
        raise RecordingError(f"an option in the header is not usable: {error}") from None


def _course(entry: CourseEntry) -> Course:
    rotation, times, points = map(np.array, (entry.rotation, entry.times, entry.points))
    if len(points) != len(times):
        raise RecordingError(f"the points of a course in the header are not {len(times)} rows")
    if np.abs(rotation @ rotation.T - np.eye(3)).max() > 1e-3 or np.linalg.det(rotation) < 0.0:
        raise RecordingError("the rotation of a course in the header is not a rotation")
    if (np.abs(points) > COURSE_FARTHEST).any():
        raise RecordingError(
            f"a point of a course in the header is more than {COURSE_FARTHEST:g} m from the base"
        )
    if times[-1] > COURSE_LONGEST:
        raise RecordingError(
            f"a course in the header goes on for {times[-1]:g} s, at most {COURSE_LONGEST:g} s"
        )
    if times[0] != 0.0 or (np.diff(times) <= 0.0).any():
        raise RecordingError("the times of a course in the header do not rise from 0")
    return Course(rotation, times, points)


def _no_constant(word: str) -> NoReturn:
    """JSON has neither infinities nor NaN."""
    raise ValueError(f"{word} is no number")

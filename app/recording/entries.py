"""Entries of a recording's header, none of them trusted: each is what it must be, or refused."""

from __future__ import annotations

import json
import math
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from app.control.autopilot import Course
from app.control.engine import State
from app.kinds import FARTHEST
from app.options import plain
from app.recording.format import (
    FORMAT,
    JOINTS,
    MAX_PLANTS,
    MAX_WAYPOINTS,
    RECORDED,
    Place,
    RecordingError,
)
from app.scenarios.values import LONGEST
from app.settings import Options
from app.words import OptionError

COURSE_FARTHEST = 2.0 * FARTHEST  # [m] of a scenario's place in its mesh, which is placed in turn
COURSE_LONGEST = LONGEST  # [s]


def parsed(data: bytes, name: str) -> dict[str, Any]:
    """A JSON object; `name` is what to call it."""
    try:
        found = json.loads(data, parse_constant=_no_constant)
    except RecordingError:
        raise
    except (ValueError, RecursionError) as error:
        raise RecordingError(f"{name} is damaged ({str(error)[:120]})") from None
    if not isinstance(found, dict):
        raise RecordingError(f"{name} is damaged (it is no JSON object)")
    return found


def header(data: bytes, version: int) -> dict[str, Any]:
    """The header of a recording of this version of the format."""
    found = parsed(data, "the header")
    if found.get("format") != FORMAT:
        raise RecordingError(f"not a recording: the format is not '{FORMAT}'")
    if found.get("version") != version:
        raise RecordingError(
            f"version {str(found.get('version'))[:20]} of the format: "
            f"this program reads version {version}"
        )
    return found


def items(header: dict[str, Any], name: str, limit: int, least: int = 1) -> list[Any]:
    """The list of this name, of `least` to `limit` entries."""
    found = header.get(name)
    if not isinstance(found, list) or not least <= len(found) <= limit:
        raise RecordingError(f"'{name}' in the header is not a list of {least} to {limit:,}")
    return found


def mapping(header: object, name: str) -> dict[str, Any]:
    """The mapping of this name."""
    found = header.get(name) if isinstance(header, dict) else None
    if not isinstance(found, dict):
        raise RecordingError(f"'{name}' is missing in the header")
    return found


def text(value: object, name: str) -> str:
    """A short text without control characters; `name` is what to call it."""
    if not isinstance(value, str) or len(value) > 4096 or not value.isprintable():
        raise RecordingError(f"the {name} in the header is no text")
    return value


def whole(value: object, name: str, low: int, high: int) -> int:
    """A whole number from `low` to `high`; `name` is what to call it."""
    if type(value) is not int or not low <= value <= high:
        raise RecordingError(f"{name} is {str(value)[:30]}, not {low:,} to {high:,}")
    return value


def _numbers(value: object, name: str, most: int) -> NDArray[np.float64]:
    sound = (
        isinstance(value, list) and 1 <= len(value) <= most and all(_is_number(x) for x in value)
    )
    if not sound:
        raise RecordingError(f"{name} in the header is not 1 to {most} finite numbers")
    return np.array(value, dtype=np.float64)


def _is_number(value: object) -> bool:
    if type(value) is int:
        return abs(value) < 1 << 63
    return isinstance(value, float) and math.isfinite(value)


def _options(entry: object) -> Options:
    values = mapping(entry, "options")
    if set(values) != set(RECORDED):
        odd = sorted(set(values) ^ set(RECORDED))[0][:40]
        raise RecordingError(f"the options in the header are not those of a session ('{odd}')")
    try:
        return Options(**{name: plain(value) for name, value in values.items()})
    except OptionError as error:
        raise RecordingError(f"an option in the header is not usable: {error}") from None


def place(entry: object) -> Place:
    """A scene."""
    if not isinstance(entry, dict):
        raise RecordingError("a place in the header is not usable")
    checksum = entry.get("checksum")
    if not isinstance(checksum, str) or len(checksum) != 64:
        raise RecordingError("a checksum in the header is not a SHA-256")
    return Place(
        options=_options(entry),
        vertices=whole(entry.get("vertices"), "the number of vertices", 1, 1 << 40),
        triangles=whole(entry.get("triangles"), "the number of triangles", 1, 1 << 40),
        checksum=checksum,
        start=_numbers(entry.get("start"), "the start", JOINTS),
    )


def places(header: dict[str, Any], least: int = 1) -> tuple[Place, ...]:
    """The scenes, `least` of them or more."""
    return tuple(place(entry) for entry in items(header, "places", MAX_PLANTS, least))


def plants(
    header: dict[str, Any], places: int, least: int = 1
) -> tuple[tuple[tuple[int, Options], ...], tuple[Course | None, ...]]:
    """The plants in so many scenes, and their courses; `least` of them or more."""
    listed = items(header, "plants", MAX_PLANTS, least)
    found = tuple(plant(entry, places) for entry in listed)
    return found, tuple(course(entry.get("course")) for entry in listed)


def packages(header: dict[str, Any]) -> dict[str, str]:
    """The versions of packages, by name."""
    return {
        text(name, "package"): text(version, "version")
        for name, version in mapping(header, "packages").items()
    }


def plant(entry: object, places: int) -> tuple[int, Options]:
    """A plant: which of so many scenes, and its options."""
    if not isinstance(entry, dict):
        raise RecordingError("a plant in the header is not usable")
    return whole(entry.get("place"), "the place of a plant", 0, places - 1), _options(entry)


def course(entry: object) -> Course | None:
    """A scenario's script; None: the plant has none."""
    if entry is None:
        return None
    if not isinstance(entry, dict):
        raise RecordingError("a course in the header is not usable")
    times = _numbers(entry.get("times"), "the times of a course", MAX_WAYPOINTS)
    tables = []
    for name, rows in (("rotation", 3), ("points", len(times))):
        table = entry.get(name)
        if not isinstance(table, list) or len(table) != rows:
            raise RecordingError(f"the {name} of a course in the header is not {rows} rows")
        found = [_numbers(row, f"the {name} of a course", 3) for row in table]
        if any(len(row) != 3 for row in found):
            raise RecordingError(f"the {name} of a course in the header is not of three columns")
        tables.append(np.array(found))
    rotation, points = tables
    if np.abs(rotation @ rotation.T - np.eye(3)).max() > 1e-3 or np.linalg.det(rotation) < 0.0:
        raise RecordingError("the rotation of a course in the header is none")
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


def state(entry: object, joints: int) -> State:
    """The engine's state, of an arm with so many joints."""
    if not isinstance(entry, dict):
        raise RecordingError("'state' is missing in the header")
    q = _numbers(entry.get("q"), "the joints", JOINTS)
    if len(q) != joints:
        raise RecordingError(f"{len(q)} joints in the header's state, not {joints}")
    target = entry.get("target")
    if target is not None:
        if not isinstance(target, list) or len(target) != 4:
            raise RecordingError("the target in the header is no pose")
        rows = [_numbers(row, "the target", 4) for row in target]
        pose = np.array([row if len(row) == 4 else np.zeros(4) for row in rows])
        if np.abs(pose[:3, :3] @ pose[:3, :3].T - np.eye(3)).max() > 1e-3:
            raise RecordingError("the target in the header is no pose")
        target = pin.SE3(pose[:3, :3], pose[:3, 3])
    since = entry.get("autopilot_since")
    most = (1 << 62) - 1
    return State(
        q=q,
        tick=whole(entry.get("tick"), "the tick", 0, most),
        steps=whole(entry.get("steps"), "the steps", 0, most),
        silent=whole(entry.get("silent"), "the silent ticks", 0, most),
        autopilot_since=None if since is None else whole(since, "the autopilot", 0, most),
        target=target,
        stale=entry.get("stale") is True,
    )


def _no_constant(word: str) -> float:
    """Refuse what JSON does not have: infinities and NaN."""
    raise RecordingError(f"{word} in the header")

"""The values of a scenario's file: how each is read from JSON, and written so as to be read back.

The file's words are the command line's: ``"radius": "5mm"`` means what ``--radius 5mm`` does.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from app import limits
from app.limits import Limit, Number, Place
from app.words import (
    OptionError,
    format_length,
    format_point,
    format_speed,
    format_turn,
    parse_corridor,
    parse_length,
    parse_point,
    parse_radius,
    parse_speed,
    parse_turn,
)

LONGEST = 600.0  # [s] a script goes on
FARTHEST_EYE = 20.0  # [m] of a camera from the mesh's origin
NEAREST_EYE = 1e-4  # [m] of a camera from what it looks at
WAYPOINT: dict[str, Limit] = {"time": Number(0.0, LONGEST, unit="s"), "at": Place()}

Vector = tuple[float, float, float]


class ScenarioError(OptionError):
    """A scenario is not usable. The message is one line that names the value and what is valid."""


@dataclass(frozen=True)
class Waypoint:
    """Where the proxy rests for a moment: time since the start [s], place (3,) [m], mesh frame.

    Raises:
        OptionError: a time or a place outside `WAYPOINT`.
    """

    time: float
    at: Vector

    def __post_init__(self) -> None:
        limits.check(self, WAYPOINT)


@dataclass(frozen=True)
class Viewpoint:
    """Eye and what it looks at, (3,) each [m], mesh frame; up is the arm's base's.

    Raises:
        ScenarioError: a place too far from the mesh, or both in one place.
    """

    eye: Vector
    look_at: Vector

    def __post_init__(self) -> None:
        for name in ("eye", "look_at"):
            place = getattr(self, name)
            if not math.hypot(*place) <= FARTHEST_EYE:
                raise ScenarioError(
                    f"the camera's {name} at {format_point(place)} is more than "
                    f"{FARTHEST_EYE:g} m from the mesh's origin"
                )
        if not math.dist(self.eye, self.look_at) >= NEAREST_EYE:
            raise ScenarioError(
                f"the camera's eye must be {NEAREST_EYE * 1e3:g} mm or more from what it looks "
                f"at, not at {format_point(self.eye)}"
            )


@dataclass(frozen=True)
class Kind:
    """How a setting is read from JSON and written to it, exactly."""

    read: Callable[[Any], Any]
    write: Callable[[Any], Any]


def text(value: Any) -> str:
    """A text."""
    if not isinstance(value, str):
        raise ScenarioError("must be a text")
    return value


def text_or_null(value: Any) -> str | None:
    """A text, or None."""
    if value is not None and not isinstance(value, str):
        raise ScenarioError("must be a text or null")
    return value


def flag(value: Any) -> bool:
    """True or false."""
    if not isinstance(value, bool):
        raise ScenarioError("must be true or false")
    return value


def _number(value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ScenarioError("must be a number")
    return float(value)


def _whole(value: Any) -> int:
    if type(value) is not int or not 0 <= value < 2**63:
        raise ScenarioError("must be a whole number from 0")
    return value


def _words(parse: Callable[[str], Any], example: str) -> Callable[[Any], Any]:
    """Reads what the command line reads."""

    def take(value: Any) -> Any:
        if not isinstance(value, str):
            raise ScenarioError(f"must be a text such as {example}")
        return parse(value)

    return take


def waypoints(value: Any) -> tuple[Waypoint, ...]:
    """The waypoints of a script."""
    if not isinstance(value, list):
        raise ScenarioError('must be a list of {"time": seconds, "at": "x,y,z"}')
    found = []
    for item in value:
        if not isinstance(item, dict) or set(item) != {"time", "at"}:
            raise ScenarioError('has a waypoint that is not {"time": seconds, "at": "x,y,z"}')
        at = parse_point(text(item["at"]))
        if at is None:
            raise ScenarioError("has a waypoint without a place: auto is none")
        found.append(Waypoint(_number(item["time"]), at))
    return tuple(found)


def quaternion(value: Any) -> tuple[float, float, float, float] | None:
    """Four numbers, or None."""
    if value is None:
        return None
    if not isinstance(value, list) or len(value) != 4:
        raise ScenarioError("must be four numbers w, x, y, z, or null")
    w, x, y, z = map(_number, value)
    return w, x, y, z


def camera(value: Any) -> str | Viewpoint | None:
    """A name, a place to look from, or None."""
    if not isinstance(value, dict):
        return text_or_null(value)
    if set(value) != {"eye", "look_at"}:
        raise ScenarioError('must be a name or {"eye": "x,y,z", "look_at": "x,y,z"}')
    eye, look_at = (parse_point(text(value[key])) for key in ("eye", "look_at"))
    if eye is None or look_at is None:
        raise ScenarioError("has no place: auto is none")
    return Viewpoint(eye, look_at)


def write_camera(camera: str | Viewpoint | None) -> Any:
    """As `camera` reads it."""
    if not isinstance(camera, Viewpoint):
        return camera
    return {"eye": write_point(camera.eye), "look_at": write_point(camera.look_at)}


def _write_length(value: float | None) -> str:
    """As one would write it if that is exact, else in metres with all digits."""
    text = format_length(value)
    return text if value is None or parse_length(text) == value else f"{value!r}m"


def _speed(value: Any) -> float:
    """A text such as "100mm/s"; a bare number, as files had it at first, is in m/s."""
    return parse_speed(value) if isinstance(value, str) else _number(value)


def _write_speed(value: float) -> str:
    text = format_speed(value)
    return text if parse_speed(text) == value else f"{value!r}m/s"


def write_point(value: Vector | None) -> str:
    """As `_write_length` each, or auto."""
    return format_point(None) if value is None else ",".join(map(_write_length, value))


def _write_turn(value: Vector) -> str:
    text = format_turn(value)
    return text if parse_turn(text) == value else ",".join(f"{angle!r}rad" for angle in value)


_TEXTS = Kind(text, str)
_LENGTH = Kind(_words(parse_length, '"20um"'), _write_length)
_NUMBER = Kind(_number, float)
_SWITCH = Kind(flag, bool)
_OPTIONAL = Kind(text_or_null, lambda value: value)

SETTINGS: dict[str, Kind] = {
    "mesh": _TEXTS,
    "unit": _OPTIONAL,
    "frame": _OPTIONAL,
    "at": Kind(_words(parse_point, '"0,-1cm,-12cm" or "auto"'), write_point),
    "rotate": Kind(_words(parse_turn, '"0,0,90"'), _write_turn),
    "up": _TEXTS,
    "damage": _TEXTS,
    "seed": Kind(_whole, int),
    "repair": _SWITCH,
    "flip": _SWITCH,
    "path": _OPTIONAL,
    "corridor": Kind(
        _words(parse_corridor, '"1mm" or "off"'),
        lambda value: "off" if value is None else _write_length(value),
    ),
    "robot": _TEXTS,
    "rule": _TEXTS,
    "radius": Kind(_words(parse_radius, '"5mm" or "auto"'), _write_length),
    "standoff": _LENGTH,
    "tip_radius": _LENGTH,
    "scale": _NUMBER,
    "lock_orientation": _SWITCH,
    "tip_speed": Kind(_speed, _write_speed),
    "force_gain": _NUMBER,
}
"""The options that belong to a scenario, and how they stand in a file."""


def taken(key: str, read: Callable[[Any], Any], value: Any) -> Any:
    """A value read; what is wrong with it is said with its key."""
    try:
        return read(value)
    except (OptionError, OverflowError) as error:
        raise ScenarioError(f'"{key}": {shown(value)}: {error}') from None


def shown(value: Any) -> str:
    """A value in an error's line: short, and of one line whatever it is."""
    text = json.dumps(value, ensure_ascii=True)
    return text if len(text) <= 60 else f"{text[:57]}…"

"""Kinds of the values in a scenario's file that are not options: checking, reading, writing."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

from app import kinds
from app.kinds import Kind, Number, OneOf, Place
from app.options import Checked, option
from app.words import OptionError

LONGEST = 600.0  # duration of a script [s]
FARTHEST_EYE = 20.0  # from a camera to the mesh's origin [m]
NEAREST_EYE = 1e-4  # from a camera to the point it looks at [m]
CAMERAS = ("arm", "anatomy", "site", "tool", "follow", "surgeon")
MOST_WAYPOINTS = 200

Vector = tuple[float, float, float]
_PLACE = Place()
_NUMBER = Number(-math.inf, math.inf)


class ScenarioError(OptionError):
    """An invalid scenario. The message is one line with the value and what is valid."""


@dataclass(frozen=True)
class Waypoint(Checked):
    """A position of the proxy at rest: time since the start [s], place (3,) [m], mesh frame.

    Raises:
        OptionError: a time or a place out of range.
    """

    time: float = option(Number(0.0, LONGEST, "s"))
    at: Vector = option(_PLACE)


@dataclass(frozen=True)
class Viewpoint:
    """A camera's eye and the point it looks at, (3,) [m], mesh frame; up is +z of the arm's base.

    Raises:
        ScenarioError: too far from the mesh, or eye and point too near to each other.
    """

    eye: Vector
    look_at: Vector

    def __post_init__(self) -> None:
        for name in ("eye", "look_at"):
            place = getattr(self, name)
            if not math.hypot(*place) <= FARTHEST_EYE:
                raise ScenarioError(
                    f"the camera's {name} at {_PLACE.format(place)} is more than "
                    f"{FARTHEST_EYE:g} m from the mesh's origin"
                )
        if not math.dist(self.eye, self.look_at) >= NEAREST_EYE:
            raise ScenarioError(
                f"the camera's eye must be {NEAREST_EYE * 1e3:g} mm or more from what it looks "
                f"at, not at {_PLACE.format(self.eye)}"
            )


class Waypoints(Kind):
    """At most `MOST_WAYPOINTS` waypoints in order of time."""

    wanted, json = 'a list of {"time": seconds, "at": "x,y,z"}', (list,)

    def check(self, name: str, value: tuple[Waypoint, ...]) -> None:
        if len(value) > MOST_WAYPOINTS:
            raise ScenarioError(
                f"{name} has {len(value)} waypoints: at most {MOST_WAYPOINTS} are allowed"
            )
        for before, after in pairwise(value):
            if not before.time < after.time:
                raise ScenarioError(
                    f"{name}: a waypoint's time {after.time:g} s must be after the one before "
                    f"({before.time:g} s)"
                )

    def from_json(self, value: Any) -> tuple[Waypoint, ...]:
        found = []
        for item in super().from_json(value):
            if not isinstance(item, dict) or set(item) != {"time", "at"}:
                raise ScenarioError('has a waypoint that is not {"time": seconds, "at": "x,y,z"}')
            at = _PLACE.from_json(item["at"])
            found.append(Waypoint(_NUMBER.from_json(item["time"]), at))
        return tuple(found)

    def to_json(self, value: tuple[Waypoint, ...]) -> Any:
        return [{"time": one.time, "at": _PLACE.to_json(one.at)} for one in value]


class Quaternion(Kind):
    """Four numbers w, x, y, z of length 1."""

    wanted, json = "four numbers w, x, y, z", (list,)

    def check(self, name: str, value: Any) -> None:
        if not abs(math.hypot(*value) - 1.0) < 1e-3:
            raise ScenarioError(
                f"{name} must be a unit quaternion such as [1, 0, 0, 0], not "
                f"{kinds.shown(list(value))}"
            )

    def from_json(self, value: Any) -> tuple[float, ...]:
        if len(super().from_json(value)) != 4:
            raise ScenarioError(f"must be {self.wanted}")
        return tuple(map(_NUMBER.from_json, value))

    def to_json(self, value: Any) -> Any:
        return list(value)


class Camera(OneOf):
    """One of `CAMERAS`, or a `Viewpoint`, which checks itself."""

    json = (str, dict)

    def check(self, name: str, value: Any) -> None:
        if not isinstance(value, Viewpoint):
            super().check(name, value)

    def from_json(self, value: Any) -> str | Viewpoint:
        if isinstance(value, str):
            return value
        if set(value) != {"eye", "look_at"}:
            raise ScenarioError('must be a name or {"eye": "x,y,z", "look_at": "x,y,z"}')
        return Viewpoint(**{key: _PLACE.from_json(place) for key, place in value.items()})

    def to_json(self, value: str | Viewpoint) -> Any:
        if isinstance(value, str):
            return value
        return {"eye": _PLACE.to_json(value.eye), "look_at": _PLACE.to_json(value.look_at)}


def taken(key: str, kind: Kind, value: Any) -> Any:
    """A value read from JSON; errors name its key."""
    try:
        return kind.from_json(value)
    except (OptionError, OverflowError) as error:
        raise ScenarioError(f'"{key}": {shown(value)}: {error}') from None


def shown(value: Any) -> str:
    """A value for an error message: one short line."""
    text = json.dumps(value, ensure_ascii=True)
    return text if len(text) <= 60 else f"{text[:57]}…"

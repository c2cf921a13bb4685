"""A set-up to come back to or to share: scene, settings, proxy and view, as a small JSON file.

The file's words are the command line's: ``"radius": "5mm"`` means what ``--radius 5mm`` does. A
file of this format version is read back exactly as it was written.
"""

from __future__ import annotations

import json
import math
import os
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NoReturn

from app.settings import (
    OptionError,
    Options,
    check_names,
    format_length,
    format_point,
    format_turn,
    parse_length,
    parse_point,
    parse_radius,
    parse_turn,
)

FORMAT = 1
SIZE_LIMIT = 100_000  # [byte] of a file; one with the most waypoints has some ten thousand
CAMERAS = ("arm", "anatomy", "site", "tool", "follow", "surgeon")
MOST_WAYPOINTS = 200
LONGEST = 600.0  # [s] a script goes on
FARTHEST = 2.0  # [m] of a waypoint from the mesh's origin; farther is a slip of the unit
FARTHEST_EYE = 20.0  # [m] of a camera from the mesh's origin
NEAREST_EYE = 1e-4  # [m] of a camera from what it looks at
_TEXT = {"name": 60, "about": 300}  # characters

Vector = tuple[float, float, float]


class ScenarioError(OptionError):
    """A scenario is not usable. The message is one line that names the value and what is valid."""


@dataclass(frozen=True)
class Waypoint:
    """Where the proxy rests for a moment: time since the start [s], place (3,) [m], mesh frame."""

    time: float
    at: Vector


@dataclass(frozen=True)
class Viewpoint:
    """Eye and what it looks at, (3,) each [m], mesh frame; up is the arm's base's."""

    eye: Vector
    look_at: Vector


@dataclass(frozen=True)
class Scenario:
    """Everything that makes a set-up.

    Attributes:
        name: short, for a list.
        about: the sentence that says what one sees.
        options: the settings; only those that belong to a scenario (`SETTINGS`) count.
        proxy: none: it stays on the tool; one at time 0: it starts there; else a script that leads
            it from one to the next, each from rest to rest, and ends at the last. A script whose
            first time is later begins on the tool.
        wxyz: orientation of the proxy in the mesh's frame, a unit quaternion; None: the tool's own
            at its start.
        camera: where to look from, one of `CAMERAS` or a place; None: as a new scene is seen.
        paused: whether the loop waits for *Run*.

    Raises:
        ScenarioError: a text too long or not of one line, waypoints out of order or too many or too
            far, no unit quaternion, an unknown camera.
    """

    name: str
    about: str
    options: Options = field(default_factory=Options)
    proxy: tuple[Waypoint, ...] = ()
    wxyz: tuple[float, float, float, float] | None = None
    camera: str | Viewpoint | None = None
    paused: bool = False

    def __post_init__(self) -> None:
        for key, most in _TEXT.items():
            text = getattr(self, key)
            if not 0 < len(text) <= most or not text.isprintable():
                raise ScenarioError(
                    f"{key} must be one line of 1 to {most} printable characters, "
                    f"not {_shown(text)}"
                )
        # One value, one scenario: what is of the server and not of the scenario is left out.
        object.__setattr__(self, "options", self.applied(Options()))
        if len(self.proxy) > MOST_WAYPOINTS:
            raise ScenarioError(
                f"proxy has {len(self.proxy)} waypoints: at most {MOST_WAYPOINTS} are allowed"
            )
        before = None
        for waypoint in self.proxy:
            _check_waypoint(waypoint, before)
            before = waypoint.time
        if self.wxyz is not None and not abs(math.hypot(*self.wxyz) - 1.0) < 1e-3:
            raise ScenarioError(
                f"wxyz must be a unit quaternion such as [1, 0, 0, 0], not {list(self.wxyz)}"
            )
        if isinstance(self.camera, Viewpoint):
            _check_view(self.camera)
        elif self.camera is not None and self.camera not in CAMERAS:
            raise ScenarioError(
                f"unknown camera {_shown(self.camera)}: choose one of {', '.join(CAMERAS)}, or null"
            )

    def applied(self, options: Options) -> Options:
        """These options, but what belongs to a scenario as this one has it."""
        return replace(options, **{key: getattr(self.options, key) for key in SETTINGS})


@dataclass(frozen=True)
class _Kind:
    """How a setting is read from JSON and written to it, exactly."""

    read: Callable[[Any], Any]
    write: Callable[[Any], Any]


def loads(
    text: str | bytes, folder: Path | None = None, find: Callable[[str], str | None] | None = None
) -> Scenario:
    """A scenario from the JSON text of a file.

    Args:
        folder: where the file is; the paths in it start there. None: it must not have any.
        find: finds a file by its name alone, in place of a folder; None: there is none.

    Raises:
        OptionError: not JSON, too long, an unknown format version, key or value; one line.
    """
    if len(text) > SIZE_LIMIT:
        raise ScenarioError(f"{len(text):,} bytes are more than a scenario has ({SIZE_LIMIT:,})")
    try:
        content = json.loads(
            text, object_pairs_hook=_without_twins, parse_constant=_refuse_constant
        )
    except ScenarioError:
        raise
    except (ValueError, RecursionError) as error:
        reason = " ".join(str(error).split())[:120]
        raise ScenarioError(f"this is not JSON ({reason})") from None
    if not isinstance(content, dict):
        raise ScenarioError(f"a scenario is a JSON object {{…}}, not {_shown(content)}")
    version = content.get("format")
    if type(version) is not int or version != FORMAT:
        said = "it has none" if version is None else f"not {_shown(version)}"
        raise ScenarioError(f'"format" must be {FORMAT}, the version of scenarios: {said}')
    known = ("format", "name", "about", *SETTINGS, "proxy", "wxyz", "camera", "paused")
    for key in content:
        if key not in known:
            raise ScenarioError(f"unknown key {_shown(key)}: choose from {', '.join(known)}")
    for key in _TEXT:
        if key not in content:
            raise ScenarioError(f'"{key}" is missing')
    wanted = {
        key: _taken(key, kind.read, content[key])
        for key, kind in SETTINGS.items()
        if key in content
    }
    scenario = Scenario(
        name=_taken("name", _text, content["name"]),
        about=_taken("about", _text, content["about"]),
        options=Options(**wanted),
        proxy=_taken("proxy", _waypoints, content.get("proxy", [])),
        wxyz=_taken("wxyz", _quaternion, content.get("wxyz")),
        camera=_taken("camera", _camera, content.get("camera")),
        paused=_taken("paused", _flag, content.get("paused", False)),
    )
    check_names(scenario.options)
    return _placed(scenario, folder, find)


def dumps(scenario: Scenario, folder: Path | None = None) -> str:
    """The JSON text of a file, which `loads` reads back exactly.

    Args:
        folder: where the file is going to be; paths are written relative to it. None: the name
            alone, for a file that is to lie beside the mesh.
    """
    options = scenario.options
    content: dict[str, Any] = {"format": FORMAT, "name": scenario.name, "about": scenario.about}
    for key, kind in SETTINGS.items():
        value = getattr(options, key)
        if key in _FILES and value is not None and _is_file(value):
            path = Path(value)
            value = path.name if folder is None else os.path.relpath(path, folder)
        content[key] = kind.write(value)
    content["proxy"] = [
        {"time": waypoint.time, "at": _write_point(waypoint.at)} for waypoint in scenario.proxy
    ]
    content["wxyz"] = None if scenario.wxyz is None else list(scenario.wxyz)
    content["camera"] = _write_camera(scenario.camera)
    content["paused"] = scenario.paused
    return json.dumps(content, indent=1, ensure_ascii=False, allow_nan=False) + "\n"


def read(path: Path) -> Scenario:
    """The scenario in a file.

    Raises:
        ScenarioError: unreadable, or not what `loads` takes; one line with the file's name.
    """
    try:
        with path.open("rb") as file:
            text = file.read(SIZE_LIMIT + 1)
        return loads(text, path.parent)
    except OSError as error:
        raise ScenarioError(f"{path}: cannot be read ({error.strerror})") from None
    except ValueError as error:
        raise ScenarioError(f"{path}: {error}") from None


def write(scenario: Scenario, path: Path) -> None:
    """Put a scenario into a file; paths in it are relative to the file's folder."""
    path.write_text(dumps(scenario, path.parent), encoding="utf-8")


# Values as they stand in a file


def _text(value: Any) -> str:
    if not isinstance(value, str):
        raise ScenarioError("must be a text")
    return value


def _text_or_null(value: Any) -> str | None:
    if value is not None and not isinstance(value, str):
        raise ScenarioError("must be a text or null")
    return value


def _flag(value: Any) -> bool:
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


def _corridor(text: str) -> float | None:
    return None if text == "off" else parse_length(text)


def _waypoints(value: Any) -> tuple[Waypoint, ...]:
    if not isinstance(value, list):
        raise ScenarioError('must be a list of {"time": seconds, "at": "x,y,z"}')
    found = []
    for item in value:
        if not isinstance(item, dict) or set(item) != {"time", "at"}:
            raise ScenarioError('has a waypoint that is not {"time": seconds, "at": "x,y,z"}')
        at = parse_point(_text(item["at"]))
        if at is None:
            raise ScenarioError("has a waypoint without a place: auto is none")
        found.append(Waypoint(_number(item["time"]), at))
    return tuple(found)


def _quaternion(value: Any) -> tuple[float, float, float, float] | None:
    if value is None:
        return None
    if not isinstance(value, list) or len(value) != 4:
        raise ScenarioError("must be four numbers w, x, y, z, or null")
    w, x, y, z = map(_number, value)
    return w, x, y, z


def _camera(value: Any) -> str | Viewpoint | None:
    if not isinstance(value, dict):
        return _text_or_null(value)
    if set(value) != {"eye", "look_at"}:
        raise ScenarioError('must be a name or {"eye": "x,y,z", "look_at": "x,y,z"}')
    eye, look_at = (parse_point(_text(value[key])) for key in ("eye", "look_at"))
    if eye is None or look_at is None:
        raise ScenarioError("has no place: auto is none")
    return Viewpoint(eye, look_at)


def _write_camera(camera: str | Viewpoint | None) -> Any:
    if not isinstance(camera, Viewpoint):
        return camera
    return {"eye": _write_point(camera.eye), "look_at": _write_point(camera.look_at)}


def _write_length(value: float | None) -> str:
    """As one would write it if that is exact, else in metres with all digits."""
    text = format_length(value)
    return text if value is None or parse_length(text) == value else f"{value!r}m"


def _write_point(value: Vector | None) -> str:
    return format_point(None) if value is None else ",".join(map(_write_length, value))


def _write_turn(value: Vector) -> str:
    text = format_turn(value)
    return text if parse_turn(text) == value else ",".join(f"{angle!r}rad" for angle in value)


_TEXTS = _Kind(_text, str)
_LENGTH = _Kind(_words(parse_length, '"20um"'), _write_length)
_NUMBER = _Kind(_number, float)
_SWITCH = _Kind(_flag, bool)
_OPTIONAL = _Kind(_text_or_null, lambda value: value)

SETTINGS: dict[str, _Kind] = {
    "mesh": _TEXTS,
    "unit": _OPTIONAL,
    "frame": _OPTIONAL,
    "at": _Kind(_words(parse_point, '"0,-1cm,-12cm" or "auto"'), _write_point),
    "rotate": _Kind(_words(parse_turn, '"0,0,90"'), _write_turn),
    "up": _TEXTS,
    "damage": _TEXTS,
    "seed": _Kind(_whole, int),
    "repair": _SWITCH,
    "flip": _SWITCH,
    "path": _OPTIONAL,
    "corridor": _Kind(
        _words(_corridor, '"1mm" or "off"'),
        lambda value: "off" if value is None else _write_length(value),
    ),
    "robot": _TEXTS,
    "rule": _TEXTS,
    "radius": _Kind(_words(parse_radius, '"5mm" or "auto"'), _write_length),
    "standoff": _LENGTH,
    "tip_radius": _LENGTH,
    "scale": _NUMBER,
    "lock_orientation": _SWITCH,
    "tip_speed": _NUMBER,
    "force_gain": _NUMBER,
}
"""The options that belong to a scenario, and how they stand in a file."""

_FILES = ("mesh", "path")


def _taken(key: str, read: Callable[[Any], Any], value: Any) -> Any:
    try:
        return read(value)
    except (OptionError, OverflowError) as error:
        raise ScenarioError(f'"{key}": {_shown(value)}: {error}') from None


def _check_waypoint(waypoint: Waypoint, before: float | None) -> None:
    time, at = waypoint.time, waypoint.at
    if before is None and not 0.0 <= time <= LONGEST:
        raise ScenarioError(
            f"the first waypoint's time must be between 0 and {LONGEST:g} s, not {time:g}"
        )
    if before is not None and not before < time <= LONGEST:
        raise ScenarioError(
            f"a waypoint's time {time:g} s must be after the one before ({before:g} s) "
            f"and at most {LONGEST:g} s"
        )
    if not math.hypot(*at) <= FARTHEST:
        raise ScenarioError(
            f"a waypoint at {format_point(at)} is more than {FARTHEST:g} m from the mesh's origin"
        )


def _check_view(view: Viewpoint) -> None:
    for name, place in (("eye", view.eye), ("look_at", view.look_at)):
        if not math.hypot(*place) <= FARTHEST_EYE:
            raise ScenarioError(
                f"the camera's {name} at {format_point(place)} is more than {FARTHEST_EYE:g} m "
                "from the mesh's origin"
            )
    if not math.dist(view.eye, view.look_at) >= NEAREST_EYE:
        raise ScenarioError(
            f"the camera's eye must be {NEAREST_EYE * 1e3:g} mm or more from what it looks at, "
            f"not at {format_point(view.eye)}"
        )


def _is_file(name: str) -> bool:
    """A mesh file has a suffix; a name of the catalogue has none, nor a folder before it."""
    return Path(name).suffix != "" or len(Path(name).parts) > 1


def _placed(
    scenario: Scenario, folder: Path | None, find: Callable[[str], str | None] | None = None
) -> Scenario:
    """The same, with the paths in it found from the file's folder, or by their names."""
    found: dict[str, Any] = {}
    for key in _FILES:
        name = getattr(scenario.options, key)
        if name is None or not (key == "path" or _is_file(name)):
            continue
        if "\0" in name or Path(name).is_absolute():
            raise ScenarioError(
                f'"{key}": {_shown(name)}: write a path relative to the scenario\'s file'
            )
        if find is not None:
            where = find(name)
            if where is None:
                raise ScenarioError(f'"{key}": {_shown(name)} is not known here: bring it first')
            found[key] = where
            continue
        if folder is None:
            raise ScenarioError(f'"{key}": {_shown(name)}: there is no file to find this one from')
        found[key] = os.path.normpath(folder / name)
    return replace(scenario, options=replace(scenario.options, **found)) if found else scenario


def _without_twins(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    content = dict(pairs)
    if len(content) != len(pairs):
        keys = [key for key, _ in pairs]
        twin = next(key for key in keys if keys.count(key) > 1)
        raise ScenarioError(f"the key {_shown(twin)} is there twice")
    return content


def _refuse_constant(name: str) -> NoReturn:
    raise ScenarioError(f"{name} is not a usable number")


def _shown(value: Any) -> str:
    """A value in an error's line: short, and of one line whatever it is."""
    text = json.dumps(value, ensure_ascii=True)
    return text if len(text) <= 60 else f"{text[:57]}…"

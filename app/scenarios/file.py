"""Scenarios: scene, settings, proxy and view in a small JSON file.

Values are written as on the command line: ``"radius": "5mm"`` is ``--radius 5mm``. Reading a file
gives back exactly the scenario that was written.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NoReturn

from app.choices import FROM_PACKAGES, MESHES, NO_MESH, SETS
from app.kinds import Kind, Maybe, Switch, Text
from app.kinds.links import parse_address
from app.options import Checked, declared, option
from app.scenarios.values import (
    CAMERAS,
    Camera,
    Quaternion,
    ScenarioError,
    Viewpoint,
    Waypoint,
    Waypoints,
    shown,
    taken,
)
from app.settings import Options
from app.structure import split

FORMAT = 1
SIZE_LIMIT = 100_000  # [byte] of a file; one with the most waypoints has some ten thousand
SETTINGS = {name: entry.kind for name, entry in declared(Options).items() if entry.shared}
"""The options that belong to a scenario; its file has them at the same level as other keys."""
LOOPBACK = ("127.0.0.1", "::1", "localhost")  # a file from elsewhere opens no port to others


@dataclass(frozen=True)
class Scenario(Checked):
    """A scenario.

    Attributes:
        name: short, for a list.
        about: one sentence that describes what the scenario shows.
        options: the settings; only those that belong to a scenario (`SETTINGS`) count.
        proxy: empty: the proxy stays on the tool; one waypoint at time 0: it starts there; else a
            script from waypoint to waypoint, at rest in each. If the first time is later than 0,
            the script starts on the tool.
        wxyz: orientation of the proxy in the mesh's frame, a unit quaternion; None: the tool's at
            its start.
        camera: one of `CAMERAS` or a viewpoint; None: the default view of a scene.
        paused: whether the loop starts paused.

    Raises:
        ScenarioError: a text too long or not of one line, waypoints out of order or too many or too
            far, no unit quaternion, an unknown camera.
    """

    name: str = option(Text(60))
    about: str = option(Text(300))
    options: Options = option(Kind(), Options())
    proxy: tuple[Waypoint, ...] = option(Waypoints(), ())
    wxyz: tuple[float, float, float, float] | None = option(Maybe(Quaternion()), None)
    camera: str | Viewpoint | None = option(Maybe(Camera("camera", CAMERAS)), None)
    paused: bool = option(Switch(), False)

    def __post_init__(self) -> None:
        super().__post_init__()
        # Equal scenarios compare equal: reset the options that do not belong to a scenario.
        object.__setattr__(self, "options", self.applied(Options()))

    def applied(self, options: Options) -> Options:
        """`options` with the settings of this scenario."""
        return replace(options, **{key: getattr(self.options, key) for key in SETTINGS})


_OWN = {name: entry.kind for name, entry in declared(Scenario).items() if name != "options"}
_KEYS = {"name": _OWN["name"], "about": _OWN["about"], **SETTINGS, **_OWN}
"""The keys of a file besides its format, in their order."""


def loads(
    text: str | bytes, folder: Path | None = None, find: Callable[[str], str | None] | None = None
) -> Scenario:
    """A scenario from the JSON text of a file.

    Args:
        folder: the file's folder; the files it names must be in it or below. None: it must not
            name any.
        find: finds a file by its name, instead of `folder`.

    Raises:
        OptionError: not JSON, too long, an unknown format version, key or value, or a file outside
            of `folder`; one line.
    """
    if len(text) > SIZE_LIMIT:
        raise ScenarioError(f"{len(text):,} bytes are more than a scenario has ({SIZE_LIMIT:,})")
    try:
        content = json.loads(
            text, object_pairs_hook=_without_duplicates, parse_constant=_refuse_constant
        )
    except ScenarioError:
        raise
    except (ValueError, RecursionError) as error:
        reason = " ".join(str(error).split())[:120]
        raise ScenarioError(f"this is not JSON ({reason})") from None
    if not isinstance(content, dict):
        raise ScenarioError(f"a scenario is a JSON object {{…}}, not {shown(content)}")
    version = content.get("format")
    if type(version) is not int or version != FORMAT:
        said = "it has none" if version is None else f"not {shown(version)}"
        raise ScenarioError(f'"format" must be {FORMAT}, the version of scenarios: {said}')
    for key in content:
        if key not in _KEYS and key != "format":
            known = ", ".join(("format", *_KEYS))
            raise ScenarioError(f"unknown key {shown(key)}: choose from {known}")
    for key in ("name", "about"):
        if key not in content:
            raise ScenarioError(f'"{key}" is missing')
    wanted = {key: taken(key, kind, content[key]) for key, kind in _KEYS.items() if key in content}
    options = Options(**{key: wanted.pop(key) for key in SETTINGS if key in wanted})
    scenario = Scenario(**wanted, options=options)
    return _placed(scenario, folder, find)


def dumps(scenario: Scenario, folder: Path | None = None) -> str:
    """The JSON text of a file, which `loads` reads back exactly.

    Args:
        folder: folder of the file, to which paths are written relative. None: file names alone.

    Raises:
        ScenarioError: a file that it names is neither in the folder nor below it.
    """
    content: dict[str, Any] = {"format": FORMAT}
    for key, kind in _KEYS.items():
        value = getattr(scenario.options if key in SETTINGS else scenario, key)
        if key in _FILES and value is not None:
            value = _written(key, value, folder)
        elif key == "structures":
            value = tuple(replace(one, file=_written(key, one.file, folder)) for one in value)
        elif key == "motions":
            value = tuple(
                one if one.file is None else replace(one, file=_written(key, one.file, folder))
                for one in value
            )
        elif key == "registration" and value is not None and isinstance(value.fiducials, str):
            value = replace(value, fiducials=_written(key, value.fiducials, folder))
        content[key] = kind.to_json(value)
    return json.dumps(content, indent=1, ensure_ascii=False, allow_nan=False) + "\n"


def read(path: Path) -> Scenario:
    """The scenario in a file.

    Raises:
        ScenarioError: unreadable or invalid; one line with the file's name.
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
    """Write a scenario to a file; paths in it are relative to the file's folder.

    Raises:
        ScenarioError: a file that it names is neither in that folder nor below it.
        OSError: it cannot be written.
    """
    path.write_text(dumps(scenario, path.parent), encoding="utf-8")


_FILES = ("mesh", "path")
# Never a label behind the file, nor a name of the catalogue.
_PLAIN = ("path", "motions", "registration")


def _is_file(name: str) -> bool:
    """Whether a name is a path: catalogue names have neither suffix nor folder."""
    return Path(name).suffix != "" or "/" in name or len(Path(name).parts) > 1


def _written(key: str, name: str, folder: Path | None) -> str:
    """A name as a file in this folder has it: a path relative to it, or without it the last part.

    A label may follow the path.
    """
    file, label = (name, None) if key in _PLAIN else split(name)
    if not _is_file(file) and key not in ("motions", "registration"):
        return name
    path = Path(file)
    file = path.name if folder is None else _relative(key, path, folder)
    if path.is_dir():
        file += "/"  # so that it is no name of the catalogue
    return file if label is None else f"{file}:{label}"


def _placed(
    scenario: Scenario, folder: Path | None, find: Callable[[str], str | None] | None
) -> Scenario:
    """The scenario with the paths of its files resolved in `folder`, or by `find`."""
    options = scenario.options
    found: dict[str, Any] = {
        key: _found(key, name, folder, find)
        for key in _FILES
        if (name := getattr(options, key)) is not None
    }
    found["structures"] = tuple(
        replace(one, file=_found("structures", one.file, folder, find))
        for one in options.structures
    )
    found["motions"] = tuple(
        one if one.file is None else replace(one, file=_found("motions", one.file, folder, find))
        for one in options.motions
    )
    for one in options.motions:
        host = "" if one.stream is None else parse_address("stream", one.stream).host
        if host not in ("", *LOOPBACK):
            raise ScenarioError(
                f'"motions": a scenario listens on this machine alone: {shown(one.stream)} must be '
                "socket://127.0.0.1:PORT"
            )
    own = options.registration
    if own is not None and isinstance(own.fiducials, str):
        file = _found("registration", own.fiducials, folder, find)
        found["registration"] = replace(own, fiducials=file)
    return replace(scenario, options=replace(options, **found))


def _found(
    key: str, name: str, folder: Path | None, find: Callable[[str], str | None] | None
) -> str:
    """The path of a file in `folder`, or by `find`; a name of the catalogue as it is."""
    file, label = (name, None) if key in _PLAIN else split(name)
    if key not in _PLAIN and not _is_file(file):
        known = (*MESHES, *FROM_PACKAGES, *SETS, NO_MESH)
        if file not in known:
            raise ScenarioError(
                f'"{key}": unknown mesh {shown(name)}: choose one of {", ".join(known)}, '
                "or a file beside the scenario"
            )
        return name
    if find is not None and not Path(file).is_absolute():
        path = find(file)
        if path is None:
            raise ScenarioError(f'"{key}": {shown(name)} is not known here: bring it first')
    elif folder is None and find is None:
        raise ScenarioError(f'"{key}": {shown(name)}: there is no file to find this one from')
    else:
        path = _beside(key, file, folder or Path())
    return path if label is None else f"{path}:{label}"


def _beside(key: str, name: str, folder: Path) -> str:
    """The path of a file in the folder or below it.

    A scenario from an untrusted source must not open any other file.
    """
    path = Path(name)
    try:
        inside = (
            not path.is_absolute()
            and ".." not in path.parts
            and (folder / path).resolve().is_relative_to(folder.resolve())
        )
    except (OSError, RuntimeError):  # a name too long, links in a circle
        inside = False
    if not inside:
        raise ScenarioError(
            f'"{key}": {shown(name)}: write the path of a file in the scenario\'s own '
            "folder or below it, relative to it; it may not lead out, by .. or a link"
        )
    return os.path.normpath(folder / path)


def _relative(key: str, path: Path, folder: Path) -> str:
    name = os.path.relpath(path, folder)
    try:
        _beside(key, name, folder)
    except ScenarioError:
        raise ScenarioError(
            f'"{key}": {path} is not in {folder} or below: keep scenario and file in one folder'
        ) from None
    return name


def _without_duplicates(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    content = dict(pairs)
    if len(content) != len(pairs):
        keys = [key for key, _ in pairs]
        duplicate = next(key for key in keys if keys.count(key) > 1)
        raise ScenarioError(f"the key {shown(duplicate)} is there twice")
    return content


def _refuse_constant(name: str) -> NoReturn:
    raise ScenarioError(f"{name} is not a usable number")

"""Reads protocols: TOML, checked at every key; and the three that are built in."""

from __future__ import annotations

import dataclasses
import difflib
import tomllib
from collections.abc import Mapping
from dataclasses import MISSING
from importlib import resources
from pathlib import Path
from typing import Any, TypeVar

from app.kinds import Kind, Repeated, shown
from app.options import Record, declared
from app.studies.people.protocol import Protocol, ProtocolError
from app.words import OptionError

FORMAT = 1
SIZE_LIMIT = 200_000  # of a file [byte]
BUILT_IN = ("paper-tracing", "paper-cutting", "fixture-under-delay")
T = TypeVar("T")


def text_of(name_or_path: str) -> str:
    """The text of a built-in protocol, or of a file.

    Raises:
        ProtocolError: neither a name nor a readable file.
    """
    if name_or_path in BUILT_IN:
        folder = resources.files("app.studies.people").joinpath("protocols")
        return folder.joinpath(f"{name_or_path}.toml").read_text("utf-8")
    path = Path(name_or_path)
    if path.suffix != ".toml" and not path.exists():
        near = difflib.get_close_matches(name_or_path, BUILT_IN, n=1)
        hint = f" (did you mean '{near[0]}'?)" if near else ""
        raise ProtocolError(
            f"unknown protocol '{name_or_path}'{hint}: choose one of {', '.join(BUILT_IN)}, or "
            "give a file's path"
        )
    try:
        with path.open("rb") as file:
            content = file.read(SIZE_LIMIT + 1)
        if len(content) > SIZE_LIMIT:
            raise ProtocolError(f"{path}: more than {SIZE_LIMIT:,} bytes are no protocol")
        return content.decode("utf-8")
    except OSError as error:
        raise ProtocolError(f"{path}: cannot be read ({error.strerror})") from None
    except UnicodeDecodeError:
        raise ProtocolError(f"{path}: this is not UTF-8 text") from None


def read(name_or_path: str) -> Protocol:
    """A built-in protocol, or the one in a file.

    Raises:
        ProtocolError: unreadable or invalid; one line with the file's name and the key.
    """
    text = text_of(name_or_path)
    try:
        return loads(text)
    except OptionError as error:
        raise ProtocolError(f"{name_or_path}: {error}") from None


def loads(text: str) -> Protocol:
    """A protocol from the text of a file.

    Raises:
        ProtocolError: not TOML, an unknown key, or an invalid value.
    """
    try:
        content = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise ProtocolError(f"this is not TOML ({error})") from None
    version = content.pop("format", None)
    if type(version) is not int or version != FORMAT:
        said = "it has none" if version is None else f"not {shown(version)}"
        raise ProtocolError(f"format must be {FORMAT}, the version of protocols: {said}")
    return _table(Protocol, content, "")


def _table(kind: type[T], content: Any, where: str) -> T:
    """A record from a table; `where` is its place in the file, for messages."""
    place = where or "the protocol"
    if not isinstance(content, Mapping):
        raise ProtocolError(f"{place} must be a table, not {shown(content)}")
    known = declared(kind)
    for key in content:
        if key not in known:
            near = difflib.get_close_matches(key, known, n=1, cutoff=0.5)
            hint = f": did you mean {near[0]}?" if near else ""
            raise ProtocolError(
                f"{place} has an unknown key {shown(key)}{hint} (it has {', '.join(known)})"
            )
    values = {}
    for one in dataclasses.fields(kind):  # type: ignore[arg-type]
        inside = f"{where}.{one.name}" if where else one.name
        if one.name in content:
            values[one.name] = _value(known[one.name].kind, content[one.name], inside)
        elif one.default is MISSING:
            raise ProtocolError(f"{place} has no {one.name}")
    try:
        return kind(**values)
    except OptionError as error:
        raise ProtocolError(f"{where}: {error}" if where else str(error)) from None


def _value(kind: Kind, value: Any, where: str) -> Any:
    if isinstance(kind, Record):
        return _table(kind.of, value, where)
    if isinstance(kind, Repeated) and isinstance(kind.of, Record):
        if not isinstance(value, list):
            raise ProtocolError(f"{where} must be a list of tables, [[{where}]]")
        rows = enumerate(value, start=1)
        return tuple(_table(kind.of.of, row, f"{where} {number}") for number, row in rows)
    try:
        return kind.from_json(value)
    except (OptionError, OverflowError) as error:
        raise ProtocolError(f"{where} = {shown(value)}: {error}") from None

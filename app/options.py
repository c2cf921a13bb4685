"""Options, each declared once as a field of a dataclass.

    @dataclass(frozen=True)
    class Cut(Checked):
        depth: float = option(Length(0.0, 5e-3), 1e-3, "How deep to cut.")

The kind validates, reads and writes the value (`app.kinds`); the command line and its help are made
from the same declaration (`parse_as`). A dataclass can be the value of an option itself (`Record`).

Cheap to import (no kernels, no robots), so that `--help` and usage errors are immediate.
"""

from __future__ import annotations

import dataclasses
import json
import textwrap
from collections.abc import Collection, Mapping
from dataclasses import MISSING, dataclass, field, make_dataclass
from enum import Enum
from inspect import cleandoc
from typing import Annotated, Any, ClassVar, TypeVar

import tyro
from tyro.constructors import PrimitiveConstructorSpec

from app.kinds import Kind, Listed, Many, Maybe, Repeated, Switch, bare, shown
from app.words import OptionError

T = TypeVar("T")


class Scope(Enum):
    """What is rebuilt when an option of a session changes."""

    MESH = "the mesh, and with it the scene"  # options that change together
    ARM = "the arm, and with it the scene"
    FIXTURE = "the fixture and the controller"
    VIEW = "the drawing"
    TELEOPERATION = "the map from the handle to the proxy"
    SERVER = "the program"


@dataclass(frozen=True)
class Option:
    """The declaration of an option, besides its name, type and default.

    Attributes:
        kind: of its values.
        about: help text.
        scope: for an option of a session: what it belongs to.
        recorded: whether it is in recordings, because ticks can depend on it.
        shared: whether it is in the files of scenarios.
        positional: whether it is given on the command line without its name.
        flag: its name on the command line; empty: the field's.
    """

    kind: Kind
    about: str
    scope: Scope | None
    recorded: bool
    shared: bool
    positional: bool
    flag: str = ""


def option(
    kind: Kind,
    default: Any = MISSING,
    about: str = "",
    scope: Scope | None = None,
    *,
    recorded: bool | None = None,
    shared: bool | None = None,
    positional: bool = False,
    flag: str = "",
) -> Any:
    """A field with its declaration, see `Option`.

    Args:
        default: if missing, the option is required.
        recorded, shared: None: true for options of a session, except those of the server.
    """
    usual = scope not in (None, Scope.SERVER)
    recorded = usual if recorded is None else recorded
    shared = usual if shared is None else shared
    entry = Option(kind, about, scope, recorded, shared, positional, flag)
    return field(default=default, metadata={"option": entry})


def like(other: type, name: str, default: Any = None, about: str | None = None) -> Any:
    """A field with the declaration of another dataclass; default and help may be replaced."""
    entry = declared(other)[name]
    if default is None:
        default = getattr(other, name, MISSING)
    return option(entry.kind, default, entry.about if about is None else about)


def declared(kind: type) -> dict[str, Option]:
    """The options of a dataclass by name, in the order of its fields.

    Raises:
        KeyError: a field that is not an option.
    """
    found: dict[str, Option] = {}
    for one in dataclasses.fields(kind):
        if "option" not in one.metadata:
            raise KeyError(f"{kind.__name__}.{one.name} is not declared by `option`")
        found[one.name] = one.metadata["option"]
    return found


class Checked:
    """Base of a dataclass of options that validates its values.

    Raises:
        OptionError: an invalid value, with the option's name.
    """

    def __post_init__(self) -> None:
        for name, entry in declared(type(self)).items():
            entry.kind.check(name, getattr(self, name))


def check_keys(what: str, content: Any, known: Collection[str]) -> Mapping[str, Any]:
    """A JSON object that has exactly these keys; `what` names it in messages.

    Raises:
        OptionError: not an object, or an unknown or missing key.
    """
    if not isinstance(content, dict):
        raise OptionError(f"{what} must be a JSON object {{…}}, not {shown(content)}")
    for key in content:
        if key not in known:
            raise OptionError(f"{what} has an unknown key {shown(key)}: it has {', '.join(known)}")
    for key in known:
        if key not in content:
            raise OptionError(f"{what} has no '{key}'")
    return content


def raw(value: Any) -> Any:
    """An option's value for JSON in SI units: what `plain` reads back."""
    if isinstance(value, tuple):
        return [raw(one) for one in value]
    if not isinstance(value, Checked):
        return value
    return {name: raw(getattr(value, name)) for name in declared(type(value))}


def plain(value: Any, kind: Kind) -> Any:
    """An option's value from its JSON in SI units: a list becomes a tuple, an object a record.

    Raises:
        OptionError: an object that is no record of the kind.
    """
    if isinstance(value, list):
        return tuple(plain(one, kind.of if isinstance(kind, Many) else kind) for one in value)
    one = bare(kind)
    if isinstance(value, dict) and isinstance(one, Record):
        return one.fields(check_keys("a record", value, declared(one.of)))
    return value


@dataclass(frozen=True)
class Record(Kind):
    """Values of a dataclass of options, in JSON an object that has what differs from the defaults.

    On the command line, repeated (`Repeated`) or not (`Maybe`), the option's word is the first
    field, and the other fields are options that follow it directly: ``--structure nerve.stl
    --margin 1mm --guard tip``.
    """

    of: type
    what: str

    json: ClassVar[tuple[type, ...]] = (dict,)

    @property
    def first(self) -> str:
        """Name of the first field."""
        return next(iter(declared(self.of)))

    @property
    def metavar(self) -> str:  # type: ignore[override]
        """That of the first field."""
        return declared(self.of)[self.first].kind.metavar

    @property
    def wanted(self) -> str:  # type: ignore[override]
        """An object with some of the fields."""
        return f"an object with {', '.join(declared(self.of))}"

    def check(self, name: str, value: Any) -> None:
        if not isinstance(value, self.of):
            raise OptionError(f"{name} must be {self.what}, not {shown(value)}")

    def fields(self, values: Mapping[str, Any]) -> Any:
        """The record of these fields, which are checked; lists are read as tuples."""
        return self.of(**{key: plain(value, Kind()) for key, value in values.items()})

    def from_json(self, value: Any) -> Any:
        known = declared(self.of)
        found = super().from_json(value)
        for key in found:
            if key not in known:
                raise OptionError(f"unknown key {shown(key)}: choose from {', '.join(known)}")
        required = {one.name for one in dataclasses.fields(self.of) if one.default is MISSING}
        if self.first in required and self.first not in found:
            raise OptionError(f'"{self.first}" is missing in {self.what}')
        values = {}
        for key, one in found.items():
            try:
                values[key] = known[key].kind.from_json(one)
            except OptionError as error:
                raise OptionError(f'"{key}": {shown(one)}: {error}') from None
        return self.of(**values)

    def to_json(self, value: Any) -> Any:
        defaults = {one.name: one.default for one in dataclasses.fields(self.of)}
        return {
            name: entry.kind.to_json(getattr(value, name))
            for name, entry in declared(self.of).items()
            if getattr(value, name) != defaults[name]
        }

    def parse(self, text: str) -> Any:
        """A word made by `gathered`, or the first field alone."""
        words = json.loads(text) if text.startswith("{") else {self.first: text}
        values = {}
        for key, entry in declared(self.of).items():
            if key in words:
                is_word = isinstance(words[key], str)
                values[key] = entry.kind.parse(words[key]) if is_word else words[key]
        return self.of(**values)

    def format(self, value: Any) -> str:
        return json.dumps(self.to_json(value), ensure_ascii=False)


def gathered(words: list[str], options: Mapping[str, Option]) -> list[str]:
    """The words of a command line with every record in one word, see `Record`."""
    records = {
        f"--{entry.flag or name}": entry.kind.of.of
        for name, entry in options.items()
        if isinstance(entry.kind, Repeated | Maybe) and isinstance(entry.kind.of, Record)
    }
    words_for_none = {
        f"--{entry.flag or name}": entry.kind.word
        for name, entry in options.items()
        if isinstance(entry.kind, Maybe)
    }
    out: list[str] = []
    left = list(words)
    while left:
        flag, equals, value = left.pop(0).partition("=")
        kind = records.get(flag)
        if kind is None or not (equals or left):
            out.append(f"{flag}{equals}{value}")
            continue
        known = declared(kind)
        first = next(iter(known))
        found: dict[str, Any] = {first: value if equals else left.pop(0)}
        if found[first] == words_for_none.get(flag):
            out += [flag, found[first]]
            continue
        while left:
            name, equals, value = left[0].removeprefix("--").partition("=")
            off = name.removeprefix("no-")
            if not left[0].startswith("--") or off not in known or off == first:
                break
            if isinstance(known[off].kind, Switch):
                found[off] = name == off
            elif name != off or not (equals or len(left) > 1):
                break
            else:
                found[name] = value if equals else left.pop(1)
            left.pop(0)
        out += [flag, json.dumps(found)]
    return out


@dataclass(frozen=True)
class _Typed:
    """Words of the command line, parsed after tyro has finished."""

    words: list[str]


def parse_as(
    kind: type[T],
    program: str,
    arguments: list[str],
    description: str = "",
    default: T | None = None,
) -> T:
    """A dataclass of options from command-line words; tyro assigns the words and prints help.

    Args:
        description: beginning of the help text; empty: the dataclass's docstring.
        default: default values; None: the dataclass's own.

    Raises:
        OptionError: an invalid value.
        SystemExit: after `--help` (0) or a usage error (2).
    """
    if any(word in ("-h", "--help") for word in arguments):
        # tyro does not wrap paragraphs
        print(_wrapped(description or kind.__doc__ or "") + "\n")
    options = declared(kind)
    arguments = gathered(arguments, options)
    fields: list[Any] = []
    for one in dataclasses.fields(kind):  # type: ignore[arg-type]
        value = one.default if default is None else getattr(default, one.name)
        fields.append((one.name, _for_tyro(options[one.name]), field(default=value)))
    found: Any = tyro.cli(
        make_dataclass(kind.__name__, fields), prog=program, description="", args=arguments
    )
    return kind(
        **{name: _read(name, entry, getattr(found, name)) for name, entry in options.items()}
    )


def _for_tyro(entry: Option) -> Any:
    """The type of a field for tyro, with its help; tyro does not parse its words."""
    kind, marks = entry.kind, [tyro.conf.arg(name=entry.flag or None, help=entry.about)]
    if entry.positional:
        marks.append(tyro.conf.Positional)
    if isinstance(kind, Switch):
        return Annotated[(bool, *marks)]
    many = isinstance(kind, Many) and not isinstance(kind, Listed)
    each = kind.of if isinstance(kind, Many) and many else kind
    spec = PrimitiveConstructorSpec[Any](
        nargs="*" if many and not isinstance(kind, Repeated) else 1,
        metavar=kind.metavar,
        instance_from_str=_Typed,
        is_instance=lambda _value: True,
        str_from_instance=lambda value: (
            list(map(each.format, value)) if many else [each.format(value)]
        ),
    )
    if isinstance(kind, Repeated):
        return Annotated[(tuple[Annotated[Any, spec], ...], tyro.conf.UseAppendAction, *marks)]
    return Annotated[(Any, spec, *marks)]


def _read(name: str, entry: Option, value: Any) -> Any:
    """The value of tyro's result: words, or the default."""
    kind = entry.kind
    try:
        if isinstance(value, _Typed):
            if isinstance(kind, Many) and not isinstance(kind, Listed):
                return tuple(map(kind.of.parse, value.words))
            return kind.parse(value.words[0])
        if isinstance(kind, Repeated):
            # Those of the default stand before those of the command line.
            return tuple(
                kind.of.parse(one.words[0]) if isinstance(one, _Typed) else one for one in value
            )
    except OptionError as error:
        raise OptionError(f"{name}: {error}") from None
    return value


def _wrapped(text: str) -> str:
    """Paragraphs in 79 columns; indented lines are not wrapped."""
    paragraphs = cleandoc(text).split("\n\n")
    return "\n\n".join(
        part if "\n " in part or part.startswith(" ") else textwrap.fill(part, 79)
        for part in paragraphs
    )

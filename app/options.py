"""Options, each declared once as a field of a dataclass.

    @dataclass(frozen=True)
    class Cut(Checked):
        depth: float = option(Length(0.0, 5e-3), 1e-3, "How deep to cut.")

The kind validates, reads and writes the value (`app.kinds`); the command line and its help are made
from the same declaration (`parse_as`).

Cheap to import (no kernels, no robots), so that `--help` and usage errors are immediate.
"""

from __future__ import annotations

import dataclasses
import textwrap
from collections.abc import Collection, Mapping
from dataclasses import MISSING, dataclass, field, make_dataclass
from enum import Enum
from inspect import cleandoc
from typing import Annotated, Any, TypeVar

import tyro
from tyro.constructors import PrimitiveConstructorSpec

from app.kinds import Kind, Listed, Many, Repeated, Switch, shown
from app.words import OptionError

T = TypeVar("T")


class Scope(Enum):
    """What is rebuilt when an option of a session changes."""

    MESH = "the mesh, and with it the scene"  # options that change together
    ARM = "the arm, and with it the scene"
    FIXTURE = "the fixture and the controller"
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
    """

    kind: Kind
    about: str
    scope: Scope | None
    recorded: bool
    shared: bool
    positional: bool


def option(
    kind: Kind,
    default: Any = MISSING,
    about: str = "",
    scope: Scope | None = None,
    *,
    recorded: bool | None = None,
    shared: bool | None = None,
    positional: bool = False,
) -> Any:
    """A field with its declaration, see `Option`.

    Args:
        default: if missing, the option is required.
        recorded, shared: None: true for options of a session, except those of the server.
    """
    usual = scope not in (None, Scope.SERVER)
    recorded = usual if recorded is None else recorded
    shared = usual if shared is None else shared
    entry = Option(kind, about, scope, recorded, shared, positional)
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


def plain(value: Any) -> Any:
    """An option's value from its JSON in SI units: a list becomes a tuple."""
    return tuple(value) if isinstance(value, list) else value


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
    kind, marks = entry.kind, [tyro.conf.arg(help=entry.about)]
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
            return tuple(kind.of.parse(typed.words[0]) for typed in value)
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

"""An option is declared once, as a field of a dataclass; whatever else knows it asks here.

    @dataclass(frozen=True)
    class Cut(Checked):
        depth: float = option(Length(0.0, 5e-3), 1e-3, "How deep to cut.")

The value's kind checks it, and reads and writes it wherever it stands (`app.kinds`); the command
line and its help are made of the same declaration (`parse_as`).

Importing this module is cheap on purpose (no kernels, no robots), so that `--help` and a mistyped
option answer at once.
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
    """What has to be made anew where an option of a session changes."""

    MESH = "the mesh, and with it the scene"  # these options change together
    ARM = "the arm, and with it the scene"
    FIXTURE = "the fixture and the controller"
    TELEOPERATION = "the map from the handle to the proxy"
    SERVER = "the program"


@dataclass(frozen=True)
class Option:
    """What is known of an option besides its name, type and default.

    Attributes:
        kind: what a value may be.
        about: a sentence or two of help.
        scope: what it is a setting of, if it is one of a session.
        recorded: whether a tick, or the way to it, can depend on it: it is in recordings.
        shared: whether it is in the files of scenarios.
        positional: whether it stands on the command line without its name.
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
        default: without one it must be given.
        recorded, shared: None: those of a session are, but for the program's.
    """
    usual = scope not in (None, Scope.SERVER)
    recorded = usual if recorded is None else recorded
    shared = usual if shared is None else shared
    told = Option(kind, about, scope, recorded, shared, positional)
    return field(default=default, metadata={"option": told})


def like(other: type, name: str, default: Any = None, about: str | None = None) -> Any:
    """A field as another dataclass has it, by default with its default and help."""
    told = declared(other)[name]
    if default is None:
        default = getattr(other, name, MISSING)
    return option(told.kind, default, told.about if about is None else about)


def declared(kind: type) -> dict[str, Option]:
    """The options of a dataclass by name, in its order.

    Raises:
        KeyError: a field that is none.
    """
    found: dict[str, Option] = {}
    for one in dataclasses.fields(kind):
        if "option" not in one.metadata:
            raise KeyError(f"{kind.__name__}.{one.name} is not declared by `option`")
        found[one.name] = one.metadata["option"]
    return found


class Checked:
    """A dataclass of options, whose values are checked when one is made.

    Raises:
        OptionError: a value that its kind does not allow, by the option's name.
    """

    def __post_init__(self) -> None:
        for name, told in declared(type(self)).items():
            told.kind.check(name, getattr(self, name))


def check_keys(what: str, content: Any, known: Collection[str]) -> Mapping[str, Any]:
    """A JSON object with just these keys; others are refused. `what` is what to call it.

    Raises:
        OptionError: by the key.
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
    """The value of an option of what JSON has of it as it is, in SI units: tuples are lists."""
    return tuple(value) if isinstance(value, list) else value


@dataclass(frozen=True)
class _Typed:
    """Words of the command line, to be read once tyro is done."""

    words: list[str]


def parse_as(
    kind: type[T],
    program: str,
    arguments: list[str],
    description: str = "",
    default: T | None = None,
) -> T:
    """A dataclass of options from command-line words; tyro sorts the words and prints help.

    Args:
        description: what help says first; the dataclass's docstring if empty.
        default: where the words say nothing; None: the dataclass's own defaults.

    Raises:
        OptionError: a value was not usable.
        SystemExit: after `--help` (0) or a usage error (2).
    """
    if any(word in ("-h", "--help") for word in arguments):
        # tyro would print a paragraph as one long line
        print(_wrapped(description or kind.__doc__ or "") + "\n")
    options = declared(kind)
    fields: list[Any] = []
    for one in dataclasses.fields(kind):  # type: ignore[arg-type]
        value = one.default if default is None else getattr(default, one.name)
        fields.append((one.name, _for_tyro(options[one.name]), field(default=value)))
    found: Any = tyro.cli(
        make_dataclass(kind.__name__, fields), prog=program, description="", args=arguments
    )
    return kind(**{name: _read(name, told, getattr(found, name)) for name, told in options.items()})


def _for_tyro(told: Option) -> Any:
    """The type of a field whose words tyro leaves as they are, with its help."""
    kind, marks = told.kind, [tyro.conf.arg(help=told.about)]
    if told.positional:
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


def _read(name: str, told: Option, value: Any) -> Any:
    """The value of what tyro found: typed words, or the default."""
    kind = told.kind
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
    """Paragraphs in 79 columns; lines that are indented stay as they are."""
    paragraphs = cleandoc(text).split("\n\n")
    return "\n\n".join(
        part if "\n " in part or part.startswith(" ") else textwrap.fill(part, 79)
        for part in paragraphs
    )

"""Kinds of option values: validation, parsing and formatting.

A value has the same kind on the command line, on the page, and in scenarios, recordings and trial
files, and is refused with the same message. `parse` and `from_json` read exactly what `format` and
`to_json` write.
"""

from __future__ import annotations

import math
import numbers
import pathlib
import unicodedata
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar

from app.words import (
    OptionError,
    format_length,
    format_speed,
    format_turn,
    parse_length,
    parse_place,
    parse_speed,
    parse_turn,
)

SEEDS = (0, 2**63 - 1)  # non-negative 64-bit integers
FARTHEST = 2.0  # of a place from its frame's origin [m]; a larger one suggests a wrong unit
MOST_TURN = math.radians(720.0)  # in either direction, about each axis


class Kind:
    """A kind of values; this one is any text. Subclasses override the methods documented here.

    Attributes:
        metavar: placeholder of a value in the help text.
        wanted: description of the JSON value, for errors.
        json: Python types of the JSON value.
    """

    metavar: str = "TEXT"
    wanted: str = "a text"
    json: ClassVar[tuple[type, ...]] = (str,)

    def check(self, name: str, value: Any) -> None:
        """Validate a value; `name` is used in the message.

        Raises:
            OptionError: with the value and what is valid.
        """

    def parse(self, text: str) -> Any:
        """The value of a word of the command line, not validated.

        Raises:
            OptionError: with the word and how to write it.
        """
        return text

    def format(self, value: Any) -> str:
        """The word that `parse` reads back."""
        return str(value)

    def from_json(self, value: Any) -> Any:
        """The value of a JSON value: a word as on the command line, except numbers and switches.

        Raises:
            OptionError: with the expected type.
        """
        if type(value) not in self.json:
            raise OptionError(f"must be {self.wanted}")
        return self.parse(value) if isinstance(value, str) else value

    def to_json(self, value: Any) -> Any:
        """What `from_json` reads back."""
        return self.format(value) if str in self.json else value


@dataclass(frozen=True)
class Number(Kind):
    """A number from low to high, in SI units; the page shows it in `unit`."""

    low: float
    high: float
    unit: str = ""

    metavar, wanted = "NUMBER", "a number"
    json: ClassVar[tuple[type, ...]] = (int, float)

    @property
    def shown(self) -> float:
        """Factor from SI to `unit`."""
        return {"mm": 1e3, "mm/s": 1e3, "µm": 1e6}.get(self.unit, 1.0)

    def check(self, name: str, value: Any) -> None:
        low, high = self.text(self.low), self.text(self.high)
        if not isinstance(value, numbers.Real) or isinstance(value, bool):
            raise OptionError(f"{name} must be a number from {low} to {high}, not {shown(value)}")
        try:
            number = float(value)
        except OverflowError:  # a whole number of more than 308 digits
            number = -math.inf if str(value).startswith("-") else math.inf
        if not self.low <= number <= self.high:
            raise OptionError(f"{name} {self.text(number)} is outside {low} to {high}")

    def clamped(self, name: str, value: float) -> float:
        """The nearest value in the range; NaN and other types are refused as by `check`."""
        if not isinstance(value, numbers.Real) or isinstance(value, bool) or value != value:
            self.check(name, value)
        return float(min(max(value, self.low), self.high))

    def text(self, value: float) -> str:
        """A value with its unit, for messages."""
        return f"{value:g} {self.unit}" if self.unit else f"{value:g}"

    def parse(self, text: str) -> float:
        try:
            return float(text)
        except ValueError:
            raise OptionError(f"{shown(text)} is not a number") from None

    def format(self, value: float) -> str:
        return repr(float(value))

    def from_json(self, value: Any) -> float:
        return float(super().from_json(value))


@dataclass(frozen=True)
class Length(Number):
    """A length [m]."""

    unit: str = "mm"

    metavar, wanted = "LENGTH", 'a text such as "5mm"'
    json: ClassVar[tuple[type, ...]] = (str,)

    def text(self, value: float) -> str:
        """In mm or um."""
        return format_length(value) if math.isfinite(value) else f"{value:g}"

    def parse(self, text: str) -> float:
        return parse_length(text)

    def format(self, value: float) -> str:
        """In mm or um if that is exact, else in metres with all digits."""
        return _exact(value, format_length, parse_length, lambda x: f"{float(x)!r}m")


@dataclass(frozen=True)
class Speed(Number):
    """A speed [m/s]; a number in JSON, as older files have it, is in m/s."""

    unit: str = "mm/s"

    metavar, wanted = "SPEED", 'a text such as "100mm/s"'
    json: ClassVar[tuple[type, ...]] = (str, int, float)

    def text(self, value: float) -> str:
        """In m/s."""
        return f"{value:g} m/s"

    def parse(self, text: str) -> float:
        return parse_speed(text)

    def format(self, value: float) -> str:
        """In mm/s if that is exact, else in m/s with all digits."""
        return _exact(value, format_speed, parse_speed, lambda x: f"{float(x)!r}m/s")


@dataclass(frozen=True)
class Whole(Kind):
    """A whole number from low to high."""

    low: int
    high: int

    metavar, wanted, json = "INT", "a whole number", (int,)

    def check(self, name: str, value: Any) -> None:
        if not isinstance(value, numbers.Integral) or isinstance(value, bool):
            raise OptionError(
                f"{name} must be a whole number from {self.low} to {self.high}, not {shown(value)}"
            )
        if not self.low <= int(value) <= self.high:
            raise OptionError(f"{name} {shown(int(value))} is outside {self.low} to {self.high}")

    def parse(self, text: str) -> int:
        try:
            return int(text)
        except ValueError:
            raise OptionError(f"{shown(text)} is not a whole number") from None


@dataclass
class OneOf(Kind):
    """One of the known names; `what` is used in messages."""

    what: str
    known: tuple[str, ...]

    def __post_init__(self) -> None:
        self.metavar = "|".join(self.known)

    def check(self, name: str, value: Any) -> None:
        if value not in self.known:
            said = f"'{value}'" if isinstance(value, str) else shown(value)
            said = said if len(said) <= 60 else f"{said[:57]}…"
            raise OptionError(f"unknown {self.what} {said}: choose one of {', '.join(self.known)}")


class Frame(OneOf):
    """The name of a patient frame, in upper or lower case."""

    def parse(self, text: str) -> str:
        return text.upper()


@dataclass(frozen=True)
class Text(Kind):
    """One line of printable characters."""

    most: int

    def check(self, name: str, value: Any) -> None:
        sound = isinstance(value, str) and all(
            c.isprintable() or unicodedata.category(c) == "Zs" for c in value
        )
        if not sound or not 0 < len(value) <= self.most:
            raise OptionError(
                f"{name} must be one line of 1 to {self.most} printable characters, "
                f"not {shown(value)}"
            )


@dataclass(frozen=True)
class File(Text):
    """A name or path, with any characters that file systems allow."""

    most: int = 4096
    metavar: str = "FILE"

    def check(self, name: str, value: Any) -> None:
        if not isinstance(value, str) or not 0 < len(value) <= self.most or "\0" in value:
            raise OptionError(
                f"{name} must be a path of 1 to {self.most} characters without a NUL, "
                f"not {shown(value)}"
            )


@dataclass(frozen=True)
class Path(File):
    """A `pathlib.Path` of a file or folder."""

    metavar: str = "PATH"

    def check(self, name: str, value: Any) -> None:
        super().check(name, None if value is None else str(value))

    def parse(self, text: str) -> pathlib.Path:
        return pathlib.Path(text)


class Switch(Kind):
    """On or off; the command line has `--name` and `--no-name`."""

    wanted, json = "true or false", (bool,)

    def check(self, name: str, value: Any) -> None:
        if not isinstance(value, bool):
            raise OptionError(f"{name} must be true or false, not {shown(value)}")


class Place(Kind):
    """Three coordinates [m], at most `FARTHEST` from the origin."""

    metavar, wanted = "X,Y,Z", 'a text such as "0,-1cm,-12cm"'

    def check(self, name: str, value: Any) -> None:
        _three(name, value, "lengths")
        if not math.hypot(*value) <= FARTHEST:
            raise OptionError(
                f"{name} {','.join(f'{x:g}m' for x in value)} is more than {FARTHEST:g} m from "
                "the origin"
            )

    def parse(self, text: str) -> tuple[float, float, float]:
        return parse_place(text)

    def format(self, value: tuple[float, float, float]) -> str:
        return ",".join(map(Length(0.0, FARTHEST).format, value))


class Turn(Kind):
    """Three angles [rad], each at most `MOST_TURN` either way."""

    metavar, wanted = "DEG,DEG,DEG", 'a text such as "0,0,90"'

    def check(self, name: str, value: Any) -> None:
        _three(name, value, "angles")
        if not all(abs(angle) <= MOST_TURN for angle in value):
            most = math.degrees(MOST_TURN)
            raise OptionError(
                f"{name} {','.join(f'{math.degrees(x):g}' for x in value)} is outside "
                f"-{most:g} to {most:g} degrees about an axis"
            )

    def parse(self, text: str) -> tuple[float, float, float]:
        return parse_turn(text)

    def format(self, value: tuple[float, float, float]) -> str:
        """In degrees if that is exact, else in radians with all digits."""
        return _exact(
            value, format_turn, parse_turn, lambda turn: ",".join(f"{float(x)!r}rad" for x in turn)
        )


@dataclass
class Maybe(Kind):
    """A value of another kind, or None, which is written as `word` if that is given."""

    of: Kind
    word: str = ""

    def __post_init__(self) -> None:
        self.metavar = f"{self.word}|{self.of.metavar}" if self.word else self.of.metavar
        self.wanted = f"{self.of.wanted} or " + (f'"{self.word}"' if self.word else "null")

    def check(self, name: str, value: Any) -> None:
        if value is not None:
            self.of.check(name, value)

    def from_json(self, value: Any) -> Any:
        if value is None and not self.word:
            return None
        if type(value) not in self.of.json:
            raise OptionError(f"must be {self.wanted}")
        return self.parse(value) if isinstance(value, str) else self.of.from_json(value)

    def parse(self, text: str) -> Any:
        if not self.word:
            return self.of.parse(text)
        if text.strip().lower() == self.word:
            return None
        try:
            return self.of.parse(text)
        except OptionError as error:
            raise OptionError(f"{error}; or write {self.word}") from None

    def format(self, value: Any) -> str:
        return (self.word or "None") if value is None else self.of.format(value)

    def to_json(self, value: Any) -> Any:
        return (self.word or None) if value is None else self.of.to_json(value)


@dataclass
class Many(Kind):
    """A tuple of one or more values of another kind; on the command line, consecutive words."""

    more: ClassVar[str] = " …"

    of: Kind

    def __post_init__(self) -> None:
        self.metavar = f"{self.of.metavar}{self.more}"

    def check(self, name: str, value: Any) -> None:
        if not isinstance(value, tuple) or not value:
            raise OptionError(f"{name} must have one value or more, not {shown(value)}")
        for one in value:
            self.of.check(name, one)


class Repeated(Many):
    """A tuple of any number of values; on the command line, the option is repeated."""

    more = ""

    def check(self, name: str, value: Any) -> None:
        for one in value:
            self.of.check(name, one)


class Listed(Many):
    """A tuple of one or more different values; on the command line, separated by commas."""

    more = ",…"

    def parse(self, text: str) -> tuple[Any, ...]:
        words = [word.strip() for word in text.split(",") if word.strip()]
        return tuple(dict.fromkeys(map(self.of.parse, words)))

    def format(self, value: tuple[Any, ...]) -> str:
        return ",".join(map(self.of.format, value))


def bare(kind: Kind) -> Kind:
    """The kind of the values that are not None."""
    return kind.of if isinstance(kind, Maybe) else kind


def shown(value: Any) -> str:
    """A value for a message: one short line."""
    text = ascii(value)
    return text if len(text) <= 60 else f"{text[:57]}…"


def _exact(
    value: Any,
    write: Callable[[Any], str],
    read: Callable[[str], Any],
    all_digits: Callable[[Any], str],
) -> str:
    text = write(value)
    return text if read(text) == value else all_digits(value)


def _three(name: str, value: Any, what: str) -> None:
    sound = (
        isinstance(value, tuple)
        and len(value) == 3
        and all(isinstance(x, numbers.Real) and not isinstance(x, bool) for x in value)
        and all(isinstance(x, float) or abs(x) < 2**63 for x in value)  # convertible to float
    )
    if not sound:
        raise OptionError(f"{name} must be three {what} x, y, z, not {shown(value)}")

"""What a value may be: ranges of numbers, choices of names, lengths of texts.

A dataclass whose values come from outside keeps a table of a limit for each of its fields, and
calls `check` when one is made: on the command line, in a scenario, in a recording's header and in a
trial's file the same value is refused with the same words. A field without a limit is refused too.
"""

from __future__ import annotations

import dataclasses
import math
import numbers
import unicodedata
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol

from app.words import OptionError, format_length

SEEDS = (0, 2**63 - 1)  # what a signed whole number of 64 bits has from 0
FARTHEST = 2.0  # [m] of a place from the origin it is given in; farther is a slip of the unit
MOST_TURN = math.radians(720.0)  # either way, about each axis


class Limit(Protocol):
    """What the value of one setting may be."""

    def check(self, name: str, value: Any) -> None:
        """Refuse a value by the setting's name.

        Raises:
            OptionError: naming the value and what is valid.
        """


@dataclass(frozen=True)
class Number:
    """A number from low to high, in the setting's unit; with `optional` also None."""

    low: float
    high: float
    optional: bool = False
    unit: str = ""

    def check(self, name: str, value: Any) -> None:
        """See `Limit.check`."""
        if value is None and self.optional:
            return
        low, high = self.text(self.low), self.text(self.high)
        if not isinstance(value, numbers.Real) or isinstance(value, bool):
            raise OptionError(f"{name} must be a number from {low} to {high}, not {shown(value)}")
        try:
            number = float(value)
        except OverflowError:  # a whole number of more than 308 digits
            number = -math.inf if str(value).startswith("-") else math.inf
        if not self.low <= number <= self.high:
            raise OptionError(f"{name} {self.text(number)} is outside {low} to {high}")

    def text(self, value: float) -> str:
        """A value as one would write it."""
        return f"{value:g} {self.unit}" if self.unit else f"{value:g}"


class Length(Number):
    """A length [m]."""

    def text(self, value: float) -> str:
        """In mm or um; what is no length at all as it is."""
        return format_length(value) if math.isfinite(value) else f"{value:g}"


@dataclass(frozen=True)
class Whole:
    """A whole number from low to high; with `optional` also None."""

    low: int
    high: int
    optional: bool = False

    def check(self, name: str, value: Any) -> None:
        """See `Limit.check`."""
        if value is None and self.optional:
            return
        if not isinstance(value, numbers.Integral) or isinstance(value, bool):
            raise OptionError(
                f"{name} must be a whole number from {self.low} to {self.high}, not {shown(value)}"
            )
        if not self.low <= int(value) <= self.high:
            raise OptionError(f"{name} {shown(int(value))} is outside {self.low} to {self.high}")


@dataclass(frozen=True)
class OneOf:
    """One of the known names; `kind` is what they are names of. With `optional` also None."""

    kind: str
    known: tuple[str, ...]
    optional: bool = False

    def check(self, name: str, value: Any) -> None:
        """See `Limit.check`."""
        if value is None and self.optional:
            return
        if value not in self.known:
            said = f"'{value}'" if isinstance(value, str) else shown(value)
            said = said if len(said) <= 60 else f"{said[:57]}…"
            raise OptionError(f"unknown {self.kind} {said}: choose one of {', '.join(self.known)}")


@dataclass(frozen=True)
class Text:
    """One line of characters that can be shown; with `optional` also None."""

    most: int
    optional: bool = False

    def check(self, name: str, value: Any) -> None:
        """See `Limit.check`."""
        if value is None and self.optional:
            return
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
    """A file's path or a name: whatever a system allows, line breaks too; None with `optional`."""

    most: int = 4096

    def check(self, name: str, value: Any) -> None:
        """See `Limit.check`."""
        if value is None and self.optional:
            return
        if not isinstance(value, str) or not 0 < len(value) <= self.most or "\0" in value:
            raise OptionError(
                f"{name} must be a path of 1 to {self.most} characters without a NUL, "
                f"not {shown(value)}"
            )


@dataclass(frozen=True)
class Path(File):
    """A `pathlib.Path` of a file or folder; with `optional` also None."""

    def check(self, name: str, value: Any) -> None:
        """See `Limit.check`."""
        super().check(name, None if value is None else str(value))


class Switch:
    """On or off."""

    def check(self, name: str, value: Any) -> None:
        """See `Limit.check`."""
        if not isinstance(value, bool):
            raise OptionError(f"{name} must be true or false, not {shown(value)}")


@dataclass(frozen=True)
class Place:
    """Three coordinates [m], together at most `FARTHEST` from the origin; None with `optional`."""

    optional: bool = False

    def check(self, name: str, value: Any) -> None:
        """See `Limit.check`."""
        if value is None and self.optional:
            return
        _three(name, value, "lengths")
        if not math.hypot(*value) <= FARTHEST:
            raise OptionError(
                f"{name} {','.join(f'{x:g}m' for x in value)} is more than {FARTHEST:g} m from "
                "the origin"
            )


class Turn:
    """Three angles [rad], each at most `MOST_TURN` either way."""

    def check(self, name: str, value: Any) -> None:
        """See `Limit.check`."""
        _three(name, value, "angles")
        if not all(abs(angle) <= MOST_TURN for angle in value):
            most = math.degrees(MOST_TURN)
            raise OptionError(
                f"{name} {','.join(f'{math.degrees(x):g}' for x in value)} is outside "
                f"-{most:g} to {most:g} degrees about an axis"
            )


def _three(name: str, value: Any, what: str) -> None:
    sound = (
        isinstance(value, tuple)
        and len(value) == 3
        and all(isinstance(x, numbers.Real) and not isinstance(x, bool) for x in value)
    )
    if not sound:
        raise OptionError(f"{name} must be three {what} x, y, z, not {shown(value)}")


def check(settings: Any, limits: Mapping[str, Limit]) -> None:
    """Refuse a dataclass's value that its limit does not allow.

    Raises:
        OptionError: by the field's name.
        KeyError: a field has no limit.
    """
    for field in dataclasses.fields(settings):
        limits[field.name].check(field.name, getattr(settings, field.name))


def check_object(what: str, content: Any, limits: Mapping[str, Limit]) -> None:
    """Refuse a JSON object that does not have just these keys, each with a value in its limit.

    Raises:
        OptionError: by the key; `what` is what to call the object.
    """
    if not isinstance(content, dict):
        raise OptionError(f"{what} must be a JSON object {{…}}, not {shown(content)}")
    for key in content:
        if key not in limits:
            raise OptionError(f"{what} has an unknown key {shown(key)}: it has {', '.join(limits)}")
    for key, limit in limits.items():
        if key not in content:
            raise OptionError(f"{what} has no '{key}'")
        limit.check(key, content[key])


def shown(value: Any) -> str:
    """A value in a message: short, and of one line whatever it is."""
    text = ascii(value)
    return text if len(text) <= 60 else f"{text[:57]}…"

"""Kinds made of another kind: optional values, and several."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

from app.kinds.base import Kind, shown
from app.words import OptionError


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
        if value == (self.word or None):
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
    wanted, json = "a list", (list,)

    def check(self, name: str, value: Any) -> None:
        if not isinstance(value, tuple):
            raise OptionError(f"{name} must be several values, not {shown(value)}")
        for one in value:
            self.of.check(name, one)

    def from_json(self, value: Any) -> tuple[Any, ...]:
        return tuple(map(self.of.from_json, super().from_json(value)))

    def to_json(self, value: tuple[Any, ...]) -> list[Any]:
        return list(map(self.of.to_json, value))


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

"""Names, lines of text and paths."""

from __future__ import annotations

import pathlib
import re
import unicodedata
from dataclasses import dataclass
from typing import Any

from app.kinds.base import Kind, shown
from app.words import OptionError


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


class Colour(Kind):
    """A colour of three bytes in hexadecimal digits, such as #cc8844."""

    metavar, wanted = "#RRGGBB", 'a text such as "#cc8844"'

    def check(self, name: str, value: Any) -> None:
        if not isinstance(value, str) or not re.fullmatch("#[0-9a-f]{6}", value):
            raise OptionError(
                f"{name} must be a colour such as #cc8844, six hexadecimal digits after #, "
                f"not {shown(value)}"
            )

    def parse(self, text: str) -> str:
        return text.lower()


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

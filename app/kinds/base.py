"""A kind of option values, and switches."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, ClassVar

from app.words import OptionError


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


class Switch(Kind):
    """On or off; the command line has `--name` and `--no-name`."""

    wanted, json = "true or false", (bool,)

    def check(self, name: str, value: Any) -> None:
        if not isinstance(value, bool):
            raise OptionError(f"{name} must be true or false, not {shown(value)}")


def shown(value: Any) -> str:
    """A value for a message: one short line."""
    text = ascii(value)
    return text if len(text) <= 60 else f"{text[:57]}…"


def exact(
    value: Any,
    write: Callable[[Any], str],
    read: Callable[[str], Any],
    all_digits: Callable[[Any], str],
) -> str:
    """What `write` gives if `read` gives the value back, else the value with all digits."""
    text = write(value)
    return text if read(text) == value else all_digits(value)

"""A single-value mailbox between threads."""

from __future__ import annotations

from typing import Generic, TypeVar

T = TypeVar("T")


class Mailbox(Generic[T]):
    """Holds the newest value put into it. Neither side waits for the other.

    Assigning an attribute is atomic in Python, so no lock is needed; the values must be immutable,
    since both sides keep references to them.
    """

    __slots__ = ("_value",)

    def __init__(self, value: T | None = None) -> None:
        self._value = value

    def put(self, value: T) -> None:
        """Replace the value, whether or not it was read."""
        self._value = value

    def get(self) -> T | None:
        """The newest value, or None if there never was one. Reading does not remove it."""
        return self._value

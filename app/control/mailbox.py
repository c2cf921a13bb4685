"""One value handed from one thread to another; the newest one wins."""

from __future__ import annotations

from typing import Generic, TypeVar

T = TypeVar("T")


class Mailbox(Generic[T]):
    """Holds the newest value put into it. Neither side ever waits for the other.

    Replacing an attribute is a single step for every reader of a Python object, so no lock is
    needed; the values themselves must be frozen, since both sides keep references to them.
    """

    __slots__ = ("_value",)

    def __init__(self, value: T | None = None) -> None:
        self._value = value

    def put(self, value: T) -> None:
        """Replace the value; what was not read in between is gone."""
        self._value = value

    def get(self) -> T | None:
        """The newest value, or None if there never was one. Reading does not remove it."""
        return self._value

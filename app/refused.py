"""The exception for refused orders."""

from __future__ import annotations


class Refused(ValueError):
    """An order is refused; the message says why, and the state is unchanged."""

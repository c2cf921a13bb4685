"""What is said to whoever asked for something that is not done."""

from __future__ import annotations


class Refused(ValueError):
    """Input that is not acted upon; the message says why. What went on before goes on."""

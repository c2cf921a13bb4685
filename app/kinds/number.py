"""Numbers, lengths, speeds and whole numbers."""

from __future__ import annotations

import math
import numbers
from dataclasses import dataclass
from typing import Any, ClassVar

from app.kinds.base import Kind, exact, shown
from app.words import OptionError, format_length, format_speed, parse_length, parse_speed

SEEDS = (0, 2**63 - 1)  # non-negative 64-bit integers


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
        return exact(value, format_length, parse_length, lambda x: f"{float(x)!r}m")


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
        return exact(value, format_speed, parse_speed, lambda x: f"{float(x)!r}m/s")


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

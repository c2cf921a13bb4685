"""Positions and rotations."""

from __future__ import annotations

import contextlib
import math
import numbers
from dataclasses import dataclass
from typing import Any, ClassVar

from app.kinds.base import Kind, exact, shown
from app.kinds.number import Length
from app.kinds.text import File
from app.words import OptionError, format_turn, parse_place, parse_turn

FARTHEST = 2.0  # of a place from its frame's origin [m]; a larger one suggests a wrong unit
MOST_TURN = math.radians(720.0)  # in either direction, about each axis


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


@dataclass(frozen=True)
class Points(Kind):
    """Several places (tuple of three coordinates [m] each), or the path of a file that has them."""

    least: int
    most: int

    metavar, wanted = "FILE", 'the name of a file, or a list of texts such as "0,-1cm,-12cm"'
    json: ClassVar[tuple[type, ...]] = (str, list)

    def check(self, name: str, value: Any) -> None:
        if isinstance(value, str):
            File().check(name, value)
            return
        if not isinstance(value, tuple) or not self.least <= len(value) <= self.most:
            said = f"{len(value)}" if isinstance(value, tuple) else shown(value)
            raise OptionError(
                f"{name} must be {self.least} to {self.most} points, or a file, not {said}"
            )
        for number, one in enumerate(value, start=1):
            Place().check(f"{name} {number}", one)

    def parse(self, text: str) -> str | tuple[tuple[float, float, float], ...]:
        """A path; or places that are separated by semicolons, if all are such."""
        if ";" in text:
            with contextlib.suppress(OptionError):
                return tuple(map(Place().parse, text.split(";")))
        return text

    def format(self, value: Any) -> str:
        if isinstance(value, str):
            return value if self.parse(value) == value else f"./{value}"
        return ";".join(map(Place().format, value))

    def from_json(self, value: Any) -> Any:
        if not isinstance(value, list):
            return super().from_json(value)
        return tuple(map(Place().from_json, value))

    def to_json(self, value: Any) -> Any:
        return value if isinstance(value, str) else [Place().format(one) for one in value]


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
        return exact(
            value, format_turn, parse_turn, lambda turn: ",".join(f"{float(x)!r}rad" for x in turn)
        )


def _three(name: str, value: Any, what: str) -> None:
    sound = (
        isinstance(value, tuple)
        and len(value) == 3
        and all(isinstance(x, numbers.Real) and not isinstance(x, bool) for x in value)
        and all(isinstance(x, float) or abs(x) < 2**63 for x in value)  # convertible to float
    )
    if not sound:
        raise OptionError(f"{name} must be three {what} x, y, z, not {shown(value)}")

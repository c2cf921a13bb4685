"""User input: why it is refused, and lengths, speeds, positions and rotations in it."""

from __future__ import annotations

import math
import re

_METRES = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "µm": 1e-6, "μm": 1e-6, "in": 0.0254}
_LENGTH = re.compile(r"([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*([a-zµμ]*)")


class OptionError(ValueError):
    """An invalid setting. The message names the value and the valid choices."""


class Refused(ValueError):
    """An order is refused; the message says why, and the state is unchanged."""


def parse_length(text: str) -> float:
    """A length in metres from text such as `5mm`, `20um` or `0.2in`.

    A number without a unit is refused, except 0: the page shows millimetres, the library uses
    metres.

    Raises:
        OptionError: the text is no length.
    """
    match = _LENGTH.fullmatch(text.strip())
    if match is not None:
        number, unit = float(match.group(1)), match.group(2)
        if unit in _METRES:
            return number * _METRES[unit]
        if not unit and number == 0.0:
            return 0.0
        if not unit:
            number_text = match.group(1)
            raise OptionError(
                f"'{text}' has no unit: write {number_text}mm for millimetres, {number_text}m for "
                "metres (or cm, um, in)"
            )
    raise OptionError(
        f"'{text}' is not a length: write a number and a unit (m, cm, mm, um, in), "
        "such as 5mm, 0.5mm or 20um"
    )


def format_length(value: float | None) -> str:
    """A length in mm or um with six significant digits; `auto` for None."""
    if value is None:
        return "auto"
    for scale, unit in ((1e-3, "mm"), (1e-6, "um")):
        if abs(value) >= 0.01 * scale or unit == "um" or value == 0.0:
            return f"{value / scale:.6g}{unit}"
    raise AssertionError("unreachable")


def parse_speed(text: str) -> float:
    """A speed [m/s] from text such as `100mm/s` or `0.1m/s`."""
    length, slash, _ = text.strip().partition("/")
    try:
        if slash and text.strip().endswith("/s"):
            return parse_length(length)
    except OptionError:
        pass
    raise OptionError(f"'{text}' is not a speed: write a number and mm/s or m/s, such as 100mm/s")


def format_speed(value: float) -> str:
    """A speed in mm/s with six significant digits."""
    return f"{value * 1e3:.6g}mm/s"


def parse_place(text: str) -> tuple[float, float, float]:
    """Three lengths [m] with commas between them, such as `0,-1cm,-12cm`."""
    words = text.split(",")
    if len(words) != 3:
        raise OptionError(
            f"'{text}' is not a place: write x,y,z as three lengths without spaces, "
            "such as 0,-1cm,-12cm"
        )
    return parse_length(words[0]), parse_length(words[1]), parse_length(words[2])


def parse_turn(text: str) -> tuple[float, float, float]:
    """Three angles [rad] with commas between them, in degrees such as `0,0,90`, or as `1.2rad`."""
    try:
        x, y, z = map(_angle, text.split(","))
    except ValueError:
        x = y = z = math.nan
    if not math.isfinite(x + y + z):
        raise OptionError(
            f"'{text}' is not a turn: write degrees about x,y,z as three numbers without spaces, "
            "such as 0,0,90"
        )
    return x, y, z


def _angle(word: str) -> float:
    radians = word.removesuffix("rad")
    return math.radians(float(word)) if radians == word else float(radians)


def format_turn(value: tuple[float, float, float]) -> str:
    """Three angles in degrees with nine significant digits."""
    return ",".join(f"{math.degrees(angle):.9g}" for angle in value)

"""Kinds of option values: validation, parsing and formatting.

A value has the same kind on the command line, on the page, and in scenarios, recordings and trial
files, and is refused with the same message. `parse` and `from_json` read exactly what `format` and
`to_json` write.
"""

from app.kinds.base import Kind, Switch, shown
from app.kinds.combined import Listed, Many, Maybe, Repeated, bare
from app.kinds.links import Device, Share, Time
from app.kinds.number import SEEDS, Length, Number, Speed, Whole
from app.kinds.space import FARTHEST, Place, Points, Turn
from app.kinds.text import Colour, File, Frame, OneOf, Path, Text

__all__ = [
    "FARTHEST", "SEEDS", "Colour", "Device", "File", "Frame", "Kind", "Length", "Listed", "Many",
    "Maybe", "Number", "OneOf", "Path", "Place", "Points", "Repeated", "Share", "Speed", "Switch",
    "Text", "Time", "Turn", "Whole", "bare", "shown",
]  # fmt: skip

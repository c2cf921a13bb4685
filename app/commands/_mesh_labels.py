"""The labels of a label map as a table."""

from __future__ import annotations

import sys
import warnings
from dataclasses import dataclass
from typing import TYPE_CHECKING

from app.console import console, count
from app.kinds import File, Maybe, Place
from app.options import Checked, option

if TYPE_CHECKING:
    from meshes import Label

_LITRE = 1e-3  # [m³]


@dataclass(frozen=True)
class Labels(Checked):
    """Print the labels of a label map: number, name, colour, voxels, volume and extent.

    The extent is that of the box around the label in the frame of the surfaces, x × y × z.
    Exit code 0: printed; 2: it could not be read, or is no label map."""

    source: str = option(
        File(),
        about="NIfTI, MGH, NRRD (also .seg.nrrd) or MetaImage file, or a folder of PNG slices.",
        positional=True,
    )
    table: str | None = option(
        Maybe(File()), None,
        "Colour table with names and colours (3D Slicer, FreeSurfer, ITK-SNAP); without it, one of "
        "the map's name beside it.",
    )  # fmt: skip
    spacing: tuple[float, float, float] | None = option(
        Maybe(Place()), None,
        "Of PNG slices: between columns, rows and slices, such as 0.5mm,0.5mm,1mm.",
    )  # fmt: skip


def print_labels(options: Labels) -> int:
    """Print the table; the notes of the reader on stderr."""
    import meshes

    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        found = meshes.labels(options.source, table=options.table, spacing=options.spacing)
    for warning in caught:
        print(f"vf-sandbox mesh: note: {warning.message}", file=sys.stderr)
    screen = console()
    heads = ("number", "name", "colour", "voxels", "volume", "extent [mm]")
    rows = [heads, *(_row(label) for label in found)]
    widths = [max(len(row[k]) for row in rows) for k in range(len(heads))]
    for row in rows:
        cells = [
            cell.ljust(width) if head in ("name", "colour", "extent [mm]") else cell.rjust(width)
            for head, cell, width in zip(heads, row, widths, strict=True)
        ]
        screen.print("  ".join(cells).rstrip(), markup=False, soft_wrap=True)
    screen.print(f"{options.source}: {count(len(found), 'label')}", markup=False, soft_wrap=True)
    return 0


def _row(label: Label) -> tuple[str, ...]:
    red, green, blue = label.colour or (0, 0, 0)
    colour = f"#{red:02x}{green:02x}{blue:02x}" if label.colour else "–"
    sides = 1e3 * (label.high - label.low)  # [mm]
    extent = " × ".join(f"{side:.4g}" for side in sides) if label.voxels else "–"
    voxels = f"{label.voxels:,}"
    return str(label.number), label.name, colour, voxels, _volume(label.volume), extent


def _volume(volume: float) -> str:
    """A volume [m³] as text: millilitres from 1 ml on, cubic millimetres below."""
    millilitres = volume / _LITRE * 1e3
    return f"{millilitres:,.4g} ml" if millilitres >= 1.0 else f"{1e9 * volume:.4g} mm³"

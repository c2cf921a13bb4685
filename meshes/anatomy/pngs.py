"""Label maps as a stack of PNG files: one slice a file, in order of name."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from meshes.anatomy.colours import Colour, Named
from meshes.errors import MeshError
from meshes.volume.grid import GUESS, LPS_TO_RAS, Stored, check_size

_KINDS = ("1", "L", "P", "I;16", "I;16B", "I", "RGB", "RGBA")


def files(folder: Path) -> list[Path]:
    """The PNG files of a folder, in order of name, numbers in names by their value."""
    found = [one for one in folder.iterdir() if one.suffix.lower() == ".png" and one.is_file()]
    return sorted(found, key=lambda one: _order(one.name))


def _order(name: str) -> list[tuple[int, str]]:
    return [(int(word), "") if word.isdigit() else (-1, word) for word in re.split(r"(\d+)", name)]


def read(
    folder: Path,
    table: Mapping[int, Named],
    spacing: tuple[float, float, float] | None,
    progress: Callable[[float, str], None],
) -> tuple[Stored, dict[int, Colour]]:
    """The label numbers ``(column, row, slice)``, and the colours of the files' palette.

    The value of a pixel is its label: the index into the palette, or the grey value. Pixels of a
    colour image have the label whose colour the table gives.

    Args:
        table: names and colours by label.
        spacing: between columns, rows and slices [m]; None: what the first file says of its pixels.

    Raises:
        MeshError: slices of different sizes or kinds, or a colour that is not in the table.
    """
    paths = files(folder)
    first = _open(paths[0])
    shape = (*first.size, len(paths))
    check_size(shape)
    values = np.zeros(shape, dtype=np.uint16 if first.mode.startswith("I") else np.uint8, order="F")
    numbers = _numbers_by_colour(table) if first.mode in ("RGB", "RGBA") else {}
    if numbers:
        values = np.zeros(shape, dtype=np.int32, order="F")
    palette = _palette(first)
    for k, path in enumerate(paths):
        progress(k / len(paths), f"reading {path.name}")
        picture = _open(path)
        if (picture.size, picture.mode) != (first.size, first.mode):
            raise MeshError(
                f"{path.name} has {picture.size[0]} × {picture.size[1]} pixels of kind "
                f"{picture.mode}, {paths[0].name} {first.size[0]} × {first.size[1]} of kind "
                f"{first.mode}: they are not slices of one label map"
            )
        if _palette(picture) != palette:
            raise MeshError(f"{path.name} has another palette than {paths[0].name}")
        try:
            pixels = np.asarray(picture)
        except (OSError, SyntaxError, ValueError) as error:
            raise MeshError(f"{path.name} is damaged or cut off ({error})") from None
        values[:, :, k] = (_labels(pixels, numbers, path.name) if numbers else pixels).T
    T, notes = _grid(first, spacing)
    return Stored(values, LPS_TO_RAS @ T, None, notes), palette


def _open(path: Path) -> Image.Image:
    try:
        picture = Image.open(path, formats=("PNG",))
    except (OSError, SyntaxError, ValueError, Image.DecompressionBombError) as error:
        raise MeshError(f"{path.name} cannot be read as PNG ({error})") from None
    if picture.mode not in _KINDS:
        kinds = "palette, grey, RGB, RGBA"
        raise MeshError(f"{path.name} has pixels of kind {picture.mode}: choose one of {kinds}")
    return picture


def _palette(picture: Image.Image) -> dict[int, Colour]:
    if picture.mode != "P":
        return {}
    flat = picture.getpalette() or []
    return {k: (flat[3 * k], flat[3 * k + 1], flat[3 * k + 2]) for k in range(len(flat) // 3)}


def _numbers_by_colour(table: Mapping[int, Named]) -> dict[int, int]:
    """Labels by colour, as 65536 red + 256 green + blue; black is the background."""
    if not table:
        raise MeshError(
            "its pictures are in colours: a colour table has to say which label each stands for "
            "(a .ctbl or .txt in the folder)"
        )
    found = {0: 0}
    for number, named in sorted(table.items(), reverse=True):  # of equal colours, the first label
        red, green, blue = named.colour
        found[65536 * red + 256 * green + blue] = number
    return found


def _labels(pixels: NDArray[Any], numbers: Mapping[int, int], name: str) -> NDArray[np.int32]:
    """Labels ``(row, column)`` of colours; transparent pixels are background."""
    wide = pixels.astype(np.int64)
    codes = wide[..., 0] * 65536 + wide[..., 1] * 256 + wide[..., 2]
    if pixels.shape[2] == 4:
        codes[pixels[..., 3] == 0] = 0
    colours, inverse = np.unique(codes, return_inverse=True)
    for code in colours.tolist():
        if code not in numbers:
            red, green, blue = code >> 16, code >> 8 & 255, code & 255
            raise MeshError(f"{name}: the colour {red} {green} {blue} is not in the colour table")
    labels = np.array([numbers[code] for code in colours.tolist()], dtype=np.int32)
    return labels[inverse].reshape(codes.shape)


def _grid(
    first: Image.Image, spacing: tuple[float, float, float] | None
) -> tuple[NDArray[np.float64], tuple[str, ...]]:
    """The affine [mm] with columns to the left, rows to the back, slices upwards (LPS)."""
    notes: tuple[str, ...] = (GUESS.format("a stack of PNG files"),)
    if spacing is None:
        dots = first.info.get("dpi")  # where the file says how large its pixels are
        sides = (25.4 / dots[0], 25.4 / dots[1]) if dots and min(dots) > 0 else (1.0, 1.0)
        spacing = (1e-3 * sides[0], 1e-3 * sides[1], 1e-3 * sides[0])
        said = "slices as far apart as columns" if dots else "1 mm"
        notes = (*notes, f"PNG files do not say how large their voxels are: {said} is taken")
    T = np.diag([*(1e3 * side for side in spacing), 1.0])  # [m] -> [mm]
    return T, notes

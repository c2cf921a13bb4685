"""Size and unit of a mesh file, for the question about its unit."""

from __future__ import annotations

from collections.abc import Callable

import meshes
from app.scene.caught import caught_warnings
from meshes.load import read
from meshes.units import UNITS, UnitNeeded, WrongSize, diagonal, sizes


def measure(path: str, progress: Callable[[str], None]) -> tuple[float, str | None]:
    """The diagonal in the file's unit, and the unit if the file or its format defines it.

    Raises:
        MeshError: the file cannot be read, or its size is not usable in any unit.
    """
    try:
        with caught_warnings() as caught:
            found = read(path, progress=progress)
    except UnitNeeded as asked:
        return asked.diagonal, None
    except WrongSize as wrong:
        if not sizes(wrong.diagonal):
            raise
        return wrong.diagonal, wrong.said
    assumed = any(issubclass(warning.category, meshes.UnitGuess) for warning in caught)
    vertices, _ = found.arrays
    return diagonal(vertices) / UNITS[found.unit], None if assumed else found.unit

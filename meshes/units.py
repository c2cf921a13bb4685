"""The unit of a mesh file: given, assumed from the size, or to be asked for."""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Mapping

import numpy as np
from numpy.typing import NDArray

from meshes.errors import MeshError, UnitGuess

UNITS = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "in": 0.0254}
"""Metres in one of each unit."""

ASSUMED = ("mm", "m")
"""Units assumed for a file that names none, where the size allows only one of them."""

SMALLEST, LARGEST = 1e-4, 10.0  # [m] allowed diagonals


class UnitNeeded(MeshError):
    """A mesh file names no unit, and its size allows several: one has to be given.

    Attributes:
        name: of the file.
        diagonal: of its bounding box, in the file's unit.
        sizes: the diagonal [m] in each unit that is possible.
    """

    def __init__(self, name: str, diagonal: float, sizes: dict[str, float]) -> None:
        super().__init__(name, diagonal, sizes)
        self.name, self.diagonal, self.sizes = name, diagonal, sizes

    def __str__(self) -> str:
        readings = " or ".join(
            f"{shown(size)} from corner to corner if in {unit}" for unit, size in self.sizes.items()
        )
        ways = " or ".join(f"--unit {unit}" for unit in self.sizes)
        return (
            f"{self.name} does not say its unit and may be {readings}: give {ways} "
            '(in Python unit=…, in a scenario "unit")'
        )


class WrongSize(MeshError):
    """A mesh is too small or too large in its unit.

    Attributes:
        diagonal: of its bounding box, in the file's unit.
        said: the unit given by the file or its format's standard, if any.
    """

    def __init__(self, reason: str, diagonal: float, said: str | None) -> None:
        super().__init__(reason, diagonal, said)
        self.diagonal, self.said = diagonal, said

    def __str__(self) -> str:
        return str(self.args[0])


def diagonal(vertices: NDArray[np.float64]) -> float:
    """Of the bounding box of vertices ``(n, 3)``, in their unit; inf where it overflows."""
    with np.errstate(over="ignore", invalid="ignore"):
        return float(np.linalg.norm(np.ptp(vertices, axis=0)))


def sizes(across: float, units: Iterable[str] = UNITS) -> dict[str, float]:
    """The diagonal [m] in each unit in which it is allowed."""
    every = {unit: across * UNITS[unit] for unit in units}
    return {unit: size for unit, size in every.items() if SMALLEST <= size <= LARGEST}


def shown(size: float) -> str:
    """A length [m] as text: ``4.95 mm``, ``1.2 m``."""
    return f"{size:.4g} m" if size >= 1.0 else f"{size * 1e3:.4g} mm"


def resolved_unit(name: str, across: float, unit: str | None, said: str | None = None) -> str:
    """The unit of the file ``name`` whose diagonal, in that unit, is ``across``.

    Args:
        unit: given by the user, which takes precedence; or None.
        said: given by the file or its format's standard; or None.

    Raises:
        UnitNeeded: none is given, and both millimetres and metres are possible.
        WrongSize: below 0.1 mm or above 10 m.

    If none is given and only one of the two is possible, it is assumed, with a `UnitGuess` warning.
    """
    known = unit or said
    possible = sizes(across, ASSUMED if known is None else (known,))
    if len(possible) > 1:
        raise UnitNeeded(name, across, possible)
    if not possible:
        tried = known or ("mm" if across * UNITS["mm"] > LARGEST else "m")
        raise WrongSize(
            f"{name}: {across * UNITS[tried]:.3g} m from corner to corner if its unit is {tried}; "
            f"from 0.1 mm to 10 m is possible (say the unit: {', '.join(UNITS)})",
            across,
            said,
        )
    (only,) = possible
    if known is None:
        warnings.warn(
            f"{name} does not say its unit: with a diagonal of {across:.4g} it is taken to be in "
            f"{only} ({shown(possible[only])}); say the unit ({', '.join(UNITS)}) "
            "if it is another",
            UnitGuess,
            stacklevel=4,
        )
    return only


def choices(across: float, said: str | None = None) -> Mapping[str, str]:
    """Labels of the units to choose from, with the sizes; the file's own unit first."""
    found = sizes(across)
    order = sorted(found, key=lambda unit: unit != said)
    return {
        unit: f"{unit}{', as the file says' * (unit == said)}: {shown(found[unit])} "
        "from corner to corner"
        for unit in order
    }

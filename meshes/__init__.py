"""Meshes for virtual fixtures: the catalogue, loading a user's file, placing it under an arm.

Everything that comes out of this package is in metres.
"""

from meshes.catalogue import Entry, catalogue, names
from meshes.errors import MeshError, UnitGuess
from meshes.health import Finding, Health, health
from meshes.load import FORMATS, UNITS, arrays, load
from meshes.place import Display, display, place, placement
from meshes.repair import Changes, Repaired, repair
from meshes.save import WRITABLE, save
from meshes.skull import planned_cut

__all__ = [
    "FORMATS",
    "UNITS",
    "WRITABLE",
    "Changes",
    "Display",
    "Entry",
    "Finding",
    "Health",
    "MeshError",
    "Repaired",
    "UnitGuess",
    "arrays",
    "catalogue",
    "display",
    "health",
    "load",
    "names",
    "place",
    "placement",
    "planned_cut",
    "repair",
    "save",
]

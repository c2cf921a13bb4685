"""Meshes for virtual fixtures: catalogue, files, health report, repair, placement. Lengths in m."""

from meshes.anatomy.maps import Label
from meshes.anatomy.margins import MarginMap, margin_map, margins
from meshes.anatomy.structures import Structure, labels, structures
from meshes.builtin.catalogue import Entry, absent, catalogue, names, planned_path
from meshes.builtin.deforming import Deforming, deforming
from meshes.checks.health import health
from meshes.checks.repair import Changes, Repaired, repair
from meshes.checks.report import Finding, Health
from meshes.errors import MeshError, UnitGuess
from meshes.formats import FORMATS, WRITABLE, kind
from meshes.frames import FRAMES, frame_description
from meshes.load import Loaded, arrays, load, read
from meshes.path import read_fiducials, read_path
from meshes.place import UPS, Display, Placement, display, place, placement, transformed
from meshes.save import save
from meshes.units import UNITS, UnitNeeded

__all__ = [
    "FORMATS",
    "FRAMES",
    "UNITS",
    "UPS",
    "WRITABLE",
    "Changes",
    "Deforming",
    "Display",
    "Entry",
    "Finding",
    "Health",
    "Label",
    "Loaded",
    "MarginMap",
    "MeshError",
    "Placement",
    "Repaired",
    "Structure",
    "UnitGuess",
    "UnitNeeded",
    "absent",
    "arrays",
    "catalogue",
    "deforming",
    "display",
    "frame_description",
    "health",
    "kind",
    "labels",
    "load",
    "margin_map",
    "margins",
    "names",
    "place",
    "placement",
    "planned_path",
    "read",
    "read_fiducials",
    "read_path",
    "repair",
    "save",
    "structures",
    "transformed",
]

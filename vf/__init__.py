"""Anatomical mesh-based virtual fixtures: the mathematics, headless, in SI units."""

from vf.closest import Feature, closest_point
from vf.conditions import every_plane, paper_planes
from vf.cover import certified_planes
from vf.planes import Planes, Rule
from vf.surface import Contacts, Edge, Surface

__all__ = [
    "Contacts",
    "Edge",
    "Feature",
    "Planes",
    "Rule",
    "Surface",
    "certified_planes",
    "closest_point",
    "every_plane",
    "paper_planes",
]

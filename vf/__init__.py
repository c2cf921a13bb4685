"""Anatomical mesh-based virtual fixtures: the mathematics, headless, in SI units."""

from vf.adjacency import Edge
from vf.controller import Controller
from vf.fixtures import RULES, Fixture, MeshFixture
from vf.motion import Motion
from vf.planes import Planes, Rule
from vf.qp.least_squares import ConstrainedLeastSquares, Solution
from vf.qp.solver import SOLVERS, Solver
from vf.reasons import Across, Cover, Explanation, TriangleReport, Verdict, explain
from vf.rules.certified import certified_planes
from vf.rules.corridor import CorridorFixture, cutting_direction
from vf.rules.paper import every_plane, paper_planes
from vf.selftest import check_kernels
from vf.settings import GUARDS, Settings
from vf.status import Status
from vf.surface import Contacts, DeformingSurface, Surface
from vf.tick.haptics import force
from vf.tick.step import Step, Timings
from vf.tree.closest import Feature, closest_point

__version__ = "0.1.0"

__all__ = [
    "GUARDS",
    "RULES",
    "SOLVERS",
    "Across",
    "ConstrainedLeastSquares",
    "Contacts",
    "Controller",
    "CorridorFixture",
    "Cover",
    "DeformingSurface",
    "Edge",
    "Explanation",
    "Feature",
    "Fixture",
    "MeshFixture",
    "Motion",
    "Planes",
    "Rule",
    "Settings",
    "Solution",
    "Solver",
    "Status",
    "Step",
    "Surface",
    "Timings",
    "TriangleReport",
    "Verdict",
    "certified_planes",
    "check_kernels",
    "closest_point",
    "cutting_direction",
    "every_plane",
    "explain",
    "force",
    "paper_planes",
]

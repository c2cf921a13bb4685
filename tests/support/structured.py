"""A scene of a cube and three balls beside it, in files."""

from __future__ import annotations

from pathlib import Path

import numpy as np

import meshes
from app.settings import Options
from app.structure import Structure

NAMES = ("dura", "nerve", "vessel")
RADIUS = 5e-3  # of each ball [m]
# Centres in the cube's frame, above its top face and beside the tool's start [m].
CENTRES = {
    "dura": (0.012, 0.0, 0.028), "nerve": (-0.012, 0.0, 0.028), "vessel": (0.0, 0.014, 0.028),
}  # fmt: skip
MARGINS = {"dura": 0.5e-3, "nerve": 1e-3, "vessel": 2e-3}


def balls(folder: Path) -> Path:
    """A folder with a file for each ball, in millimetres."""
    folder.mkdir(exist_ok=True)
    vertices, faces = meshes.arrays("sphere")
    unit = vertices / np.linalg.norm(vertices, axis=1).max()
    for name, centre in CENTRES.items():
        meshes.save(folder / f"{name}.stl", RADIUS * unit + np.array(centre), faces, unit="mm")
    return folder


def options(folder: Path, **more: object) -> Options:
    """The cube and the balls, each with its margin; a point for a tool."""
    structures = tuple(
        Structure(str(folder / f"{name}.stl"), margin=MARGINS[name], unit="mm") for name in NAMES
    )
    return Options(**{"mesh": "cube", "robot": "point", "structures": structures, **more})

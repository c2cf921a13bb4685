"""Planned paths from text files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from meshes.errors import MeshError

MOST = 100_000  # points


def read_path(file: str | Path) -> NDArray[np.float64]:
    """A planned path: ``(k, 3)`` points [m] from a text file with x, y, z [mm] in a line.

    Numbers are separated by blanks or commas; # begins a comment.

    Raises:
        MeshError: no such file, a line that is no point, fewer than two points.
    """
    try:
        lines = Path(file).read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise MeshError(f"cannot read a path from {file}: {error}") from None
    points: list[list[float]] = []
    for number, line in enumerate(lines, start=1):
        words = line.partition("#")[0].replace(",", " ").split()
        if not words:
            continue
        try:
            point = [float(word) for word in words]
        except ValueError:
            point = []
        if len(point) != 3 or not np.isfinite(point).all() or len(points) == MOST:
            raise MeshError(
                f"{file}, line {number}: {line[:60]!r} is not x y z of a point of a path in mm"
            )
        points.append(point)
    if len(points) < 2:
        raise MeshError(f"{file} has {len(points)} points: a path needs two or more")
    return np.array(points) * 1e-3  # [mm] -> [m]

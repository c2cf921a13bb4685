"""Points from text files: planned paths, fiducials."""

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
    points = _read(file, "path", MOST)
    if len(points) < 2:
        raise MeshError(f"{file} has {len(points)} points: a path needs two or more")
    return points


def read_fiducials(file: str | Path, most: int = MOST) -> NDArray[np.float64]:
    """Fiducials: ``(N, 3)`` points [m], at most `most`, from a text file as that of `read_path`.

    Raises:
        MeshError: no such file, a line that is no point, fewer than three points, too many.
    """
    points = _read(file, "set of fiducials", most)
    if len(points) < 3:
        raise MeshError(f"{file} has {len(points)} points: a registration needs three or more")
    return points


def _read(file: str | Path, what: str, most: int) -> NDArray[np.float64]:
    try:
        lines = Path(file).read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise MeshError(f"cannot read a {what} from {file}: {error}") from None
    points: list[list[float]] = []
    for number, line in enumerate(lines, start=1):
        words = line.partition("#")[0].replace(",", " ").split()
        if not words:
            continue
        try:
            point = [float(word) for word in words]
        except ValueError:
            point = []
        if len(point) != 3 or not np.isfinite(point).all():
            raise MeshError(
                f"{file}, line {number}: {line[:60]!r} is not x y z of a point of a {what} in mm"
            )
        if len(points) == most:
            raise MeshError(f"{file}, line {number}: a {what} has {most:,} points at most")
        points.append(point)
    return np.array(points, dtype=np.float64).reshape(-1, 3) * 1e-3  # [mm] -> [m]

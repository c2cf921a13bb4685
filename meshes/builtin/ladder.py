"""One shape at the triangle counts of the paper's section IV-B, for run-time measurements.

A closed shape of genus 0 is decimated to 61,836 triangles; two Loop subdivisions make the master of
989,376 (midpoint subdivision would leave sixteen coplanar facets per parent and distort the
statistics of edges). The smaller meshes are decimated from the master; 51,978 triangles of a closed
genus-0 mesh have the paper's 25,991 vertices.
"""

from __future__ import annotations

import contextlib
import hashlib
import importlib
import importlib.util
import io
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from importlib.metadata import version
from pathlib import Path

import fast_simplification
import numpy as np
import trimesh
from numpy.typing import NDArray

from meshes.builtin import cache, packaged
from meshes.content import Arrays
from meshes.errors import MeshError
from meshes.load import arrays

SIZES = (51_978, 103_956, 207_912, 415_824, 989_376)
"""Triangles of the paper's meshes, smallest first."""

BUNNY = 0.1557
"""Longest side [m] of the Stanford bunny's bounding box, for which the paper's radii are given."""

_SUBDIVISIONS = 2  # each makes four triangles of one


@dataclass(frozen=True)
class Source:
    """Where a ladder's shape comes from.

    Attributes:
        name: for the reader of a result.
        make: vertices (n, 3) in any unit and faces (m, 3), deterministic.
        key: of the cached meshes.
    """

    name: str
    make: Callable[[], Arrays]
    key: str


def source(path: str | os.PathLike[str] | None = None, unit: str | None = None) -> Source:
    """The user's file or catalogue mesh, else an installed package's bunny, else `organic`.

    Raises:
        MeshError: the file cannot be read; see `meshes.arrays`.
    """
    if path is not None:
        shape = arrays(path, unit=unit)
        digest = hashlib.sha256(shape[0].tobytes() + shape[1].tobytes()).hexdigest()[:12]
        return Source(f"{Path(path).name}", lambda: shape, digest)
    if importlib.util.find_spec("pymeshfix") is not None:
        release = version("pymeshfix")
        return Source(
            f"Stanford bunny carried by pymeshfix {release}, its holes closed by it",
            _packaged_bunny,
            f"bunny-{release}",
        )
    return Source("built-in organic shape (no package with a bunny installed)", organic, "organic")


def rungs(
    shape: Source,
    sizes: Sequence[int] = SIZES,
    progress: Callable[[str], None] | None = None,
) -> dict[int, Arrays]:
    """Meshes of the given triangle counts, `BUNNY` long, kept in the user's cache folder.

    The largest of `sizes` is the master, rounded down to a multiple of the subdivisions' factor.
    Keys are the counts reached, exact for closed shapes.

    Args:
        progress: called with a description of each mesh.

    Raises:
        MeshError: the decimation cannot reach a count (an open or very dirty shape).
    """
    say = progress or (lambda _text: None)
    factor = 4**_SUBDIVISIONS
    if min(sizes) < 8 * factor:
        raise MeshError(f"a ladder's rungs have at least {8 * factor} triangles, not {min(sizes)}")
    top = max(sizes) // factor * factor
    tools = f"fs{version('fast-simplification')}-trimesh{version('trimesh')}"
    name = f"ladder-{shape.key}-{top}-{tools}"
    say(f"{top:,} triangles")
    master = cache.cached(name, lambda: _master(shape.make(), top // factor))()
    result = {len(master[1]): master}
    for size in sorted(set(sizes) - {max(sizes)}, reverse=True):
        say(f"{size:,} triangles")
        rung = cache.cached(f"{name}-{size}", partial(_decimated, master, size))()
        result[len(rung[1])] = rung
    return dict(sorted(result.items()))


def organic() -> Arrays:
    """A closed bumpy body with folds and pits, some 150 mm long: 81,920 triangles [m].

    The distance along a unit direction d is 50 mm · (1 + Σ A exp(κ (d·c − 1))) over 28 directions
    distributed evenly: bumps and pits of two widths, without symmetry.
    """
    ball = trimesh.creation.icosphere(6)
    d = np.asarray(ball.vertices)
    k = np.arange(28)
    # A Fibonacci lattice on the sphere.
    height, turn = 1.0 - (2.0 * k + 1.0) / 28, k * np.pi * (3.0 - np.sqrt(5.0))
    ring = np.sqrt(1.0 - height**2)
    centres = np.column_stack([ring * np.cos(turn), ring * np.sin(turn), height])
    amplitude = np.where(k % 2 == 0, 0.16, -0.13) * (1.0 + 0.5 * np.sin(2.4 * k))
    width = np.where(k % 3 == 0, 14.0, 45.0)
    radius = 0.05 * (1.0 + (amplitude * np.exp(width * (d @ centres.T - 1.0))).sum(axis=1))
    return radius[:, None] * d * [1.3, 1.0, 0.9], np.asarray(ball.faces, dtype=np.int64)


def _packaged_bunny() -> Arrays:
    """pymeshfix's example: 99,785 triangles with holes and non-manifold edges, closed by it."""
    # Not a dependency, because of its licence (AGPL); an installed one is used.
    pymeshfix = importlib.import_module("pymeshfix")
    dirty = trimesh.load(packaged.file("pymeshfix", packaged.BUNNY), process=False)
    with contextlib.redirect_stdout(io.StringIO()):
        vertices, faces = pymeshfix.clean_from_arrays(
            np.asarray(dirty.vertices, dtype=np.float64), np.asarray(dirty.faces, dtype=np.int32)
        )
    return np.asarray(vertices, dtype=np.float64), np.asarray(faces, dtype=np.int64)


def _master(shape: Arrays, parents: int) -> Arrays:
    vertices, faces = shape
    if not len(faces):
        raise MeshError("a ladder needs a shape with triangles")
    while len(faces) < parents:
        vertices, faces = trimesh.remesh.subdivide_loop(vertices, faces, iterations=1)
    vertices, faces = _decimated((_sized(vertices), faces), parents)
    vertices, faces = trimesh.remesh.subdivide_loop(vertices, faces, iterations=_SUBDIVISIONS)
    return _sized(np.asarray(vertices, dtype=np.float64)), np.asarray(faces, dtype=np.int64)


def _decimated(mesh: Arrays, size: int) -> Arrays:
    vertices, faces = mesh
    if len(faces) == size:
        return mesh
    # In millimetres: the library's tolerances are absolute.
    points, triangles = fast_simplification.simplify(
        vertices * 1e3, faces.astype(np.int32), target_count=size
    )
    # The last collapse takes two triangles, at an open edge one.
    if not size - 2 <= len(triangles) <= size:
        raise MeshError(
            f"decimating {len(faces):,} triangles to {size:,} left {len(triangles):,}: "
            "a closed manifold shape is needed"
        )
    return np.asarray(points, dtype=np.float64) * 1e-3, np.asarray(triangles, dtype=np.int64)


def _sized(vertices: NDArray[np.float64]) -> NDArray[np.float64]:
    longest = float(np.ptp(vertices, axis=0).max())
    if not longest > 0.0:
        raise MeshError("a ladder needs a shape of some size")
    return vertices * (BUNNY / longest)

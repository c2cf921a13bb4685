"""Generated meshes kept between runs, in the user's cache folder."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path

import numpy as np
import platformdirs

from meshes.atomic import replacing
from meshes.content import Arrays

RECIPES = 1
"""Version of the recipes, part of every key; increased with each change."""


def folder() -> Path:
    """The folder of the files, which exists after the first write."""
    return Path(platformdirs.user_cache_dir("vf-sandbox", appauthor=False)) / "meshes"


def path(name: str) -> Path:
    """The file of one mesh. Triangulations differ between versions of the solid kernel."""
    return folder() / f"{name}-r{RECIPES}-manifold3d-{version('manifold3d')}.npz"


def cached(name: str, make: Callable[[], Arrays]) -> Callable[[], Arrays]:
    """``make``, run once for each user and version, then read from the cache.

    A damaged file is replaced; a folder that cannot be written is no error.
    """

    def read_or_make() -> Arrays:
        file = path(name)
        arrays = _read(file)
        if arrays is None:
            arrays = make()
            with contextlib.suppress(OSError):
                _write(file, arrays)
        return arrays

    return read_or_make


def _read(file: Path) -> Arrays | None:
    """The arrays in ``file``, or None if it is missing or damaged."""
    try:
        with np.load(file, allow_pickle=False) as stored:
            vertices = stored["vertices"]
            faces = stored["faces"].astype(np.int64)
    # A damaged archive raises exceptions of zipfile, zlib or numpy.
    except Exception:
        return None
    sound = (
        vertices.dtype == np.float64
        and vertices.ndim == faces.ndim == 2
        and vertices.shape[1] == faces.shape[1] == 3
        and faces.size > 0
        and faces.min() >= 0
        and faces.max() < len(vertices)
        and bool(np.isfinite(vertices).all())
    )
    return (vertices, faces) if sound else None


def _write(file: Path, arrays: Arrays) -> None:
    file.parent.mkdir(parents=True, exist_ok=True)
    vertices, faces = arrays
    with replacing(file) as stream:
        np.savez(stream, vertices=vertices, faces=faces.astype(np.int32))

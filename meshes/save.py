"""Writing mesh files in the highest precision of their format."""

from __future__ import annotations

import os
from pathlib import Path

from numpy.typing import ArrayLike

from meshes import frames
from meshes.atomic import replacing
from meshes.content import checked_mesh
from meshes.errors import MeshError
from meshes.formats import BY_END, WRITABLE
from meshes.units import UNITS


def save(
    path: str | os.PathLike[str],
    vertices: ArrayLike,
    faces: ArrayLike,
    *,
    unit: str = "mm",
    frame: str | None = None,
    overwrite: bool = False,
) -> None:
    """Write vertices ``(n, 3)`` [m] and faces ``(m, 3)`` to a file in a unit of `meshes.UNITS`.

    The suffix chooses the format. PLY, OBJ and OFF hold double precision; STL and GLB single, and
    STL corners instead of vertices. GLB is always in metres, as its standard says. ``frame``, the
    patient frame that the vertices are in ("RAS", "LPS", or None where it is not known), is written
    as 3D Slicer reads it (`SPACE=RAS`); nothing is transformed. The file is put in place when it is
    complete.

    Raises:
        MeshError: unknown format, unit or frame, an existing file unless ``overwrite``, a folder
            that cannot be written to, or arrays that are no mesh.
    """
    file = Path(path)
    kind = file.suffix[1:].lower()
    check_writable(file, overwrite)
    if unit not in UNITS:
        raise MeshError(f"unknown unit {unit!r}: choose one of {', '.join(UNITS)}")
    frame = frames.chosen(frame)
    v, f = checked_mesh(vertices, faces)
    comment = "vf-sandbox" + (f" {frames.tag(frame)}" if frame else "")
    entry = BY_END[kind]
    assert entry.write is not None  # `check_writable` has refused the others
    content = entry.write(v / (1.0 if entry.in_metres else UNITS[unit]), f, comment)
    try:
        with replacing(file) as stream:
            stream.write(content)
    except OSError as error:
        raise MeshError(f"{file}: cannot be written ({error.strerror or error})") from None


def check_writable(path: str | os.PathLike[str], overwrite: bool = False) -> None:
    """Raise the `MeshError` that `save` would raise for this path, before long work."""
    file = Path(path)
    if file.suffix[1:].lower() not in WRITABLE:
        choices = ", ".join(f".{kind}" for kind in WRITABLE)
        raise MeshError(f"{file}: unknown format {file.suffix!r}; choose one of {choices}")
    if not file.parent.is_dir():
        raise MeshError(f"{file}: there is no folder {file.parent}")
    if file.is_dir() or (file.exists() and not overwrite):
        raise MeshError(f"{file}: exists already; choose another name, or say to overwrite it")

"""From a name or a file to arrays in metres, or to a :class:`vf.Surface`."""

from __future__ import annotations

import difflib
import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from meshes import frames, packed
from meshes.builtin.catalogue import absent, catalogue, first_use
from meshes.content import SIZE_LIMIT, Arrays, Content, allowed_unpacked, check_unpacked, compact
from meshes.errors import MeshError
from meshes.formats import BY_END, FORMATS, identified, kind
from meshes.units import UNITS, diagonal, resolved_unit
from vf.surface import Surface


@dataclass(frozen=True)
class Loaded:
    """A mesh as read."""

    arrays: Arrays
    """Vertices ``(n, 3)`` float64 [m] and faces ``(m, 3)`` int64."""
    unit: str
    """The unit of the file, of `UNITS`: given by the user or the file, or assumed from the size."""
    frame: str | None
    """The patient frame of the coordinates: "RAS", "LPS", or None if not known."""
    notes: tuple[str, ...] = ()
    """What the user should know about the file, a sentence each."""


def load(name_or_path: str | os.PathLike[str], *, unit: str | None = None) -> Surface:
    """A catalogue mesh by its name, or a mesh file, as a surface for fixtures; see :func:`arrays`.

    Raises :class:`meshes.MeshError`.
    """
    vertices, faces = arrays(name_or_path, unit=unit)
    return Surface.from_arrays(vertices, faces)


def arrays(
    name_or_path: str | os.PathLike[str],
    *,
    unit: str | None = None,
    progress: Callable[[str], None] | None = None,
) -> Arrays:
    """Vertices ``(n, 3)`` float64 [m] and faces ``(m, 3)`` int64 of a catalogue mesh or a file.

    A string that is a catalogue name means that mesh; for a file of that name write ``./name``.
    Files: STL, OBJ, PLY, OFF, GLB, glTF, 3MF, VTP, legacy VTK, GIfTI and FreeSurfer surfaces, also
    packed with gzip. Several bodies become one mesh, each where its scene puts it. Polygons become
    triangles, cut by their shape. Nothing is repaired or welded, except that corners at *exactly*
    the same place become one vertex in STL, GLB and glTF, which cannot express shared vertices;
    unused vertices are dropped. The only other files opened are buffers of a glTF beside it.

    ``unit`` is "m", "cm", "mm" or "in". ``None``: metres for GLB and glTF, as their standard says,
    millimetres for GIfTI and FreeSurfer, the file's own unit for 3MF; otherwise millimetres or
    metres where the size allows only one of them, with a :class:`meshes.UnitGuess` warning. The
    catalogue's meshes ignore ``unit``.

    Raises :class:`meshes.MeshError` with a one-line reason: unknown name or unit, missing, empty,
    oversized or unreadable file, no triangles, non-finite vertices, face indices out of range, a
    diagonal below 0.1 mm or above 10 m, no unit where the size allows both millimetres and metres
    (:class:`meshes.UnitNeeded`, which has both sizes). ``progress`` is called with a description of
    each step.
    """
    return read(name_or_path, unit=unit, progress=progress).arrays


def read(
    name_or_path: str | os.PathLike[str],
    *,
    unit: str | None = None,
    frame: str | None = None,
    progress: Callable[[str], None] | None = None,
) -> Loaded:
    """The same as :func:`arrays`, with the unit (see `units.resolved_unit`) and the patient frame.

    ``frame`` is "RAS" or "LPS" where the file does not give it; nothing is transformed. The
    catalogue's meshes are in "m" and in no patient frame.

    Raises :class:`meshes.MeshError` also where ``frame`` contradicts the file.
    """
    frame = frames.chosen(frame)
    if unit is not None and unit not in UNITS:
        raise MeshError(f"unknown unit {unit!r}: choose one of {', '.join(UNITS)}")
    say = progress or (lambda _stage: None)
    say(f"loading the mesh {name_or_path}")
    if isinstance(name_or_path, str) and name_or_path in catalogue():
        entry = catalogue()[name_or_path]
        if first_use(entry):
            say(f"making the mesh {entry.name} for the first time (kept for later runs)")
        return Loaded(entry.make(), "m", frame)
    path = Path(name_or_path)
    _check_file(path, str(name_or_path))
    form = kind(path.name) or ""
    try:
        content = _content(path.read_bytes(), path, form)
        frame = frames.combined(frame, content.frame)
        vertices, faces = _joined(content.bodies, form)
        used_vertices, used_faces = compact(vertices, faces)
    except MeshError as error:
        raise MeshError(f"{path}: {error}") from None
    except OSError as error:
        raise MeshError(f"{path}: cannot be read ({error.strerror or error})") from None
    # Any other exception of a reader is caused by a damaged file, MemoryError and RecursionError
    # included: counts and nesting come from the file.
    except Exception as error:
        reason = " ".join(f"{type(error).__name__}: {error}".split())[:200]
        raise MeshError(f"{path}: cannot be read as {form.upper()} ({reason})") from error
    unit = resolved_unit(str(path), diagonal(used_vertices), unit, content.unit)
    notes = content.notes
    if unused := len(vertices) - len(used_vertices):
        are = "1 vertex is" if unused == 1 else f"{unused:,} vertices are"
        notes += (f"{are} in no face: left out.",)
    return Loaded((used_vertices * UNITS[unit], used_faces), unit, frame, notes)


def _check_file(path: Path, given: str) -> None:
    """Raise `MeshError` for what is not a mesh file of an allowed size, before it is opened."""
    formats = ", ".join(f".{suffix}" for suffix in FORMATS)
    try:
        size = path.stat().st_size if path.exists() else None
    except (OSError, ValueError) as error:  # no permission, a name too long, a NUL in it
        raise MeshError(f"{given!r}: cannot be opened ({error})") from None
    if size is None:
        if kind(path.name) or len(path.parts) > 1:
            raise MeshError(f"{given!r}: there is no such file")
        if given in absent():
            raise MeshError(f"{given!r} is not on this machine: {absent()[given]}")
        near = difflib.get_close_matches(given.lower(), catalogue(), n=1)
        hint = f" (did you mean {near[0]!r}?)" if near else ""
        raise MeshError(
            f"unknown mesh {given!r}{hint}: choose one of {', '.join(catalogue())},"
            f" or give the path of a file ({formats})"
        )
    if not path.is_file():
        raise MeshError(f"{path}: not a file; give the path of a mesh file ({formats})")
    if kind(path.name) is None:
        raise MeshError(f"{path}: unknown format {path.suffix!r}; choose one of {formats}")
    if size == 0:
        raise MeshError(f"{path}: the file is empty")
    if size > SIZE_LIMIT:
        raise MeshError(
            f"{path}: {size / 1e6:.0f} MB, more than the {SIZE_LIMIT / 1e6:.0f} allowed"
        )


def _content(data: bytes, path: Path, form: str) -> Content:
    """The content of a file's bytes in a format, decompressed first if gzipped."""
    if data.startswith(packed.MAGIC) and path.name.lower().endswith(".gz"):
        size = len(data)
        data = packed.gunzip(data, allowed_unpacked(size))
        check_unpacked(len(data), size)
    entry = BY_END[form]
    try:
        return entry.read(data, path.parent) if entry.opens_others else entry.read(data)
    except MeshError:
        what, forms = identified(data)
        if what and form not in forms:
            raise MeshError(f"{what}, not {form.upper()} as its name says") from None
        raise


def _joined(bodies: list[Arrays], form: str) -> Arrays:
    """All bodies as one mesh."""
    if not any(len(faces) for _, faces in bodies):
        points = sum(len(vertices) for vertices, _ in bodies)
        raise MeshError(f"no triangles, only {points:,} points" if points else "no triangles")
    starts = np.cumsum([0] + [len(vertices) for vertices, _ in bodies])
    vertices = np.vstack([vertices for vertices, _ in bodies])
    faces = np.vstack([f + start for (_, f), start in zip(bodies, starts[:-1], strict=True)])
    return (vertices, faces) if BY_END[form].shares_vertices else _merged(vertices, faces)


def _merged(vertices: NDArray[np.float64], faces: NDArray[np.int64]) -> Arrays:
    """Vertices of exactly equal coordinates joined, in the order of the first of each."""
    vertices = vertices + 0.0  # −0 becomes 0
    order = np.lexsort(vertices.T)  # stable: equals stay in the file's order
    ranked = vertices[order]
    new = np.r_[True, (ranked[1:] != ranked[:-1]).any(axis=1)]
    first = np.empty(len(vertices), dtype=np.int64)
    first[order] = order[np.flatnonzero(new)][np.cumsum(new) - 1]
    kept = first == np.arange(len(vertices))
    return vertices[kept], (np.cumsum(kept) - 1)[first][faces]

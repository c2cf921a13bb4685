"""From a name or a file to arrays in metres, or to a :class:`vf.Surface`."""

from __future__ import annotations

import difflib
import io
import os
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import NDArray

from meshes import frames, gltf, obj, threemf
from meshes.catalogue import absent, catalogue, first_use
from meshes.errors import MeshError
from meshes.shapes import Arrays
from meshes.units import UNITS, diagonal, settled
from vf.surface import Surface

FORMATS = ("stl", "obj", "ply", "off", "glb", "gltf", "3mf")
SIZE_LIMIT = 500_000_000  # [byte] of a file: some ten million triangles


@dataclass(frozen=True)
class Loaded:
    """A mesh as it was found."""

    arrays: Arrays
    """Vertices ``(n, 3)`` float64 [m] and faces ``(m, 3)`` int64."""
    unit: str
    """The unit the file is in, of `UNITS`: said by the user or the file, or guessed."""
    frame: str | None
    """The patient frame of the coordinates: "RAS", "LPS", or None where nothing says it."""


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
    Files: STL, OBJ, PLY, OFF, GLB, glTF, 3MF. Several bodies become one mesh, each where its scene
    puts it. Polygons become triangles. Nothing is repaired or welded, except that corners at
    *exactly* the same place are one vertex in STL, GLB and glTF, which have no way to say so;
    vertices that no face uses are dropped. Of other files only what a glTF needs is opened, and
    only beside it.

    ``unit`` is "m", "cm", "mm" or "in". ``None``: metres for GLB and glTF, as their standard says,
    and what a 3MF says; otherwise millimetres or metres where the size allows only one of them,
    told by a :class:`meshes.UnitGuess` warning. The catalogue's meshes know their size, so ``unit``
    does not touch them.

    Raises :class:`meshes.MeshError` with a one-line reason: unknown name or unit, missing, empty,
    oversized or unreadable file, no triangles, non-finite vertices, face indices out of range, a
    diagonal below 0.1 mm or above 10 m, no unit where the size allows both millimetres and metres
    (:class:`meshes.UnitNeeded`, which has both sizes). ``progress`` is called with a few words
    before each step.
    """
    return read(name_or_path, unit=unit, progress=progress).arrays


def read(
    name_or_path: str | os.PathLike[str],
    *,
    unit: str | None = None,
    frame: str | None = None,
    progress: Callable[[str], None] | None = None,
) -> Loaded:
    """The same as :func:`arrays`, with the unit (see `units.settled`) and the patient frame.

    ``frame`` is "RAS" or "LPS" where the file does not say it; nothing is turned. The catalogue's
    meshes are in "m" and in no patient's frame.

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
    kind = path.suffix[1:].lower()
    try:
        data = path.read_bytes()
        vertices, faces, known = _parsed(data, kind, path.parent)
        frame = frames.agreed(frame, _frame(data, kind))
    except MeshError as error:
        raise MeshError(f"{path}: {error}") from None
    # Whatever a parser trips over in a damaged file, the file is what is wrong. MemoryError and
    # RecursionError are among them: counts and nesting come from the file.
    except Exception as error:
        reason = " ".join(f"{type(error).__name__}: {error}".split())[:200]
        raise MeshError(f"{path}: cannot be read as {kind.upper()} ({reason})") from error
    unit = settled(str(path), diagonal(vertices), unit, known)
    return Loaded((vertices * UNITS[unit], faces), unit, frame)


def _check_file(path: Path, given: str) -> None:
    """Refuse what is not a mesh file of a sensible size, before opening it."""
    formats = ", ".join(f".{kind}" for kind in FORMATS)
    try:
        size = path.stat().st_size if path.exists() else None
    except (OSError, ValueError) as error:  # no permission, a name too long, a NUL in it
        raise MeshError(f"{given!r}: cannot be opened ({error})") from None
    if size is None:
        if path.suffix[1:].lower() in FORMATS or len(path.parts) > 1:
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
    if path.suffix[1:].lower() not in FORMATS:
        raise MeshError(f"{path}: unknown format {path.suffix!r}; choose one of {formats}")
    if size == 0:
        raise MeshError(f"{path}: the file is empty")
    if size > SIZE_LIMIT:
        raise MeshError(
            f"{path}: {size / 1e6:.0f} MB, more than the {SIZE_LIMIT / 1e6:.0f} allowed"
        )


def _parsed(
    data: bytes, kind: str, folder: Path
) -> tuple[NDArray[np.float64], NDArray[np.int64], str | None]:
    """Checked vertices, in the file's unit, and faces of a file's content; its unit if known."""
    known = "m" if kind in ("glb", "gltf") else None
    if kind == "obj":
        bodies = [_checked(*obj.read(data))]
    elif kind == "3mf":
        placed, known = threemf.read(data)
        bodies = [_checked(*body) for body in placed]
    else:
        bodies = _bodies(data, kind, folder)
    if not any(len(faces) for _, faces in bodies):
        points = sum(len(vertices) for vertices, _ in bodies)
        raise MeshError(f"no triangles, only {points} points" if points else "no triangles")
    starts = np.cumsum([0] + [len(vertices) for vertices, _ in bodies])
    vertices = np.vstack([vertices for vertices, _ in bodies])
    faces = np.vstack([f + start for (_, f), start in zip(bodies, starts[:-1], strict=True)])
    if kind in ("stl", "glb", "gltf"):
        vertices, faces = _merged(vertices, faces)
    return *_compact(vertices, faces), known


def _frame(data: bytes, kind: str) -> str | None:
    """The frame that a file names where 3D Slicer names it: in a header or a comment."""
    if kind == "stl":
        return frames.in_text(
            data[:80] if not data.startswith(b"solid") else data.partition(b"\n")[0]
        )
    if kind == "ply":
        return frames.in_text(data.partition(b"end_header")[0])
    if kind in ("obj", "off"):
        return frames.in_text(b"\n".join(x for x in data[:4096].splitlines() if x.startswith(b"#")))
    if kind == "glb":
        return frames.in_text(data[:1000])
    return None


def _bodies(data: bytes, kind: str, folder: Path) -> list[Arrays]:
    """Every body of a file that trimesh reads, in the scene's frame."""
    if kind == "stl":
        _check_stl(data)
    elif kind in ("glb", "gltf"):
        gltf.check(data, kind)
    with warnings.catch_warnings():
        # numpy only deprecates half-read number lists: here they are a damaged file.
        warnings.filterwarnings("error", message="string or file could not be read")
        # A stream and no resolver: a file can refer to no other file, but for a glTF's buffers.
        scene = trimesh.load_scene(
            io.BytesIO(data), file_type=kind, process=False, skip_materials=True, fix_texture=False,
            resolver=gltf.Beside(folder, SIZE_LIMIT) if kind == "gltf" else None,
        )  # fmt: skip
    if kind == "off":
        _check_off(data, list(scene.geometry.values()))
    bodies = []
    for node in scene.graph.nodes_geometry:
        T_scene_body, name = scene.graph[node]
        body = scene.geometry[name]
        vertices, faces = _checked(
            np.asarray(body.vertices, dtype=np.float64),
            np.asarray(getattr(body, "faces", np.empty((0, 3))), dtype=np.int64),
        )
        T = np.asarray(T_scene_body, dtype=np.float64)
        if not np.array_equal(T, np.eye(4)):  # moving by nothing would still round
            vertices = vertices @ T[:3, :3].T + T[:3, 3]
            if np.linalg.det(T[:3, :3]) < 0:  # a mirror turns the winding inside out
                faces = faces[:, ::-1]
            vertices, faces = _checked(vertices, faces)
        bodies.append((vertices, faces))
    return bodies


def _check_stl(data: bytes) -> None:
    """Tell a cut-off binary STL as such: a reader that tries it as text finds only nothing."""
    if data[:512].lstrip().lower().startswith(b"solid") and b"facet" in data[:2048]:
        return
    if len(data) < 84:
        raise MeshError(f"{len(data)} bytes are too few for an STL file")
    count = int.from_bytes(data[80:84], "little")
    if len(data) != 84 + 50 * count:
        raise MeshError(
            f"its header promises {count} triangles ({84 + 50 * count} bytes),"
            f" the file has {len(data)} bytes: cut off or not STL"
        )


def _check_off(data: bytes, read: list[trimesh.Trimesh]) -> None:
    """Tell a cut-off OFF as such: its reader is content with what there is."""
    lines = (line.partition(b"#")[0] for line in data[:10_000].splitlines())
    words = b" ".join(lines).split()
    vertices, faces = int(words[1]), int(words[2])
    # Polygons become several triangles, never fewer than they were.
    found = sum(len(getattr(body, "faces", ())) for body in read)
    if found < faces or sum(len(body.vertices) for body in read) != vertices:
        raise MeshError(f"its header promises {vertices} vertices and {faces} faces: cut off")


def _checked(vertices: NDArray[np.float64], faces: NDArray[np.int64]) -> Arrays:
    if vertices.ndim != 2 or vertices.shape[1] != 3:
        raise MeshError(f"vertices of shape {vertices.shape} instead of (n, 3)")
    if faces.ndim != 2 or (len(faces) and faces.shape[1] != 3):
        raise MeshError(f"faces of shape {faces.shape} instead of (m, 3)")
    bad = ~np.isfinite(vertices).all(axis=1)
    if bad.any():
        raise MeshError(f"{bad.sum()} vertices are not finite, the first is vertex {bad.argmax()}")
    if len(faces) and (faces.min() < 0 or faces.max() >= len(vertices)):
        worst = int(faces.min()) if faces.min() < 0 else int(faces.max())
        raise MeshError(f"a face refers to vertex {worst}, of {len(vertices)} (counted from 0)")
    return vertices, faces.reshape(-1, 3)


def _merged(vertices: NDArray[np.float64], faces: NDArray[np.int64]) -> Arrays:
    """One vertex for all that have exactly equal coordinates; first come, first kept."""
    vertices = vertices + 0.0  # −0 and 0 are the same place
    order = np.lexsort(vertices.T)  # stable: equals stay in the file's order
    ranked = vertices[order]
    new = np.r_[True, (ranked[1:] != ranked[:-1]).any(axis=1)]
    first = np.empty(len(vertices), dtype=np.int64)
    first[order] = order[np.flatnonzero(new)][np.cumsum(new) - 1]
    return vertices, first[faces]


def _compact(vertices: NDArray[np.float64], faces: NDArray[np.int64]) -> Arrays:
    """Only the vertices that faces use, in their order."""
    used = np.zeros(len(vertices), dtype=bool)
    used[faces] = True
    if used.all():
        return vertices, faces
    return vertices[used], (np.cumsum(used) - 1)[faces]

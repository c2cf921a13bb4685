"""The further structures of a scene: read from their files, placed, indexed."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import meshes
import vf
from app import choices
from app.scene.caught import caught_warnings
from app.scene.outside import shows_fronts_only
from app.settings import MOST, Options
from app.structure import Structure, printable, split
from meshes.frames import half_turn

FloatArray = NDArray[np.float64]
Arrays = tuple[FloatArray, NDArray[np.int64]]
Progress = Callable[[str], None]

DRAWN = 150_000  # triangles drawn of all further structures
LEAST = 3_000  # of one


@dataclass(frozen=True)
class Built:
    """A further structure of a scene, arm base frame; its settings are in the options.

    Attributes:
        surface: the full mesh that the controller uses.
        vertices_shown, faces_shown: the mesh that is drawn, which may be decimated.
        decimated: whether it is.
        fronts_only: whether only front faces of it are visible from outside.
    """

    surface: vf.Surface
    vertices_shown: FloatArray
    faces_shown: NDArray[np.int64]
    decimated: bool
    fronts_only: bool


def read(
    options: Options, progress: Progress
) -> tuple[Options, meshes.Structure | None, list[meshes.Structure]]:
    """The further structures as their files have them.

    Before them the options with one entry for each structure: where a file or a folder has several,
    there is an entry for each, with its name and, as far as the source says them and the options do
    not, its colour and margin. Reading these options gives the same again. Then the mesh if it is
    one of several in its file, else None. Without a mesh (`choices.NO_MESH`) the first structure
    becomes the mesh.

    Raises:
        ValueError: a file that cannot be read, an unknown label, too many structures.
    """
    first = options.mesh == choices.NO_MESH
    mesh_too = first or split(options.mesh)[1] is not None
    entries = options.structures if first or not mesh_too else options.anatomy
    if first and not entries:
        raise meshes.MeshError("there is neither a mesh nor a structure")
    wanted: dict[tuple[str, str | None], list[str | None]] = {}
    for entry in entries:
        wanted.setdefault((entry.file, entry.unit or options.unit), []).append(entry.label)
    found = {source: _read(*source, labels, progress) for source, labels in wanted.items()}
    settings: list[Structure] = []
    there: list[meshes.Structure] = []
    for entry in entries:
        every = found[entry.file, entry.unit or options.unit]
        mine = _chosen(every, entry)
        several = len(every) > 1 or entry.label is not None
        for one in mine:
            margin = one.margin or 0.0 if entry.margin is None else entry.margin
            settings.append(
                replace(
                    entry,
                    label=_label(entry.file, one, every) if several else None,
                    name=(entry.name if len(mine) == 1 else None) or printable(one.name),
                    colour=entry.colour or _hex(one.colour),
                    margin=margin,
                )
            )
            there.append(one)
    mesh = there.pop(0) if mesh_too else None
    if mesh_too:
        own = settings.pop(0)
        options = replace(
            options,
            mesh=own.file if own.label is None else f"{own.file}:{own.label}",
            unit=own.unit or options.unit,
            margin=own.margin or 0.0,
            guarded=own.guarded,
            colour=own.colour,
            opacity=own.opacity,
        )
    if len(settings) > MOST:
        raise meshes.MeshError(
            f"the scene has {len(settings)} structures: at most {MOST} are guarded; choose some "
            "labels, as FILE:3 or FILE:NAME"
        )
    return replace(options, structures=tuple(settings)), mesh, there


def placed(
    one: meshes.Structure, name: str, frame: str | None, T_base_mesh: FloatArray, options: Options
) -> Arrays:
    """Vertices (n, 3) [m] of a structure in the arm's base frame, and faces (m, 3), repaired.

    Args:
        name: for messages.
        frame: patient frame of the scene's mesh. A structure that says the other one is turned.
    """
    vertices, faces = one.vertices, one.faces
    if options.repair or options.flip:
        mended = meshes.repair(vertices, faces, flip=options.flip)
        if not len(mended.faces):
            raise meshes.MeshError(f"{name}: no face has any area, nothing is left of it")
        vertices, faces = mended.arrays
    if frame is not None and one.frame not in (None, frame):
        vertices = half_turn(vertices)
    return meshes.transformed(T_base_mesh, vertices), faces


def build(arrays: Sequence[Arrays], names: Sequence[str], progress: Progress) -> tuple[Built, ...]:
    """The structures of these vertices (n, 3) [m], arm base frame, and faces (m, 3)."""
    most = max(DRAWN // max(len(arrays), 1), LEAST)
    built = []
    for k, ((vertices, faces), name) in enumerate(zip(arrays, names, strict=True)):
        progress(f"building {name}, {len(faces):,} triangles ({k + 1} of {len(arrays)})")
        surface = vf.Surface.from_arrays(vertices, faces)
        shown, faces_shown, decimated = meshes.display(vertices, faces, most, most)
        for array in (shown, faces_shown):
            array.flags.writeable = False
        fronts_only = shows_fronts_only(shown, faces_shown)
        built.append(Built(surface, shown, faces_shown, decimated, fronts_only))
    return tuple(built)


def files_of(options: Options) -> tuple[str, ...]:
    """The files, or names of the catalogue, that a scene of these options reads."""
    names = (options.mesh, *(one.file for one in options.structures))
    files = dict.fromkeys(split(name)[0] for name in names if name != choices.NO_MESH)
    files |= dict.fromkeys(one.file for one in options.motions if one.file is not None)
    return tuple(
        str(path)
        for name in files
        for path in (sorted(Path(name).iterdir()) if Path(name).is_dir() else (name,))
    )


def _read(
    file: str, unit: str | None, labels: list[str | None], progress: Progress
) -> tuple[meshes.Structure, ...]:
    progress(f"reading {Path(file).name}")
    # Files of a folder are brought to one frame, so all of them are read.
    every = None in labels or Path(file).is_dir()
    chosen = () if every else tuple(str(label) for label in dict.fromkeys(labels))
    with caught_warnings():  # a guess of the unit is checked by the size of the scene's mesh
        return meshes.structures(
            file, chosen, unit, lambda share, text: progress(f"{text}, {share:.0%}")
        )


def _chosen(every: Sequence[meshes.Structure], entry: Structure) -> Sequence[meshes.Structure]:
    """Those of a source that an entry names, by name, else by number."""
    label = entry.label
    if label is None:
        return every
    found = (
        [one for one in every if one.name == label]
        or [one for one in every if one.name.casefold() == label.casefold()]
        or [one for one in every if str(one.label) == label]
    )
    if not found:
        known = ", ".join(one.name for one in every)
        raise meshes.MeshError(f"{entry.file}: there is no structure {label!r}: choose of {known}")
    return found


def _label(file: str, one: meshes.Structure, every: Sequence[meshes.Structure]) -> str:
    """What chooses a structure of a file: its name, or its number where the name does not."""
    unique = sum(other.name == one.name for other in every) == 1
    plain = not one.name.isdigit() and split(f"{file}:{one.name}") == (file, one.name)
    fits = len(one.name) <= 100 and printable(one.name) == one.name
    return one.name if one.label is None or (unique and plain and fits) else str(one.label)


def _hex(colour: tuple[int, int, int] | None) -> str | None:
    return None if colour is None else "#" + "".join(f"{part:02x}" for part in colour)

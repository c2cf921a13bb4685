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
from app.settings import MOST, Options, Structure, printable, split

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


def read(options: Options, progress: Progress) -> tuple[Options, Arrays | None, list[Arrays]]:
    """The further structures' vertices (n, 3) [m] and faces (m, 3), in their files' frame.

    Before them the options with one entry for each structure: where a file or a folder has several,
    there is an entry for each, with its name and, of a label map, its label and colour. Reading
    these options gives the same again. Then the mesh's arrays if it is one of several in its file,
    else None. Without a mesh (`choices.NO_MESH`) the first structure becomes the mesh.

    Raises:
        ValueError: a file that cannot be read, an unknown label, too many structures.
    """
    first = options.mesh == choices.NO_MESH
    mesh_too = first or split(options.mesh)[1] is not None
    given = options.structures if first or not mesh_too else options.anatomy
    if first and not given:
        raise meshes.MeshError("there is neither a mesh nor a structure")
    entries = [one for entry in given for one in _files(entry)]
    wanted: dict[tuple[str, str | None], list[str | None]] = {}
    for entry in entries:
        wanted.setdefault((entry.file, entry.unit or options.unit), []).append(entry.label)
    found = {source: _read(*source, labels, progress) for source, labels in wanted.items()}
    settings: list[Structure] = []
    arrays: list[Arrays] = []
    for entry in entries:
        there = found[entry.file, entry.unit or options.unit]
        mine = [one for one in there if entry.label in (None, one.name, str(one.label))]
        for one in mine:
            several = len(there) > 1 or entry.label is not None
            settings.append(
                replace(
                    entry,
                    label=_label(entry.file, one, there) if several else None,
                    name=(entry.name if len(mine) == 1 else None) or printable(one.name),
                    colour=entry.colour or _hex(one.colour),
                )
            )
            arrays.append(_mended(one.name, (one.vertices, one.faces), options))
    mesh = arrays.pop(0) if mesh_too else None
    if mesh_too:
        own = settings.pop(0)
        options = replace(
            options,
            mesh=own.file if own.label is None else f"{own.file}:{own.label}",
            unit=own.unit or options.unit,
            margin=own.margin,
            guarded=own.guarded,
            colour=own.colour,
            opacity=own.opacity,
        )
    if len(settings) > MOST:
        raise meshes.MeshError(
            f"the scene has {len(settings)} structures: at most {MOST} are guarded; choose some "
            "labels, as FILE:3 or FILE:NAME"
        )
    return replace(options, structures=tuple(settings)), mesh, arrays


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


def label_of(text: str) -> int | str:
    """A label as `meshes.structures` takes it: a number or a name."""
    return int(text) if text.isdigit() else text


def _files(entry: Structure) -> list[Structure]:
    """An entry for each mesh file of a folder that has any, in order of name; else the entry."""
    folder = Path(entry.file)
    if entry.file in choices.SETS or entry.label is not None or not folder.is_dir():
        return [entry]
    files = sorted(path for path in folder.iterdir() if meshes.kind(path.name))
    return [replace(entry, file=str(path), name=None) for path in files] or [entry]


def _read(
    file: str, unit: str | None, labels: list[str | None], progress: Progress
) -> tuple[meshes.Structure, ...]:
    progress(f"reading {Path(file).name}")
    chosen = () if None in labels else tuple(label_of(str(one)) for one in dict.fromkeys(labels))
    with caught_warnings():  # a guess of the unit is checked by the size of the scene's mesh
        return meshes.structures(
            file, chosen, unit, lambda share, text: progress(f"{text}, {share:.0%}")
        )


def _label(file: str, one: meshes.Structure, there: Sequence[meshes.Structure]) -> str:
    """What chooses a structure of a file: its name, or its number where the name does not."""
    unique = sum(other.name == one.name for other in there) == 1
    plain = not one.name.isdigit() and split(f"{file}:{one.name}") == (file, one.name)
    return one.name if one.label is None or (unique and plain) else str(one.label)


def _mended(name: str, arrays: Arrays, options: Options) -> Arrays:
    if not (options.repair or options.flip):
        return arrays
    mended = meshes.repair(*arrays, flip=options.flip)
    if not len(mended.faces):
        raise meshes.MeshError(f"{name}: no face has any area, nothing is left of it")
    return mended.arrays


def _hex(colour: tuple[int, int, int] | None) -> str | None:
    return None if colour is None else "#" + "".join(f"{part:02x}" for part in colour)

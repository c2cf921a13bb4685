"""Named structures of label maps, mesh files, folders of them, and built-in sets."""

from __future__ import annotations

import difflib
import os
import warnings
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from meshes import frames
from meshes.anatomy.colours import Colour
from meshes.anatomy.maps import Label, Part, Progress, is_map, read_map
from meshes.anatomy.smooth import label_surface
from meshes.builtin import craniotomy, temporal_bone
from meshes.errors import MeshError
from meshes.formats import FORMATS, kind
from meshes.load import read
from meshes.volume.files import FORMATS as VOLUMES
from meshes.volume.surfaces import MOST_TRIANGLES

SETS = {one.NAME: one.members for one in (temporal_bone, craniotomy)}
"""Built-in sets of structures by name."""

_MOST_LISTED = 20


@dataclass(frozen=True)
class Structure:
    """A surface with a name.

    Attributes:
        name: unique among the structures of one source.
        colour: red, green, blue, 0 to 255; None if the source gives none.
        vertices: ``(n, 3)`` [m].
        faces: ``(m, 3)``, the corners anticlockwise seen from outside.
        label: its number in a label map; None otherwise.
        frame: "RAS" or "LPS", the patient frame of the vertices; None if not known.
        margin: a distance to keep from it [m], where the source says one; None otherwise.
    """

    name: str
    colour: Colour | None
    vertices: NDArray[np.float64]
    faces: NDArray[np.int64]
    label: int | None = None
    frame: str | None = None
    margin: float | None = None


def labels(
    path: str | os.PathLike[str],
    *,
    table: str | os.PathLike[str] | None = None,
    spacing: tuple[float, float, float] | None = None,
) -> tuple[Label, ...]:
    """The labels of a label map, by number; background (0) is none.

    Read are NIfTI, Analyze, MGH, NRRD, MetaImage, and a folder of PNG files, one slice each; names
    and colours are those of 3D Slicer's segmentations (``.seg.nrrd``, with all their layers), of
    palettes, and of colour tables (3D Slicer, FreeSurfer, ITK-SNAP).

    Args:
        table: the colour table; None: a file of the map's name beside it (``head.ctbl``, ``.txt``,
            ``.label``, ``.lut`` for ``head.nii.gz``; in a folder of PNG files the only one).
        spacing: of a stack of PNG files, between columns, rows and slices [m].

    Raises:
        meshes.MeshError: it cannot be read, or is no label map: values that are not whole numbers,
            negative, more than 500 different ones, or different from voxel to voxel.
    """
    return tuple(part.label for part in read_map(path, table=table, spacing=spacing).parts)


def structures(
    path: str | os.PathLike[str],
    chosen: Iterable[int | str] = (),
    unit: str | None = None,
    progress: Progress | None = None,
    *,
    table: str | os.PathLike[str] | None = None,
    spacing: tuple[float, float, float] | None = None,
) -> tuple[Structure, ...]:
    """The structures of a label map, a mesh file, a folder of mesh files, or a built-in set.

    A label map gives one structure a label, in RAS [m]. Its surface is closed, contains the centres
    of exactly the label's voxels, and is smoothed within 0.45 voxels of their border; volumes are
    those of the voxels. A mesh file, or a mesh of the catalogue, gives one of its name (see
    :func:`meshes.arrays`); a folder one a mesh file, in order of name. Files of a folder that say
    different frames are all brought to RAS. The set "temporal-bone" is a drilled mastoid with its
    nerves, ossicles, canals, sinus and dura, each with a margin; for a file of that name write
    ``./temporal-bone``.

    Args:
        chosen: numbers or names of labels, or names of structures; (): all. A name that is a number
            stands for the label of that number.
        unit: of mesh files, "m", "cm", "mm" or "in", as for :func:`meshes.arrays`.
        progress: called with the share that is done, 0 to 1, and a text.
        table, spacing: of a label map, see :func:`labels`.

    Raises:
        meshes.MeshError: what cannot be read, or is not there to be chosen; one line.
    """
    say = progress or (lambda _share, _text: None)
    wanted = tuple(chosen)
    if path in SETS:
        return _of_set(str(path), wanted, say)
    file = Path(path)
    if is_map(file):
        return _of_map(file, wanted, say, table, spacing)
    if table is not None or spacing is not None:
        raise MeshError(f"{file}: a colour table or a spacing is given for label maps only")
    found = _of_folder(file, wanted, unit, say) if file.is_dir() else (_of_file(path, unit),)
    return tuple(_picked(found, wanted, str(path)))


def _of_map(
    file: Path,
    wanted: Sequence[int | str],
    say: Progress,
    table: str | os.PathLike[str] | None,
    spacing: tuple[float, float, float] | None,
) -> tuple[Structure, ...]:
    found = read_map(
        file, table=table, spacing=spacing, progress=lambda share, text: say(0.2 * share, text)
    )
    parts = _chosen_parts(found.parts, wanted, str(file))
    work = np.cumsum([0.0] + [_size(part) for part in parts])
    result = []
    triangles = 0
    for part, done in zip(parts, work, strict=False):
        say(0.2 + 0.8 * float(done / work[-1]), f"surface of {part.label.name}")
        assert part.box is not None  # parts without voxels are not chosen
        start = np.array([side.start for side in part.box])
        T = np.array(found.T_world_voxel)
        T[:3, 3] += T[:3, :3] @ start
        try:
            vertices, faces = label_surface(found.layers[part.layer][part.box] == part.value, T)
        except MeshError as error:
            raise MeshError(f"{file}: {part.label.name}: {error}") from None
        triangles += len(faces)
        if triangles > MOST_TRIANGLES:
            raise MeshError(
                f"{file}: its surfaces have more than {MOST_TRIANGLES:,} triangles: choose some of "
                f"its {len(parts)} labels"
            )
        one = part.label
        result.append(Structure(one.name, one.colour, vertices, faces, one.number, found.frame))
    say(1.0, f"{len(result)} structures")
    return tuple(result)


def _size(part: Part) -> float:
    """How long a label takes, in relation to others: by the voxels of its box."""
    return float(np.prod([side.stop - side.start for side in part.box or ()]))


def _chosen_parts(parts: Sequence[Part], wanted: Sequence[int | str], file: str) -> Sequence[Part]:
    if not wanted:
        return [part for part in parts if part.label.voxels]
    found = []
    for one in wanted:
        label = _chosen(one, [part.label for part in parts], file)
        if not label.voxels:
            raise MeshError(f"{file}: no voxel has the label {label.number}, {label.name!r}")
        found.append(next(part for part in parts if part.label == label))
    return sorted({id(part): part for part in found}.values(), key=lambda p: p.label.number)


def _chosen(one: int | str, every: Sequence[Label], file: str) -> Label:
    """The label of a number or a name; letters' case matters only where two names differ by it."""
    text = str(one).strip()
    by_name = [label for label in every if label.name == text] or [
        label for label in every if label.name.casefold() == text.casefold()
    ]
    by_number = [label for label in every if str(label.number) == text]
    matches = (by_name or by_number) if isinstance(one, str) else by_number
    if len(matches) == 1:
        return matches[0]
    there = [f"{label.number} {label.name}" for label in every]
    some = ", ".join(there[:_MOST_LISTED])
    more = f" and {len(there) - _MOST_LISTED} more" if len(there) > _MOST_LISTED else ""
    near = difflib.get_close_matches(text, [label.name for label in every], n=1)
    hint = f" (did you mean {near[0]!r}?)" if near else ""
    raise MeshError(f"{file}: there is no label {one!r}{hint}: choose of {some}{more}")


def _of_set(name: str, wanted: Sequence[int | str], say: Progress) -> tuple[Structure, ...]:
    members = SETS[name]()
    for given in wanted:
        _check_name(given, list(members), name)
    kept = [one for one in members.values() if not wanted or one.name in wanted]
    found = []
    for k, one in enumerate(kept):
        say(k / len(kept), f"making {one.name}")
        vertices, faces = one.make()
        found.append(Structure(one.name, one.colour, vertices, faces, margin=one.margin))
    say(1.0, f"{len(found)} structures")
    return tuple(found)


def _of_file(path: str | os.PathLike[str], unit: str | None) -> Structure:
    found = read(path, unit=unit)
    name = str(path)
    ending = kind(Path(path).name)
    if ending is not None:
        name = _stem(Path(path).name)
    return Structure(name, None, *found.arrays, None, found.frame)


def _stem(name: str) -> str:
    """A file's name without the ending of its format."""
    stem = name[:-3] if name.lower().endswith(".gz") else name
    for ending in sorted(FORMATS, key=len, reverse=True):
        if stem.lower().endswith(f".{ending}") and len(stem) > len(ending) + 1:
            return stem[: -len(ending) - 1]
    return stem


def _of_folder(
    folder: Path, wanted: Sequence[int | str], unit: str | None, say: Progress
) -> tuple[Structure, ...]:
    files = sorted(one for one in folder.iterdir() if one.is_file() and kind(one.name))
    if not files:
        endings = ", ".join(f".{ending}" for ending in FORMATS)
        raise MeshError(
            f"{folder}: no mesh files ({endings}) and no PNG files are in this folder "
            f"(a label map is given by its file: {', '.join(VOLUMES)})"
        )
    volumes = [one.name for one in sorted(folder.iterdir()) if one.name.lower().endswith(VOLUMES)]
    if volumes:
        warnings.warn(
            f"{folder}: only mesh files are read of a folder, and not {', '.join(volumes)}: give "
            "the file itself for the labels of a label map",
            stacklevel=3,
        )
    names = _unique([_stem(file.name) for file in files], [file.name for file in files])
    if wanted:  # only these are read
        kept = [name for name in names if name in set(map(str, wanted))]
        files = [file for file, name in zip(files, names, strict=True) if name in kept] or files
        names = kept or names
    found = []
    for k, (file, name) in enumerate(zip(files, names, strict=True)):
        say(k / len(files), f"reading {file.name}")
        found.append(replace(_of_file(file, unit), name=name))
    say(1.0, f"{len(found)} structures")
    return _in_one_frame(tuple(found), str(folder))


def _unique(names: Sequence[str], longer: Sequence[str]) -> list[str]:
    """Names, each of those that occur twice replaced by its longer form."""
    return [
        full if names.count(name) > 1 else name for name, full in zip(names, longer, strict=True)
    ]


def _in_one_frame(found: tuple[Structure, ...], folder: str) -> tuple[Structure, ...]:
    said = {one.frame: one.name for one in found}
    if len(said) < 2:
        return found
    if None in said:
        known = next(frame for frame in said if frame)
        raise MeshError(
            f"{folder}: {said[known]!r} is in {known}, and {said[None]!r} does not say its patient "
            "frame: they cannot be put together (vf-sandbox mesh repair --frame writes it)"
        )
    return tuple(
        one
        if one.frame == "RAS"
        else replace(one, vertices=frames.half_turn(one.vertices), frame="RAS")
        for one in found
    )


def _picked(
    found: Sequence[Structure], wanted: Sequence[int | str], source: str
) -> Sequence[Structure]:
    for name in wanted:
        _check_name(name, [one.name for one in found], source)
    return [one for one in found if not wanted or one.name in wanted]


def _check_name(name: int | str, there: Sequence[str], source: str) -> None:
    """Raise `MeshError` for a name that no structure has."""
    if name not in there:
        some = ", ".join(there[:_MOST_LISTED])
        raise MeshError(f"{source}: there is no structure {name!r}: choose of {some}")

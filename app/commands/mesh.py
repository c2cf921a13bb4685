"""Meshes: list the catalogue, check a file, repair it, make one from a volume; list labels."""

from __future__ import annotations

import json
import sys
import textwrap
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.markup import escape

from app.commands import interrupted
from app.commands._mesh_labels import Labels, print_labels
from app.console import console as new_console
from app.console import count, progress
from app.kinds import File, Length, Maybe, Number, Switch, Whole
from app.options import Checked, like, option
from app.settings import Options
from app.words import OptionError

if TYPE_CHECKING:
    from meshes import Changes, Health, Loaded

PROGRAM = "vf-sandbox mesh"
SOUND, DEFECTS = 0, 1
OVERWRITE = "Replace a file that exists."


@dataclass(frozen=True)
class List(Checked):
    """Print the catalogue: names, triangles, size, source and licence."""


@dataclass(frozen=True)
class Check(Checked):
    """Report the defects of a mesh, and what they mean for the fixtures.

    Exit code 0: sound; 1: it has defects; 2: it could not be read."""

    mesh: str = option(
        File(),
        about="Path of a mesh file (STL, OBJ, PLY, OFF, GLB, glTF, 3MF, VTP, VTK, GIfTI, "
        "FreeSurfer; also with .gz), or a catalogue name.",
        positional=True,
    )
    unit: str | None = like(Options, "unit")
    frame: str | None = like(
        Options, "frame", about="Patient frame of a file that does not say it."
    )
    json: bool = option(
        Switch(), False,
        "Print the report as JSON, with up to 1000 ids of faces, edges or vertices a finding.",
    )  # fmt: skip
    examine: int = option(
        Whole(0, 10**9), 50_000,
        "Look at so many faces for self-intersections and thin walls: all, or evenly sampled.",
    )  # fmt: skip


@dataclass(frozen=True)
class Repair(Checked):
    """Weld, drop degenerate and duplicate faces, correct the winding; no vertex is moved.

    Exit code 0: written; 1: written, but something could not be repaired; 2: nothing written."""

    mesh: str = option(
        File(), about="Path of a mesh file of any format that is read.", positional=True
    )
    out: str = option(
        File(),
        about="File to write: .stl, .obj, .ply, .off, .glb; in the unit of the file that was read.",
        positional=True,
    )
    unit: str | None = like(Options, "unit")
    frame: str | None = like(
        Options, "frame", about="Patient frame of a file that does not say it."
    )
    write_frame: str | None = like(
        Options, "frame",
        about="Turn it into this patient frame: half a turn about z where it is in the other.",
    )  # fmt: skip
    tolerance: float | None = option(
        Maybe(Length(0.0, 1e-2), "auto"), None,
        "Vertices that near become one; auto is a millionth of the diagonal.",
    )  # fmt: skip
    flip: bool = like(Options, "flip")
    overwrite: bool = option(Switch(), False, OVERWRITE)


@dataclass(frozen=True)
class FromVolume(Checked):
    """Make a surface of a CT or MR volume, at a level, or of one label of a label map.

    In the patient's world coordinates: x to the right, y to the front, z up (RAS). NIfTI and DICOM
    need the extra 'volume'. Exit code 0: written; 2: nothing written."""

    source: str = option(
        File(),
        about="NIfTI, MGH, NRRD or MetaImage file, or DICOM: a folder of slices or a multi-frame "
        "file.",
        positional=True,
    )
    out: str = option(
        File(), about="File to write: .stl, .obj, .ply, .off (in mm) or .glb (in m).",
        positional=True,
    )  # fmt: skip
    level: float | None = option(
        Maybe(Number(-1e9, 1e9)), None,
        "Value at the surface: in a CT, bone is above some 300 (Hounsfield units).",
    )  # fmt: skip
    label: int | None = option(
        Maybe(Whole(-(2**31), 2**31)), None,
        "Number of a structure in a label map, instead of a level.",
    )  # fmt: skip
    volume: int | None = option(
        Maybe(Whole(0, 10**6)), None,
        "Which volume of a file with several (a time series, layers of labels): from 0.",
    )  # fmt: skip
    smooth: float = option(
        Length(0.0, 5e-2), 0.0, "Standard deviation of a Gaussian before, such as 0.5mm."
    )
    largest: bool = option(Switch(), False, "Keep only the largest piece.")
    overwrite: bool = option(Switch(), False, OVERWRITE)


def _list(_options: List) -> int:
    """Print each mesh as soon as it is made: some take seconds the first time."""
    import numpy as np

    import meshes

    console = new_console()
    entries = meshes.catalogue().values()
    width = max(len(entry.name) for entry in entries)
    console.print(f"{'name':{width}}  {'triangles':>9}  {'size [mm]':18}  about", markup=False)
    room = max(console.width - width - 2 - 9 - 2 - 18 - 2, 20)
    shown = 0
    with _stages() as say:
        try:
            for entry in entries:
                say(f"making {entry.name}")
                vertices, faces = meshes.arrays(entry.name)
                size = " × ".join(f"{1e3 * side:.3g}" for side in np.ptp(vertices, axis=0))
                first, *rest = textwrap.wrap(entry.about, room)
                line = f"{entry.name:{width}}  {len(faces):9,}  {size:18}  {first}"
                console.print(line, markup=False, soft_wrap=True)
                for more in rest:
                    console.print(" " * (width + 33) + more, markup=False, soft_wrap=True)
                shown += 1
        except KeyboardInterrupt:
            return interrupted(
                f"{PROGRAM} list", f"{shown} of {count(len(entries), 'mesh', 'meshes')}"
            )
    sources: dict[tuple[str, str], list[str]] = {}
    for entry in entries:
        sources.setdefault((entry.source, entry.licence), []).append(entry.name)
    console.print()
    for (source, licence), names in sources.items():
        console.print(f"{', '.join(names)}: {source}; {licence}", markup=False)
    for name, remedy in meshes.absent().items():
        console.print(f"not on this machine: {name}: {remedy}", markup=False)
    return SOUND


def examined(
    name: str, unit: str | None, frame: str | None, examine: int, progress: Callable[[str], None]
) -> tuple[Health, str, str | None, list[str]]:
    """The report on a mesh, its unit and frame, and the notes of its loader."""
    import meshes

    progress(f"reading {name}")
    found, notes = _opened(name, unit, frame)
    report = meshes.health(*found.arrays, examine=examine, progress=progress)
    return report, found.unit, found.frame, notes


def repaired(
    options: Repair, progress: Callable[[str], None]
) -> tuple[Changes, int, str, str | None, list[str]]:
    """Repair a mesh and write it: changes, remaining triangles, unit, frame, and notes."""
    import meshes
    from meshes import frames
    from meshes.save import save

    progress(f"reading {options.mesh}")
    found, notes = _opened(options.mesh, options.unit, options.frame)
    wanted = frames.chosen(options.write_frame)
    vertices, frame = frames.turned(found.arrays[0], found.frame, wanted)
    result = meshes.repair(
        vertices, found.arrays[1], tolerance=options.tolerance, flip=options.flip, progress=progress
    )
    if len(result.faces) == 0:
        raise meshes.MeshError(f"{options.mesh}: no face has any area, nothing is written")
    progress(f"writing {options.out}")
    save(options.out, *result.arrays, unit=found.unit, frame=frame, overwrite=options.overwrite)
    return result.changes, len(result.faces), found.unit, frame, notes


def _run(name: str, work: Callable[..., Any]) -> Any:
    """The result of the work on a mesh, in a process with limits unless the mesh is light.

    The last item of the result, the notes, is printed on stderr.
    """
    from app.scene import worker

    with _stages() as say:
        if worker.light(name):
            result = work(progress=say)
        else:
            result = worker.run(work, worker.allowance(name), say)
    for note in result[-1]:
        print(f"vf-sandbox mesh: note: {note}", file=sys.stderr)
    return result


def _check(options: Check) -> int:
    import meshes

    work = partial(examined, options.mesh, options.unit, options.frame, options.examine)
    report, unit, frame, notes = _run(options.mesh, work)
    if options.json:
        about = {"mesh": options.mesh, "unit": unit, "frame": frame, "notes": notes}
        print(json.dumps({**about, **report.as_dict()}, indent=1))
    else:
        told = (
            "of no patient"
            if options.mesh in meshes.catalogue()
            else meshes.frame_description(frame)
        )
        _print_report(new_console(), options.mesh, report, told)
    return SOUND if report.sound else DEFECTS


def _print_report(console: Console, name: str, report: Health, frame: str) -> None:
    def yes(value: bool) -> str:
        return "yes" if value else "no"

    def number(value: float | None, scale: float, unit: str) -> str:
        return "–" if value is None else f"{value * scale:.6g} {unit}"

    least, _, median, _, most = (1e3 * length for length in report.edge_percentiles)
    facts = (
        ("triangles", f"{report.triangles:,} on {count(report.vertices, 'vertex', 'vertices')}"),
        ("size", " × ".join(f"{1e3 * side:.4g}" for side in report.extents) + " mm"),
        ("frame", frame),
        ("edges", f"{least:.3g} … {median:.3g} (median) … {most:.3g} mm"),
        ("pieces", f"{report.components:,}, genus {'–' if report.genus is None else report.genus}"),
        ("watertight", yes(report.watertight)),
        ("wound alike", yes(report.consistent)),
        ("area", number(report.area, 1e4, "cm²")),
        ("volume", number(report.volume, 1e6, "cm³")),
        ("thinnest wall", number(report.wall, 1e3, "mm") if report.examined else "not looked for"),
        ("examined", "all faces" if report.exact else count(report.examined, "sampled face")),
    )
    console.print(f"[bold]{escape(name)}[/]")
    for title, text in facts:
        console.print(f"  {title:14} {text}", soft_wrap=True)
    for finding in report.findings:
        mark = "[red]✗[/]" if finding.defect else "[yellow]![/]"
        first = ", ".join(
            f"{one[0]}–{one[1]}" if isinstance(one, list) else str(one)
            for one in finding.ids[:5].tolist()
        )
        console.print(f"{mark} {escape(finding.text)}", soft_wrap=True)
        console.print(f"    {escape(finding.meaning)}", soft_wrap=True)
        if first:
            more = ", …" if len(finding.ids) > 5 else ""
            console.print(f"    [dim]{finding.of} {first}{more}[/]", soft_wrap=True)
    console.print("[green]sound[/]" if report.sound else "[red]has defects[/]")


def _repair(options: Repair) -> int:
    from meshes import frames
    from meshes.save import check_writable

    check_writable(options.out, options.overwrite)
    frames.chosen(options.write_frame)
    changes, triangles, unit, frame, _ = _run(options.mesh, partial(repaired, options))
    console = new_console()
    for line in changes.lines() or ("nothing to repair",):
        console.print(f"[green]✓[/] {escape(line)}", soft_wrap=True)
    for line in changes.left:
        console.print(f"[yellow]![/] left: {escape(line)}", soft_wrap=True)
    unit_text = "m" if options.out.lower().endswith(".glb") else unit
    frame_text = frame or "patient frame not known"
    console.print(
        f"written: {escape(options.out)}, {count(triangles, 'triangle')}, in {unit_text}, "
        f"{frame_text}",
        soft_wrap=True,
    )
    return DEFECTS if changes.left else SOUND


def _from_volume(options: FromVolume) -> int:
    import numpy as np

    from meshes import frame_description, volume
    from meshes.save import check_writable, save

    if options.level is not None and options.label is not None:
        raise OptionError("give --level for an image or --label for a label map, not both")
    check_writable(options.out, options.overwrite)
    with _stages() as say:
        with _notes():
            grid = volume.read(options.source, volume=options.volume, progress=say)
        field, level = grid, options.level
        if options.label is not None:
            field, level = volume.one_label(grid, options.label), volume.MIDDLE
        if level is None:
            raise OptionError(
                f"{options.source}: give --level, or --label for a label map: "
                f"{volume.describe_values(grid)}"
            )
        vertices, faces = volume.surface(
            field, level, smooth=options.smooth, largest=options.largest, progress=say
        )
        say(f"writing {options.out}")
        save(options.out, vertices, faces, unit="mm", frame=grid.frame, overwrite=options.overwrite)
    spacing = " × ".join(
        f"{1e3 * s:.3g}" for s in np.linalg.norm(grid.T_world_voxel[:3, :3], axis=0)
    )
    size = " × ".join(f"{1e3 * side:.4g}" for side in np.ptp(vertices, axis=0))
    shape = " × ".join(map(str, grid.values.shape))
    unit = "m" if options.out.lower().endswith(".glb") else "mm"
    console = new_console()
    console.print(f"read: {escape(options.source)}, {shape} voxels of {spacing} mm", soft_wrap=True)
    console.print(
        f"written: {escape(options.out)}, {count(len(faces), 'triangle')}, {size} mm, in {unit}, "
        + (frame_description(grid.frame) if grid.frame else "left and right a guess"),
        soft_wrap=True,
    )
    return SOUND


def _opened(name: str, unit: str | None, frame: str | None) -> tuple[Loaded, list[str]]:
    """The mesh in a file, and the notes of its loader."""
    from meshes.load import read

    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        found = read(name, unit=unit, frame=frame)
    return found, [*(str(warning.message) for warning in caught), *found.notes]


@contextmanager
def _notes() -> Iterator[None]:
    """Prints warnings as notes on stderr."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        yield
    for warning in caught:
        print(f"vf-sandbox mesh: note: {warning.message}", file=sys.stderr)


@contextmanager
def _stages() -> Iterator[Callable[[str], None]]:
    """Shows the current stage on stderr, if that is a terminal."""
    with progress(bar=False) as bar:
        task = bar.add_task("starting", total=None)
        yield lambda stage: bar.update(task, description=escape(stage))


def _unless_interrupted(name: str, do: Callable[[Any], int], left: str) -> Callable[[Any], int]:
    """The work of a subcommand; if interrupted, `left` is printed."""

    def work(options: Any) -> int:
        try:
            return do(options)
        except KeyboardInterrupt:
            return interrupted(f"{PROGRAM} {name}", left)

    return work


NOTHING = "nothing was written"
KINDS = {
    "list": (List, _list),
    "check": (Check, _unless_interrupted("check", _check, "no report yet")),
    "repair": (Repair, _unless_interrupted("repair", _repair, NOTHING)),
    "from-volume": (FromVolume, _unless_interrupted("from-volume", _from_volume, NOTHING)),
    "labels": (Labels, _unless_interrupted("labels", print_labels, "no labels yet")),
}

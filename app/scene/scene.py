"""The scene: an arm and a mesh placed in its workspace."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

import meshes
import robots
import vf
from app import choices
from app.control.autopilot import Script, plan
from app.control.engine import Plant, is_free
from app.control.plant import Description, assemble, clearance, corridor
from app.judges import boxes, meeting
from app.judges.nearest import gaps
from app.motion.course import Course
from app.motion.movement import courses, too_fast
from app.scene import structures
from app.scene.caught import caught_warnings
from app.scene.outside import shows_fronts_only
from app.scene.registered import ranges, registered, with_fiducials
from app.scene.structures import Arrays, Built
from app.settings import Options
from meshes.builtin.damage import damage
from robots import Arm

FloatArray = NDArray[np.float64]
Progress = Callable[[str], None]

DEFAULT_WIDTH = 1e-3  # of a corridor, as in the paper's experiments [m]


@dataclass(frozen=True)
class Scene:
    """Anatomy and arm; immutable.

    Attributes:
        version: increases with every change of mesh or robot; `Telemetry.scene` refers to it.
        mesh_name: catalogue name, or the file's name.
        surface: the full mesh that the controller uses, arm base frame.
        structures: those beside the mesh, in the order of their settings in the options.
        T_base_mesh: (4, 4) pose of the mesh's own frame in the arm's base frame.
        planned_path: (k, 3) the planned cut on this mesh, arm base frame [m]; None: there is none.
        vertices_shown, faces_shown: the mesh that is drawn, which may be decimated.
        decimated: whether it is.
        fronts_only: whether only front faces of it are visible from outside.
        robot: name of the arm.
        arm: an arm for the view's thread alone (the controller has its own).
        notes: notes on this mesh for the user, one sentence each.
        start: (n,) start and reset joints, with the tip in free space.
        T_base_start: the tip at `start`.
        autopilot: the scripted tour over this mesh.
        options: the settings it was built with, with an entry for each structure.
        courses: how each of the `surfaces` moves; None: it stands still.
        added: margins that the registration adds to those of all structures; None: nothing.
        added_range: the least and the largest of these on each of the `surfaces` [m], or empty.
    """

    version: int
    mesh_name: str
    surface: vf.Surface
    T_base_mesh: FloatArray
    planned_path: FloatArray | None
    vertices_shown: FloatArray
    faces_shown: NDArray[np.int64]
    decimated: bool
    fronts_only: bool
    robot: str
    arm: Arm
    notes: tuple[str, ...]
    start: FloatArray
    T_base_start: pin.SE3
    autopilot: Script
    options: Options
    structures: tuple[Built, ...] = ()
    courses: tuple[Course | None, ...] = ()
    added: meshes.MarginMap | None = None
    added_range: tuple[tuple[float, float], ...] = ()

    @property
    def moves(self) -> bool:
        """Whether any of its structures moves."""
        return any(course is not None for course in self.courses)

    @property
    def surfaces(self) -> tuple[vf.Surface, ...]:
        """Those of all structures, the mesh first, in the order of `Options.anatomy`."""
        return self.surface, *(one.surface for one in self.structures)

    def looks(self, number: int) -> tuple[FloatArray, NDArray[np.int64], bool]:
        """What is drawn of a structure, 0 is the mesh: vertices, faces, whether fronts only."""
        of = self.structures[number - 1] if number else self
        return of.vertices_shown, of.faces_shown, of.fronts_only


def build(
    options: Options, version: int, progress: Progress | None = None, warm: bool = True
) -> Scene:
    """Load arm and mesh, place the mesh under the tool, build its tree, find a free start.

    Takes up to some seconds for large meshes.

    Args:
        progress: called with a short text before each step.
        warm: whether to compile the kernels of a tick too.

    Raises:
        ValueError: unknown robot, unusable mesh (`meshes.MeshError`) or no free spot for the
            tool; the message gives the reason and the valid choices.
    """
    say = progress or (lambda _text: None)
    say(f"loading the robot {options.robot}")
    arm = robots.load(options.robot)
    T_base_tip = arm.tip(arm.neutral)

    options, mesh, further = structures.read(with_fiducials(options), say)
    vertices, faces, T_base_mesh, notes, frame = anatomy(options, T_base_tip, say, mesh)

    if warm:
        say("preparing the kernels (the first start compiles them: up to a minute)")
        warm_up()
    say(f"building the tree of {len(faces):,} triangles")
    surface = vf.Surface.from_arrays(vertices, faces)
    if not surface.closed:
        notes.append(
            "The mesh is not closed or not consistently wound: "
            "it has no inside, so it is guarded from both sides."
        )

    names = [str(one.name) for one in options.structures]
    placed = [
        structures.placed(one, name, frame, T_base_mesh, options)
        for one, name in zip(further, names, strict=True)
    ]
    built = structures.build(placed, names, say)
    if open_ones := [n for n, one in zip(names, built, strict=True) if not one.surface.closed]:
        notes.append(f"Not closed, so guarded from both sides: {', '.join(open_ones)}.")

    surfaces = (surface, *(one.surface for one in built))
    names_of = [str(own.name) for own in options.anatomy]
    moved = courses(
        options.motions, names_of, surfaces, options.dt, options.tracker, T_base_mesh
    )  # fmt: skip
    notes += too_fast(options.tracker, moved, surfaces)

    added = registered(options, T_base_mesh)
    added_range = ranges(added, [str(own.name) for own in options.anatomy], surfaces)

    path = _planned_path(options, T_base_mesh)
    if path is not None:
        corridor(surface, path, options.corridor or DEFAULT_WIDTH)  # raises if it is invalid
    elif options.corridor is not None:
        notes.append("No path is planned on this mesh: there is no corridor.")

    say("preparing the picture")
    shown, faces_shown, decimated = meshes.display(vertices, faces)
    if decimated:
        notes.append(
            f"Shown with {len(faces_shown):,} triangles; "
            f"the control uses all {len(faces):,} of them."
        )

    say("finding a free start for the tool")
    pairs = zip(options.anatomy, added_range or [(0.0, 0.0)] * len(surfaces), strict=True)
    margins = [(own.margin or 0.0) + most for own, (_, most) in pairs]
    find = partial(
        free_start, arm, surface, clearance(options), margin=margins[0],
        further=list(zip(surfaces[1:], margins[1:], strict=True)),
    )  # fmt: skip
    try:
        start = find(options=options)
    except ValueError:
        if not options.guards_tool:
            raise
        start = find()
        notes.append("No start was found at which all of the instrument is clear of the mesh.")
    T_base_start = arm.tip(start)
    return Scene(
        version=version,
        mesh_name=Path(options.mesh).name,
        surface=surface,
        T_base_mesh=_read_only(T_base_mesh),
        planned_path=path,
        vertices_shown=_read_only(shown),
        faces_shown=_read_only(faces_shown),
        decimated=decimated,
        fronts_only=shows_fronts_only(shown, faces_shown),
        robot=arm.name,
        arm=arm,
        notes=tuple(notes),
        start=_read_only(start),
        T_base_start=T_base_start,
        autopilot=plan(surface, T_base_start),
        options=options,
        structures=built,
        courses=moved,
        added=added,
        added_range=added_range,
    )


def anatomy(
    options: Options, T_base_tip: pin.SE3, progress: Progress, own: meshes.Structure | None = None
) -> tuple[FloatArray, NDArray[np.int64], FloatArray, list[str], str | None]:
    """Load, damage, repair and place the mesh as these options say.

    Args:
        own: the mesh, as `structures.read` read it from a file of several; None: load it.

    Returns:
        Vertices (n, 3) [m] in the arm's base frame, faces (m, 3), ``T_base_mesh`` (4, 4), notes for
        the user, one sentence each, and the patient frame, None if it is not known.

    Raises:
        ValueError: unusable mesh or placement, with the reason.
    """
    if own is None:
        mesh, notes, frame = _loaded(options, progress)
    else:
        mesh, notes, frame = (own.vertices, own.faces), [], own.frame
    if options.damage != "none":
        mesh = damage(options.damage, mesh, options.seed)
        notes.append(f"Damaged on purpose: {options.damage}, seed {options.seed}.")
    if options.repair or options.flip:
        progress("repairing the mesh")
        mended = meshes.repair(*mesh, flip=options.flip)
        if not len(mended.faces):
            raise meshes.MeshError(f"{options.mesh}: no face has any area, nothing is left of it")
        mesh = mended.arrays
        done, left = mended.changes.lines(), mended.changes.left
        notes.append(
            "Repaired: " + ("; ".join(done) if done else "there was nothing to mend") + "."
        )
        if left:
            notes.append("Left as it is: " + "; ".join(left) + ".")
    vertices, faces = mesh
    placement = meshes.Placement(options.at, options.rotate, options.up)
    T_base_mesh = placement.pose(vertices, T_base_tip)
    return meshes.transformed(T_base_mesh, vertices), faces, T_base_mesh, notes, frame


def _loaded(options: Options, progress: Progress) -> tuple[Arrays, list[str], str | None]:
    """The mesh as its file has it, notes for the user, and its patient frame."""
    with caught_warnings() as caught:
        found = meshes.read(options.mesh, unit=options.unit, frame=options.frame, progress=progress)
    notes = [str(w.message) for w in caught if issubclass(w.category, meshes.UnitGuess)]
    notes += found.notes
    if options.mesh not in meshes.catalogue():
        notes.append(f"Patient frame: {meshes.frame_description(found.frame)}.")
    return found.arrays, notes, found.frame


def _planned_path(options: Options, T_base_mesh: FloatArray) -> FloatArray | None:
    """The path given by the user or known to the catalogue, arm base frame [m]."""
    if options.path is not None:
        path = meshes.read_path(options.path)
    else:
        entry = meshes.catalogue().get(options.mesh)
        if entry is None or entry.path is None:
            return None
        path = entry.path()
    return _read_only(meshes.transformed(T_base_mesh, path))


def plant(scene: Scene, options: Options) -> Plant:
    """The plant of this scene with these settings, see `settled`; takes milliseconds.

    Raises:
        ValueError: a corridor wider than the bends of its path allow.
    """
    options = settled(options, scene)
    description = Description(
        robot=scene.arm.name,
        q0=scene.start,
        surface=scene.surface,
        planned_path=scene.planned_path,
        scene=scene.version,
        autopilot=scene.autopilot,
        options=options,
        scene_options=scene.options,
        structures=tuple(one.surface for one in scene.structures),
        courses=scene.courses,
        added=scene.added,
    )
    return assemble(description, scene.arm.copy())


def settled(options: Options, scene: Scene) -> Options:
    """The options in a scene: with an entry for each of its structures, and the mesh it has."""
    built = scene.options
    options = replace(options, registration=built.registration)
    if options.mesh == choices.NO_MESH:  # the first structure is the mesh
        taken = ("mesh", "unit", "margin", "guarded", "colour", "opacity", "structures")
        return replace(options, **{name: getattr(built, name) for name in taken})
    if [one.source for one in options.structures] != [one.source for one in built.structures]:
        return replace(options, structures=built.structures)
    filled = [
        replace(
            own,
            name=own.name or found.name,
            colour=own.colour or found.colour,
            margin=found.margin if own.margin is None else own.margin,
        )
        for own, found in zip(options.structures, built.structures, strict=True)
    ]
    return replace(options, structures=tuple(filled))


@cache
def warm_up() -> None:
    """Compile the kernels of a tick, or load them from disk; once per process."""
    vf.Controller(robots.load("point"), []).warm_up()
    meeting.warm_up()


def free_start(
    arm: Arm,
    surface: vf.Surface,
    clearance: float,
    options: Options | None = None,
    margin: float = 0.0,
    further: Sequence[tuple[vf.Surface, float]] = (),
) -> FloatArray:
    """Joints (n,) with the tip outside the anatomy and farther than `clearance` [m] from it.

    The neutral ones if possible; otherwise increasing displacements of the tip are tried.

    Args:
        options: if they guard the whole tool, all of it keeps their standoff; None: its tip alone.
        margin: added to both [m].
        further: other surfaces to be clear of, each with its own margin [m].

    Raises:
        ValueError: no such position within the arm's reach was found.
    """
    around = ((surface, margin), *further)

    def clear(p_base: FloatArray) -> bool:
        return all(is_free(one, p_base, clearance + more) for one, more in around)

    def free(q: FloatArray) -> bool:
        if not clear(arm.tip(q).translation):
            return False
        if options is None or not options.guards_tool:
            return True
        return all(
            gaps(boxes.of(one), arm, q, options.trocar).min() > options.standoff + more
            for one, more in around
        )

    neutral = arm.tip(arm.neutral)
    q = np.array(arm.neutral)
    if free(q):
        return q
    for displacement in _displacements(surface.size):
        pose = pin.SE3(neutral.rotation, neutral.translation + displacement)
        if not clear(pose.translation):
            continue
        try:
            q = arm.inverse(pose, start=arm.neutral)
        except robots.Unreachable:
            continue
        # Inverse kinematics may reach the pose only approximately: check the actual tip.
        if free(q):
            return np.array(q)
    raise ValueError(
        f"no free spot for the tool of {arm.name}: the mesh fills its workspace "
        f"(size {surface.size * 1e3:.0f} mm; is the unit right?)"
    )


def _displacements(size: float) -> Iterator[FloatArray]:
    sideways = [np.array([np.cos(a), np.sin(a), 0.0]) for a in np.arange(8) * np.pi / 4]
    up = np.array([0.0, 0.0, 1.0])
    directions = [up, *(d + up for d in sideways), *sideways, *(d - up for d in sideways), -up]
    for distance in np.geomspace(1e-3, max(2.0 * size, 2e-3), 24):
        for direction in directions:
            yield distance * direction / np.linalg.norm(direction)


def _read_only(array: NDArray[Any]) -> NDArray[Any]:
    array = np.array(array)
    array.flags.writeable = False
    return array

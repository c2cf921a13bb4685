"""Repeats a recording without thread and clock, and compares it bit for bit."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

import meshes
from app.control.engine import Engine, Orders, Plant
from app.control.messages import STATES, LoopStats, Telemetry
from app.files import shown
from app.motion.movement import checksum, streamed
from app.recording.format import (
    CHUNK,
    COMPARED,
    MEASURED,
    ROWS,
    SIMULATED,
    Place,
    Recording,
    RecordingError,
)
from app.recording.rows import command as command_of
from app.recording.rows import fill
from app.scene import scene as scenes
from app.scene.scene import Progress, Scene
from app.settings import Options


@dataclass(frozen=True)
class Difference:
    """The first difference of a repetition from its recording: row, tick, column of `ROWS`."""

    row: int
    tick: int
    field: str
    recorded: str
    repeated: str

    def __str__(self) -> str:
        return (
            f"tick {self.tick}: {self.field} differs: "
            f"recorded {self.recorded}, repeated {self.repeated}"
        )


class PlayedArm:
    """An `Arm` that measures what was recorded, whatever it is told to do."""

    def __init__(self, joints: int) -> None:
        """`joints`: how many it has."""
        self._n = joints
        self._measured: NDArray[np.float64] | None = None

    def turn(self, noted: np.void) -> None:
        """Be where the arm was before the tick of this row of `ROWS`."""
        known = noted["sensed"] == MEASURED
        self._measured = np.array(noted["measured"][: self._n]) if known else None

    def measured(self) -> NDArray[np.float64] | None:
        """The joints (n,); None: they were not known."""
        return self._measured

    def servo(self, q: NDArray[np.float64]) -> None:
        """Stay."""


def rerun(
    recording: Recording,
    mesh: str | None = None,
    path: str | None = None,
) -> Iterator[tuple[int, Telemetry, bool]]:
    """Run a new engine with the recorded orders, each for as many ticks as it was in force.

    Args:
        mesh: present path of the mesh, for all scenes; None: the recorded one.
        path: likewise, of the planned path.

    Yields:
        For each row of the recording the row of its orders, the telemetry, and whether it ticked.

    Raises:
        RecordingError: a mesh is not the one that was recorded.
        ValueError: a mesh is not usable.
    """
    stats = LoopStats()
    order, index, place = -1, -1, -1
    scene: Scene | None = None
    plant = None
    engine: Engine | None = None
    arm: PlayedArm | None = None
    # Row −1: the orders that were in force when the recording began.
    for row in range(-1, len(recording.rows)):
        due = 0 if row < 0 else int(recording.rows["order"][row])
        if due != order:
            order = due
            noted = recording.orders[order]
            if noted["plant"] != index:
                index = int(noted["plant"])
                where, options = recording.plants[index]
                if where != place or scene is None:
                    place = where
                    scene = build(recording.places[where], where + 1, mesh, path)
                    reshape(recording, where, scene)
                course = recording.courses[index]
                room = scene if course is None else replace(scene, autopilot=course)
                plant = scenes.plant(room, options)
            assert plant is not None
            orders = orders_of(noted, plant)
        if engine is None:
            sensed = bool((recording.rows["sensed"] != SIMULATED).any())
            arm = PlayedArm(len(recording.state.q)) if sensed else None
            engine = Engine(orders, recording.state, arm)
            continue
        if arm is not None:
            arm.turn(recording.rows[row])
        yield order, *engine.advance(orders, stats)


def orders_of(noted: np.void, plant: Plant) -> Orders:
    """The orders of a row of `ORDERS`."""
    return Orders(
        plant=plant,
        command=command_of(noted),
        paused=bool(noted["paused"]),
        steps=int(noted["steps"]),
        resets=int(noted["resets"]),
        autopilot=bool(noted["autopilot"]),
        scale=float(noted["scale"]),
        lock_orientation=bool(noted["lock"]),
        moving=bool(noted["moving"]),
        pace=float(noted["pace"]),
        state=STATES[int(noted["state"])],
    )


def reshape(recording: Recording, place: int, scene: Scene) -> None:
    """Give a scene the shapes that came from elsewhere while it was recorded.

    Args:
        place: index of the scene in the recording.

    Raises:
        RecordingError: they are not of its structure.
    """
    form = streamed(scene.courses)
    shapes = [frame for k, frame in recording.shapes if k == place]
    if form is None:
        if shapes:
            raise RecordingError("it has shapes of a structure that does not change its shape")
        return
    for frame in shapes:
        if len(frame.vertices) != form.count:
            raise RecordingError(
                f"a shape in it has {len(frame.vertices):,} vertices, its structure {form.count:,}"
            )
    form.stream.fill(shapes)


def build(
    noted: Place,
    version: int,
    mesh: str | None = None,
    path: str | None = None,
    progress: Progress | None = None,
    warm: bool = True,
) -> Scene:
    """Build a scene of a recording, and compare mesh and start with the recorded ones.

    Args:
        mesh, path: present paths of mesh and planned path; None: the recorded ones.
        warm: as in `scene.build`.

    Raises:
        RecordingError: the mesh, a structure, their placement or the start differs.
        ValueError: an unusable mesh, or unknown names.
    """
    options = noted.options
    options = replace(options, mesh=mesh or options.mesh, path=path or options.path)
    try:
        scene = scenes.build(options, version, progress, warm)
    except meshes.UnitNeeded:
        # Older recordings have no unit, as it was guessed: the checksum identifies it.
        found = _with_matching_unit(options, noted.checksum, version, progress, warm)
        if found is None:
            raise
        scene = found
    surface = scene.surface
    if surface.checksum != noted.checksum:
        raise RecordingError(
            f"the mesh '{shown(options.mesh)}' is not the one that was recorded: "
            f"{len(surface.faces):,} triangles, recorded {noted.triangles:,}; SHA-256 "
            f"{surface.checksum[:12]}…, recorded {noted.checksum[:12]}…"
        )
    pairs = zip(scene.options.structures, scene.structures, noted.structures, strict=False)
    for own, built, shape in pairs:
        if built.surface.checksum != shape.checksum:
            raise RecordingError(
                f"the structure '{own.name}' of '{shown(own.file)}' is not the one that was "
                f"recorded: {len(built.surface.faces):,} triangles, recorded {shape.triangles:,}; "
                f"SHA-256 {built.surface.checksum[:12]}…, recorded {shape.checksum[:12]}…"
            )
    if len(scene.structures) != len(noted.structures):
        raise RecordingError(
            f"the files give {len(scene.structures)} structures, recorded {len(noted.structures)}"
        )
    if checksum(scene.courses) != noted.poses:
        files = ", ".join(f"'{shown(one.file)}'" for one in options.motions if one.file is not None)
        raise RecordingError(f"the poses of {files} are not those that were recorded")
    if scene.start.tobytes() != noted.start.tobytes():
        raise RecordingError(
            f"the tool starts elsewhere over '{shown(options.mesh)}' than was recorded"
        )
    return scene


def _with_matching_unit(
    options: Options, checksum: str, version: int, progress: Progress | None, warm: bool
) -> Scene | None:
    """The scene of this mesh in the unit that gives this checksum, if there is one."""
    for unit in ("mm", "m"):
        with contextlib.suppress(ValueError):
            scene = scenes.build(replace(options, unit=unit), version, progress, warm)
            if scene.surface.checksum == checksum:
                return scene
    return None


def first_difference(
    recording: Recording,
    mesh: str | None = None,
    path: str | None = None,
    repeated: Callable[[int], None] = lambda _rows: None,
) -> Difference | None:
    """Repeat a recording and compare every column of `COMPARED` bit for bit; None: all equal.

    Args:
        mesh, path: as in `rerun`, which also says what is raised.
        repeated: called with the number of equal rows so far.
    """
    table = np.zeros(CHUNK, dtype=ROWS)
    before = None
    filled = start = 0
    for order, telemetry, ticked in rerun(recording, mesh, path):
        fill(table, filled, order, telemetry, ticked, before)
        before = telemetry.step
        filled += 1
        if filled == len(table) or start + filled == len(recording.rows):
            found = compare(recording.rows[start : start + filled], table[:filled])
            if found is not None:
                return replace(found, row=start + found.row)
            start, filled = start + filled, 0
            repeated(start)
    return None


def compare(recorded: np.ndarray, repeated: np.ndarray) -> Difference | None:
    """The first difference between two tables (n,) of `ROWS`, by row, then by column."""
    first: tuple[int, str] | None = None
    for name in COMPARED:
        ours, theirs = (
            np.ascontiguousarray(table[name]).view(np.uint8).reshape(len(table), -1)
            for table in (recorded, repeated)
        )
        rows = np.flatnonzero((ours != theirs).any(axis=1))
        if len(rows) and (first is None or rows[0] < first[0]):
            first = int(rows[0]), name
    if first is None:
        return None
    row, name = first
    return Difference(
        row=row,
        tick=int(recorded["tick"][row]),
        field=name,
        recorded=_text(recorded[name][row]),
        repeated=_text(repeated[name][row]),
    )


def _text(value: np.ndarray) -> str:
    return str(np.asarray(value).tolist())  # all digits: the last bit may be what differs

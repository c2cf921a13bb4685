"""The measures of a trial, from its recording: those of the experiments in silico.

Smoothness is that of `app.studies.experiments.smoothness`, the path deviation of tracing and
cutting that of `app.studies.experiments.cutting`, and distances from anatomy are of the judges
(`app.judges`), which share no code with the fixtures.
"""

from __future__ import annotations

import itertools
from collections import OrderedDict
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import robots
import vf
from app.judges import boxes, depth, nearest
from app.motion.movement import Movement
from app.recording import rerun
from app.recording.format import Recording
from app.recording.read import read
from app.recording.write import as_json
from app.scene.moment import seen_from
from app.scene.scene import Scene
from app.settings import MESH, Options
from app.studies.experiments import cutting, smoothness
from app.studies.people.tasks import Goal

FloatArray = NDArray[np.float64]

CONTACT = 1e-4  # a tip nearer than this is in contact; more than the standoff of a fixture [m]
RELEASE = 5e-4  # a contact ends farther than this, so that a trembling tip makes one of it [m]
TRACED = 2e-3  # a path is traced up to this height over the surface [m]
STRIDE = 64  # ticks between the first samples of a distance
RESTING = 1e-6  # on a way as short as this the distance counts as constant [m]
KEPT = 8  # scenes that are kept for further trials

_scenes: OrderedDict[tuple[object, ...], Scene] = OrderedDict()


def measure(
    recording: Path | str | Recording, goal: Goal, scene: Scene | None = None
) -> dict[str, float]:
    """The measures of a trial; NaN where one is not defined, as of a tool that never moved.

    - ``sal``, ``sparc``: smoothness of the tip's speed.
    - ``path_deviation`` [m]: tracing and cutting: mean distance to the side of the path, at
      stations of 1 mm that the tip passed (cutting: in the bone). Targeting: mean distance from the
      straight way from target to target.
    - ``penetration`` [m]: how deep the tip was in a guarded structure at most; 0: in none.
    - ``time`` [s]: of all ticks.
    - ``contacts``, ``contacts NAME``: how often the tip came into contact, with all guarded
      structures and with each one.
    - ``force_integral`` [N s]: of the force on the operator's hand over time.

    What is to be spared is what the options guard, whether or not the rule is off. A reset during
    the trial begins the movement anew: what is before it counts for the time alone.

    Args:
        recording: the trial's file, or its content.
        goal: what was to be done.
        scene: the recording's scene; None: it is built again, and kept for further trials.

    Raises:
        ValueError: an unusable file, or anatomy that is not what was recorded.
    """
    if not isinstance(recording, Recording):
        recording = read(recording)
    if scene is None:
        scene = scene_of(recording)
    ticked = recording.rows["ticked"] == 1
    found = {"time": float(ticked.sum()) * recording.dt}
    run = _Run.of(recording, scene)
    found |= _smoothness(run) | _contacts(run)
    found["path_deviation"] = _deviation(goal, run.tips)
    found["force_integral"] = float(np.linalg.norm(run.forces, axis=1).sum()) * recording.dt
    return found


def scene_of(recording: Recording) -> Scene:
    """The last scene of a recording, built again from its options; the newest `KEPT` are kept.

    Raises:
        ValueError: as `app.recording.rerun.build`.
    """
    last = recording.plants[int(recording.orders["plant"][-1])][0]
    place = recording.places[last]
    built = as_json(place.options)
    key = (
        place.checksum, tuple(one.checksum for one in place.structures), place.poses,
        place.start.tobytes(), repr([built.get(name) for name in MESH]),
    )  # fmt: skip
    scene = _scenes.get(key)
    if scene is None:
        scene = _scenes[key] = rerun.build(place, 1, warm=False)
        if len(_scenes) > KEPT:
            _scenes.popitem(last=False)
    _scenes.move_to_end(key)
    return scene


@dataclass(frozen=True)
class _Run:
    """The ticks of a trial since the last reset, in a scene.

    Attributes:
        rate: [Hz].
        tips: (n, 3) arm base frame [m].
        forces: (n, 3) on the operator's hand [N].
        phases: (n,) of the motion of structures [s].
        options: in force at the end.
    """

    scene: Scene
    options: Options
    rate: float
    tips: FloatArray
    forces: FloatArray
    phases: FloatArray

    @staticmethod
    def of(recording: Recording, scene: Scene) -> _Run:
        rows, orders = recording.rows, recording.orders
        of_place = np.array([place for place, _options in recording.plants])
        resets = orders["resets"][rows["order"]]
        places = of_place[orders["plant"][rows["order"]]]
        anew = np.flatnonzero((np.diff(resets) != 0) | (np.diff(places) != 0))
        begin = int(anew[-1]) + 1 if len(anew) else 0
        mine = rows[begin:][rows["ticked"][begin:] == 1]
        options = recording.plants[int(orders["plant"][-1])][1]
        return _Run(
            scene, options, 1.0 / recording.dt, _tips(scene, mine),
            np.where(mine["stepped"][:, None] == 1, mine["force"], 0.0), mine["phase"],
        )  # fmt: skip


def _tips(scene: Scene, rows: NDArray[np.void]) -> FloatArray:
    """Positions (n, 3) of the tip after rows of `app.recording.format.ROWS`, base frame [m]."""
    tips = np.array(rows["tip"])
    arm = robots.load(scene.robot)
    for k in np.flatnonzero(rows["stepped"] == 0):
        if k > 0 and (rows["q"][k] == rows["q"][k - 1]).all():
            tips[k] = tips[k - 1]
        else:
            tips[k] = arm.tip(rows["q"][k, : len(scene.start)]).translation
    return tips


def _smoothness(run: _Run) -> dict[str, float]:
    points, rate = smoothness.sampled(run.tips, run.rate)
    found = {"sal": np.nan, "sparc": np.nan}
    if len(points) > 2 and rate >= 2.0 * smoothness.CUTOFF:
        speed = smoothness.speed_of(points, rate)
        if speed.any():
            found = {
                "sal": smoothness.sal(speed, rate),
                "sparc": smoothness.sparc(speed, rate),
            }
    return found


def _deviation(goal: Goal, tips: FloatArray) -> float:
    """Mean deviation from the path [m]; NaN: there is none, or the tip never was at it."""
    if not len(tips):
        return np.nan
    if goal.planned is None:
        return _away(np.vstack([tips[:1], goal.targets]), tips)
    below = 0.0 if goal.task == "cutting" else TRACED
    aside = np.abs(cutting.kerf(goal.planned, tips, below=below).deviation)
    return float(np.nanmean(aside)) if np.isfinite(aside).any() else np.nan


def _away(path: FloatArray, tips: FloatArray) -> float:
    """Mean distance (in space) of the tip from a polyline (k, 3), every mm of it counting alike."""
    steps = np.diff(path, axis=0)
    lengths = np.linalg.norm(steps, axis=1)
    steps, begins = steps[lengths > 0.0], path[:-1][lengths > 0.0]
    lengths = lengths[lengths > 0.0]
    if not len(lengths):
        return np.nan
    off = tips[:, None] - begins  # (n, k, 3)
    share = np.clip((off * steps).sum(axis=2) / lengths**2, 0.0, 1.0)
    gaps = np.linalg.norm(off - share[:, :, None] * steps, axis=2)
    piece = gaps.argmin(axis=1)
    every = np.arange(len(tips))
    station = np.r_[0.0, np.cumsum(lengths)][piece] + share[every, piece] * lengths[piece]
    slot = (station / cutting.INTERVAL).astype(np.int64)
    count = np.bincount(slot)
    mean = np.bincount(slot, gaps[every, piece])[count > 0] / count[count > 0]
    return float(mean.mean())


def _contacts(run: _Run) -> dict[str, float]:
    """Contacts with each structure and with the guarded ones, and the depth in these."""
    found: dict[str, float] = {"contacts": 0.0, "penetration": 0.0}
    if not len(run.tips):
        return {"contacts": np.nan, "penetration": np.nan}
    movement = Movement(run.scene.courses, run.options.tracker)
    poses = None
    if movement.moves:
        poses = [movement.truth(float(phase)) for phase in run.phases]
    pairs = zip(run.options.anatomy, run.scene.surfaces, strict=True)
    for number, (own, surface) in enumerate(pairs):
        if movement.moves and movement.forms[number] is not None:
            count = deepest = np.nan  # of what changes its shape the distance is not measured
        else:
            tips = run.tips
            if poses is not None and poses[0][number] is not None:
                tips = np.array(
                    [seen_from(at[number], p) for at, p in zip(poses, tips, strict=True)]
                )
            gaps = heights(surface, tips, RELEASE + run.options.tip_radius)
            gaps -= run.options.tip_radius
            count, deepest = float(episodes(gaps)), max(0.0, -float(gaps.min()))
        found[f"contacts {own.name}"] = found.get(f"contacts {own.name}", 0.0) + count
        if own.guarded:
            found["contacts"] += count
            found["penetration"] = float(np.fmax(found["penetration"], deepest))
    return found


def episodes(gaps: FloatArray) -> int:
    """Number of contacts in distances (n,) of the tip [m], one after another in time.

    One begins where the distance falls below `CONTACT`, and ends where it exceeds `RELEASE`.
    """
    change = np.where(gaps <= CONTACT, 1, np.where(gaps > RELEASE, 0, -1))
    known = np.flatnonzero(change >= 0)
    states = np.r_[0, change[known]]
    return int((np.diff(states) > 0).sum())


def heights(surface: vf.Surface, points: FloatArray, reach: float) -> FloatArray:
    """Signed distance (n,) [m] of the points (n, 3) of a way from a surface, negative inside it.

    Infinite where it is certainly larger than `reach` [m]: the distance changes by no more than the
    way is long, so most ticks far away need no search. Of a closed surface the winding number
    decides what is inside, else the nearest triangle.
    """
    tree = boxes.of(surface)
    n = len(points)
    way = np.r_[0.0, np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))]
    found = np.full(n, np.nan)
    known = np.unique(np.r_[np.arange(0, n, STRIDE), n - 1])
    found[known] = nearest.signed(tree, points[known])
    for _ in range(int(np.log2(STRIDE)) + 1):
        a, b = known[:-1], known[1:]
        # The least distance there can be between two samples.
        least = 0.5 * (np.abs(found[a]) + np.abs(found[b]) - (way[b] - way[a]))
        away = (least > reach) & (found[a] > 0.0) & (found[b] > 0.0)
        open_ = (b - a > 1) & ~away & (way[b] - way[a] > RESTING)
        middle = (a[open_] + b[open_]) // 2
        if not len(middle):
            break
        found[middle] = nearest.signed(tree, points[middle])
        known = np.sort(np.r_[known, middle])
    # What was left out is as far away as the sample before it, or somewhere beyond the reach.
    before = known[np.searchsorted(known, np.arange(n), "right") - 1]
    after = known[np.searchsorted(known, np.arange(n), "left")]
    unknown = np.isnan(found)
    resting = unknown & (way[after] - way[before] <= RESTING)
    found[resting] = found[before[resting]]
    found[unknown & ~resting] = np.inf
    return _true_sides(surface, points, found) if depth.closed(surface.faces) else found


def _true_sides(surface: vf.Surface, points: FloatArray, gaps: FloatArray) -> FloatArray:
    """Distances (n,) with the sign by the winding number, one for each piece of one sign.

    The nearest triangle may err about which side it is where two meet at a sharp edge.
    """
    found = gaps.copy()
    behind = gaps < 0.0
    begins = np.r_[0, np.flatnonzero(np.diff(behind)) + 1, len(gaps)]
    for a, b in itertools.pairwise(begins):
        size = np.abs(gaps[a:b])
        if size.max() <= CONTACT and not behind[a]:
            continue  # in contact and not deep, on whichever side
        at = a + int(size.argmax())
        inside = abs(depth.winding(surface.vertices, surface.faces, points[at])) > 0.5
        if inside and not np.isfinite(size).all():
            size = np.abs(nearest.signed(boxes.of(surface), points[a:b]))
        found[a:b] = -size if inside else size
    return found

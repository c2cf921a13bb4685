"""Position of the tool relative to the anatomy, independent of planes and rules.

Distance and side of the tip are the surface's own queries, on the tree that the planes use too;
crossings, lines of sight and the distance of the other parts are computed by `app.judges`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

import vf
from app.control.watch import Crossing
from app.judges import boxes
from app.judges.meeting import sees
from app.judges.nearest import gaps
from app.judges.oracles import OVERLAP_TOLERANCE
from app.scene.moment import Placed, seen_from
from app.scene.scene import Scene
from robots import Arm

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Whereabouts:
    """Position of the tool relative to the anatomy.

    Attributes:
        distance: from the tip's centre to the nearest triangle, unsigned [m].
        tip_radius: radius of the tip's ball [m].
        closed: whether the mesh has an inside.
        inside: whether the tip's centre is inside it.
        crossing: first contact of the tip with the mesh since the last reset, or None.
        beyond: whether the tip is on the far side of a shell or an open mesh: its centre crossed
            the mesh, is not inside, and sees neither the point before the crossing nor the start.
        from_crossing: from the tip's centre to the crossing [m]; 0 without one.
        part: name of the part of the instrument that is nearest to the mesh.
        part_gap: its distance from there [m]; negative: it overlaps it, by its radius at most.
        in_mesh: names of the parts that are in the mesh: those beyond the first, which is at the
            tip, that overlap it, and any whose axis meets it.
        structure: name of the structure that the distance is from.
    """

    distance: float
    tip_radius: float
    closed: bool
    inside: bool
    crossing: Crossing | None
    beyond: bool
    from_crossing: float
    part: str
    part_gap: float
    in_mesh: tuple[str, ...]
    structure: str = ""

    @property
    def gap(self) -> float:
        """From the tip's ball to the nearest triangle [m]; negative if they overlap."""
        return self.distance - self.tip_radius

    @property
    def overlaps(self) -> bool:
        """Whether the tip's ball overlaps the mesh by more than rounding."""
        return self.tip_radius > 0.0 and self.gap < -OVERLAP_TOLERANCE

    @property
    def free(self) -> bool:
        """Whether the tip is in free space and has not met the mesh."""
        return not (self.inside or self.overlaps or self.crossing)


def whereabouts(
    scene: Scene,
    q: ArrayLike,
    p_tip: ArrayLike,
    tip_radius: float,
    crossing: Crossing | None,
    trocar: float = 0.0,
    around: Sequence[tuple[str, vf.Surface]] = (),
    poses: Sequence[pin.SE3 | None] = (),
) -> Whereabouts:
    """Position of the tip p_tip (3,) [m], base frame, of the arm at joints q (n,).

    Args:
        trocar: radius of the trocar zone [m], in which the shaft may be in the mesh.
        around: the structures that count, each with its name; empty: the scene's mesh.
        poses: T_rest_now of each; None: it rests. Empty: all do.
    """
    around, p = around or (("", scene.surface),), np.asarray(p_tip, dtype=np.float64)
    poses = poses or [None] * len(around)
    own = [seen_from(pose, p) for pose in poses]
    inside = [surface.inside(x) for (_, surface), x in zip(around, own, strict=True)]
    distances = [surface.nearest(x)[0] for (_, surface), x in zip(around, own, strict=True)]
    # Inside of something, that counts, however near another one is.
    k = min(range(len(around)), key=lambda k: (not inside[k], distances[k]))
    beyond, length = False, 0.0
    if crossing is not None:
        length = float(np.linalg.norm(p - crossing.point))
        near = (crossing.before, np.asarray(scene.T_base_start.translation))
        every = [(name, s, pose) for (name, s), pose in zip(around, poses, strict=True)]
        met = [one for one in every if one[0] == crossing.structure] or every
        seen = any(
            all(sees(s, seen_from(pose, p), seen_from(pose, y)) for _, s, pose in met) for y in near
        )
        beyond = crossing.centre and not any(inside) and not seen
    part, part_gap, in_mesh = _parts(scene, q, trocar, [s for _, s in around], poses)
    return Whereabouts(
        distance=distances[k],
        tip_radius=tip_radius,
        closed=any(surface.closed for _, surface in around),
        inside=inside[k],
        crossing=crossing,
        beyond=beyond,
        from_crossing=length,
        part=part,
        part_gap=part_gap,
        in_mesh=in_mesh,
        structure=around[k][0],
    )


def _parts(
    scene: Scene,
    q: ArrayLike,
    trocar: float,
    surfaces: Sequence[vf.Surface],
    poses: Sequence[pin.SE3 | None],
) -> tuple[str, float, tuple[str, ...]]:
    """Of a `Whereabouts`: part, part_gap, in_mesh."""
    capsules = scene.arm.capsules
    pairs = zip(surfaces, poses, strict=True)
    found = np.min([part_gaps(one, scene.arm, q, trocar, pose) for one, pose in pairs], axis=0)
    in_mesh = tuple(
        capsule.name
        for k, (capsule, gap) in enumerate(zip(capsules, found, strict=True))
        if gap == -capsule.radius or (k > 0 and gap < -OVERLAP_TOLERANCE)
    )
    k = int(found.argmin())
    return capsules[k].name, float(found[k]), in_mesh


class _Seen:
    """An arm as a structure sees that has moved: what `gaps` asks of it."""

    def __init__(self, arm: Arm, pose: pin.SE3) -> None:
        self.capsules = arm.capsules
        self._arm, self._pose = arm, pose

    def axes(self, q: ArrayLike) -> FloatArray:
        return seen_from(self._pose, self._arm.axes(q))


def part_gaps(
    surface: vf.Surface, arm: Arm, q: ArrayLike, trocar: float, pose: pin.SE3 | None = None
) -> FloatArray:
    """`app.judges.nearest.gaps` of a surface that has moved: T_rest_now; None: it rests."""
    seen = arm if pose is None else _Seen(arm, pose)
    return gaps(boxes.of(surface), seen, q, trocar)  # type: ignore[arg-type]


def nearest_of(structures: Sequence[Placed], p_base: ArrayLike) -> Placed:
    """The structure that is nearest to p_base (3,)."""
    return min(structures, key=lambda one: one.surface.nearest(one.seen(p_base))[0])


def signed_distance(surface: vf.Surface, p_base: ArrayLike) -> float:
    """Distance from p_base (3,) to the surface [m]; negative inside a closed one."""
    distance, _, _ = surface.nearest(p_base)
    return -distance if surface.inside(p_base) else distance

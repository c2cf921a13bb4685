"""Position of the tool relative to the anatomy, independent of planes and rules.

Distance and side are the surface's own queries, on the tree that the planes use too; crossings and
lines of sight are computed by `app.judges`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

import vf
from app.control.watch import Crossing
from app.judges.meeting import sees
from app.judges.oracles import OVERLAP_TOLERANCE
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
        shaft_crosses: whether the instrument's axis, from the tip along the arm, meets the mesh.
    """

    distance: float
    tip_radius: float
    closed: bool
    inside: bool
    crossing: Crossing | None
    beyond: bool
    from_crossing: float
    shaft_crosses: bool

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
    scene: Scene, q: ArrayLike, p_tip: ArrayLike, tip_radius: float, crossing: Crossing | None
) -> Whereabouts:
    """Position of the tip p_tip (3,) [m], base frame, of the arm at joints q (n,)."""
    surface, p = scene.surface, np.asarray(p_tip, dtype=np.float64)
    inside = surface.inside(p)
    beyond, length = False, 0.0
    if crossing is not None:
        length = float(np.linalg.norm(p - crossing.point))
        near = (crossing.before, np.asarray(scene.T_base_start.translation))
        beyond = crossing.centre and not inside and not any(sees(surface, p, y) for y in near)
    return Whereabouts(
        distance=surface.nearest(p)[0],
        tip_radius=tip_radius,
        closed=surface.closed,
        inside=inside,
        crossing=crossing,
        beyond=beyond,
        from_crossing=length,
        shaft_crosses=not free_line(surface, shaft(scene.arm, q, p)),
    )


def shaft(arm: Arm, q: ArrayLike, p_tip: FloatArray) -> FloatArray:
    """Polyline (k, 3) [m] of an arm at joints q (n,), from its tip through its joints to its base.

    Joints without a drawn body, and repeated points, are skipped.
    """
    places = {body.frame: row[4:] for body, row in zip(arm.bodies, arm.placements(q), strict=True)}
    line = [np.asarray(p_tip, dtype=np.float64)]
    for joint in reversed(arm.joints):
        place = places.get(joint)
        if place is not None and np.linalg.norm(place - line[-1]) > 1e-6:
            line.append(place)
    return np.array(line)


def free_line(surface: vf.Surface, line: FloatArray) -> bool:
    """Whether no segment of a polyline (k, 3) [m] meets the mesh."""
    return all(sees(surface, line[k], line[k + 1]) for k in range(len(line) - 1))


def signed_distance(surface: vf.Surface, p_base: ArrayLike) -> float:
    """Distance from p_base (3,) to the surface [m]; negative inside a closed one."""
    distance, _, _ = surface.nearest(p_base)
    return -distance if surface.inside(p_base) else distance

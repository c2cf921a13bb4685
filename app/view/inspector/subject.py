"""What the inspector looks at: the structure that matters at the shown tick, and where a ray hits.

Structures that move are looked at where the guard believed them to be at the end of the tick, in
the shape that it believed them to have.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from app.scene.moment import Moment, Placed, seen_from
from app.scene.picking import along, main_structure, margin_near, pick
from app.view.inspector.compare import Pose
from app.view.inspector.inspection import Subject

FloatArray = NDArray[np.float64]


def at_tool(shown: Moment, chosen: int | None) -> Subject | None:
    """The tool at the shown tick; None: there was no tick in this scene.

    Args:
        chosen: number of the structure to look at, where it is guarded; None: the one that pushes
            most, or else the nearest.
    """
    options, scene, telemetry = shown.options, shown.scene, shown.telemetry
    step = telemetry.step
    if step is None or telemetry.scene != scene.version:
        return None
    p_tip, target = np.array(step.tip.translation), telemetry.target
    around = around_tool(shown)
    points = [seen_from(one.believed, p_tip) for one in around]
    numbers = [one.number for one in around]
    k = main_structure(
        [one.guards for one in around], step, points, numbers.index(chosen)
        if chosen in numbers else None,
    )  # fmt: skip
    one = around[k]
    moves = shown.pose(one.number) is not None
    margin = margin_near(one.own, one.guards, points[k], scene.added) + shown.margin(one.number)
    # A forecast's controller knows structures at rest alone.
    pose = None if target is None or shown.moves else Pose(telemetry.q, target)
    return Subject(
        scene.surfaces[one.number], p_tip, step.radius, options, options.rule, scene, step, pose,
        fixture=k, structure=str(one.own.name) if scene.structures else "", tick=telemetry.tick,
        axes=scene.arm.axes(step.q), margin=margin, number=one.number,
        placed=one if moves else None,
    )  # fmt: skip


def around_tool(shown: Moment) -> list[Placed]:
    """The structures that are guarded, in the order of the fixtures; if none is, the mesh."""
    return shown.guarded or shown.structures[:1]


def hit(shown: Moment, eye: FloatArray, direction: FloatArray) -> tuple[int, int] | None:
    """Structure and triangle that a ray from an eye (3,) [m] meets first; None: it meets none.

    Raises:
        ValueError: no ray.
    """
    found = []
    for one in around_tool(shown):
        turn = np.eye(3) if one.believed is None else one.believed.rotation
        o, d = seen_from(one.believed, eye), np.asarray(direction, dtype=np.float64) @ turn
        triangle = pick(one.guards, o, d)
        if triangle >= 0:
            found.append((along(one.guards, triangle, o, d), one.number, triangle))
    return min(found)[1:] if found else None

"""How far a point is from the anatomy, and on which side."""

from __future__ import annotations

from numpy.typing import ArrayLike

import vf


def signed_distance(surface: vf.Surface, p_base: ArrayLike) -> float:
    """Distance from p_base (3,) to the surface [m]; negative inside it: minus the depth.

    An open surface has no inside, so there the distance is never negative.
    """
    distance, _, _ = surface.nearest(p_base)
    return -distance if surface.inside(p_base) else distance

"""Where the tip meets a structure that truly deforms, by the judge of moving triangles."""

from __future__ import annotations

from collections.abc import Sequence
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

import vf
from app.judges import passing
from app.judges.meeting import Meeting
from app.motion.forms import Form
from vf.tree.memory import Memory

FloatArray = NDArray[np.float64]
Memories = tuple[Memory, Memory, Memory]

IN_USE = 3  # arrays of a kind that are taken again

# Of every form the pair of shapes that was looked at last: ticks come in their order.
# The memory of those before is used again: new one for each takes longer than what is written.
_known: WeakKeyDictionary[Form, tuple[int, passing.Shapes, Memories]] = WeakKeyDictionary()


def first_of_shapes(
    surface: vf.Surface,
    form: Form,
    shapes: Sequence[tuple[int, tuple[float, float]]],
    starts: FloatArray,
    ends: FloatArray,
    tip_radius: float,
) -> Meeting | None:
    """The first tick in which a tip meets a structure, as `app.judges.meeting.first_meeting`.

    Args:
        surface: the structure at rest, for its faces.
        shapes: of every tick, see `Form.during`.
        starts, ends: (n, 3) of the tip, as the structure sees it [m].
        tip_radius: [m].
    """
    for k, (pair, blend) in enumerate(shapes):
        a, b = starts[k], ends[k]
        if (a == b).all() and blend[0] == blend[1]:
            continue
        mesh = _mesh(surface, form, pair)
        crossed = passing.first_touch(mesh, a, b, 0.0, blend)
        found = crossed
        if tip_radius > 0.0:
            touched = passing.first_touch(mesh, a, b, tip_radius, blend)
            # One that overlapped already meets nothing but with its centre.
            if touched is not None and touched[1] > 0.0:
                found = touched
        if found is not None:
            triangle, share = found
            return Meeting(k, triangle, a + share * (b - a), crossed is not None)
    return None


def _mesh(surface: vf.Surface, form: Form, pair: int) -> passing.Shapes:
    known = _known.get(form)
    if known is None or known[0] != pair:
        like, memory = (None, (Memory(IN_USE), Memory(IN_USE), Memory(IN_USE)))
        room = None
        if known is not None:
            like, memory = known[1:]
            sizes = like.ways, like.boxes.vertices, like.boxes.boxes
            ways, corners, around = (
                own.array(one.shape) for own, one in zip(memory, sizes, strict=True)
            )
            room = ways, corners, around
        first, second = form.shape(pair), form.shape(pair + 1)
        mesh = passing.shapes(first, surface.faces, second, like, room)
        known = _known[form] = pair, mesh, memory
    return known[1]

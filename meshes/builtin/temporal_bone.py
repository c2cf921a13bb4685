"""A temporal bone of our own making: a drilled mastoid with the named structures around it.

The drill comes from above (+z, lateral); x points to the front, y to the top of the head. It is a
model with anatomy's order, sizes (nerves and ossicles of 1 to 3 mm) and distances, not a patient.
Margins are those of drilling: what must not be touched by more, what is robust by less.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from manifold3d import Manifold
from numpy.typing import ArrayLike

from meshes.builtin.shapes import to_metres
from meshes.builtin.tubes import as_solid, tube, united
from meshes.content import Arrays

NAME = "temporal-bone"
Colour = tuple[int, int, int]


@dataclass(frozen=True)
class Member:
    """A structure of a set.

    Attributes:
        name, colour: as `meshes.Structure` has them.
        margin: distance to keep from it [m]; None for what is to be cut.
        make: vertices [m] and faces.
    """

    name: str
    colour: Colour
    margin: float | None
    make: Callable[[], Arrays]


def bone() -> Arrays:
    """A block, 46 × 42 × 32 mm, with a cavity open to the top, ⌀ 28 mm narrowing to 12."""
    block = Manifold.cube((46.0, 42.0, 32.0), True).refine_to_length(2.0).translate((0, 0, -16.0))
    cavity = Manifold.cylinder(20.0, 6.0, 14.2, 64).translate((-2.0, 0.0, -19.8))
    return to_metres((block - cavity).refine_to_length(2.0).translate((0.0, 0.0, _UP)))


def facial_nerve() -> Arrays:
    """⌀ 1.6 mm: the horizontal part, the second genu, and the vertical part downwards."""
    return _tube([(12, 4, -25), (6, 3.6, -23), (0.5, 2.4, -21.4), (-2, -2, -20.2), (-2, -9, -19.4),
                  (-2, -19, -19)], 0.8)  # fmt: skip


def chorda_tympani() -> Arrays:
    """⌀ 1 mm: from beside the vertical part of the facial nerve upwards to the front."""
    return _tube([(0.4, -10.6, -18.2), (1.8, -7, -17), (4.5, -2.5, -16), (9.0, 1.5, -15.5)], 0.5)


def malleus() -> Arrays:
    """A head of 2.6 mm and a handle of ⌀ 1.1 mm, 5 mm long."""
    handle = tube([(6.5, 5.0, -18.5), (7.2, 2.6, -18.7), (8.2, 0.5, -19.2)], 0.55, 16)
    return _moved(united([_ball((6.5, 5.4, -18.3), 1.3), as_solid(handle)]))


def incus() -> Arrays:
    """A body of 2.4 mm, a short process backwards and a long one downwards."""
    long = tube([(3.2, 5.2, -18.4), (3.4, 2.6, -18.6), (3.8, 1.1, -19.4)], 0.5, 16)
    short = tube([(3.2, 5.2, -18.4), (1.8, 5.4, -18.2), (0.2, 5.6, -18.0)], 0.6, 16)
    return _moved(united([_ball((3.3, 5.3, -18.4), 1.2), as_solid(long), as_solid(short)]))


def stapes() -> Arrays:
    """A stirrup, 3 mm high: two legs on a footplate."""
    legs = tube([(3.0, -0.2, -23.0), (3.1, 0.1, -21.6), (4.0, 0.2, -20.8), (4.9, 0.1, -21.6),
                 (5.0, -0.2, -23.0)], 0.32, 12)  # fmt: skip
    plate = tube([(2.8, -0.2, -23.2), (4.0, -0.2, -23.3), (5.2, -0.2, -23.2)], 0.5, 16)
    return _moved(united([as_solid(plate), as_solid(legs)]))


def canals() -> Arrays:
    """Three loops of ⌀ 1.4 mm, 6 mm across, at right angles to each other, on a vestibule."""
    loops = [_loop((-4.6, 6.6, -22.2), turn) for turn in ((0, 0, 0), (90, 0, 0), (0, 90, 0))]
    return _moved(united([*loops, _ball((-4.6, 6.6, -22.2), 1.9)]))


def sigmoid_sinus() -> Arrays:
    """⌀ 9 mm: an S behind the cavity, downwards."""
    return _tube([(-14.6, 9, -8.6), (-16, 4.5, -9), (-15.2, 0, -11), (-15.0, -8, -14),
                  (-12, -16, -18)], 4.5, 32)  # fmt: skip


def dura() -> Arrays:
    """A sheet 1 mm thick over the top of the cavity, 36 × 24 mm, bent."""

    def bend(points: np.ndarray) -> np.ndarray:
        bent = np.array(points)
        bent[:, 1] += 16.5 + 0.004 * points[:, 0] ** 2 - 0.006 * (points[:, 2] + 2.0) ** 2
        bent[:, 2] -= 16.0
        return bent

    sheet = Manifold.cube((36.0, 1.0, 24.0), True).refine_to_length(1.0)
    return _moved(sheet.warp_batch(bend))


def members() -> Mapping[str, Member]:
    """The structures by name, the bone first."""
    return {one.name: one for one in _MEMBERS}


_UP = 16.0  # [mm] so that the origin is in the middle of the block


def _moved(solid: Manifold) -> Arrays:
    return to_metres(solid.translate((0.0, 0.0, _UP)))


def _tube(path: ArrayLike, radius: float, sides: int = 24) -> Arrays:
    points = np.array(path, dtype=np.float64)
    points[:, 2] += _UP
    found = tube(points, radius, sides)
    return 1e-3 * found.vertices, found.faces  # [mm] -> [m]


def _ball(centre: tuple[float, float, float], radius: float) -> Manifold:
    return Manifold.sphere(radius, 32).translate(centre)


def _loop(centre: tuple[float, float, float], turn: tuple[float, float, float]) -> Manifold:
    """A ring about the z axis of ⌀ 6 mm beside a centre, turned [degree] about it."""
    angles = np.radians(np.linspace(0.0, 360.0, 48, endpoint=False))
    around = np.radians(np.linspace(0.0, 360.0, 16, endpoint=False))
    ring = 3.0 + 0.7 * np.cos(around)
    x = -2.6 + ring[None, :] * np.cos(angles)[:, None]
    y = ring[None, :] * np.sin(angles)[:, None]
    z = np.broadcast_to(0.7 * np.sin(around), x.shape)
    grid = np.arange(x.size).reshape(x.shape)
    a, b = grid, np.roll(grid, -1, axis=0)
    c, d = np.roll(b, -1, axis=1), np.roll(grid, -1, axis=1)
    faces = np.concatenate(
        [np.stack([a, b, c], axis=2).reshape(-1, 3), np.stack([a, c, d], axis=2).reshape(-1, 3)]
    )
    solid = as_solid((np.stack([x, y, z], axis=2).reshape(-1, 3), faces))
    return solid.rotate(turn).translate(centre)


_MEMBERS = (
    Member("bone", (227, 218, 201), None, bone),
    Member("facial nerve", (244, 214, 49), 1.0e-3, facial_nerve),
    Member("chorda tympani", (244, 170, 66), 0.5e-3, chorda_tympani),
    Member("malleus", (214, 230, 130), 0.5e-3, malleus),
    Member("incus", (180, 220, 140), 0.5e-3, incus),
    Member("stapes", (140, 200, 150), 1.0e-3, stapes),
    Member("semicircular canals", (120, 170, 220), 1.0e-3, canals),
    Member("sigmoid sinus", (70, 110, 210), 2.0e-3, sigmoid_sinus),
    Member("dura", (200, 120, 150), 3.0e-3, dura),
)

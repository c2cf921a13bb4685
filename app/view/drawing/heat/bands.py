"""Bands of a surface between levels of a value, their colours and their legend."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from app.view import palette

FloatArray = NDArray[np.float64]
Part = tuple[FloatArray, NDArray[np.int64]]  # vertices (n, 3) and faces (m, 3)

MOST = 10  # bands of a scale
_STEPS = (1.0, 2.0, 2.5, 5.0)  # of a scale, times a power of ten
# matplotlib's viridis (CC0) at equal distances: steps of lightness that look alike.
_RAMP = np.array(
    [
        (68, 1, 84), (71, 45, 123), (59, 82, 139), (44, 114, 142), (33, 145, 140), (40, 174, 128),
        (94, 201, 98), (173, 220, 48), (253, 231, 37),
    ],
    dtype=float,
)  # fmt: skip


@dataclass(frozen=True)
class Scale:
    """Round levels around a range of lengths.

    Attributes:
        low, high: the range [m].
        step: between two levels [m].
        first: number of the lowest level; level k is at k times the step.
        bands: how many.
    """

    low: float
    high: float
    step: float
    first: int
    bands: int

    @property
    def levels(self) -> FloatArray:
        """The levels (bands + 1,), the lowest first [m]."""
        return np.asarray(self.step * np.arange(self.first, self.first + self.bands + 1.0))

    @property
    def colors(self) -> list[palette.Rgb]:
        """The colour of every band; of a single one that of the middle."""
        if self.bands == 1:
            return [ramp(0.5)]
        return [ramp(k / (self.bands - 1)) for k in range(self.bands)]


def scale(low: float, high: float) -> Scale:
    """The finest scale of at most `MOST` bands around a range of lengths [m]."""
    span = max(high - low, 1e-6)
    power = 10.0 ** math.floor(math.log10(span / MOST))
    for step in (power * one for one in (*_STEPS, 10.0, 20.0)):
        first = math.floor(low / step + 1e-9)
        bands = max(math.ceil(high / step - 1e-9) - first, 1)
        if bands <= MOST:
            return Scale(low, high, step, first, bands)
    raise AssertionError("the coarsest step is a fifth of the range")


def ramp(share: float) -> palette.Rgb:
    """The colour at a share of the range, 0 to 1."""
    place = min(max(share, 0.0), 1.0) * (len(_RAMP) - 1)
    low = min(int(place), len(_RAMP) - 2)
    red, green, blue = _RAMP[low] + (place - low) * (_RAMP[low + 1] - _RAMP[low])
    return round(red), round(green), round(blue)


@dataclass(frozen=True)
class Piece:
    """The part of a surface in a band, by the surface's vertices: it follows where these go.

    Attributes:
        kept: (u,) numbers of vertices that are vertices of the part.
        corners: (l, 3) numbers of those of the triangle that a further vertex is in.
        weights: (l, 3) of these in it.
        faces: (k, 3) of vertices, those that are kept first.
    """

    kept: NDArray[np.int64]
    corners: NDArray[np.int64]
    weights: FloatArray
    faces: NDArray[np.int64]

    def vertices(self, of: FloatArray) -> FloatArray:
        """Its vertices (u + l, 3), of those of the surface (n, 3)."""
        inner = np.einsum("ij,ijk->ik", self.weights, of[self.corners])
        return np.concatenate([of[self.kept], inner])


def bands(
    vertices: FloatArray, faces: NDArray[np.int64], values: FloatArray, among: Scale
) -> list[Part]:
    """The part of a surface in each band of a scale, see `pieces`.

    Args:
        vertices: (n, 3).
    """
    found = pieces(faces, values, among)
    return [(piece.vertices(vertices), piece.faces) for piece in found]


def pieces(faces: NDArray[np.int64], values: FloatArray, among: Scale) -> list[Piece]:
    """The part of a surface in each band of a scale, cut along the levels; may be empty.

    Args:
        faces: (m, 3).
        values: (n,) at the vertices [m], linear on a triangle; those outside of the scale count to
            its first or last band.
    """
    inner = among.levels[1:-1]
    of_vertex = np.searchsorted(inner, values, side="right")[faces]  # (m, 3)
    lowest, highest = of_vertex.min(axis=1), of_vertex.max(axis=1)
    mixed = faces[lowest != highest]
    # Corners (k, 3, 4), each by its weights in the triangle and the triangle's number, and their
    # values (k, 3).
    weights = np.broadcast_to(np.eye(3), (len(mixed), 3, 3))
    number = np.broadcast_to(np.arange(float(len(mixed)))[:, None, None], (len(mixed), 3, 1))
    rest = np.concatenate([weights, number], axis=2), values[mixed]
    found = []
    for k in range(among.bands):
        cut = rest[0]
        if k < len(inner):
            (cut, _), rest = _split(*rest, inner[k])
        whole = faces[(lowest == k) & (highest == k)]
        found.append(_joined(len(values), whole, cut, mixed))
    return found


def _split(
    corners: FloatArray, values: FloatArray, level: float
) -> tuple[tuple[FloatArray, FloatArray], tuple[FloatArray, FloatArray]]:
    """Triangles (k, 3, d) with values (k, 3) below and above a level, cut along it."""
    below = values < level
    count = below.sum(axis=1)
    low, high = count == 3, count == 0
    mixed = ~(low | high)
    # The corner that is alone on its side comes first.
    alone = np.where(count[mixed, None] == 1, below[mixed], ~below[mixed]).argmax(axis=1)
    turn = (alone[:, None] + np.arange(3)) % 3
    p = np.take_along_axis(corners[mixed], turn[:, :, None], axis=1)
    v = np.take_along_axis(values[mixed], turn, axis=1)
    share = (level - v[:, :1]) / (v[:, 1:] - v[:, :1])  # (k, 2), along both of its edges
    at = p[:, :1] + share[:, :, None] * (p[:, 1:] - p[:, :1])
    level_ = np.full(len(v), level)
    tip = np.stack([p[:, 0], at[:, 0], at[:, 1]], axis=1)
    sides = [
        np.stack([at[:, 0], p[:, 1], p[:, 2]], axis=1),
        np.stack([at[:, 0], p[:, 2], at[:, 1]], axis=1),
    ]
    tip_values = np.stack([v[:, 0], level_, level_], axis=1)
    side_values = [
        np.stack([level_, v[:, 1], v[:, 2]], axis=1),
        np.stack([level_, v[:, 2], level_], axis=1),
    ]
    under = count[mixed] == 1  # the corner alone is below
    return (
        (
            np.concatenate([corners[low], tip[under], *(one[~under] for one in sides)]),
            np.concatenate([values[low], tip_values[under], *(one[~under] for one in side_values)]),
        ),
        (
            np.concatenate([corners[high], tip[~under], *(one[under] for one in sides)]),
            np.concatenate(
                [values[high], tip_values[~under], *(one[under] for one in side_values)]
            ),
        ),
    )


def _joined(n: int, faces: NDArray[np.int64], cut: FloatArray, mixed: NDArray[np.int64]) -> Piece:
    """One part of some faces (m, 3) of n vertices, and of loose triangles (k, 3, 4) in `mixed`."""
    used = np.zeros(n, dtype=bool)
    used[faces] = True
    number = np.cumsum(used) - 1
    loose = used.sum() + np.arange(3 * len(cut)).reshape(-1, 3)
    flat = cut.reshape(-1, 4)
    # Rounded: a mean of equal numbers need not be that number.
    corners = mixed[np.rint(flat[:, 3]).astype(np.int64)]
    return Piece(
        np.flatnonzero(used), corners.reshape(-1, 3), flat[:, :3],
        np.concatenate([number[faces], loose]),
    )  # fmt: skip


def legend(among: Scale) -> str:
    """HTML legend: the bands side by side with their levels, and the range [mm]."""
    swatches = "".join(
        f"<span style='flex:1;background:{palette.css(color)}'></span>" for color in among.colors
    )
    every = 2 if among.bands > 6 else 1
    marks = "".join(
        f"<span style='position:absolute;left:{100.0 * k / among.bands:.3f}%;"
        f"transform:translateX(-50%)'>{1e3 * level:.4g}</span>"
        for k, level in enumerate(among.levels)
        if k % every == 0 or (k == among.bands and among.bands % every == 0)
    )
    return (
        "<div class='vf-heat' style='margin:0 1.4em .3em;font-size:11px;line-height:1.3;"
        "color:var(--vf-soft)'>"
        "<div style='display:flex;justify-content:space-between'><span>Margin [mm], with what the "
        f"registration adds</span><b>{1e3 * among.low:.2f} – {1e3 * among.high:.2f}</b></div>"
        f"<div style='display:flex;height:9px;border-radius:2px;overflow:hidden'>{swatches}</div>"
        f"<div style='position:relative;height:14px'>{marks}</div></div>"
    )

"""Layer: the path of the tool's tip, coloured by its depth in the anatomy."""

from __future__ import annotations

import numpy as np
import viser
from numpy.typing import NDArray

from app.view import palette
from app.view.drawing import nodes
from app.view.units import to_buffer

FloatArray = NDArray[np.float64]

LENGTH = 600  # segments kept; the oldest are dropped
MIN_STEP = 2e-4  # length of the shortest segment [m]
MAX_STEP = 1e-2  # a longer motion between two frames is a reset: no segment [m]
MAX_DEPTH = 2e-3  # of the darkest colour [m]: the skull's thickness

# From the surface downwards; distinct from bone and from each other by lightness alone.
_OUTSIDE = palette.SKY
_RAMP = np.array([palette.YELLOW, palette.ORANGE, palette.VERMILION, (90, 20, 0)], dtype=float)


def colors(distances: FloatArray) -> NDArray[np.uint8]:
    """Colours (n, 3) of signed distances (n,) [m] from the surface, negative inside."""
    place = np.clip(-distances / MAX_DEPTH, 0.0, 1.0) * (len(_RAMP) - 1)
    low = np.minimum(place.astype(int), len(_RAMP) - 2)
    mixed = _RAMP[low] + (place - low)[:, None] * (_RAMP[low + 1] - _RAMP[low])
    mixed[distances >= 0.0] = _OUTSIDE
    return mixed.round().astype(np.uint8)


def legend() -> str:
    """HTML legend of the trail's colours."""
    stops = ",".join(palette.css(tuple(map(int, c))) for c in _RAMP)  # type: ignore[arg-type]
    return (
        "<div style='margin:0 .75em .4em;font-size:11px;color:var(--vf-soft);display:flex;gap:5px;"
        "align-items:center;white-space:nowrap'>"
        f"<span style='width:12px;height:9px;background:{palette.css(_OUTSIDE)}'></span>outside"
        "<span style='margin-left:8px'>0</span>"
        f"<span style='flex:1;height:9px;background:linear-gradient(90deg,{stops})'></span>"
        f"{MAX_DEPTH * 1e3:g} mm deep</div>"
        "<div style='margin:0 .75em .4em;font-size:11px;line-height:1.3;color:var(--vf-faint)'>"
        "The bone hides what is inside it: View › Layers › See-through.</div>"
    )


class Path:
    """The newest `LENGTH` segments of a path."""

    def __init__(self) -> None:
        self.segments = np.zeros((LENGTH, 2, 3))  # end points [m], oldest first
        self.distances = np.zeros((LENGTH, 2))  # signed, at the end points [m]
        self.count = 0
        self._last: tuple[FloatArray, float] | None = None

    def add(self, p_tip: FloatArray, distance: float) -> bool:
        """Extend to p_tip (3,) [m] at a signed distance [m]; whether a segment was added."""
        last = self._last
        if last is None:
            self._last = (p_tip, distance)
            return False
        moved = float(np.linalg.norm(p_tip - last[0]))
        if moved < MIN_STEP:
            return False
        self._last = (p_tip, distance)
        if moved > MAX_STEP:
            return False
        if self.count == LENGTH:
            self.segments[:-1] = self.segments[1:]
            self.distances[:-1] = self.distances[1:]
            self.count -= 1
        self.segments[self.count] = last[0], p_tip
        self.distances[self.count] = last[1], distance
        self.count += 1
        return True

    def clear(self) -> None:
        """Remove all segments."""
        self.count = 0
        self._last = None

    def break_line(self) -> None:
        """The next point starts a new line."""
        self._last = None


class Trail:
    """Draws a path. Its node always has `LENGTH` segments; unused ones have zero length."""

    def __init__(self, api: viser.SceneApi) -> None:
        self.path = Path()
        self._node = nodes.lines(api, "/trail", 4.0, count=LENGTH)

    def draw(self) -> None:
        """Send the path to the clients."""
        n = self.path.count
        self._node.visible = n > 0
        if n == 0:
            return
        points = np.empty((LENGTH, 2, 3))
        points[:n] = self.path.segments[:n]
        points[n:] = self.path.segments[n - 1, 1]
        shades = np.zeros((LENGTH, 2, 3), dtype=np.uint8)
        shades[:n] = colors(self.path.distances[:n].ravel()).reshape(n, 2, 3)
        self._node.points = to_buffer(points)
        self._node.colors = palette.linear(shades)

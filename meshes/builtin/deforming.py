"""Shapes that move as anatomy does: a beating heart, a breathing liver, a vessel that swells.

A rest shape, which is a mesh of the catalogue, and modes: fields of displacements with amplitudes
that are periodic. Shapes and modes are of our own making, in the orders of magnitude of the
literature: the heart's free wall moves 5 to 10 mm at 1 to 1.7 Hz, the liver 5 to 20 mm at 0.2 to
0.33 Hz with a pause after expiration, arteries widen by some 5 to 10 % of their diameter.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from meshes.builtin.tubes import tube
from meshes.content import Arrays
from meshes.errors import MeshError

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Deforming:
    """A closed mesh that deforms periodically, with the same faces at every phase.

    Attributes:
        name: of its rest shape in the catalogue.
        vertices: ``(n, 3)`` rest shape [m], that of phase 0.
        faces: ``(m, 3)``, the corners anticlockwise seen from outside.
        modes: ``(k, n, 3)`` displacements of the vertices [m] at amplitude 1.
        harmonics: ``(k, h)`` complex; the amplitude of mode k at a phase φ is
            ``Re Σ_m harmonics[k, m] exp(2πi m φ)``, and 0 at phase 0.
        period: usual duration of a cycle [s].
    """

    name: str
    vertices: FloatArray
    faces: NDArray[np.int64]
    modes: FloatArray
    harmonics: NDArray[np.complex128]
    period: float

    def amplitudes(self, phase: float) -> FloatArray:
        """``(k,)`` amplitudes at a phase, counted in cycles: 1.25 is the same as 0.25."""
        order = np.arange(self.harmonics.shape[1])
        return np.real(self.harmonics @ np.exp(2j * np.pi * order * (phase % 1.0)))

    def shape(self, phase: float) -> FloatArray:
        """``(n, 3)`` vertices [m] at a phase, counted in cycles."""
        return self.vertices + np.tensordot(self.amplitudes(phase), self.modes, axes=1)

    def rates(self, phase: float) -> FloatArray:
        """``(k,)`` derivatives of the amplitudes by the phase."""
        order = np.arange(self.harmonics.shape[1])
        turned = self.harmonics * (2j * np.pi * order)
        return np.real(turned @ np.exp(2j * np.pi * order * (phase % 1.0)))

    def fastest(self, period: float | None = None) -> float:
        """The largest speed of a vertex in a cycle [m/s], sampled at 256 phases."""
        speeds = [
            np.linalg.norm(np.tensordot(self.rates(phase), self.modes, axes=1), axis=1).max()
            for phase in np.arange(256) / 256
        ]
        return float(max(speeds)) / (self.period if period is None else period)


def deforming(name: str) -> Deforming:
    """A deforming mesh by its name: "heart", "liver" or "vessel".

    Raises:
        meshes.MeshError: another name; lists these.
    """
    if name not in _MAKERS:
        raise MeshError(f"{name!r} does not deform: choose one of {', '.join(_MAKERS)}")
    return _made(name)


def deforming_names() -> tuple[str, ...]:
    """The names of the deforming meshes."""
    return tuple(_MAKERS)


def rest(name: str) -> Arrays:
    """Vertices [m] and faces of a deforming mesh at rest."""
    one = deforming(name)
    return one.vertices.copy(), one.faces.copy()


@cache
def _made(name: str) -> Deforming:
    one = _MAKERS[name]()
    for array in (one.vertices, one.faces, one.modes, one.harmonics):
        array.flags.writeable = False
    return one


def _harmonics(times: list[float], values: list[float], count: int) -> NDArray[np.complex128]:
    """Fourier coefficients ``(count,)`` of a smooth periodic curve through points of a cycle.

    Shifted to be 0 at phase 0.
    """
    samples = 512
    curve = CubicSpline([*times, times[0] + 1.0], [*values, values[0]], bc_type="periodic")
    found = np.fft.rfft(curve(np.arange(samples) / samples))[:count] / samples
    found[1:] *= 2.0
    found[0] -= found.real.sum()
    return found


def _ball(subdivisions: int) -> tuple[FloatArray, NDArray[np.int64]]:
    """Unit directions ``(n, 3)`` and faces of an icosphere."""
    ball = trimesh.creation.icosphere(subdivisions=subdivisions)
    directions = np.array(ball.vertices, dtype=np.float64)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    return directions, np.array(ball.faces, dtype=np.int64)


def _heart() -> Deforming:
    """A heart-like egg, 110 × 86 × 77 mm, base towards −x, a groove between the ventricles.

    Modes: the wall moves inwards (8 mm at the middle of the free wall), the base approaches the
    apex (9 mm), the apex twists (8°). At 1.2 Hz; the curve is that of a ventricle's volume: fast
    ejection, fast filling, rest, and the atrium's kick.
    """
    u, faces = _ball(5)
    along = u[:, 0]  # −1 base, 1 apex
    slim = 1.0 - 0.22 * along - 0.10 * along**2  # thinner towards the apex
    groove = 1.0 - 0.07 * np.exp(-(((u[:, 1] + 0.25) / 0.16) ** 2)) * _step(u[:, 2], 0.0, 0.35)
    radial = slim * groove
    vertices = 1e-3 * np.column_stack(
        [55.0 * along, 42.0 * u[:, 1] * radial, 38.0 * u[:, 2] * radial]
    )
    share = np.clip((along + 1.0) / 2.0, 0.0, 1.0)  # 0 base, 1 apex
    across = vertices * [0.0, 1.0, 1.0]
    thickness = np.linalg.norm(across, axis=1, keepdims=True)
    # Proportional to the distance from the long axis: no wall is pushed through another one.
    inwards = -8.0e-3 * across / thickness.max() * (0.35 + 0.65 * np.sin(np.pi * share))[:, None]
    shorter = np.zeros_like(vertices)
    shorter[:, 0] = 9.0e-3 * (1.0 - share) ** 1.5
    twist = np.radians(8.0) * share**2
    turned = twist[:, None] * np.cross([1.0, 0.0, 0.0], vertices)
    times = [0.0, 0.08, 0.2, 0.33, 0.40, 0.48, 0.58, 0.72, 0.85, 0.93]
    squeeze = _harmonics(times, [0.0, 0.12, 0.72, 1.0, 0.92, 0.55, 0.2, 0.1, 0.09, 0.03], 20)
    untwist = _harmonics(times, [0.0, 0.05, 0.6, 1.0, 0.75, 0.25, 0.06, 0.02, 0.01, 0.0], 20)
    modes = np.stack([inwards, shorter, turned])
    return Deforming(
        "heart", vertices, faces, modes, np.stack([squeeze, squeeze, untwist]), 1 / 1.2
    )


def _liver() -> Deforming:
    """A liver-like wedge, 190 × 130 × 80 mm, thick on the right (−x), its dome towards +y.

    Modes: inspiration moves it down (−y) by 14 mm, the dome 4 mm more, and tilts its front (+z) up
    by 4 mm. At 0.25 Hz, by cos⁴, with the pause after expiration.
    """
    u, faces = _ball(5)
    x, y, z = u.T
    right = 0.5 * (1.0 - x)  # 1 at the right end
    thick = 0.32 + 0.68 * right**0.8
    vertices = 1e-3 * np.column_stack(
        [100.0 * x, 80.0 * y * (0.62 + 0.38 * right) + 14.0 * right, 54.0 * z * thick - 9.0 * x**2]
    )
    # A hollow on the lower back, where the gallbladder lies.
    hollow = np.exp(-(((x + 0.1) / 0.35) ** 2 + ((y + 0.75) / 0.4) ** 2 + ((z + 0.6) / 0.5) ** 2))
    vertices[:, 1] += 7e-3 * hollow
    high = (vertices[:, 1] - vertices[:, 1].min()) / np.ptp(vertices[:, 1])
    down = np.zeros_like(vertices)
    down[:, 1] = -14e-3
    flatter = np.zeros_like(vertices)
    flatter[:, 1] = -4e-3 * high**2
    forwards = np.zeros_like(vertices)
    forwards[:, 2] = 4e-3 * (1.0 - high)
    # 1 − cos⁴(π φ) = 5/8 − cos(2π φ)/2 − cos(4π φ)/8 is flat at inspiration; shifted by half a
    # cycle it pauses after expiration, where phase 0 is.
    breath = np.array([3 / 8, -1 / 2, 1 / 8], dtype=np.complex128)
    late = breath * np.exp(-2j * np.pi * np.arange(3) * 0.03)  # the front follows a little later
    late[0] -= late.real.sum()
    modes = np.stack([down, flatter, forwards])
    return Deforming("liver", vertices, faces, modes, np.stack([breath, breath, late]), 4.0)


def _vessel() -> Deforming:
    """A bent vessel with closed ends, ⌀ 12 mm, 80 mm long, that widens by a tenth with each pulse.

    Modes: the widening, and a sway of 1.5 mm that follows it. At 1.2 Hz.
    """
    at = np.linspace(0.0, 1.0, 9)
    path = np.column_stack([80.0 * at - 40.0, 4.0 * at, 12.0 * np.sin(np.pi * at)])  # [mm]
    whole = tube(1e-3 * path, 6e-3, sides=48)
    wider = 0.1 * (whole.vertices - whole.centres)
    sway = np.zeros_like(wider)
    sway[:, 1] = 1.5e-3 * np.sin(np.pi * whole.share) ** 2
    pulse = _harmonics(
        [0.0, 0.1, 0.18, 0.35, 0.42, 0.6, 0.8], [0, 0.75, 1.0, 0.6, 0.58, 0.3, 0.1], 12
    )
    late = pulse * np.exp(-2j * np.pi * np.arange(12) * 0.05)
    late[0] -= late.real.sum()
    modes, amplitudes = np.stack([wider, sway]), np.stack([pulse, late])
    return Deforming("vessel", whole.vertices, whole.faces, modes, amplitudes, 1 / 1.2)


def _step(x: FloatArray, middle: float, width: float) -> FloatArray:
    """0 below and 1 above the middle, smoothly."""
    return 0.5 * (1.0 + np.tanh((x - middle) / width))


_MAKERS: dict[str, Callable[[], Deforming]] = {
    "heart": _heart,
    "liver": _liver,
    "vessel": _vessel,
}

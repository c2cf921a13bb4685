"""Adversarial proxies, which try to move the tool through the surface."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

import vf

FloatArray = NDArray[np.float64]


def goals(
    rng: np.random.Generator, surface: vf.Surface, tip: pin.SE3, tools: list[pin.SE3]
) -> Iterator[pin.SE3]:
    """Endless proxy poses, base frame: pokes, slides, jumps and full-speed reversals.

    Args:
        rng: source of all randomness.
        surface: the anatomy.
        tip: start pose of the tool.
        tools: the caller keeps its only element, `tools[0]`, at the tool's present pose.
    """
    kinds = (_poke, _slide, _jerk, _reverse, _through)
    rotation = tip.rotation.copy()
    while True:
        kind = kinds[rng.integers(len(kinds))]
        if rng.random() < 0.3:
            axis = rng.normal(size=3)
            axis *= rng.uniform(0.0, 2.0) / np.linalg.norm(axis)
            rotation = pin.exp3(axis) @ tip.rotation
        length = int(rng.integers(20, 120))
        for p in kind(rng, surface, tools, length):
            yield pin.SE3(rotation, p)


def _poke(
    rng: np.random.Generator, surface: vf.Surface, tools: list[pin.SE3], length: int
) -> Iterator[FloatArray]:
    """Through the nearest point of the surface, up to 10 mm behind it."""
    x = tools[0].translation
    _distance, _face, point = surface.nearest(x)
    towards = point - x
    towards /= max(float(np.linalg.norm(towards)), 1e-12)
    depth = rng.uniform(0.0, 0.01)
    for _ in range(length):
        yield point + depth * towards


def _slide(
    rng: np.random.Generator, surface: vf.Surface, tools: list[pin.SE3], length: int
) -> Iterator[FloatArray]:
    """Along the surface and a little below it, following the tool."""
    heading = rng.normal(size=3)
    heading /= np.linalg.norm(heading)
    press = rng.uniform(0.0, 3e-3)
    stride = rng.uniform(1e-4, 5e-3)
    for _ in range(length):
        x = tools[0].translation
        _distance, _face, point = surface.nearest(x)
        towards = point - x
        towards /= max(float(np.linalg.norm(towards)), 1e-12)
        yield x + stride * heading + press * towards


def _jerk(
    rng: np.random.Generator, surface: vf.Surface, tools: list[pin.SE3], length: int
) -> Iterator[FloatArray]:
    """A new random goal within centimetres every tick."""
    for _ in range(length):
        yield tools[0].translation + rng.normal(size=3) * 0.01


def _reverse(
    rng: np.random.Generator, surface: vf.Surface, tools: list[pin.SE3], length: int
) -> Iterator[FloatArray]:
    """Back and forth through the surface at full speed."""
    x = tools[0].translation.copy()
    _distance, _face, point = surface.nearest(x)
    span = 3.0 * (point - x) + rng.normal(size=3) * 2e-3
    period = int(rng.integers(1, 6))
    for k in range(length):
        yield x + span * (1.0 if (k // period) % 2 == 0 else -1.0)


def _through(
    rng: np.random.Generator, surface: vf.Surface, tools: list[pin.SE3], length: int
) -> Iterator[FloatArray]:
    """Through any random vertex of the mesh, to a point beyond it."""
    goal = surface.vertices[rng.integers(len(surface.vertices))]
    x = tools[0].translation.copy()
    for _ in range(length):
        yield goal + 0.2 * (goal - x)

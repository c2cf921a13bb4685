"""A batch of queries: clearance and planes at thousands of points, on all cores.

To judge a planned path, or where a tool may be at all. A `Surface` is read-only and its queries
release the interpreter lock, so plain threads do it.
"""

import os
import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np

import meshes
import vf

surface = meshes.load("skull-coarse")
RADIUS = 5e-3  # of the motion sphere [m]

# 4,000 points within 5 mm of the planned cut, along each axis.
rng = np.random.default_rng(1)
path = meshes.planned_path("skull-coarse")  # (k, 3) [m]
points = path[rng.integers(len(path), size=4000)] + rng.uniform(-5e-3, 5e-3, (4000, 3))


def examine(x: np.ndarray) -> tuple[float, bool, int, float]:
    """Distance to the surface [m], whether x is inside, planes, the radius they hold in [m]."""
    planes = vf.certified_planes(surface, x, RADIUS, standoff=20e-6)
    return surface.nearest(x)[0], surface.inside(x), len(planes), planes.radius


examine(points[0])  # the first query of a process compiles the kernels, or loads them
began = time.perf_counter()
with ThreadPoolExecutor(os.cpu_count()) as pool:
    gaps, inside, counts, radii = map(np.array, zip(*pool.map(examine, points), strict=True))
seconds = time.perf_counter() - began

free = ~inside
print(f"{len(points)} points, {inside.sum()} of them inside the bone")
print(f"clearance outside: {gaps[free].min() * 1e3:.3f} to {gaps[free].max() * 1e3:.3f} mm")
print(f"planes: median {np.median(counts):.0f}, at most {counts.max()}")
print(f"the whole motion sphere is certified at {(radii == RADIUS).mean():.1%} of the points")
print(f"{seconds / len(points) * 1e6:.0f} µs a point")
assert counts.max() <= 64  # a query gives no more, and a smaller ball where that is too few

"""Only the planes: half-spaces for a solver of your own.

You have a robot and a solver. At every tick you ask for planes at the tip's position and add one
row to your problem for each. A step that obeys them, checked, touches no triangle.
"""

import numpy as np

import meshes
import vf

# Any triangles in the frame your controller works in, in metres; nothing needs to be cleaned.
surface = vf.Surface.from_arrays(*meshes.arrays("torus"))

# A point of the surface, and the tip 2 mm off it along the face's normal.
face = 100
foot = surface.vertices[surface.faces[face]].mean(axis=0)  # [m]
x = foot + 2e-3 * surface.normals[face]

planes = vf.certified_planes(surface, x, radius=5e-3, standoff=20e-6)
print(f"{surface.nearest(x)[0] * 1e3:.3f} mm from the surface, planes: {len(planes)}")

# Rows of a quadratic program in the tip's displacement d: normals @ d >= offsets - normals @ x.
G, h = planes.normals, planes.offsets - planes.normals @ x

# What a solver does with them, here without one: go 4 mm towards the surface, and shorten the step
# until it obeys every plane.
d = -4e-3 * surface.normals[face]
d *= min(1.0, (h[G @ d < 0] / (G @ d)[G @ d < 0]).min(initial=1.0))

# Check the position that the robot really reaches, not the one the solver believes in.
y = x + 0.999 * d
assert planes.slack(y).min() >= 0.0
assert np.linalg.norm(y - x) <= planes.radius
print(f"asked for 4.000 mm, allowed {np.linalg.norm(y - x) * 1e3:.3f} mm")
print(f"{surface.nearest(y)[0] * 1e6:.0f} µm are left to the surface")

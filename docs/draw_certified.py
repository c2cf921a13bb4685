"""Draw the pictures of certified.md beside it: `python docs/draw_certified.py` (extra `docs`).

Both show what the library computes, none is drawn by hand.
"""

from __future__ import annotations

from pathlib import Path

import matplotlib as mpl
import numpy as np
import trimesh
from matplotlib import pyplot as plt
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.patches import Circle, Patch, Polygon
from numpy.typing import NDArray

import meshes
import vf
from app.judges import oracles
from app.studies.verification import campaign

FloatArray = NDArray[np.float64]

HERE = Path(__file__).parent
MM = 1e-3
BONE, EDGE, ROOM, LOST = "#e8e1d4", "#7a6f5d", "#cfe8dc", "#f3c6a5"
# Okabe–Ito, as on the page.
COLOURS = {vf.Rule.FACE: "#0072b2", vf.Rule.RIDGE: "#d55e00", vf.Rule.VALLEY: "#009e73"}
NAMES = {vf.Rule.FACE: "face plane", vf.Rule.RIDGE: "ridge plane", vf.Rule.VALLEY: "valley plane"}


def clip(polygon: FloatArray, normal: FloatArray, offset: float) -> FloatArray:
    """The part of a convex polygon (k, 2) with n·z ≥ offset."""
    heights = polygon @ normal - offset
    kept = []
    for k in range(len(polygon)):
        j = (k + 1) % len(polygon)
        if heights[k] >= 0.0:
            kept.append(polygon[k])
        if (heights[k] >= 0.0) != (heights[j] >= 0.0):
            share = heights[k] / (heights[k] - heights[j])
            kept.append(polygon[k] + share * (polygon[j] - polygon[k]))
    return np.array(kept).reshape(-1, 2)


def prism(profile: FloatArray) -> vf.Surface:
    """A long strip of triangles over a profile (k, 2) in x and z, the same at every y."""
    k = len(profile)
    ends = [np.column_stack([profile[:, 0], np.full(k, y), profile[:, 1]]) for y in (-0.2, 0.2)]
    i = np.arange(k - 1)
    faces = np.concatenate(
        [np.column_stack([i, i + 1, k + i]), np.column_stack([i + 1, k + i + 1, k + i])]
    )
    return vf.Surface.from_arrays(np.concatenate(ends), faces)


def cover(path: Path) -> None:
    """Ball, triangles, planes, the convex region C and a step in it, on a slice."""
    profile = MM * np.array(
        [[-9, 2.2], [-6, 1.9], [-4, 1.5], [-1, -1.5], [1.5, -1.2], [1.2, 0.6], [3.2, 1.2],
         [5.2, 0.2], [9, -0.6]]
    )  # fmt: skip
    surface = prism(profile)
    x, radius, standoff = MM * np.array([-1.6, 0.0, 1.0]), 5 * MM, 0.2 * MM
    planes = vf.certified_planes(surface, x, radius, standoff)
    assert planes.radius == radius

    angles = np.linspace(0.0, 2.0 * np.pi, 361)[:-1]
    ball = x[[0, 2]] + radius * np.column_stack([np.cos(angles), np.sin(angles)])
    region = ball
    for n, o in zip(planes.normals, planes.offsets, strict=True):
        region = clip(region, n[[0, 2]], o - n[1] * x[1])
    y = MM * np.array([0.3, 0.0, 3.9])
    assert (planes.slack(y) > 0.0).all()
    assert np.linalg.norm(y - x) < radius

    figure, axes = plt.subplots(figsize=(7.2, 5.2), layout="constrained")
    under = np.concatenate([profile, MM * np.array([[9, -9], [-9, -9]])])
    axes.add_patch(Polygon(under / MM, closed=True, facecolor=BONE, edgecolor="none"))
    axes.plot(*(profile / MM).T, color=EDGE, lw=2.2, marker="o", ms=3.5)
    axes.add_patch(Circle(x[[0, 2]] / MM, radius / MM, fill=False, color="0.35", lw=1.2, ls="--"))
    axes.add_patch(Polygon(region / MM, closed=True, facecolor=ROOM, edgecolor="none"))
    for n, o, p, rule in zip(
        planes.normals, planes.offsets, planes.points, planes.rules, strict=True
    ):
        chord(axes, x, radius, n, o, COLOURS[vf.Rule(rule)])
        axes.plot(p[0] / MM, p[2] / MM, "o", color=COLOURS[vf.Rule(rule)], ms=6, zorder=5)
    arrow = {"arrowstyle": "-|>", "lw": 1.8, "color": "black"}
    axes.annotate("", y[[0, 2]] / MM, x[[0, 2]] / MM, arrowprops=arrow)
    axes.plot(x[0] / MM, x[2] / MM, "ko", ms=6)
    axes.text(x[0] / MM - 0.45, x[2] / MM + 0.1, "x", fontsize=13, style="italic")
    axes.text(y[0] / MM + 0.15, y[2] / MM + 0.05, "y", fontsize=13, style="italic")
    axes.text(-3.2, 3.6, "C", fontsize=16, style="italic")
    axes.text(-5.4, 5.35, "motion sphere", color="0.35", ha="center")
    axes.text(-7.6, -4.9, "behind the surface", color=EDGE)
    seen = [rule for rule in COLOURS if rule in planes.rules]
    handles = [plt.Line2D([], [], color=COLOURS[r], marker="o", label=NAMES[r]) for r in seen]
    handles.append(Patch(facecolor=ROOM, label="C: where a step may end"))
    axes.legend(handles=handles, loc="lower right", framealpha=1.0)
    frame(axes, x, 6.6)
    axes.set_xlim(-8, 8)
    axes.set_xlabel("[mm]; standoff drawn large: 0.2 mm")
    figure.savefig(path, metadata={"Date": None})
    plt.close(figure)


def chord(axes: Axes, x: FloatArray, radius: float, n: FloatArray, o: float, colour: str) -> None:
    """The line in which a plane cuts the slice through x, as far as it is in the ball."""
    m = n[[0, 2]]
    size = float(np.linalg.norm(m))
    gap = (o - n @ x) / size
    middle = x[[0, 2]] + gap * m / size
    half = np.sqrt(radius**2 - gap**2)
    along = np.array([-m[1], m[0]]) / size
    ends = np.array([middle - half * along, middle + half * along]) / MM
    axes.plot(*ends.T, color=colour, lw=1.6)


def frame(axes: Axes, x: FloatArray, half: float) -> None:
    axes.set_xlim(x[0] / MM - half, x[0] / MM + half)
    axes.set_ylim(x[2] / MM - half, x[2] / MM + half)
    axes.set_aspect("equal")
    axes.tick_params(labelsize=8)


def blocked(path: Path) -> None:
    """What the paper's planes and ours forbid of the same ball over the same bowl, on a slice."""
    surface = meshes.load("saddle-slab")
    bowl = surface.nearest([8 * MM, -8 * MM, 0.0])[2]
    x = bowl + MM * np.array([2.0, 0.0, 1.2])
    radius = 5 * MM
    axis = np.linspace(-radius, radius, 181)
    figure, panels = plt.subplots(1, 2, figsize=(9.2, 4.9), layout="constrained")
    cut = trimesh.intersections.mesh_plane(
        trimesh.Trimesh(surface.vertices, surface.faces, process=False), [0, 1, 0], x
    )
    for axes, rule in zip(panels, ("paper", "certified"), strict=True):
        planes = campaign.planes_of(rule, surface, x, radius, standoff=0.0)
        image = np.full((len(axis), len(axis)), np.nan)
        for i, dz in enumerate(axis):
            for j, dx in enumerate(axis):
                z = x + np.array([dx, 0.0, dz])
                if np.hypot(dx, dz) <= radius and not oracles.crossings(surface, x, z):
                    image[i, j] = (planes.slack(z) < 0.0).any()
        share = np.nanmean(image)
        box = [(x[0] - radius) / MM, (x[0] + radius) / MM, (x[2] - radius) / MM,
               (x[2] + radius) / MM]  # fmt: skip
        axes.imshow(image, extent=box, origin="lower", cmap=ListedColormap([ROOM, LOST]),
                    vmin=0, vmax=1, interpolation="nearest")  # fmt: skip
        for segment in cut:
            axes.plot(*(segment[:, [0, 2]] / MM).T, color=EDGE, lw=1.6)
        for n, o in zip(planes.normals, planes.offsets, strict=True):
            if abs(o - n @ x) < radius * np.linalg.norm(n[[0, 2]]):
                chord(axes, x, radius, n, o, "#00000030")
        axes.add_patch(Circle(x[[0, 2]] / MM, radius / MM, fill=False, color="0.35", ls="--"))
        axes.plot(x[0] / MM, x[2] / MM, "ko", ms=5)
        axes.set_title(f"{rule}: {len(planes)} planes, {100 * share:.0f} % of the slice blocked")
        frame(axes, x, 5.6)
        axes.set_xlabel("[mm]")
    figure.legend(
        handles=[Patch(facecolor=ROOM, label="free"),
                 Patch(facecolor=LOST, label="free, but forbidden by a plane"),
                 plt.Line2D([], [], color=EDGE, label="surface")],
        loc="outside lower center", ncols=3,
    )  # fmt: skip
    figure.savefig(path, dpi=90, metadata={"Software": None})
    plt.close(figure)


def main() -> None:
    mpl.use("Agg")
    mpl.rcParams.update({"font.size": 10, "svg.hashsalt": "certified", "svg.fonttype": "none"})
    cover(HERE / "certified-cover.svg")
    blocked(HERE / "certified-blocked.png")


if __name__ == "__main__":
    main()

"""Colours and short texts of the page, each defined once.

The colours are from Okabe and Ito's palette, which is distinct with any of the common colour
blindnesses (jfly.uni-koeln.de/color).
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import NDArray

import vf
from app.structure import Structure

Rgb = tuple[int, int, int]

ORANGE: Rgb = (230, 159, 0)
SKY: Rgb = (86, 180, 233)
GREEN: Rgb = (0, 158, 115)
YELLOW: Rgb = (240, 228, 66)
BLUE: Rgb = (0, 114, 178)
VERMILION: Rgb = (213, 94, 0)
PURPLE: Rgb = (204, 121, 167)
BLACK: Rgb = (20, 20, 20)
GREY: Rgb = (110, 110, 110)

BONE: Rgb = (222, 206, 178)
SPHERE = SKY
TOOL = BLACK
PROXY: Rgb = (110, 70, 150)
FORCE = VERMILION
FORCE_NAME = "simulated force"
BLOCKING = BLACK  # the plane that holds the tool back most
CORRIDOR: Rgb = (115, 65, 25)  # the planned path and the walls along it
PROBE = YELLOW
PART: Rgb = (150, 150, 150)  # a part of the instrument that nothing holds
PART_NEAR: Rgb = (150, 200, 90)  # one that has planes, which do not hold it
PART_HELD: Rgb = (240, 90, 40)
TROCAR: Rgb = (120, 200, 200)
ALARM: Rgb = (200, 0, 30)  # the tip crossed the mesh


@dataclass(frozen=True)
class Look:
    """Colour, name and explanation of a kind of plane or triangle."""

    color: Rgb
    name: str
    meaning: str


LOOKS: dict[vf.Rule, Look] = {
    vf.Rule.FACE: Look(BLUE, "Condition 1, face", "the closest point lies inside the face"),
    vf.Rule.RIDGE: Look(ORANGE, "Condition 2, ridge", "the plane faces the tool from an edge"),
    vf.Rule.VALLEY: Look(GREEN, "Condition 3, valley", "the face continues beyond its edge"),
    vf.Rule.NAIVE: Look(GREY, "no condition", "every face in the sphere, as in rule “all”"),
    vf.Rule.EXIT: Look(YELLOW, "way out", "the tool is inside: only outward motion passes"),
    vf.Rule.CORRIDOR: Look(CORRIDOR, "corridor", "a wall along the planned path"),
    vf.Rule.NEAREST: Look(PURPLE, "nearest point", "the plane faces the tool from there"),
    vf.Rule.SAMPLED: Look(SKY, "distance field", "the plane is interpolated between samples"),
}


CONDITIONS = (vf.Rule.FACE, vf.Rule.RIDGE, vf.Rule.VALLEY)
"""Of the paper's rule. Planes of the certified rule are classed by them too, see `CLASSED`."""
CLASSED = (
    "Conditions 1–3 are those of the paper’s rule. Planes of the certified rule have their colours "
    "by where on its triangle the closest point lies; that rule does not ask for them."
)


class TriangleState(Enum):
    """The inspector's classes of triangles in the motion sphere."""

    FACE = "condition 1"
    RIDGE = "condition 2"
    VALLEY = "condition 3"
    CERTIFIED = "certified"
    INACTIVE = "inactive"


TRIANGLE_STATES: dict[TriangleState, Look] = {
    TriangleState.FACE: Look(BLUE, "Condition 1", "closest point inside the face, tool in front"),
    TriangleState.RIDGE: Look(ORANGE, "Condition 2", "the neighbour has the same closest point"),
    TriangleState.VALLEY: Look(
        GREEN, "Condition 3", "closest point on a valley edge, tool in front"
    ),
    TriangleState.CERTIFIED: Look(
        PURPLE, "certified only", "no condition, yet the certified rule needs it"
    ),
    TriangleState.INACTIVE: Look((150, 150, 150), "inactive", "in the sphere, but passed over"),
}

RULE_HELP: dict[str, str] = {
    "certified": "Separating planes that cover every triangle in the sphere: the tool cannot "
    "cross the surface, on any mesh.",
    "paper": "Conditions 1–3 of Li et al. 2020. Right on clean closed meshes; can leak on "
    "damaged ones.",
    "all": "The plane of every face in the sphere, without conditions: blocks free space too.",
    "off": "No fixture: the tool goes wherever the proxy is.",
    "nearest": "One plane at the nearest point, as other controllers have it: the second wall of a "
    "corner is not guarded.",
    "sdf": "One plane from a distance field sampled every 0.5 mm: what is thinner can be passed.",
}

GUARD_HELP: dict[str, str] = {
    "tool": "Every part of the instrument is kept out.",
    "tip": "The tip alone is kept out: the shaft may pass through bone.",
}
TIP_ALONE = "This rule guards the tip alone, whatever is chosen here."
NO_GUARD = "Without a fixture nothing is guarded."

GHOST = (86, 140, 190)
"""Where the guard believes a structure to be."""

STATUS_HELP: dict[vf.Status, str] = {
    vf.Status.SOLVED: "step as solved",
    vf.Status.SHORTENED: "part of it was safe",
    vf.Status.HELD: "no step was safe",
    vf.Status.RECOVERING: "out to the standoff",
    vf.Status.INSIDE: "inside the anatomy",
    vf.Status.REFUSED: "proxy unusable",
    vf.Status.OVERTAKEN: "the anatomy may be in the tool",
}

SOLVER_HELP: dict[vf.Solver, str] = {
    vf.Solver.FREE: "no plane in the way",
    vf.Solver.PROJECTED: "one plane, direct",
    vf.Solver.SOLVED: "several planes",
    vf.Solver.NOT_CONVERGED: "not converged",
    vf.Solver.INFEASIBLE: "no step allowed",
    vf.Solver.IDLE: "not asked",
}


# Of structures beside the mesh whose files say no colour, in turn.
STRUCTURES: tuple[Rgb, ...] = (
    (240, 228, 66), (86, 180, 233), (204, 121, 167), (0, 158, 115), (230, 159, 0), (213, 94, 0),
    (150, 140, 210), (160, 110, 70),
)  # fmt: skip


def structure_colour(own: Structure, number: int) -> Rgb:
    """The colour of a structure; number 0 is the mesh, others follow in the order of the options.

    One that the options name, else bone for the mesh and one of `STRUCTURES`.
    """
    if own.colour is not None:
        red, green, blue = bytes.fromhex(own.colour[1:])
        return red, green, blue
    return BONE if number == 0 else STRUCTURES[(number - 1) % len(STRUCTURES)]


def tinted(color: Rgb, strength: float) -> Rgb:
    """The colour mixed with white: strength 1 is the colour itself, 0 has 35 % of it."""
    share = 0.35 + 0.65 * min(max(strength, 0.0), 1.0)
    red, green, blue = (round(share * c + (1.0 - share) * 255) for c in color)
    return red, green, blue


def linear(colors: NDArray[np.integer]) -> NDArray[np.uint8]:
    """sRGB colours (…, 3) as linear intensities.

    viser takes these for instances of a batch and for line segments; a node's colour is sRGB.
    """
    return np.asarray(255.0 * (colors / 255.0) ** 2.2).round().astype(np.uint8)


def css(color: Rgb) -> str:
    """The colour for a style attribute."""
    return f"rgb({color[0]},{color[1]},{color[2]})"

"""The built-in scenarios, by name."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType

from app.motion.declared import Motion, Tracker
from app.scenarios.file import Scenario, ScenarioError, Waypoint, read
from app.scenarios.values import Viewpoint
from app.settings import Options
from app.structure import Structure


def find(name_or_path: str) -> Scenario:
    """A preset by its name, or the scenario in a file.

    Raises:
        ScenarioError: an unknown name (the message lists the presets) or an invalid file; one line.
    """
    if name_or_path in PRESETS:
        return PRESETS[name_or_path]
    path = Path(name_or_path)
    if path.suffix == "" and len(path.parts) <= 1:
        raise ScenarioError(
            f"unknown scenario '{name_or_path}': choose one of {', '.join(PRESETS)}, "
            "or a file such as ./mine.json"
        )
    return read(path)


def _at(time: float, x: float, y: float, z: float) -> Waypoint:
    return Waypoint(time, (x * 1e-3, y * 1e-3, z * 1e-3))  # [mm] -> [m]


def _round(time: float, radius: float, degrees: float, z: float, y: float = 0.0) -> Waypoint:
    angle = math.radians(degrees)
    return _at(time, radius * math.cos(angle), y + radius * math.sin(angle), z)


_PUSH = Scenario(
    "push-on-the-skull",
    "The proxy is pushed into the bone: the tool stops at its standoff, 20 µm above it, and the "
    "hand would feel 1.4 N.",
    Options(mesh="skull"),
    (_at(1.5, 20, -10, 68), _at(3.0, 17, -8.5, 48)),
)
_ORBIT = Scenario(
    "slide-into-the-orbit",
    "Pressed on the brow and drawn down, the tool slides over the rim into the hollow of the "
    "orbit, and along its wall to the bottom.",
    Options(mesh="skull", up="y"),
    (_at(1.5, 24, 70, 4), _at(2.5, 24, 58, 4), _at(5.0, 20.5, 41, -16.4)),
    camera="follow",
)
_PLATE = Scenario(
    "thin-plate-both-sides",
    "A plate of 0.5 mm, far thinner than the motion sphere: the tool is held on one side of it, "
    "goes over its edge, and is held on the other side.",
    # Upright and seen along its edge, so that both sides are visible.
    Options(
        mesh="thin-plate", robot="point", rotate=(0.0, math.radians(90.0), math.radians(-41.6))
    ),
    (
        _at(1.5, -42, 0, 6),
        _at(2.5, -42, 0, -8),
        _at(3.5, -60, 0, -8),
        _at(4.5, -42, 0, -8),
        _at(5.5, -42, 0, 8),
    ),
)
_GEAR = Scenario(
    "valley-of-the-gear",
    "Pressed into the gap between two teeth of a gear, the tool rests in a valley, on a plane of "
    "the paper’s Condition 3.",
    Options(mesh="gear", rule="paper"),
    (
        _round(1.5, 47, 10, 12),
        _round(2.2, 47, 10, 0),
        _round(3.2, 33, 10, 0),
        _round(4.2, 26, 4, 0),
    ),
    camera="follow",
)
_SADDLE = Scenario(
    "saddle",
    "On a saddle, bent up one way and down the other, planes of ridges (Condition 2) and of "
    "valleys (Condition 3) stand around the tool.",
    Options(mesh="saddle-slab", rule="paper", radius=1e-3),
    (_at(1.5, -8, -8, 14), _at(2.5, -8, -8, 3), _at(4.5, 0, 0, 3)),
    camera="follow",
)
_UNCLEAN = Scenario(
    "unclean-mesh-paper",
    "Triangles that do not quite meet, as from a poor export: at such a seam the paper’s rule "
    "lets the tool through the bone.",
    Options(mesh="skull-coarse", damage="jittered", rule="paper"),
    (_at(1.5, 20, -30, 68), _at(2.5, 20, -30, 50), _at(5.5, 20, 10, 50)),
)
_HELD = replace(
    _UNCLEAN,
    name="unclean-mesh-certified",
    about="The same unclean mesh and the same hand: the certified rule asks for no neighbours, "
    "and the tool stays outside.",
    options=replace(_UNCLEAN.options, rule="certified"),
)
_MILLION = Scenario(
    "million-triangles",
    "A skull of 936 thousand triangles, every one of them in force: the tool slides over it as "
    "over a coarse one.",
    Options(mesh="skull-fine"),
    (_at(1.5, 25, -20, 68), _at(2.5, 22, -20, 54), _at(5.0, 22, 15, 54)),
)
_FONTANELLE = Scenario(
    "through-the-fontanelle",
    "The shaft is in the fontanelle and the tip at work inside the skull; as the hand circles, the "
    "shaft leans on the rim from all sides and the tip pivots about it.",
    # The middle of the opening is under the remote centre.
    Options(mesh="skull", at=(0.0, -0.024, -0.1988)),
    (
        _at(1.5, 0, 24, 50),
        _at(3.0, 0, 24, 15),
        *(_round(3.8 + 0.7 * k, 16, 45 * k, 15, y=24) for k in range(9)),
    ),
    camera="anatomy",
)
_KEYHOLE = Scenario(
    "keyhole",
    "Through a canal 0.65 mm wider than the shaft: below it the hand wants 15 mm to each side, and "
    "gets the half millimetre that the shaft has.",
    Options(mesh="canal-block"),
    (
        _at(1.0, 0, 0, 15),
        _at(3.0, 0, 0, -35),
        _at(4.0, 15, 0, -35),
        _at(5.0, 0, 15, -35),
        _at(6.0, -15, 0, -35),
        _at(7.0, 0, 0, -35),
    ),
    # The block, and where the hand goes below it.
    camera=Viewpoint((0.064, 0.072, 0.055), (0.0, 0.0, -0.002)),
)
_CORNER = Scenario(
    "around-the-corner",
    "Round the edge of a plate to below it: the tip is free on its way back under the plate, and "
    "stops where the shaft meets the edge.",
    Options(mesh="thin-plate"),
    (_at(1.5, 76, 0, 8), _at(2.5, 76, 0, -30), _at(4.0, 40, 0, -30), _at(5.0, 40, 0, -15)),
    camera="anatomy",
)
_CORNER_TIP = replace(
    _CORNER,
    name="around-the-corner-tip-only",
    about="The same plate and the same hand with the tip alone guarded: it goes where the hand "
    "wants, and the shaft goes through the plate.",
    options=replace(_CORNER.options, guard="tip"),
)

_EAR = Scenario(
    "temporal-bone",
    "A burr of 2 mm in a drilled mastoid. The bone is to be cut and not guarded; nerve, ossicles, "
    "canals, sinus and dura hold the tool at margins of 0.5 to 3 mm.",
    Options(
        mesh="temporal-bone:bone", guarded=False, opacity=0.35, tip_radius=1e-3,
        structures=tuple(
            Structure("temporal-bone", name, name)
            for name in (
                "facial nerve", "chorda tympani", "malleus", "incus", "stapes",
                "semicircular canals", "sigmoid sinus", "dura",
            )
        ),
    ),
    (
        _at(1.5, -2, 0, 12),
        _at(2.5, -2, -3, 2),
        _at(4.0, -2, -9, -6),
        _at(5.0, 0, -2, 2),
        _at(6.5, 4, 5, -5),
        _at(7.5, 0, 2, 6),
        _at(9.0, -16, 3, 4),
        _at(10.0, -2, 4, 8),
        _at(11.5, 0, 20, 6),
    ),
    camera="anatomy",
)  # fmt: skip

_BREATH = Scenario(
    "breathing-liver",
    "A breathing liver, seen ten times a second and 0.15 s late. With the age of the sighting the "
    "margin grows by the declared 20 mm/s, and the tool never touches it.",
    Options(
        mesh="liver",
        motions=(Motion("breathing", move=(0.0, 0.0, 0.012), period=4.0),),
        tracker=Tracker(rate=10.0, latency=0.15, bound=0.02),
    ),
    (_at(1.0, 0, 9, 50), _at(2.0, 0, 9, 25), _at(4.5, 20, 5, 25), _at(9.0, -10, 15, 25)),
    camera="anatomy",
)
_BREATH_ALONE = replace(
    _BREATH,
    name="breathing-liver-no-margin",
    about="The same liver, tracker and hand with a declared speed of 0: there is no margin for the "
    "age of the sighting, and the true liver meets the tool.",
    options=replace(_BREATH.options, tracker=Tracker(rate=10.0, latency=0.15, bound=0.0)),
)
_KNOCK = Scenario(
    "knock-on-the-table",
    "The table is knocked up by 8 mm within 60 ms: faster than the tool may yield, and the cube "
    "overtakes it. Inside, only the way out is open, on which the hand leads it back.",
    Options(
        mesh="cube",
        tip_speed=0.1,
        motions=(Motion("knock", move=(0.0, 0.0, 0.008), period=0.06, after=2.5),),
    ),
    (_at(1.0, 0, 0, 30), _at(2.0, 0, 0, 15), _at(3.5, 0, 0, 15), _at(5.5, 0, 0, 38)),
    camera="anatomy",
)
_HEART = Scenario(
    "beating-heart",
    "A heart that beats 72 times a minute: its wall comes and goes by up to 9 mm. The "
    "tool is pressed on it and slides over it, rides on it, and never touches it.",
    Options(mesh="heart", motions=(Motion("deforming"),)),
    (
        _at(1.0, 0, 0, 60), _at(2.0, 0, 0, 42), _at(4.0, 0, 0, 28), _at(6.0, 18, 8, 26),
        _at(8.0, -15, 12, 28), _at(10.0, 0, 0, 60),
    ),
    camera="anatomy",
)  # fmt: skip

_ALL = (
    _PUSH, _ORBIT, _PLATE, _GEAR, _SADDLE, _UNCLEAN, _HELD, _MILLION, _FONTANELLE, _KEYHOLE,
    _CORNER, _CORNER_TIP, _EAR, _BREATH, _BREATH_ALONE, _KNOCK, _HEART,
)  # fmt: skip
PRESETS: Mapping[str, Scenario] = MappingProxyType({one.name: one for one in _ALL})

"""Campaigns beside anatomy that moves, of one arm or of all, and their tables."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
from rich.console import Console

import robots
import vf
from app.console import Column, show_table
from app.motion.declared import Tracker
from app.studies.verification import moving
from app.studies.verification.guarded import parts
from app.studies.verification.moving import Passed
from meshes.builtin.damage import damage
from meshes.builtin.shapes import Arrays

PERIODS = (1e-3, 5e-3, 0.02)  # of the control loop, in turn [s]
COLUMNS = (
    "ticks", "starts", "crossed", "by which part", "led out too late", "overtaken", "met then",
    "too deep", "held", "shortened", "recovering", "inside", "planes", "tick µs",
)  # fmt: skip


@dataclass(frozen=True)
class Campaign:
    """What is done.

    Attributes:
        arms: by the name in the tables, each with its number of ticks.
        meshes: by name.
        damages: kinds of damage done to each, "none" among them.
        radii: of the motion sphere [m]; None: what a tick can do.
        motions: of `moving.MOTIONS`.
        guard: see `moving.drive`.
        rule: of the fixtures.
        noise: see `moving.drive`; every second case has none.
        tracker: see `moving.drive`.
        seed: of everything random.
    """

    arms: dict[str, tuple[robots.Arm, int]]
    meshes: dict[str, Arrays]
    damages: Sequence[str]
    radii: Sequence[float | None]
    motions: Sequence[str]
    guard: str | None
    rule: str
    noise: float
    tracker: Tracker | None
    seed: int

    def shares(self) -> Iterator[tuple[str, int]]:
        """Ticks of a mesh with one kind of damage, one radius and one motion, for each arm."""
        cases = len(self.meshes) * len(self.damages) * len(self.radii) * len(self.motions)
        for name, (_arm, ticks) in self.arms.items():
            yield name, -(-ticks // cases)

    @property
    def work(self) -> int:
        """Ticks in all."""
        cases = len(self.meshes) * len(self.damages) * len(self.radii) * len(self.motions)
        return cases * sum(share for _name, share in self.shares())


@dataclass
class Findings:
    """Results: of drives by arm and motion, each with the mesh and the damage."""

    drives: list[tuple[str, str, str, Passed]] = field(default_factory=list)

    @property
    def crossings(self) -> int:
        return sum(one[-1].crossings for one in self.drives)

    @property
    def late(self) -> int:
        return sum(one[-1].late for one in self.drives)

    @property
    def too_deep(self) -> int:
        return sum(one[-1].too_deep for one in self.drives)


def run(
    campaign: Campaign,
    found: Findings,
    begin: Callable[[str], None],
    progress: Callable[[int], None],
) -> None:
    """Do everything; what is done so far is in `found` whenever this is interrupted.

    Args:
        begin: called with the name of each mesh and damage.
        progress: called with the number of ticks just done.
    """
    cases = [(name, kind) for name in campaign.meshes for kind in campaign.damages]
    for number, (name, kind) in enumerate(cases):
        case = f"{name}, {kind}"
        begin(case)
        mesh = damage(kind, campaign.meshes[name], campaign.seed)
        for arm_name, share in campaign.shares():
            for m, motion in enumerate(campaign.motions):
                for k, radius, part, steps in parts(campaign.radii, share):
                    turn = number + k + part + m
                    drive = moving.drive(
                        campaign.arms[arm_name][0], mesh, motion=motion, guard=campaign.guard,
                        rule=campaign.rule, radius=radius, period=PERIODS[turn % len(PERIODS)],
                        steps=steps,
                        seed=campaign.seed + 1000 * number + 10 * m + k + 10**6 * part,
                        noise=campaign.noise if (number + k) % 2 else 0.0,
                        tracker=campaign.tracker, progress=progress,
                    )  # fmt: skip
                    found.drives.append((arm_name, motion, case, drive))


def show(found: Findings, console: Console, title: str) -> None:
    """Print the drives by arm, motion, rate and damage."""
    arms = dict.fromkeys(one[0] for one in found.drives)
    _show(
        console, "arm", [(arm, [one[-1] for one in found.drives if one[0] == arm]) for arm in arms],
        title,
    )  # fmt: skip
    motions = dict.fromkeys(one[1] for one in found.drives)
    if len(motions) > 1:
        groups = [(kind, [one[-1] for one in found.drives if one[1] == kind]) for kind in motions]
        _show(console, "motion", groups)
    drives = [one[-1] for one in found.drives]
    rates = sorted({drive.period for drive in drives}, reverse=True)
    _show(
        console, "rate",
        [(f"{1.0 / rate:,.0f} Hz", [d for d in drives if d.period == rate]) for rate in rates],
    )  # fmt: skip


def complaints(found: Findings) -> list[str]:
    """Where the first crossing of a drive was, or what was deeper than said, to repeat it."""
    lines = []
    for arm, motion, case, drive in found.drives:
        begun = f"{arm}, {motion}, {1.0 / drive.period:,.0f} Hz, {case}: "
        lines += [begun + drive.first] * bool(drive.first)
        lines += [f"{begun}too deep: {drive.first_deep}"] * bool(drive.first_deep)
    return lines


def _show(
    console: Console, what: str, groups: Iterable[tuple[str, list[Passed]]], title: str = ""
) -> None:
    rows = []
    for name, drives in groups:
        ticks = sum(d.ticks for d in drives)
        statuses = sum((d.statuses for d in drives), Counter[vf.Status]())
        crossed = sum((d.parts for d in drives), Counter[str]())
        rows.append(
            (
                name,
                f"{ticks:,}",
                f"{sum(d.episodes for d in drives):,}",
                f"{sum(d.crossings for d in drives):,}",
                ", ".join(f"{part} {times:,}" for part, times in crossed.most_common()),
                f"{sum(d.late for d in drives):,}",
                f"{statuses[vf.Status.OVERTAKEN]:,}",
                f"{sum(d.met for d in drives):,}",
                f"{sum(d.too_deep for d in drives):,}",
                f"{statuses[vf.Status.HELD]:,}",
                f"{statuses[vf.Status.SHORTENED]:,}",
                f"{statuses[vf.Status.RECOVERING]:,}",
                f"{statuses[vf.Status.INSIDE]:,}",
                f"{sum(d.planes for d in drives) / max(ticks, 1):.1f}",
                f"{1e6 * float(np.median([t for d in drives for t in d.times])):.0f}",
            )
        )
    columns = [Column(what, left=True), *map(Column, COLUMNS)]
    show_table(console, columns, rows, title=title or None)

"""Campaigns with the whole instrument of one arm or of all, and their tables."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import TypeVar

import numpy as np
from rich.console import Console

import robots
import vf
from app.console import Column, show_table
from app.studies.verification import instrument
from app.studies.verification.campaign import Cover
from app.studies.verification.instrument import PERIODS, Pushed
from meshes.builtin.damage import damage
from meshes.builtin.shapes import Arrays
from robots import point

T = TypeVar("T")
D = TypeVar("D", bound=Pushed)
More = Sequence[tuple[str, Callable[[D], int]]]

NEEDLE = (0.01, 0.0, 0.04)  # of the second point arm of `all_arms` [m]
PART = 10_000  # ticks or queries per call of the campaign
EDGES = (0.3, 1.0, 3.0, None)  # radii of the queries in median edges; None: a tick of the arm
COUNTED = ("ticks", "starts", "crossed", "by which part")
MEASURED = ("held", "shortened", "recovering", "inside", "planes", "tick µs")


@dataclass(frozen=True)
class Campaign:
    """What is done.

    Attributes:
        arms: by the name in the tables, each with its number of ticks.
        meshes: by name.
        damages: kinds of damage done to each, "none" among them.
        radii: of the motion sphere [m]; None: what a tick can do.
        guard: what the controllers guard, one of `vf.GUARDS`.
        queries: in all, with the capsules of the first arm.
        tools: standoff and thickness of the queries in turn [m].
        noise: see `instrument.drive`; every second case has none.
        seed: of everything random.
    """

    arms: dict[str, tuple[robots.Arm, int]]
    meshes: dict[str, Arrays]
    damages: Sequence[str]
    radii: Sequence[float | None]
    guard: str
    queries: int
    tools: Sequence[tuple[float, float]]
    noise: float
    seed: int

    def shares(self) -> Iterator[tuple[str, int]]:
        """Ticks of a mesh with one kind of damage and one radius, for each arm."""
        cases = len(self.meshes) * len(self.damages)
        for name, (_arm, ticks) in self.arms.items():
            yield name, -(-ticks // (cases * len(self.radii)))

    @property
    def share(self) -> int:
        """Queries of a mesh with one kind of damage and one radius."""
        return -(-self.queries // (len(self.meshes) * len(self.damages) * len(EDGES)))

    @property
    def work(self) -> int:
        """Ticks and queries in all."""
        ticks = sum(share for _name, share in self.shares()) * len(self.radii)
        cases = len(self.meshes) * len(self.damages)
        return cases * (ticks + self.share * len(EDGES))


@dataclass
class Findings:
    """Results: drives by arm, queries by radius, each with the mesh and the damage."""

    drives: list[tuple[str, str, Pushed]] = field(default_factory=list)
    covers: list[tuple[float | None, str, Cover]] = field(default_factory=list)

    @property
    def crossings(self) -> int:
        return sum(drive.crossings for _arm, _case, drive in self.drives)

    @property
    def leaks(self) -> int:
        return sum(cover.leaking for _edges, _case, cover in self.covers)


def all_arms(ticks: int) -> dict[str, tuple[robots.Arm, int]]:
    """Every arm, and the point with a needle: all `ticks` with the PSM, a tenth with each other."""
    arms = {name: (robots.load(name), -(-ticks // 10)) for name in robots.names()}
    arms["psm"] = arms["psm"][0], ticks
    arms["point, needle"] = point.load(NEEDLE), -(-ticks // 10)
    return arms


def run(
    campaign: Campaign,
    found: Findings,
    begin: Callable[[str], None],
    progress: Callable[[int], None],
) -> None:
    """Do everything; what is done so far is in `found` whenever this is interrupted.

    Args:
        begin: called with the name of each mesh and damage.
        progress: called with the number of ticks or queries just done.
    """
    cases = [(name, kind) for name in campaign.meshes for kind in campaign.damages]
    first_arm, _ticks = next(iter(campaign.arms.values()))
    for number, (name, kind) in enumerate(cases):
        case = f"{name}, {kind}"
        begin(case)
        mesh = damage(kind, campaign.meshes[name], campaign.seed)
        for arm_name, share in campaign.shares():
            for k, radius, part, steps in parts(campaign.radii, share):
                turn = number + k + part
                found.drives.append(
                    (
                        arm_name,
                        case,
                        instrument.drive(
                            campaign.arms[arm_name][0], mesh, guard=campaign.guard, radius=radius,
                            period=PERIODS[turn % len(PERIODS)], steps=steps,
                            seed=campaign.seed + 1000 * number + k + 10**6 * part,
                            noise=campaign.noise if turn % 2 else 0.0, progress=progress,
                        ),
                    )
                )  # fmt: skip
        for k, edges, part, queries in parts(EDGES, campaign.share):
            standoff, thickness = campaign.tools[(number + k) % len(campaign.tools)]
            if edges is None:
                standoff = vf.Settings.standoff
            found.covers.append(
                (
                    edges,
                    case,
                    instrument.query(
                        mesh, edges=edges, queries=queries, standoff=standoff, thickness=thickness,
                        seed=campaign.seed + 1000 * number + k + 10**6 * part, arm=first_arm,
                        progress=progress,
                    ),
                )
            )  # fmt: skip


def parts(kinds: Sequence[T], share: int) -> Iterator[tuple[int, T, int, int]]:
    """(Index of the kind, the kind, index of the part, its length); an interrupt loses one part."""
    for k, kind in enumerate(kinds):
        for part, start in enumerate(range(0, share, PART)):
            yield k, kind, part, min(PART, share - start)


def show(found: Findings, console: Console, title: str) -> None:
    """Print the drives by arm, rate and damage, and the queries by radius."""
    if found.drives:
        arms = dict.fromkeys(arm for arm, _case, _drive in found.drives)
        by_arm = [(arm, [d for a, _, d in found.drives if a == arm]) for arm in arms]
        show_groups(console, "arm", by_arm, title)
        show_rates(console, [drive for _arm, _case, drive in found.drives])
    if found.covers:
        rows = []
        for edges in EDGES:
            mine = [(case, cover) for e, case, cover in found.covers if e == edges]
            asked = sum(cover.queries for _case, cover in mine)
            if asked:
                most = max(mine, key=lambda one: one[1].planes / max(one[1].queries, 1))
                rows.append(
                    (
                        "a tick of the arm" if edges is None else f"{edges:g} edges",
                        f"{asked:,}",
                        f"{sum(cover.leaking for _case, cover in mine):,}",
                        f"{sum(cover.planes for _case, cover in mine) / asked:.2f}",
                        f"{most[1].planes / max(most[1].queries, 1):.1f} ({most[0]})",
                        f"{sum(cover.shrunk for _case, cover in mine):,}",
                    )
                )
        names = ("queries", "leaked", "planes", "planes of the worst mesh", "budget spent")
        show_table(console, [Column("radius", left=True), *map(Column, names)], rows)


def complaints(found: Findings) -> list[str]:
    """Where the first crossing or leak of a drive or a query was, to repeat it."""
    lines = [f"{arm}, {case}: {drive.first}" for arm, case, drive in found.drives if drive.first]
    return lines + [f"{case}: {cover.first}" for _, case, cover in found.covers if cover.first]


def show_groups(
    console: Console,
    kind: str,
    groups: Iterable[tuple[str, Sequence[D]]],
    title: str = "",
    more: More[D] = (),
) -> None:
    """Print a row for each group of drives.

    Args:
        kind: what the groups are of, the heading of their names.
        more: headings and numbers of columns beside those that all campaigns have.
    """
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
                *(f"{sum(map(number, drives)):,}" for _heading, number in more),
                f"{statuses[vf.Status.HELD]:,}",
                f"{statuses[vf.Status.SHORTENED]:,}",
                f"{statuses[vf.Status.RECOVERING]:,}",
                f"{statuses[vf.Status.INSIDE]:,}",
                f"{sum(d.planes for d in drives) / max(ticks, 1):.1f}",
                f"{1e6 * float(np.median([t for d in drives for t in d.times])):.0f}",
            )
        )
    names = (*COUNTED, *(heading for heading, _number in more), *MEASURED)
    show_table(console, [Column(kind, left=True), *map(Column, names)], rows, title=title or None)


def show_rates(console: Console, drives: Sequence[D], more: More[D] = ()) -> None:
    """`show_groups` by the rate of the control loop."""
    rates = sorted({drive.period for drive in drives}, reverse=True)
    groups = [(f"{1.0 / rate:,.0f} Hz", [d for d in drives if d.period == rate]) for rate in rates]
    show_groups(console, "rate", groups, more=more)

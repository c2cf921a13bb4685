"""Campaigns beside anatomy that moves, of one arm or of all, and their tables."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from multiprocessing import get_context

from rich.console import Console

import robots
import vf
from app.motion.declared import Tracker
from app.studies.verification import moving
from app.studies.verification.guarded import More, parts, show_groups, show_rates
from app.studies.verification.moving import Passed
from meshes.builtin.damage import damage
from meshes.builtin.shapes import Arrays

PERIODS = (1e-3, 5e-3, 0.02)  # of the control loop, in turn [s]
MORE: More[Passed] = (
    ("led out too late", lambda drive: drive.late),
    ("overtaken", lambda drive: drive.statuses[vf.Status.OVERTAKEN]),
    ("met then", lambda drive: drive.met),
    ("too deep", lambda drive: drive.too_deep),
)


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


@dataclass(frozen=True)
class _Part:
    """A drive of a campaign; the seed makes it repeat, wherever it is computed."""

    arm: str
    mesh: str
    damage: str
    motion: str
    radius: float | None
    period: float
    steps: int
    seed: int
    noise: float


def run(
    campaign: Campaign,
    found: Findings,
    begin: Callable[[str], None],
    progress: Callable[[int], None],
    workers: int = 0,
) -> None:
    """Do everything; what is done so far is in `found` whenever this is interrupted.

    Args:
        begin: called with the name of each mesh and damage.
        progress: called with the number of ticks just done.
        workers: processes; 0: in this one. What is found is the same for any number.
    """
    todo = list(_parts(campaign))
    if workers == 0:
        for part in todo:
            begin(f"{part.mesh}, {part.damage}")
            _keep(found, part, _drive(campaign, part, progress))
        return
    context = get_context("spawn")
    with ProcessPoolExecutor(workers, context, _end_at_interrupt, (campaign,)) as pool:
        try:
            waiting = [(part, pool.submit(_drive_of_worker, part)) for part in todo]
            for part, future in waiting:
                begin(f"{part.mesh}, {part.damage}")
                _keep(found, part, future.result())
                progress(part.steps)
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise


def _parts(campaign: Campaign) -> Iterator[_Part]:
    cases = [(name, kind) for name in campaign.meshes for kind in campaign.damages]
    for number, (name, kind) in enumerate(cases):
        for arm, share in campaign.shares():
            for m, motion in enumerate(campaign.motions):
                for k, radius, part, steps in parts(campaign.radii, share):
                    yield _Part(
                        arm, name, kind, motion, radius,
                        PERIODS[(number + k + part + m) % len(PERIODS)], steps,
                        campaign.seed + 1000 * number + 10 * m + k + 10**6 * part,
                        campaign.noise if (number + k) % 2 else 0.0,
                    )  # fmt: skip


def _keep(found: Findings, part: _Part, drive: Passed) -> None:
    found.drives.append((part.arm, part.motion, f"{part.mesh}, {part.damage}", drive))


def _drive(campaign: Campaign, part: _Part, progress: Callable[[int], None]) -> Passed:
    mesh = damage(part.damage, campaign.meshes[part.mesh], campaign.seed)
    return moving.drive(
        campaign.arms[part.arm][0], mesh, motion=part.motion, guard=campaign.guard,
        rule=campaign.rule, radius=part.radius, period=part.period, steps=part.steps,
        seed=part.seed, noise=part.noise, tracker=campaign.tracker, progress=progress,
    )  # fmt: skip


_campaign: Campaign | None = None  # of a worker


def _end_at_interrupt(campaign: Campaign) -> None:
    """What a worker begins with: Ctrl-C goes to it too, and ends it without a word."""
    global _campaign
    _campaign = campaign
    signal.signal(signal.SIGINT, signal.SIG_DFL)


def _drive_of_worker(part: _Part) -> Passed:
    assert _campaign is not None
    return _drive(_campaign, part, lambda _ticks: None)


def show(found: Findings, console: Console, title: str) -> None:
    """Print the drives by arm, motion, and rate."""
    arms = dict.fromkeys(one[0] for one in found.drives)
    by_arm = [(arm, [one[-1] for one in found.drives if one[0] == arm]) for arm in arms]
    show_groups(console, "arm", by_arm, title, MORE)
    motions = dict.fromkeys(one[1] for one in found.drives)
    if len(motions) > 1:
        groups = [(kind, [one[-1] for one in found.drives if one[1] == kind]) for kind in motions]
        show_groups(console, "motion", groups, more=MORE)
    show_rates(console, [one[-1] for one in found.drives], MORE)


def complaints(found: Findings) -> list[str]:
    """Where the first crossing of a drive was, or what was deeper than said, to repeat it."""
    lines = []
    for arm, motion, case, drive in found.drives:
        begun = f"{arm}, {motion}, {1.0 / drive.period:,.0f} Hz, {case}: "
        lines += [begun + drive.first] * bool(drive.first)
        lines += [f"{begun}too deep: {drive.first_deep}"] * bool(drive.first_deep)
    return lines

"""The inspector's requests and results: frozen values, independent of the page."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

import vf
from app.scene.moment import Placed
from app.scene.scene import Scene
from app.settings import Options
from app.view.inspector.compare import Comparison, Forecasts, Pose
from app.view.inspector.region import Region, allowed_region

FloatArray = NDArray[np.float64]

MAX_TRIANGLES = 2000  # examined, the nearest ones
COMPARISON_PERIOD = 0.5  # shortest time between two comparisons [s]


@dataclass(frozen=True)
class Subject:
    """What is inspected: the tool at a tick, or the probe.

    Attributes:
        surface: the anatomy, or one of the paper's cases.
        x: (3,) [m].
        radius: of the motion sphere [m].
        options: the session's.
        rule: the one in force, or the one shown at the probe.
        scene: its arm is used for the forecasts.
        step: of the shown tick; None for a probe.
        pose: for the forecasts; None for a probe, or without a proxy.
        names: of the triangles, if they have names.
        axes: (c, 2, 3) of the arm's capsules at the tick [m]; None for a probe.
        tick: number of the shown tick.
        fixture: number of the controller's fixture that the surface belongs to.
        structure: name of the surface, where the scene has several.
        margin: of the structure [m].
        number: of the structure in the scene.
        placed: the structure where the guard believes it at the tick; None: it rests. The surface
            is replaced by one that is there before it is looked at.
    """

    surface: vf.Surface
    x: FloatArray
    radius: float
    options: Options
    rule: str
    scene: Scene
    step: vf.Step | None = None
    pose: Pose | None = None
    names: tuple[str, ...] = ()
    tick: int | None = None
    axes: FloatArray | None = None
    fixture: int = 0
    structure: str = ""
    margin: float = 0.0
    number: int = 0
    placed: Placed | None = None

    def part(self, planes: vf.Planes, k: int) -> str:
        """Name of the part of the instrument that a plane holds."""
        capsules = self.scene.arm.capsules
        return capsules[0 if planes.capsules is None else int(planes.capsules[k])].name

    def room(self, planes: vf.Planes, k: int) -> float:
        """Room that a plane leaves to the tip, or to the axis that it holds [m]."""
        if self.axes is None or planes.of_axis is None or not planes.of_axis[k]:
            return float(planes.slack(self.x)[k])
        assert planes.capsules is not None
        ends = self.axes[int(planes.capsules[k])]
        return float((ends @ planes.normals[k]).min() - planes.offsets[k])

    def name(self, triangle: int) -> str:
        """Name of a triangle."""
        return self.names[triangle] if triangle < len(self.names) else f"#{triangle:,}"

    def same_setting(self, other: Subject) -> bool:
        """Whether another one has the same surface, options and kind (tool or probe)."""
        moves = self.placed is not None and other.placed is not None
        return (
            (self.surface is other.surface or (moves and self.number == other.number))
            and self.scene is other.scene
            and self.options == other.options
            and (self.step is None) == (other.step is None)
        )

    def same_place(self, other: Subject | None) -> bool:
        """Whether another one has the same triangles and explanations."""
        return other is not None and (
            self.surface is other.surface
            and self.radius == other.radius
            and self.options == other.options
            and self.rule == other.rule
            and bool((self.x == other.x).all())
        )


@dataclass(frozen=True)
class Request:
    """A subject, and whether its region and the comparison of rules are wanted."""

    subject: Subject
    region: bool
    comparison: bool

    def same(self, other: Request | None) -> bool:
        """Whether another one has the same result."""
        return (
            other is not None
            and self.subject.step is other.subject.step
            and self.subject.same_place(other.subject)
            and (self.region, self.comparison) == (other.region, other.comparison)
        )


@dataclass(frozen=True)
class Inspection:
    """The result of a `Request`.

    Attributes:
        subject: what was inspected.
        explanation: for each triangle.
        planes: of the tick and of the subject's surface, or of the subject's rule at the probe.
        multipliers: (m,) how far each plane pushed the tip back in the tick [m].
        pushes: sum of the multipliers of all planes of the tick [m].
        region: the allowed region; None: not requested.
        forecasts: of all rules; None: not requested. As they take long, they may be of an earlier
            moment than the subject, the same one for all rules.
        settled: whether the same request would give the same result again.
    """

    subject: Subject
    explanation: vf.Explanation
    planes: vf.Planes
    multipliers: FloatArray
    region: Region | None
    forecasts: Forecasts | None
    settled: bool = True
    pushes: float = 0.0

    def push(self, triangle: int) -> tuple[float, float]:
        """How far a triangle's planes pushed the tip back [m], and their share of all pushes."""
        total = self.pushes
        mine = float(self.multipliers[self.planes.triangles == triangle].sum())
        return mine, mine / total if total > 0.0 else 0.0

    def main_triangle(self) -> int:
        """The triangle whose plane pushes most, else the nearest; −1 if there is none."""
        pushes = np.where(self.planes.triangles >= 0, self.multipliers, 0.0)
        if pushes.max(initial=0.0) > 0.0:
            return int(self.planes.triangles[pushes.argmax()])
        return int(self.explanation.triangles[0]) if len(self.explanation) else -1


class Inspector:
    """Computes inspections; reuses what did not change."""

    def __init__(self) -> None:
        self._comparison: tuple[Scene, Comparison] | None = None
        self._compared_at = 0.0  # monotonic time [s]
        self._last: Inspection | None = None
        self._request: Request | None = None
        self._every = vf.Planes.none(0.0)  # the planes of all fixtures at the last subject

    def inspect(self, request: Request) -> Inspection:
        """Inspect the subject of a request."""
        subject, last = self._frozen(request.subject), self._last
        options = subject.options
        same = last is not None and subject.same_place(last.subject)
        if last is not None and same:
            explanation = last.explanation
        else:
            explanation = vf.explain(
                subject.surface,
                subject.x,
                subject.radius,
                options.standoff,
                options.tip_radius + subject.margin,  # as if the tool were so much thicker
                MAX_TRIANGLES,
            )
        if subject.step is not None:
            every = subject.step.planes
            planes, multipliers = _of_fixture(every, subject.step.multipliers, subject.fixture)
            pushes = float(subject.step.multipliers.sum())
        else:
            every = planes = _planes(subject, explanation)
            multipliers, pushes = np.zeros(len(planes)), 0.0
        region = None
        if request.region:
            if last is not None and same and _equal(self._every, every):
                region = last.region
            region = region or allowed_region(every.of_tip(), subject.x)
        self._every = every
        forecasts, settled = None, True
        if request.comparison:
            alike = last is not None and last.subject.same_setting(subject)
            forecasts = last.forecasts if last is not None and alike else None
            due = time.monotonic() > self._compared_at + COMPARISON_PERIOD
            settled = last is not None and last.settled and request.same(self._request)
            if forecasts is None or (due and not settled):
                forecasts, settled = self._compare(subject), True
                self._compared_at = time.monotonic()
        self._request = request
        self._last = Inspection(
            subject, explanation, planes, multipliers, region, forecasts, settled, pushes
        )
        return self._last

    def _frozen(self, subject: Subject) -> Subject:
        """The subject with its surface where it is at the tick."""
        if subject.placed is None:
            return subject
        last = None if self._last is None else self._last.subject
        if (
            last is None
            or last.step is not subject.step
            or last.number != subject.number
            or last.scene is not subject.scene
        ):
            return replace(subject, surface=subject.placed.frozen())
        return replace(subject, surface=last.surface)

    def _compare(self, subject: Subject) -> Forecasts:
        if self._comparison is None or self._comparison[0] is not subject.scene:
            self._comparison = subject.scene, Comparison(subject.scene)
        found = self._comparison[1].forecasts(
            subject.surface, subject.x, subject.radius, subject.options, subject.pose
        )
        return Forecasts(subject.x, subject.tick, found)


def _of_fixture(
    planes: vf.Planes, multipliers: FloatArray, fixture: int
) -> tuple[vf.Planes, FloatArray]:
    """The planes (m) of a fixture, and those of corridors, with their multipliers (m,)."""
    if planes.fixtures is None:
        return planes, multipliers
    kept = (planes.fixtures == fixture) | (planes.rules == vf.Rule.CORRIDOR)
    arrays: dict[str, Any] = {
        name: array[kept] for name, array in vars(planes).items() if isinstance(array, np.ndarray)
    }
    return replace(planes, **arrays), multipliers[kept]


def _equal(a: vf.Planes, b: vf.Planes) -> bool:
    return (
        a.radius == b.radius
        and np.array_equal(a.normals, b.normals)
        and np.array_equal(a.offsets, b.offsets)
    )


def _planes(subject: Subject, explanation: vf.Explanation) -> vf.Planes:
    """The planes of the subject's rule at a probe."""
    if subject.rule == "paper":
        return explanation.paper
    if subject.rule == "certified":
        return explanation.certified
    options = subject.options
    fixture = vf.MeshFixture(subject.surface, subject.rule, subject.radius)
    return fixture.planes(
        subject.x, subject.radius, options.standoff, options.tip_radius, explanation.inside
    )

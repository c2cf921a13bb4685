"""The trials of the experiments: which there are, and what comes of one.

A trial depends on its own description alone, seed included: run anywhere, in any order, it gives
the same numbers on the same kind of machine.
"""

from __future__ import annotations

import dataclasses
import time
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

import meshes
import vf
from app import limits
from app.scene.scene import corridor
from app.studies.experiments import cutting, judge, registration, site, smoothness
from app.studies.experiments.follower import ControlledArm
from app.studies.experiments.limits import EXPERIMENTS, OUTCOME, RULES, TRIAL
from app.studies.experiments.operators import Operator
from app.studies.experiments.site import PlannedCut
from app.studies.experiments.trial import Run, perform

FloatArray = NDArray[np.float64]

RADIUS = 5e-3  # of the motion sphere, the paper's [m]
LOCALISATION = 0.35e-3  # fiducial localisation error, 3D root mean square, assumed [m]
SAMPLED = 100.0  # the smoothness is judged at, and trajectories are kept at [Hz]
OPERATORS_DIFFER = 0.15  # log-normal spread of the calibrated values among operators, assumed


@dataclass(frozen=True)
class Trial:
    """One trial, completely described.

    Attributes:
        experiment: tracing or cutting.
        rule: off is plain teleoperation; certified or paper guard the inner surface, and a corridor
            the path.
        number: tells trials of one kind apart.
        operator: 0 is the calibrated one, any other number somebody else.
        mesh: skull, skull-coarse or skull-fine.
        noise: fiducial localisation error [m].
        width: of the corridor to either side [m].
        seed: of everything random.
        rate: ticks per second [Hz].
        length: of the planned cut, None: all of it [m].

    Raises:
        OptionError: a value that is none of these.
    """

    experiment: str
    rule: str
    number: int = 0
    operator: int = 0
    mesh: str = "skull"
    noise: float = LOCALISATION
    width: float = 1e-3
    seed: int = 0
    rate: float = 1000.0
    length: float | None = None

    def __post_init__(self) -> None:
        limits.check(self, TRIAL)

    @property
    def key(self) -> str:
        """A name for files: equal for equal trials, different for different ones."""
        length = "all" if self.length is None else f"{self.length * 1e3:g}mm"
        return (
            f"{self.experiment}-{self.mesh}-{self.rule}-noise{self.noise * 1e6:g}um"
            f"-width{self.width * 1e6:g}um-{length}-{self.rate:g}hz"
            f"-seed{self.seed}-operator{self.operator}-{self.number}"
        )

    @property
    def assisted(self) -> bool:
        return self.rule != "off"

    def generator(self, purpose: int) -> np.random.Generator:
        """Randomness for one purpose.

        Tracing is compared in pairs: trials that differ in the rule alone have the same operator on
        the same day. Cutting needs a new skull every time, so no two trials share anything.
        """
        apart = RULES.index(self.rule) if self.experiment == "cutting" else 0
        entropy = (
            self.seed, EXPERIMENTS.index(self.experiment), self.operator, self.number, apart,
            purpose,
        )  # fmt: skip
        return np.random.default_rng(np.random.SeedSequence(entropy))


@dataclass(frozen=True)
class Outcome:
    """What came of a trial. Lengths in metres, times in seconds.

    Attributes:
        duration: simulated.
        finished: whether the end of the cut was reached.
        sal, sparc: smoothness of the tip's speed.
        fre, tre: errors of the registration, at the fiducials and along the cut.
        stations, deviation, penetration: of the cut, signed, NaN where there is none.
        removed: volume of bone [m³].
        crossings: steps of the tip that met the registered surface (judged, assisted only).
        outside: ticks outside the registered corridor (judged, assisted only).
        ticks, statuses: of the controller.
        submovements, corrections: of the operator.
        elapsed: what the trial took to compute; driving: processor time of controller and operator.
        trajectory: (m, 4) station, aside, height and time of the tip at `SAMPLED`.
    """

    trial: Trial
    duration: float
    finished: bool
    sal: float
    sparc: float
    fre: float
    tre: float
    stations: FloatArray
    deviation: FloatArray
    penetration: FloatArray
    removed: float
    crossings: int
    outside: int
    ticks: int
    statuses: dict[str, int]
    submovements: int
    corrections: int
    elapsed: float
    driving: float
    trajectory: FloatArray

    def to_json(self) -> dict[str, Any]:
        """Everything as plain values; `from_json` gives back an equal outcome."""
        values = {f.name: getattr(self, f.name) for f in dataclasses.fields(self)}
        values["trial"] = dataclasses.asdict(self.trial)
        for name, value in values.items():
            if isinstance(value, np.ndarray):
                # Trajectories to a nanometre, or a study would fill a disk with digits.
                rounded = np.round(value, 9) if name == "trajectory" else value
                values[name] = [[None if np.isnan(x) else x for x in row]
                                for row in np.atleast_2d(rounded).tolist()]  # fmt: skip
        return values

    @staticmethod
    def from_json(content: object) -> Outcome:
        """An outcome from the plain values of a file that nobody vouches for.

        Raises:
            OptionError: a key that does not belong there or is missing, or a value out of range.
        """
        limits.check_object("the outcome of a trial", content, OUTCOME)
        assert isinstance(content, dict)
        values = dict(content)
        limits.check_object("its trial", values["trial"], TRIAL)
        values["trial"] = Trial(**values["trial"])
        for name in ("stations", "deviation", "penetration", "trajectory"):
            array = np.array(values[name], dtype=np.float64)
            values[name] = array.reshape(-1, 4) if name == "trajectory" else array[0]
        return Outcome(**values)


@dataclass(frozen=True)
class Recorded:
    """A trial's outcome together with all that was recorded of it: what a replay needs."""

    outcome: Outcome
    run: Run
    joints: FloatArray
    T_base_registered: FloatArray
    planned: PlannedCut


def run(trial: Trial, operator: Operator | None = None) -> Outcome:
    """Do one trial."""
    return record(trial, operator).outcome


def record(trial: Trial, operator: Operator | None = None) -> Recorded:
    """Do one trial and keep every tick of it.

    Args:
        operator: whose hand; the one with the trial's number if not given.
    """
    began = time.perf_counter()
    place = site.build(trial.mesh, trial.length)
    if operator is None:
        operator = who(trial)
    truth = place.planned.moved(place.T_base_skull)
    found = registration.fit(
        place.fiducials,
        registration.measure(
            meshes.transformed(place.T_base_skull, place.fiducials),
            trial.noise,
            trial.generator(0),
        ),
    )
    believed = place.planned.moved(found.T)
    fixtures: list[vf.Fixture] = []
    if trial.assisted:
        guarded = place.guarded(found.T)
        fixtures = [
            vf.MeshFixture(guarded, trial.rule, RADIUS),
            corridor(guarded, believed.points, trial.width),
        ]
    arm = ControlledArm(place.arm, fixtures, place.T_base_start, 1.0 / trial.rate)
    # Of this thread alone: what the machine does besides is not the trial's.
    driving = time.thread_time()
    done = perform(
        operator,
        truth,
        place.T_base_start.translation,
        arm,
        assisted=trial.assisted,
        stroke=operator.stroke if trial.experiment == "cutting" else operator.tracing_stroke,
        rate=trial.rate,
        rng=trial.generator(1),
    )
    driving = time.thread_time() - driving
    path = np.vstack([place.T_base_start.translation, done.tips])
    crossings = outside = 0
    if trial.assisted:
        vertices, faces = place.inner
        crossings = judge.crossings(meshes.transformed(found.T, vertices), faces, path)
        outside = judge.outside(believed.points, path, trial.width)
    cut = cutting.kerf(truth, done.tips)
    every = max(round(trial.rate / SAMPLED), 1)
    sampled = done.tips[every - 1 :: every]
    speed = smoothness.speed_of(sampled, trial.rate / every)
    outcome = Outcome(
        trial=trial,
        duration=done.duration,
        finished=done.finished,
        sal=smoothness.sal(speed, trial.rate / every),
        sparc=smoothness.sparc(speed, trial.rate / every),
        fre=found.fre,
        tre=registration.target_error(found, place.T_base_skull, place.planned.points),
        stations=cut.stations,
        deviation=cut.deviation,
        penetration=cut.penetration,
        removed=float(np.nansum(cut.area) * cutting.INTERVAL),
        crossings=crossings,
        outside=outside,
        ticks=len(done.tips),
        statuses={s.name: n for s, n in sorted(arm.statuses.items())},
        submovements=done.submovements,
        corrections=done.corrections,
        elapsed=time.perf_counter() - began,
        driving=driving,
        trajectory=_along(truth, sampled, trial.rate / every),
    )
    return Recorded(outcome, done, np.concatenate(arm.joints), found.T, truth)


def who(trial: Trial) -> Operator:
    """The operator of a trial: the same hand in all trials with that number and seed."""
    if trial.operator == 0:
        return Operator()
    entropy = np.random.SeedSequence((trial.seed, 1 << 20, trial.operator))
    return Operator().varied(np.random.default_rng(entropy), OPERATORS_DIFFER)


def _along(planned: PlannedCut, points: FloatArray, rate: float) -> FloatArray:
    """Points in the planned cut's own coordinates: station, aside, height over bone, and time."""
    nearest = np.linalg.norm(points[:, None] - planned.points, axis=2).argmin(axis=1)
    off = points - planned.points[nearest]
    return np.stack(
        [
            planned.stations[nearest] + (off * planned.along[nearest]).sum(axis=1),
            (off * planned.aside[nearest]).sum(axis=1),
            (off * planned.outward[nearest]).sum(axis=1),
            np.arange(1, len(points) + 1) / rate,
        ],
        axis=1,
    )

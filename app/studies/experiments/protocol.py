"""Runs a trial of an experiment and computes its outcome.

The outcome depends only on the trial's description, which includes the seed, and on the kind of
machine.
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
from app.control.plant import corridor
from app.kinds import Kind, Length, Number, Switch, Whole, shown
from app.options import check_keys, declared, option
from app.studies.experiments import cutting, judge, registration, site, smoothness
from app.studies.experiments.description import Trial
from app.studies.experiments.follower import ControlledArm
from app.studies.experiments.operators import Operator
from app.studies.experiments.site import PlannedCut
from app.studies.experiments.trial import Run, perform
from app.words import OptionError

FloatArray = NDArray[np.float64]

LONGEST = 1e6  # of simulated or computing time [s]
RADIUS = 5e-3  # of the motion sphere, as in the paper [m]
LEAST_NOISE = 1e-6  # with less localisation error nothing is added [m]
OPERATOR_SPREAD = 0.15  # log-normal spread of the calibrated values among operators, assumed


class Mapping(Kind):
    """A JSON object, whose content is checked elsewhere."""

    def check(self, name: str, value: Any) -> None:
        if not isinstance(value, dict):
            raise OptionError(f"{name} must be an object {{…}}, not {shown(value)}")


class Counts(Mapping):
    """A JSON object of counts by name."""

    def check(self, name: str, value: Any) -> None:
        super().check(name, value)
        for key, count in value.items():
            _COUNT.check(f"{name} {shown(key)}", count)


@dataclass(frozen=True)
class Table(Kind):
    """A JSON list of rows of numbers or null; `rows` rows, or rows of `columns` numbers."""

    low: float
    high: float
    rows: int | None = None
    columns: int | None = None

    def check(self, name: str, value: Any) -> None:
        rows: list[list[Any]] = value if isinstance(value, list) else []
        sound = (
            isinstance(value, list)
            and all(isinstance(row, list) for row in rows)
            and self.rows in (None, len(rows))
            and all(self.columns in (None, len(row)) for row in rows)
        )
        if not sound:
            shape = f"{self.rows} row" if self.rows else f"rows of {self.columns} numbers"
            raise OptionError(f"{name} must be a table of {shape}, not {shown(value)}")
        for number in (x for row in rows for x in row if x is not None):
            known = isinstance(number, int | float) and not isinstance(number, bool)
            if not known or not self.low <= number <= self.high:
                raise OptionError(
                    f"{name} has {shown(number)}, which is no number from {self.low:g} "
                    f"to {self.high:g}"
                )


_COUNT = Whole(0, 10**9)  # of ticks and events
_TIME = Number(0.0, LONGEST, "s")
_ERROR = Length(0.0, 1.0)


@dataclass(frozen=True)
class Outcome:
    """The outcome of a trial. Lengths in metres, times in seconds.

    Attributes:
        duration: simulated.
        finished: whether the end of the cut was reached.
        sal, sparc: smoothness of the tip's speed.
        fre, tre: errors of the registration, at the fiducials and along the cut.
        stations, deviation, penetration: of the cut, signed; NaN where no bone was cut.
        removed: volume of bone [m³].
        injured: ticks with the tip beyond the true inner surface (by `judge`).
        deepest: how far at most; negative: it came no nearer than that.
        crossings: steps of the tip that met the registered surface (by `judge`, assisted only).
        outside: ticks outside the registered corridor (by `judge`, assisted only).
        ticks, statuses: of the controller.
        submovements, corrections: of the operator.
        elapsed: time of computation; driving: processor time of controller and operator.
        trajectory: (m, 4) station, lateral offset, height and time of the tip at
            `smoothness.SAMPLED`.
    """

    trial: Trial = option(Mapping())
    duration: float = option(_TIME)
    finished: bool = option(Switch())
    sal: float = option(Number(-1e6, 0.0))
    sparc: float = option(Number(-1e6, 0.0))
    fre: float = option(_ERROR)
    tre: float = option(_ERROR)
    stations: FloatArray = option(Table(0.0, 1.0, rows=1))
    deviation: FloatArray = option(Table(-1.0, 1.0, rows=1))
    penetration: FloatArray = option(Table(-1.0, 1.0, rows=1))
    removed: float = option(Number(0.0, 1.0, "m³"))
    injured: int = option(_COUNT)
    deepest: float = option(Length(-1.0, 1.0))
    crossings: int = option(_COUNT)
    outside: int = option(_COUNT)
    ticks: int = option(_COUNT)
    statuses: dict[str, int] = option(Counts())
    submovements: int = option(_COUNT)
    corrections: int = option(_COUNT)
    elapsed: float = option(_TIME)
    driving: float = option(_TIME)
    trajectory: FloatArray = option(Table(-LONGEST, LONGEST, columns=4))

    def to_json(self) -> dict[str, Any]:
        """All values as JSON; `from_json` gives back an equal outcome."""
        values = {f.name: getattr(self, f.name) for f in dataclasses.fields(self)}
        values["trial"] = dataclasses.asdict(self.trial)
        for name, value in values.items():
            if isinstance(value, np.ndarray):
                # Trajectories are rounded to a nanometre, to keep the files small.
                rounded = np.round(value, 9) if name == "trajectory" else value
                values[name] = [[None if np.isnan(x) else x for x in row]
                                for row in np.atleast_2d(rounded).tolist()]  # fmt: skip
        return values

    @staticmethod
    def from_json(content: object) -> Outcome:
        """An outcome from the JSON of an untrusted file.

        Raises:
            OptionError: an unknown or missing key, or a value out of range.
        """
        options = declared(Outcome)
        values = dict(check_keys("the outcome of a trial", content, options))
        for name, value in values.items():
            options[name].kind.check(name, value)
        values["trial"] = Trial(**check_keys("its trial", values["trial"], declared(Trial)))
        for name in ("stations", "deviation", "penetration", "trajectory"):
            array = np.array(values[name], dtype=np.float64)
            values[name] = array.reshape(-1, 4) if name == "trajectory" else array[0]
        return Outcome(**values)


@dataclass(frozen=True)
class Recorded:
    """A trial's outcome together with its ticks, for a replay."""

    outcome: Outcome
    run: Run
    joints: FloatArray
    T_base_registered: FloatArray
    planned: PlannedCut


def run(trial: Trial, operator: Operator | None = None) -> Outcome:
    """Run one trial."""
    return record(trial, operator).outcome


def record(trial: Trial, operator: Operator | None = None) -> Recorded:
    """Run one trial and keep all ticks.

    Args:
        operator: None: the trial's own, see `operator_of`.
    """
    began = time.perf_counter()
    place = site.build(trial.mesh, trial.length)
    if operator is None:
        operator = operator_of(trial)
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
        added = margin_map(trial, found.T)
        margin = 0.0 if added is None else added.at(guarded.vertices)
        fixtures = [
            vf.MeshFixture(guarded, trial.rule, RADIUS, margin=margin),
            corridor(guarded, believed.points, trial.width),
        ]
    arm = ControlledArm(place.arm, fixtures, place.T_base_start, 1.0 / trial.rate)
    driving = time.thread_time()  # of this thread alone
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
    vertices, faces = place.inner
    heights = judge.heights(meshes.transformed(place.T_base_skull, vertices), faces, done.tips)
    if trial.assisted:
        crossings = judge.crossings(meshes.transformed(found.T, vertices), faces, path)
        outside = judge.outside(believed.points, path, trial.width)
    cut = cutting.kerf(truth, done.tips)
    sampled, rate = smoothness.sampled(done.tips, trial.rate)
    speed = smoothness.speed_of(sampled, rate)
    outcome = Outcome(
        trial=trial,
        duration=done.duration,
        finished=done.finished,
        sal=smoothness.sal(speed, rate),
        sparc=smoothness.sparc(speed, rate),
        fre=found.fre,
        tre=registration.target_error(found, place.T_base_skull, place.planned.points),
        stations=cut.stations,
        deviation=cut.deviation,
        penetration=cut.penetration,
        removed=float(np.nansum(cut.area) * cutting.INTERVAL),
        injured=int((heights < 0.0).sum()),
        deepest=-float(heights.min()),
        crossings=crossings,
        outside=outside,
        ticks=len(done.tips),
        statuses={s.name: n for s, n in sorted(arm.statuses.items())},
        submovements=done.submovements,
        corrections=done.corrections,
        elapsed=time.perf_counter() - began,
        driving=driving,
        trajectory=_along(truth, sampled, rate),
    )
    return Recorded(outcome, done, np.concatenate(arm.joints), found.T, truth)


def margin_map(trial: Trial, T: FloatArray) -> meshes.MarginMap | None:
    """The margins of a trial's registration for a skull at T (4, 4), base frame; None: none.

    The localisation error is known to the guard, as if it had been measured before.
    """
    if not trial.margin or trial.noise < LEAST_NOISE:
        return None
    place = site.build(trial.mesh, trial.length)
    return meshes.margin_map(place.fiducials, trial.noise, trial.margin).moved(T)


def operator_of(trial: Trial) -> Operator:
    """The operator of a trial: the same in all trials with this operator number and seed."""
    if trial.operator == 0:
        return Operator()
    entropy = np.random.SeedSequence((trial.seed, 1 << 20, trial.operator))
    return Operator().varied(np.random.default_rng(entropy), OPERATOR_SPREAD)


def _along(planned: PlannedCut, points: FloatArray, rate: float) -> FloatArray:
    """Points in coordinates of the planned cut: station, lateral offset, height over bone, time."""
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

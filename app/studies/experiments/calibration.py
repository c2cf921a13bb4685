"""Fits the operator model to the paper's results without the fixture.

Six parameters are fitted so that plain teleoperation has the paper's six figures: mean and standard
deviation of |penetration| and of cutting-path deviation, the time of a cut, and the smoothness of
tracing. The model's results with the fixture are then a prediction.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from app.studies.experiments import cutting, site, smoothness
from app.studies.experiments.follower import IdealArm
from app.studies.experiments.operators import Operator
from app.studies.experiments.trial import perform
from app.studies.results import published

FloatArray = NDArray[np.float64]

# Fitted parameters and their initial values, which do not depend on the operator's present values.
START = {
    "view_angle": 0.65,  # [rad]
    "depth_bias": 0.8e-3,  # [m]
    "depth_error": 0.5e-3,  # [m]
    "image_error": 0.25e-3,  # [m]
    "stroke": 0.12e-3,  # [m]
    "tracing_stroke": 0.4e-3,  # [m]
}
FITTED = tuple(START)
CUTTING_RATE = 100.0  # shape and time of a cut do not depend on it [Hz]
TRACING_RATE = 1000.0  # smoothness may depend on it [Hz]
TRACES = 4  # tracing trials per figure: smoothness varies little between trials
SETTLED = 3  # final corrections of the two strokes
DIFFERENCE = 0.25  # finite difference in the logarithm of a value, large as figures are noisy


@dataclass(frozen=True)
class Calibration:
    """The fitted operator, with rows of name, wanted and reached figure.

    `finished`: the fit converged; else it was interrupted, and this is the best so far.
    """

    operator: Operator
    rows: tuple[tuple[str, float, float], ...]
    finished: bool = True


def wanted() -> dict[str, float]:
    """The paper's figures of plain teleoperation, in the published units."""
    return {
        "mean |PD| [mm]": published.PENETRATION.off.mean,
        "std |PD| [mm]": published.PENETRATION.off.spread,
        "mean CPD [mm]": published.DEVIATION.off.mean,
        "std CPD [mm]": published.DEVIATION.off.spread,
        "time [s]": published.DURATION.off.mean,
        "SAL": published.SAL.off.mean,
    }


def reached(operator: Operator, trials: int, seed: int) -> dict[str, float]:
    """The figures of `wanted`, of simulated teleoperation; deterministic for a seed."""
    place = site.build()
    planned = place.planned.moved(place.T_base_skull)
    start = place.T_base_start.translation
    deviation, penetration, durations, smooth = [], [], [], []
    for number in range(trials):
        rng = np.random.default_rng(np.random.SeedSequence((seed, number)))
        cut = perform(
            operator, planned, start, IdealArm(), assisted=False,
            stroke=operator.stroke, rate=CUTTING_RATE, rng=rng,
        )  # fmt: skip
        shape = cutting.kerf(planned, cut.tips)
        deviation.append(np.abs(shape.deviation))
        penetration.append(np.abs(shape.penetration))
        durations.append(cut.duration)
        if number >= TRACES:
            continue
        trace = perform(
            operator, planned, start, IdealArm(), assisted=False,
            stroke=operator.tracing_stroke, rate=TRACING_RATE, rng=rng,
        )  # fmt: skip
        sampled, rate = smoothness.sampled(trace.tips, TRACING_RATE)
        smooth.append(smoothness.sal(smoothness.speed_of(sampled, rate), rate))
    values = (
        1e3 * np.nanmean(penetration), 1e3 * np.nanstd(penetration),
        1e3 * np.nanmean(deviation), 1e3 * np.nanstd(deviation),
        np.mean(durations), np.mean(smooth),
    )  # fmt: skip
    return dict(zip(wanted(), map(float, values), strict=True))


def calibrate(
    trials: int = 12, seed: int = 0, say: Callable[[str], None] = lambda _text: None
) -> Calibration:
    """Fit the six parameters, by least squares of the relative differences.

    Raises:
        KeyboardInterrupt: interrupted before the first evaluation was done.
    """
    goal = np.array(list(wanted().values()))
    start = np.log(list(START.values()))

    def operator(x: FloatArray) -> Operator:
        values = {name: float(v) for name, v in zip(FITTED, np.exp(x), strict=True)}
        return replace(Operator(), **values)

    seen: list[tuple[float, Operator, dict[str, float]]] = []

    def miss(x: FloatArray) -> FloatArray:
        figures = reached(operator(x), trials, seed)
        off = np.array(list(figures.values())) / goal - 1.0
        seen.append((float(off @ off), operator(x), figures))
        say(f"off by {100 * float(np.abs(off).max()):.1f} %")
        return off

    try:
        fit = least_squares(
            miss, start, diff_step=DIFFERENCE / np.maximum(np.abs(start), 1.0), max_nfev=6,
            xtol=1e-3, ftol=1e-4,
        )  # fmt: skip
        found = operator(fit.x)
        # Time and SAL depend nearly on one stroke each: correct these for the remaining error.
        for _ in range(SETTLED):
            figures = reached(found, trials, seed)
            found = replace(
                found,
                stroke=found.stroke * figures["time [s]"] / goal[4],
                tracing_stroke=found.tracing_stroke * figures["SAL"] / goal[5],
            )
        figures = reached(found, trials, seed)
    except KeyboardInterrupt:
        if not seen:
            raise
        _, found, figures = min(seen, key=lambda one: one[0])
        return Calibration(found, _rows(figures), finished=False)
    return Calibration(found, _rows(figures))


def _rows(figures: dict[str, float]) -> tuple[tuple[str, float, float], ...]:
    return tuple((name, value, figures[name]) for name, value in wanted().items())

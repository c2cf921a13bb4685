"""Model of a surgeon: perception, motion and their errors.

The hand moves in submovements of minimum jerk, with the visual delay between them. Depth is
perceived through a stereo endoscope that views the cut obliquely: an error along the line of sight
is invisible in the image, and is partly an error in depth and partly a lateral one. With the
fixture on, the operator presses lightly inwards and leaves depth to the fixture; the tip's position
on the known surface then follows from the image.

All lengths are at the tool, i.e. after the scaling of teleoperation.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import signal

FloatArray = NDArray[np.float64]

CALIBRATED = "calibrated on the paper's teleoperation arm: vf-sandbox experiment calibrate --seed 0"


def _parameter(value: float, unit: str, source: str, about: str) -> Any:
    return field(default=value, metadata={"unit": unit, "source": source, "about": about})


@dataclass(frozen=True)
class Operator:
    """Parameters of an operator; each field has unit, source and description in its metadata."""

    movement_time: float = _parameter(
        0.35, "s", "submovements last 0.2–0.5 s: Novak, Miller, Houk, Exp Brain Res 2002",
        "length of a submovement of minimum jerk (Flash, Hogan, J Neurosci 1985)",
    )  # fmt: skip
    visual_delay: float = _parameter(
        0.2, "s", "0.15–0.25 s: Slifkin, Vaillancourt, Newell, J Neurophysiol 2000",
        "from the end of a submovement until what is seen of it leads to the next",
    )  # fmt: skip
    movement_noise: float = _parameter(
        0.05, "of the movement", "a few percent: Harris, Wolpert, Nature 1998",
        "standard deviation of a submovement's end, in every direction",
    )  # fmt: skip
    tremor: float = _parameter(
        50e-6, "m", "around 50 µm in microsurgery: Riviere, Rader, Khosla, IEEE EMBS 1997",
        "tremor of 8–12 Hz at the hand, root mean square in every direction; scaled like movement",
    )  # fmt: skip
    scale: float = _parameter(
        0.2, "1", "default of the dVRK (facts of the setting)", "movement of tool per hand"
    )
    view_angle: float = _parameter(
        0.768, "rad", CALIBRATED, "between the line of sight and the plane of the cut"
    )
    depth_bias: float = _parameter(
        0.809e-3, "m", CALIBRATED,
        "constant error along the line of sight, the tool believed nearer than it is",
    )  # fmt: skip
    depth_error: float = _parameter(
        0.648e-3, "m", CALIBRATED, "slow error along the line of sight, standard deviation"
    )
    image_error: float = _parameter(
        0.191e-3, "m", CALIBRATED, "slow lateral error in the picture, standard deviation"
    )
    slow: float = _parameter(
        5.0, "s", "assumed: some submovements, well below a trial",
        "correlation time of the slow errors",
    )  # fmt: skip
    session_spread: float = _parameter(
        0.2, "of the bias", "assumed", "by which the bias differs between trials, std. deviation"
    )
    tolerance: float = _parameter(
        0.2e-3, "m", "assumed: a third of the blade's width",
        "a deviation seen to be larger is corrected before the tool goes on",
    )  # fmt: skip
    stroke: float = _parameter(
        0.147e-3, "m", CALIBRATED, "how far a submovement goes on along a cut in bone"
    )
    tracing_stroke: float = _parameter(
        0.272e-3, "m", CALIBRATED, "how far a submovement goes on along an open slot"
    )  # fmt: skip
    press: float = _parameter(
        0.15, "N", "assumed: light contact",
        "force with which the hand presses inwards where it relies on the fixture",
    )  # fmt: skip
    press_noise: float = _parameter(
        0.1, "of the force", "Weber fraction of force: Jones, Exp Neurol 1989; Pang et al. 1991",
        "standard deviation of the force pressed with",
    )  # fmt: skip
    stiffness: float = _parameter(
        150.0, "N/m", "the paper's haptic gain", "of the force felt per distance of tool and proxy"
    )

    def __post_init__(self) -> None:
        for f in fields(self):
            value = getattr(self, f.name)
            if not np.isfinite(value) or value < 0.0:
                raise ValueError(f"{f.name} must be finite and zero or more, got {value!r}")

    def varied(self, rng: np.random.Generator, spread: float) -> Operator:
        """Another operator: calibrated values times a log-normal factor of this spread."""
        names = [f.name for f in fields(self) if f.metadata["source"] == CALIBRATED]
        factors = np.exp(spread * rng.normal(size=len(names)))
        return replace(
            self,
            **{n: getattr(self, n) * float(k) for n, k in zip(names, factors, strict=True)},
        )


class Tremor:
    """Tremor of 8–12 Hz in blocks of (n, 3) [m], continuous across blocks."""

    def __init__(self, size: float, rate: float, rng: np.random.Generator) -> None:
        self._rng = rng
        if size == 0.0 or rate <= 24.0:  # cannot be represented
            self._gain = 0.0
        else:
            self._sos = signal.butter(2, (8.0, 12.0), "bandpass", fs=rate, output="sos")
            _, response = signal.sosfreqz(self._sos, 4096, fs=rate)
            self._gain = size / float(np.sqrt((np.abs(response) ** 2).mean()))
            self._state = np.zeros((len(self._sos), 2, 3))

    def __call__(self, n: int) -> FloatArray:
        if self._gain == 0.0:
            return np.zeros((n, 3))
        white = self._gain * self._rng.normal(size=(n, 3))
        out, self._state = signal.sosfilt(self._sos, white, axis=0, zi=self._state)
        return np.asarray(out)


class SlowError:
    """An Ornstein–Uhlenbeck process, sampled exactly at increasing times."""

    def __init__(self, size: float, memory: float, rng: np.random.Generator) -> None:
        self._size, self._memory, self._rng = size, memory, rng
        self._value = size * rng.normal()

    def after(self, elapsed: float) -> float:
        """The error `elapsed` seconds after the last one."""
        kept = float(np.exp(-elapsed / self._memory)) if self._memory > 0.0 else 0.0
        fresh = float(np.sqrt(1.0 - kept**2)) * self._size
        self._value = kept * self._value + fresh * self._rng.normal()
        return self._value


def minimum_jerk(n: int) -> FloatArray:
    """Fraction (n,) of a minimum-jerk movement after each of its n ticks (Flash, Hogan)."""
    t = np.arange(1, n + 1) / n
    return np.asarray(t**3 * (10.0 - 15.0 * t + 6.0 * t**2))

"""Description of a trial. Cheap to import: the command line derives its options from it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from app import choices
from app.kinds import SEEDS, Length, Maybe, Number, OneOf, Whole
from app.options import Checked, option

if TYPE_CHECKING:
    import numpy as np

EXPERIMENTS = ("tracing", "cutting")
RULES = ("off", "certified", "paper")
WORKERS = Whole(0, 1000)  # processes of a study


@dataclass(frozen=True)
class Trial(Checked):
    """The complete description of a trial.

    Attributes:
        experiment: tracing or cutting.
        rule: off is plain teleoperation; certified or paper guard the inner surface, and a corridor
            the path.
        number: of the trial, among trials with equal parameters.
        operator: 0: the calibrated one; any other number: a random variation of it.
        mesh: skull, skull-coarse or skull-fine.
        noise: fiducial localisation error [m].
        width: of the corridor to either side [m].
        seed: of everything random.
        rate: ticks per second [Hz].
        length: of the planned cut, None: all of it [m].
        margin: the guard adds the margin map of the registration with this factor; 0: none.

    Raises:
        OptionError: an invalid value.
    """

    experiment: str = option(OneOf("experiment", EXPERIMENTS))
    rule: str = option(OneOf("rule", RULES))
    number: int = option(Whole(0, 10**6), 0)
    operator: int = option(Whole(0, 10**6), 0)
    mesh: str = option(OneOf("skull", choices.SKULLS), "skull", "Which of the built-in skulls.")
    noise: float = option(
        Length(0.0, 5e-3), 0.35e-3, "Fiducial localisation error, root mean square in 3D."
    )  # the default is assumed
    width: float = option(
        Length(1e-4, 2e-2), 1e-3, "Of the corridor, to either side of the planned cut."
    )
    seed: int = option(Whole(*SEEDS), 0, "Of everything random.")
    rate: float = option(
        Number(50.0, 5000.0, "Hz"), 1000.0, "Ticks per second of simulated control."
    )
    length: float | None = option(
        Maybe(Length(1e-3, 30e-3), "all"), None,
        "How much of the planned cut is done, such as 5mm, or all of it.",
    )  # fmt: skip
    margin: float = option(
        Number(0.0, 10.0), 0.0,
        "Factor of the margin map over the target registration error; 0: no margins.",
    )  # fmt: skip

    @property
    def key(self) -> str:
        """A file name that is unique for the trial's parameters."""
        length = "all" if self.length is None else f"{self.length * 1e3:g}mm"
        return (
            f"{self.experiment}-{self.mesh}-{self.rule}-noise{self.noise * 1e6:g}um"
            f"-width{self.width * 1e6:g}um-{length}-{self.rate:g}hz"
            f"-seed{self.seed}-operator{self.operator}-{self.number}"
            + (f"-margin{self.margin:g}" if self.margin else "")
        )

    @property
    def assisted(self) -> bool:
        return self.rule != "off"

    def generator(self, purpose: int) -> np.random.Generator:
        """The random generator for one purpose.

        Tracing is compared in pairs: trials that differ only in the rule have the same generator.
        Cutting trials, each on a new skull, all have different ones; those that differ only in
        the margin have the same, as they are compared in pairs.
        """
        import numpy as np

        apart = RULES.index(self.rule) if self.experiment == "cutting" else 0
        entropy = (
            self.seed, EXPERIMENTS.index(self.experiment), self.operator, self.number, apart,
            purpose,
        )  # fmt: skip
        return np.random.default_rng(np.random.SeedSequence(entropy))

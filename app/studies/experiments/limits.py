"""What a trial and its outcome may be, on the command line and in the files of a study."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from app import choices, limits
from app.limits import SEEDS, Limit, Number, OneOf, Switch, Whole
from app.words import OptionError

EXPERIMENTS = ("tracing", "cutting")
RULES = ("off", "certified", "paper")
COUNTS = (0, 10**9)  # of ticks and of what happens in them
WORKERS = Whole(0, 1000)  # processes of a study
LONGEST = 1e6  # [s] of simulated or computing time

TRIAL: dict[str, Limit] = {
    "experiment": OneOf("experiment", EXPERIMENTS),
    "rule": OneOf("rule", RULES),
    "number": Whole(0, 10**6),
    "operator": Whole(0, 10**6),
    "mesh": OneOf("skull", choices.SKULLS),
    "noise": limits.Length(0.0, 5e-3),
    "width": limits.Length(1e-4, 2e-2),
    "seed": Whole(*SEEDS),
    "rate": Number(50.0, 5000.0, unit="Hz"),
    "length": limits.Length(1e-3, 30e-3, optional=True),
}


class Mapping:
    """A JSON object; what is in it is checked where it is made into something."""

    def check(self, name: str, value: Any) -> None:
        """See `limits.Limit.check`."""
        if not isinstance(value, dict):
            raise OptionError(f"{name} must be an object {{…}}, not {limits.shown(value)}")


class Counts(Mapping):
    """A JSON object of counts by name."""

    def check(self, name: str, value: Any) -> None:
        """See `limits.Limit.check`."""
        super().check(name, value)
        for key, count in value.items():
            Whole(*COUNTS).check(f"{name} {limits.shown(key)}", count)


@dataclass(frozen=True)
class Table:
    """Rows of numbers as JSON has them: `rows` rows, or each of `columns` numbers; null: none."""

    low: float
    high: float
    rows: int | None = None
    columns: int | None = None

    def check(self, name: str, value: Any) -> None:
        """See `limits.Limit.check`."""
        rows: list[list[Any]] = value if isinstance(value, list) else []
        sound = (
            isinstance(value, list)
            and all(isinstance(row, list) for row in rows)
            and self.rows in (None, len(rows))
            and all(self.columns in (None, len(row)) for row in rows)
        )
        if not sound:
            shape = f"{self.rows} row" if self.rows else f"rows of {self.columns} numbers"
            raise OptionError(f"{name} must be a table of {shape}, not {limits.shown(value)}")
        for number in (x for row in rows for x in row if x is not None):
            known = isinstance(number, int | float) and not isinstance(number, bool)
            if not known or not self.low <= number <= self.high:
                raise OptionError(
                    f"{name} has {limits.shown(number)}, which is no number from {self.low:g} "
                    f"to {self.high:g}"
                )


OUTCOME: dict[str, Limit] = {
    "trial": Mapping(),
    "duration": Number(0.0, LONGEST, unit="s"),
    "finished": Switch(),
    "sal": Number(-1e6, 0.0),
    "sparc": Number(-1e6, 0.0),
    "fre": limits.Length(0.0, 1.0),
    "tre": limits.Length(0.0, 1.0),
    "stations": Table(0.0, 1.0, rows=1),
    "deviation": Table(-1.0, 1.0, rows=1),
    "penetration": Table(-1.0, 1.0, rows=1),
    "removed": Number(0.0, 1.0, unit="m³"),
    "crossings": Whole(*COUNTS),
    "outside": Whole(*COUNTS),
    "ticks": Whole(*COUNTS),
    "statuses": Counts(),
    "submovements": Whole(*COUNTS),
    "corrections": Whole(*COUNTS),
    "elapsed": Number(0.0, LONGEST, unit="s"),
    "driving": Number(0.0, LONGEST, unit="s"),
    "trajectory": Table(-LONGEST, LONGEST, columns=4),
}

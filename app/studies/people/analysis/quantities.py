"""What is analysed: the measures of a trial and the workload, with names and units for people."""

from __future__ import annotations

from dataclasses import dataclass

from app.studies.people.sitting import SCALES

WORKLOAD = "workload"  # stands for a task where the ratings of blocks are compared
STRUCTURE = "contacts "  # begins the name of a measure of one structure


@dataclass(frozen=True)
class Quantity:
    """A measure.

    Attributes:
        name: in the data, where it is in SI units.
        label: for people.
        unit: in which it is shown; empty: it has none.
        scale: times a value of the data is that shown.
        column: its heading in the tables, with the unit of the data.
        more: whether more of it is better; None: neither is.
    """

    name: str
    label: str
    unit: str
    scale: float
    column: str
    more: bool | None = False

    @property
    def titled(self) -> str:
        """The label with the unit."""
        return f"{self.label} [{self.unit}]" if self.unit else self.label


MEASURES = (
    Quantity("path_deviation", "path deviation", "mm", 1e3, "path_deviation_m"),
    Quantity("penetration", "penetration", "mm", 1e3, "penetration_m"),
    Quantity("contacts", "contacts", "", 1.0, "contacts"),
    Quantity("time", "time", "s", 1.0, "time_s"),
    Quantity("sal", "smoothness, SAL", "", 1.0, "sal", more=True),
    Quantity("sparc", "smoothness, SPARC", "", 1.0, "sparc", more=True),
    Quantity("force_integral", "force over time", "N s", 1.0, "force_integral_Ns", more=None),
)
TLX = Quantity("tlx", "workload (raw TLX)", "of 100", 1.0, "tlx")
"""The mean of the six ratings: the raw TLX, without weights (Hart 2006)."""

__all__ = ["MEASURES", "SCALES", "STRUCTURE", "TLX", "WORKLOAD", "Quantity"]

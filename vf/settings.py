"""Settings of a controller: what does not change from tick to tick."""

from __future__ import annotations

from dataclasses import dataclass
from math import inf, nan

from vf.qp.solver import check_solver

GUARDS = ("tip", "tool")
# Lowest and highest value and the unit of each of the `Settings` that is a number.
RANGES = {
    "dt": (1e-6, 10.0, " s"),
    "standoff": (1e-9, 1.0, " m"),
    "tip_radius": (0.0, 1.0, " m"),
    "rotation_length": (1e-6, 1e3, " m/rad"),
    "damping": (1e-15, 1e3, " m²"),
    "force_gain": (0.0, 1e6, " N/m"),
    "force_cap": (0.0, 1e6, " N"),
    "tip_speed": (1e-9, inf, " m/s"),
    "trocar": (0.0, 1.0, " m"),
    "approach": (1e-3, 1e6, " /s"),
}


@dataclass(frozen=True)
class Settings:
    """What does not change from tick to tick.

    Attributes:
        dt: period of the control loop [s].
        standoff: distance kept between tool and surface [m].
        tip_radius: of the spherical cutter [m].
        rotation_length: weighs rotation against translation [m/rad].
        damping: λ, weighs joint motion [m²].
        force_gain: haptic stiffness K [N/m].
        force_cap: largest haptic force [N].
        tip_speed: a tick moves the tip by tip_speed × dt at most [m/s]; inf: only the joints' own
            speed limits count.
        solver: one of `vf.SOLVERS`, for what the exact shortcuts do not settle.
        guard: "tip", or "tool": every capsule of the arm's instrument (`arm.capsules`) too, against
            the meshes whose rule is "certified". Other rules and corridors hold the tip only.
        trocar: with guard "tool", the mesh is exempt for the shaft in a ball of this radius around
            the remote centre, where it enters [m]; 0: nowhere. A radius up to the shaft's is none.
        approach: limit η on the speed of approach [1/s]: a point that is d farther away than a
            plane lets it be comes nearer to it by at most η·d·dt in a tick, as with vector-field
            inequalities. None: it may come up to the plane in one tick.

    Raises:
        ValueError: a value that is no number or out of its range, or an unknown solver or guard.
    """

    dt: float = 1e-3
    standoff: float = 20e-6
    tip_radius: float = 0.0
    rotation_length: float = 0.05
    damping: float = 1e-7
    force_gain: float = 150.0
    force_cap: float = 4.0
    tip_speed: float = inf
    solver: str = "osqp"
    guard: str = "tip"
    trocar: float = 0.0
    approach: float | None = None

    def __post_init__(self) -> None:
        check_solver(self.solver)
        if self.guard not in GUARDS:
            raise ValueError(f"unknown guard {self.guard!r}: choose one of {', '.join(GUARDS)}")
        for name, (low, high, unit) in RANGES.items():
            value = getattr(self, name)
            if value is None and name == "approach":
                continue
            try:
                # A float whatever kind of number came: kernels are compiled anew for any other.
                number = float(value)
            except (TypeError, ValueError):
                number = nan
            if not low <= number <= high:
                raise ValueError(
                    f"{name} must be a number from {low:g} to {high:g}{unit}, got {value!r}"
                )
            object.__setattr__(self, name, number)

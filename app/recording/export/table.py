"""Exports a recording as CSV: one line per tick, units in the heading."""

from __future__ import annotations

import csv
from pathlib import Path

import vf
from app.control.messages import STATES
from app.recording.format import JOINTS, MEASURED, Recording, RecordingError
from app.words import format_length

HEADING = (
    "tick", "time [s]", "robot", "mesh", "rule", "motion radius", "paused", "autopilot", "clutch",
    "held", "command", *(f"q{k} [rad or m]" for k in range(1, JOINTS + 1)), "proxy x [m]",
    "proxy y [m]", "proxy z [m]", "tip x [m]", "tip y [m]", "tip z [m]", "force x [N]",
    "force y [N]", "force z [N]", "status", "distance [m]", "planes", "controller [s]",
    "motion [s]", *(f"measured q{k} [rad or m]" for k in range(1, JOINTS + 1)), "state",
)  # fmt: skip


def write(recording: Recording, path: Path) -> None:
    """Write the rows of a recording as CSV; missing values are empty.

    Poses are in the arm's base frame. `command` is the number of the newest command.

    Raises:
        RecordingError: the file exists.
        OSError: it cannot be written.
    """
    if path.exists():
        raise RecordingError(f"{path} exists already: choose another name")
    with path.open("w", newline="", encoding="utf-8") as file:
        out = csv.writer(file)
        out.writerow(HEADING)
        for row in recording.rows:
            order = recording.orders[row["order"]]
            place, options = recording.plants[order["plant"]]
            n = len(recording.places[place].start)
            driven, stepped = bool(row["driven"]), bool(row["stepped"])
            blank = ("", "", "")
            out.writerow(
                (
                    row["tick"],
                    float(row["tick"]) * recording.dt,
                    options.robot,
                    options.mesh,
                    options.rule,
                    format_length(options.radius),
                    order["paused"],
                    order["autopilot"],
                    order["clutch"],
                    order["held"],
                    order["sequence"],
                    *row["q"][:n].tolist(),
                    *[""] * (JOINTS - n),
                    *(row["target"].tolist() if driven else blank),
                    *(row["tip"].tolist() if stepped else blank),
                    *(row["force"].tolist() if stepped else blank),
                    vf.Status(int(row["status"])).name.lower() if stepped else "",
                    row["distance"] if stepped else "",
                    row["planes"] if stepped else "",
                    f"{row['spent']:.9f}" if stepped else "",
                    row["phase"],
                    *(row["measured"][:n].tolist() if row["sensed"] == MEASURED else [""] * n),
                    *[""] * (JOINTS - n),
                    STATES[int(order["state"])],
                )
            )

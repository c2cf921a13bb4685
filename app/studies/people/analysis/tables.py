"""Tidy tables of a study: a line for each trial, rating, participant, and test; CSV and Parquet.

Values are in SI units, which the headings name; participants are named by their codes alone.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from app.studies.people.analysis.contrasts import Contrast
from app.studies.people.analysis.data import Data
from app.studies.people.analysis.quantities import MEASURES, SCALES

Table = tuple[list[str], list[list[Any]]]


def trials(data: Data) -> Table:
    """A row for each finished trial, training included."""
    structures = data.structures
    names = [one.name for one in MEASURES] + structures
    heading = [
        "participant", "trial", "block", "repetition", "task", "condition", "training",
        "completed", "started", "duration_s", "unfinished_before",
        *(one.column for one in MEASURES), *(_column(name) for name in structures),
    ]  # fmt: skip
    rows = [
        [p.code, one.trial, one.block, one.repetition, one.task, one.condition, one.training,
         one.completed, one.started, one.duration, one.unfinished,
         *(one.measures.get(name, math.nan) for name in names)]
        for p in data.people for one in p.trials
    ]  # fmt: skip
    return heading, rows


def workload(data: Data) -> Table:
    """A row for each rating of a block."""
    rows = [
        [p.code, block, condition, *(rated[name] for name in SCALES),
         math.fsum(rated.values()) / len(SCALES)]
        for p in data.people for block, (condition, rated) in sorted(p.tlx.items())
    ]  # fmt: skip
    return ["participant", "block", "condition", *SCALES, "tlx"], rows


def participants(data: Data) -> Table:
    """A row for each participant, with the answers."""
    asked = list(dict.fromkeys(key for p in data.people for key in p.answers))
    heading = ["participant", "number", "order", "stage", "simulated", "started", "trials_done",
               "trials_wanted", *(f"answer_{key}" for key in asked)]  # fmt: skip
    rows = [
        [p.code, p.number, " > ".join(p.order), p.stage, p.simulated, p.started, len(p.measured),
         data.wanted, *(_text(p.answers.get(key)) for key in asked)]
        for p in data.people
    ]  # fmt: skip
    return heading, rows


def comparisons(contrasts: Sequence[Contrast]) -> Table:
    """A row for each comparison; differences are second minus first, in SI units."""
    heading = ["task", "measure", "first", "second", "participants", "first_mean", "second_mean",
               "difference", "difference_low", "difference_high", "t", "degrees", "p", "p_holm",
               "p_wilcoxon", "d_z", "d_z_low", "d_z_high", "note"]  # fmt: skip
    rows: list[list[Any]] = []
    for one in contrasts:
        begin = [one.task, one.quantity.name, one.first, one.second, len(one.codes)]
        c = one.comparison
        if c is None:
            rows.append([*begin, *[math.nan] * 13, one.why])
            continue
        rows.append(
            [*begin, c.off[0], c.assisted[0], c.difference, c.low, c.high, c.t, c.degrees, c.p,
             one.corrected, one.wilcoxon, c.effect, c.effect_low, c.effect_high, ""]
        )  # fmt: skip
    return heading, rows


def write(tables: dict[str, Table], folder: Path) -> list[Path]:
    """Write each table as NAME.csv; what is not a number there is empty."""
    written = []
    for name, (heading, rows) in tables.items():
        path = folder / f"{name}.csv"
        with path.open("w", newline="", encoding="utf-8") as file:
            out = csv.writer(file)
            out.writerow(heading)
            out.writerows([["" if _nothing(x) else x for x in row] for row in rows])
        written.append(path)
    return written


def write_parquet(tables: dict[str, Table], folder: Path) -> list[Path]:
    """Write each table as NAME.parquet; what is not a number is null there.

    Raises:
        ImportError: pyarrow is not installed.
    """
    import pyarrow
    import pyarrow.parquet

    written = []
    for name, (heading, rows) in tables.items():
        columns = {
            key: pyarrow.array([None if _nothing(row[k]) else row[k] for row in rows])
            for k, key in enumerate(heading)
        }
        path = folder / f"{name}.parquet"
        pyarrow.parquet.write_table(pyarrow.table(columns), path)
        written.append(path)
    return written


def _column(name: str) -> str:
    return "_".join(name.split())


def _text(value: Any) -> str:
    """An answer; text that a spreadsheet would take for a formula begins with an apostrophe."""
    text = "" if value is None else str(value)
    return f"'{text}" if text[:1] in ("=", "+", "-", "@", "\t", "\r") else text


def _nothing(value: Any) -> bool:
    return value is None or (isinstance(value, float) and not math.isfinite(value))

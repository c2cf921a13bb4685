"""Folders of user studies with known effects, written without the code that runs a study."""

from __future__ import annotations

import itertools
import json
import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

PROTOCOL = """
format = 1
name = "Known effects"
about = "A study of which the effects are known."
title = "Test"
repetitions = {repetitions}

[consent]
text = "Yes?"

{tasks}
{conditions}
"""
SCALES = ("mental", "physical", "temporal", "performance", "effort", "frustration")
# Mean, and standard deviation of participants, of participants under a condition, of trials.
USUAL = {
    "path_deviation": (6e-4, 1e-4, 4e-5, 8e-5),
    "penetration": (8e-4, 1.5e-4, 5e-5, 1e-4),
    "contacts": (3.0, 0.5, 0.3, 1.0),
    "time": (60.0, 10.0, 4.0, 6.0),
    "sal": (-12.0, 1.0, 0.5, 1.0),
    "sparc": (-8.0, 0.8, 0.4, 0.8),
    "force_integral": (5.0, 1.0, 0.5, 1.0),
}


def make(
    folder: Path,
    participants: int = 12,
    *,
    conditions: Sequence[str] = ("off", "on"),
    tasks: Sequence[str] = ("tracing",),
    repetitions: int = 3,
    effects: Mapping[tuple[str, str], float] | None = None,
    learning: Mapping[str, float] | None = None,
    seed: int = 0,
    simulated: bool = False,
) -> Path:
    """A complete study in a folder.

    Args:
        effects: by condition and measure, or "tlx": what is added to the mean.
        learning: by measure: what is added with every trial of a task.
    """
    rng = np.random.default_rng(seed)
    folder.mkdir(parents=True, exist_ok=True)
    tables = (
        "\n".join(f'[[tasks]]\ntask = "{one}"\n' for one in tasks),
        "\n".join(f'[[conditions]]\nname = "{one}"\nrule = "off"\n' for one in conditions),
    )
    text = PROTOCOL.format(repetitions=repetitions, tasks=tables[0], conditions=tables[1])
    (folder / "protocol.toml").write_text(text, "utf-8")
    orders = list(itertools.permutations(conditions))
    for number in range(participants):
        order = orders[number % len(orders)]
        person(
            folder, f"P{number:02d}", number, order, tasks, repetitions, effects or {},
            learning or {}, rng, simulated,
        )  # fmt: skip
    return folder


def person(
    folder: Path, code: str, number: int, order: Sequence[str], tasks: Sequence[str],
    repetitions: int, effects: Mapping[tuple[str, str], float], learning: Mapping[str, float],
    rng: np.random.Generator, simulated: bool,
) -> None:  # fmt: skip
    """Write the files of one who is complete; a trial of training comes first."""
    path = folder / "participants" / code
    (path / "trials").mkdir(parents=True)
    own = {name: rng.normal(mean, spread) for name, (mean, spread, *_) in USUAL.items()}
    trial, done = 0, dict.fromkeys(tasks, 0)
    plan = [(-1, order[0], tasks[0], 0)]
    plan += [
        (block, condition, task, k)
        for block, condition in enumerate(order) for task in tasks for k in range(repetitions)
    ]  # fmt: skip
    tlx, shift = {}, {}
    for block, condition, task, repetition in plan:
        measures: dict[str, float] = {"contacts dura": float(trial)}
        for name, (_mean, _spread, among, within) in USUAL.items():
            key = (task, condition, name)
            if key not in shift:
                shift[key] = rng.normal(0.0, among)
            value = own[name] + shift[key] + effects.get((condition, name), 0.0)
            value += rng.normal(0.0, within) + learning.get(name, 0.0) * done[task] * (block >= 0)
            measures[name] = float(value)
        content = {
            "trial": trial, "block": block, "repetition": repetition, "task": task,
            "condition": condition, "started": f"2026-01-01T10:{trial % 60:02d}:00+00:00",
            "duration": 60.0, "recording": f"{trial:03d}.vfrec", "seed": trial, "completed": True,
            "training": block < 0, "measures": measures, "unfinished": 0,
        }  # fmt: skip
        (path / f"trials/{trial:03d}.json").write_text(json.dumps(content))
        (path / f"trials/{trial:03d}.vfrec").write_bytes(b"recording")
        trial += 1
        done[task] += block >= 0
        if block >= 0:
            load = rng.normal(50.0, 6.0) + effects.get((condition, "tlx"), 0.0)
            ratings = {name: float(np.clip(rng.normal(load, 8.0), 0, 100)) for name in SCALES}
            tlx.setdefault(str(block), {"condition": condition, **ratings})
    (path / "tlx.json").write_text(json.dumps(tlx))
    sitting = {
        "code": code, "number": number, "started": "2026-01-01T10:00:00+00:00", "stage": "thanks",
        "order": list(order), "next_trial": trial, "answers": {"experience": "none"},
        "consent": "2026-01-01T10:00:00+00:00", "simulated": simulated, "withdrawn": None,
    }  # fmt: skip
    (path / "sitting.json").write_text(json.dumps(sitting))


def change(folder: Path, code: str, trial: int, **changes: object) -> None:
    """Change a trial's file; `measures` replaces these alone, and keeps the others."""
    path = folder / f"participants/{code}/trials/{trial:03d}.json"
    content = json.loads(path.read_text())
    content["measures"] |= changes.pop("measures", {})
    path.write_text(json.dumps(content | changes))


def interrupt(folder: Path, code: str, after: int, stage: str = "trial") -> None:
    """Take away the trials from this number on, and all ratings: this one is not complete."""
    path = folder / f"participants/{code}"
    for file in (path / "trials").iterdir():
        if int(file.stem) >= after:
            file.unlink()
    (path / "tlx.json").unlink()
    sitting = json.loads((path / "sitting.json").read_text())
    (path / "sitting.json").write_text(json.dumps(sitting | {"stage": stage}))


def drop(folder: Path, code: str) -> None:
    shutil.rmtree(folder / f"participants/{code}")

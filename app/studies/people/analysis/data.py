"""The data of a study, from its folder. What cannot be read is named, and the rest is read."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from app.studies.people.analysis.quantities import SCALES, TLX, WORKLOAD
from app.studies.people.folder import SITTING, Study
from app.studies.people.folder import TLX as TLX_FILE


@dataclass(frozen=True)
class Done:
    """A finished trial, as its file has it; measures in SI units, NaN where not defined."""

    trial: int
    block: int
    repetition: int
    task: str
    condition: str
    training: bool
    completed: bool
    started: str
    duration: float
    unfinished: int
    measures: Mapping[str, float]


@dataclass(frozen=True)
class Person:
    """A participant.

    Attributes:
        code: the only name there is.
        number: row of the Latin square.
        order: names of the conditions in the order of the blocks.
        stage: where they are, one of `app.studies.people.sitting.STAGES`.
        simulated: whether it is a model.
        started: ISO time.
        answers: by id of the question.
        trials: the finished ones in order, training included.
        tlx: ratings by block: the condition's name, and each of `SCALES`.
    """

    code: str
    number: int
    order: tuple[str, ...]
    stage: str
    simulated: bool
    started: str
    answers: Mapping[str, Any]
    trials: tuple[Done, ...]
    tlx: Mapping[int, tuple[str, Mapping[str, float]]]

    @property
    def measured(self) -> list[Done]:
        """The trials of the blocks, without training."""
        return [one for one in self.trials if not one.training]

    @property
    def complete(self) -> bool:
        return self.stage == "thanks"


@dataclass(frozen=True)
class Data:
    """A study.

    Attributes:
        title, about: of its protocol.
        conditions, tasks: their names, in the protocol's order.
        repetitions: of each task in a block.
        people: by code.
        problems: what could not be read, one sentence each.
    """

    title: str
    about: str
    conditions: tuple[str, ...]
    tasks: tuple[str, ...]
    repetitions: int
    people: tuple[Person, ...]
    problems: tuple[str, ...] = ()

    @property
    def wanted(self) -> int:
        """Number of trials of a complete participant, without training."""
        return len(self.conditions) * len(self.tasks) * self.repetitions

    @property
    def simulated(self) -> int:
        """Number of participants who are models."""
        return sum(one.simulated for one in self.people)

    def means(self, task: str, quantity: str) -> dict[str, dict[str, float]]:
        """Mean of a measure over the repetitions, by participant and condition.

        Values that are not finite are left out; what has none left has no entry.

        Args:
            task: name of one, or `WORKLOAD`.
        """
        found: dict[str, dict[str, float]] = {}
        for person in self.people:
            values: dict[str, list[float]] = {}
            for condition, value in self._values(person, task, quantity):
                if math.isfinite(value):
                    values.setdefault(condition, []).append(value)
            if values:
                found[person.code] = {c: math.fsum(v) / len(v) for c, v in values.items()}
        return found

    def missing(self, task: str, quantity: str) -> int:
        """How many values are there that are not finite."""
        return sum(
            not math.isfinite(value)
            for person in self.people
            for _condition, value in self._values(person, task, quantity)
        )

    def _values(self, person: Person, task: str, quantity: str) -> list[tuple[str, float]]:
        if task == WORKLOAD:
            rated = person.tlx.values()
            if quantity == TLX.name:
                return [(c, math.fsum(one.values()) / len(SCALES)) for c, one in rated]
            return [(c, one[quantity]) for c, one in rated]
        return [
            (one.condition, one.measures.get(quantity, math.nan))
            for one in person.measured
            if one.task == task
        ]

    @property
    def structures(self) -> list[str]:
        """Names of the measures of single structures."""
        names = {
            name: None for p in self.people for one in p.trials for name in one.measures
            if name.startswith("contacts ")
        }  # fmt: skip
        return list(names)


def read(folder: Path) -> Data:
    """The data in the folder of a study.

    Raises:
        app.studies.people.protocol.ProtocolError: it is none, or its protocol is invalid.
    """
    study = Study.open(folder)
    protocol = study.protocol
    problems: list[str] = []
    people = []
    where = folder / "participants"
    for path in sorted(where.iterdir()) if where.is_dir() else []:
        if not path.is_dir() or path.name.startswith("."):
            continue
        if not (path / SITTING).is_file():
            problems.append(f"{path.name} has no {SITTING}: left out.")
            continue
        try:
            people.append(_person(path, problems))
        except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
            problems.append(f"{path.name} cannot be read and is left out: {_why(error)}.")
    data = Data(
        protocol.name, protocol.about, tuple(one.name for one in protocol.conditions),
        tuple(one.task for one in protocol.tasks), protocol.repetitions, tuple(people),
        tuple(problems),
    )  # fmt: skip
    return data


def _person(path: Path, problems: list[str]) -> Person:
    sitting = _content(path / SITTING)
    trials = []
    for file in sorted((path / "trials").glob("*.json")):
        try:
            trials.append(_trial(_content(file)))
        except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
            problems.append(
                f"{path.name}, {file.name} cannot be read and is left out: {_why(error)}."
            )
    tlx: dict[int, tuple[str, dict[str, float]]] = {}
    if (path / TLX_FILE).is_file():
        try:
            for block, one in _content(path / TLX_FILE).items():
                ratings = {name: _number(one[name]) for name in SCALES}
                tlx[int(block)] = (str(one["condition"]), ratings)
        except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
            problems.append(f"{path.name}, {TLX_FILE} cannot be read: {_why(error)}.")
    return Person(
        code=path.name,
        number=int(sitting["number"]),
        order=tuple(map(str, sitting["order"])),
        stage=str(sitting["stage"]),
        simulated=bool(sitting["simulated"]),
        started=str(sitting["started"]),
        answers=dict(sitting["answers"]),
        trials=tuple(sorted(trials, key=lambda one: one.trial)),
        tlx=tlx,
    )


def _trial(content: Mapping[str, Any]) -> Done:
    return Done(
        trial=int(content["trial"]),
        block=int(content["block"]),
        repetition=int(content["repetition"]),
        task=str(content["task"]),
        condition=str(content["condition"]),
        training=bool(content["training"]),
        completed=bool(content["completed"]),
        started=str(content["started"]),
        duration=_number(content["duration"]),
        unfinished=int(content.get("unfinished", 0)),
        measures={str(name): _number(one) for name, one in content["measures"].items()},
    )


def _number(value: Any) -> float:
    """A number of JSON; null stands for one that is not finite."""
    if value is None:
        return math.nan
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ValueError(f"{value!r} is not a number")
    return float(value)


def _content(path: Path) -> dict[str, Any]:
    content = json.loads(path.read_text("utf-8"))
    if not isinstance(content, dict):
        raise ValueError("it is no JSON object")
    return content


def _why(error: Exception) -> str:
    if isinstance(error, KeyError):
        return f"it has no {error}"
    return " ".join(str(error).split()) or type(error).__name__

"""The protocol of a user study: what participants are asked, do, and under which conditions.

Cheap to import: the command line checks protocols before the libraries are loaded.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from app import choices
from app.kinds import (
    SEEDS,
    Kind,
    Length,
    Maybe,
    Number,
    OneOf,
    Repeated,
    Switch,
    Text,
    Time,
    Whole,
    shown,
)
from app.options import Checked, Record, like, option
from app.settings import Options
from app.words import OptionError

TASKS = ("tracing", "targeting", "cutting")
RULES = tuple(rule for rule in choices.RULES if rule != "off")
QUESTIONS = ("choice", "number", "text", "scale")
BOUNDED = ("path_deviation", "penetration", "time", "contacts", "force_integral")
"""Measures that a criterion of training may bound from above."""
LENGTHS = ("path_deviation", "penetration")
LINE, PARAGRAPH = Text(300), 8000


class ProtocolError(OptionError):
    """An invalid protocol. The message is one line with the key, the value and what is valid."""


class Paragraphs(Kind):
    """Text of several lines, paragraphs apart by an empty line."""

    def check(self, name: str, value: Any) -> None:
        sound = isinstance(value, str) and all(c.isprintable() or c in "\n\t" for c in value)
        if not sound or not 0 < len(value.strip()) <= PARAGRAPH:
            raise OptionError(
                f"{name} must be a text of 1 to {PARAGRAPH} printable characters, "
                f"not {shown(value)}"
            )


class Name(Text):
    """A short name of letters, digits, spaces, - and _."""

    def check(self, name: str, value: Any) -> None:
        super().check(name, value)
        if not all(c.isalnum() or c in " -_" for c in value) or value != value.strip():
            raise OptionError(
                f"{name} must be of letters, digits, spaces, - and _, not {shown(value)}"
            )


class Bounds(Kind):
    """Largest values of measures by name, in SI units; in a file lengths have a unit."""

    wanted, json = "a table such as { path_deviation = '1mm', time = 60 }", (dict,)

    def check(self, name: str, value: Any) -> None:
        if not isinstance(value, dict) or not value:
            raise OptionError(f"{name} must be {self.wanted}, not {shown(value)}")
        for key, bound in value.items():
            OneOf("measure", BOUNDED).check(name, key)
            Number(0.0, 1e6).check(f"{name} {key}", bound)

    def from_json(self, value: Any) -> dict[str, float]:
        found = super().from_json(value)
        for key in found:
            OneOf("measure", BOUNDED).check("until", key)
        length = Length(0.0, 1.0)
        return {
            key: length.from_json(bound) if key in LENGTHS else Number(0.0, 1e6).from_json(bound)
            for key, bound in found.items()
        }


@dataclass(frozen=True)
class Consent(Checked):
    """What participants agree to before anything else.

    Attributes:
        text: what they read.
        agree: the sentence they tick.
    """

    text: str = option(Paragraphs())
    agree: str = option(LINE, "I have read this, and I take part of my own free will.")


@dataclass(frozen=True)
class Question(Checked):
    """A question before the training.

    Attributes:
        id: key of the answer.
        text: the question.
        kind: how it is answered: choice, number, text or scale (low to high in whole steps).
        choices: of a choice.
        low, high: of a number or a scale.
        ends: words at the two ends of a scale.
        required: whether it must be answered.

    Raises:
        OptionError: also for a choice without choices, or low not below high.
    """

    id: str = option(Name(40))
    text: str = option(LINE)
    kind: str = option(OneOf("kind", QUESTIONS), "text")
    choices: tuple[str, ...] = option(Repeated(Text(100)), ())
    low: float = option(Number(-1e6, 1e6), 0.0)
    high: float = option(Number(-1e6, 1e6), 10.0)
    ends: tuple[str, ...] = option(Repeated(Text(60)), ())
    required: bool = option(Switch(), False)

    def __post_init__(self) -> None:
        super().__post_init__()
        if (self.kind == "choice") != bool(self.choices):
            raise OptionError(f"question {self.id}: the kind choice needs choices, and no other")
        if not self.low < self.high:
            raise OptionError(f"question {self.id}: low {self.low:g} is not below {self.high:g}")
        if self.ends and (self.kind != "scale" or len(self.ends) != 2):
            raise OptionError(f"question {self.id}: ends are two texts, of a scale")

    def checked(self, value: Any) -> Any:
        """An answer as it is kept, from the text of a form; None: not answered.

        Raises:
            OptionError: missing, or not valid; the message is for the participant.
        """
        text = str(value).strip() if value is not None else ""
        if not text:
            if self.required:
                raise OptionError(f"“{self.text}” needs an answer.")
            return None
        if self.kind == "choice":
            if text not in self.choices:
                raise OptionError(f"“{self.text}”: choose one of {', '.join(self.choices)}.")
            return text
        if self.kind == "text":
            if len(text) > 1000 or not all(c.isprintable() or c in "\r\n\t" for c in text):
                raise OptionError(f"“{self.text}”: at most 1000 printable characters.")
            return text
        try:
            number = float(text)
        except ValueError:
            raise OptionError(f"“{self.text}”: “{text[:40]}” is not a number.") from None
        if not self.low <= number <= self.high:
            raise OptionError(f"“{self.text}”: a number from {self.low:g} to {self.high:g}.")
        return number


@dataclass(frozen=True)
class Task(Checked):
    """A task of every block.

    Attributes:
        task: tracing, targeting or cutting.
        length: of the path that is traced or cut [m].
        targets: how many are touched, in targeting.
        limit: a trial ends, not completed, after this time [s].
        instruction: one sentence for the participant; None: the task's own.
    """

    task: str = option(OneOf("task", TASKS))
    length: float = option(Length(1e-3, 30e-3), 15e-3)
    targets: int = option(Whole(1, 20), 4)
    limit: float = option(Number(1.0, 1800.0, "s"), 120.0)
    instruction: str | None = option(Maybe(LINE), None)


@dataclass(frozen=True)
class Condition(Checked):
    """A condition, which is compared with the others within each participant.

    Attributes:
        name: in the data; participants see it where the protocol is not blinded.
        rule: off: no fixture.
        delay: from the hand to the tool [s].
        sound: whether contact is heard.
        margin: that the fixture keeps from what it guards [m].
        corridor: half width of the corridor about the path, in tracing and cutting [m]; None: none.
        scale, radius, force_gain, tip_speed: as the options of a session.
    """

    name: str = option(Name(60))
    rule: str = like(Options, "rule")
    delay: float = option(Time(0.0, 2.0), 0.0)
    sound: bool = option(Switch(), False)
    margin: float = option(Length(0.0, 5e-3), 0.0)
    corridor: float | None = like(Options, "corridor")
    scale: float = like(Options, "scale")
    radius: float | None = like(Options, "radius")
    force_gain: float = like(Options, "force_gain")
    tip_speed: float = like(Options, "tip_speed")


@dataclass(frozen=True)
class Training(Checked):
    """Trials before the blocks, until the criterion is met.

    Attributes:
        task: which of the protocol's tasks.
        condition: name of one of its conditions.
        until: largest values of measures, all of which a trial that counts keeps; it is completed.
        in_a_row: how many such trials there must be, one after the other.
        most: after this many the training ends in any case.
    """

    task: str = option(OneOf("task", TASKS))
    condition: str = option(Name(60))
    until: dict[str, float] = option(Bounds())
    in_a_row: int = option(Whole(1, 20), 1)
    most: int = option(Whole(1, 100), 8)


@dataclass(frozen=True)
class Protocol(Checked):
    """A study, see `app.studies.people.reading` for its file.

    Attributes:
        name, about: for who runs it.
        title: for participants.
        blinded: participants see A, B, … instead of the names of conditions.
        seed: of the places of targets, and of simulated participants.
        repetitions: of each task in a block.
        rest: least time between two blocks [s].
        robot: carries the tool.
        codes: who may take part; empty: any code.

    Raises:
        OptionError: an invalid value; names that are there twice, or not at all.
    """

    name: str = option(Text(100))
    about: str = option(Paragraphs())
    title: str = option(Text(100))
    consent: Consent = option(Record(Consent, "a consent"))
    tasks: tuple[Task, ...] = option(Repeated(Record(Task, "a task")))
    conditions: tuple[Condition, ...] = option(Repeated(Record(Condition, "a condition")))
    questions: tuple[Question, ...] = option(Repeated(Record(Question, "a question")), ())
    training: tuple[Training, ...] = option(Repeated(Record(Training, "a training")), ())
    blinded: bool = option(Switch(), True)
    seed: int = option(Whole(*SEEDS), 0)
    repetitions: int = option(Whole(1, 100), 3)
    rest: float = option(Number(0.0, 3600.0, "s"), 30.0)
    robot: str = like(Options, "robot")
    codes: tuple[str, ...] = option(Repeated(Name(24)), ())

    def __post_init__(self) -> None:
        super().__post_init__()
        _different("tasks", [one.task for one in self.tasks])
        _different("conditions", [one.name for one in self.conditions])
        _different("questions", [one.id for one in self.questions], least=0)
        for one in self.training:
            OneOf("task of a training", tuple(t.task for t in self.tasks)).check("task", one.task)
            names = tuple(c.name for c in self.conditions)
            OneOf("condition of a training", names).check("condition", one.condition)
        if len(self.conditions) > 26:
            raise OptionError(f"{len(self.conditions)} conditions are more than 26")

    def task(self, name: str) -> Task:
        """The task of this name."""
        return next(one for one in self.tasks if one.task == name)

    def condition(self, name: str) -> Condition:
        """The condition of this name."""
        return next(one for one in self.conditions if one.name == name)


def _different(what: str, names: list[str], least: int = 1) -> None:
    if len(names) < least:
        raise OptionError(f"a protocol needs {least} or more {what}")
    for name in names:
        if names.count(name) > 1:
            raise OptionError(f"{what}: {shown(name)} is there twice")

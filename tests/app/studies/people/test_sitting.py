"""A participant's way through a study, with processes killed at any moment."""

from __future__ import annotations

import os
import shutil
import tempfile
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule

from app.studies.people.folder import Study
from app.studies.people.sitting import SCALES, Sitting
from app.words import Refused

PROTOCOL = """
format = 1
name = "Tiny"
about = "For tests."
title = "A test"
repetitions = 2
rest = 10
[consent]
text = "Yes?"
[[questions]]
id = "age"
text = "How old?"
kind = "number"
low = 18
high = 99
required = true
[[tasks]]
task = "targeting"
[[conditions]]
name = "a"
[[conditions]]
name = "b"
rule = "off"
[[training]]
task = "targeting"
condition = "a"
until = { time = 5 }
in_a_row = 2
most = 3
"""
RATINGS = dict.fromkeys(SCALES, 50)


class Killed(BaseException):
    """The process ends here."""


class Clock:
    def __init__(self) -> None:
        self.now = datetime(2026, 1, 1, tzinfo=UTC)

    def __call__(self) -> datetime:
        return self.now


@pytest.fixture
def study(tmp_path: Path) -> Study:
    (tmp_path / "tiny.toml").write_text(PROTOCOL)
    return Study.make(tmp_path / "study", str(tmp_path / "tiny.toml"))


def finish(sitting: Sitting, time: float = 1.0) -> None:
    sitting.finish(
        sitting.next_trial, started=datetime(2026, 1, 1, tzinfo=UTC), duration=time,
        completed=True, measures={"time": time},
    )  # fmt: skip


class Machine(RuleBasedStateMachine):
    """Takes the steps of a study; any of them may be killed at any of its writes.

    What is expected is told by the steps that came back, and for the one that was killed either
    what was before it or what is after it.
    """

    def __init__(self) -> None:
        super().__init__()
        self.folder = Path(tempfile.mkdtemp())
        (self.folder / "tiny.toml").write_text(PROTOCOL)
        self.clock = Clock()
        self.patch = pytest.MonkeyPatch()
        self.left = -1  # writes until the kill; −1: none
        for name in ("replace", "fsync"):
            self.patch.setattr(os, name, self.counted(name, getattr(os, name)))

    def counted(self, name: str, real: Any) -> Any:
        def write(*arguments: Any) -> None:
            if self.left == 0:
                raise Killed
            self.left -= 1
            if name != "fsync":
                real(*arguments)

        return write

    def teardown(self) -> None:
        self.patch.undo()
        shutil.rmtree(self.folder)

    @initialize()
    def begin(self) -> None:
        self.study = Study.make(self.folder / "study", str(self.folder / "tiny.toml"))
        self.sitting = Sitting.enter(self.study, "p1", self.clock)
        self.trained: list[bool] = []  # whether each trial of the training passed
        self.trials = self.rated = self.rested = 0
        self.consented = self.answered = False

    def due(self) -> str:
        """The stage that follows from what is known to be done, by another way of thinking."""
        if not self.consented:
            return "consent"
        if not self.answered:
            return "questions"
        passed_twice = any(a and b for a, b in zip(self.trained, self.trained[1:], strict=False))
        if not passed_twice and len(self.trained) < 3:
            return "training"
        if self.trials == 2 * (self.rested + 1):
            if self.rated == self.rested:
                return "tlx"
            return "thanks" if self.trials == 4 else "rest"
        return "trial"

    @rule(left=st.sampled_from([-1, -1, -1, *range(12)]), quick=st.booleans(), again=st.booleans())
    def step(self, left: int, quick: bool, again: bool) -> None:
        stage = self.sitting.look()
        self.left = left
        try:
            self.take(stage, quick)
        except Killed:
            self.left = -1
            sitting = Sitting.enter(self.study, "P1", self.clock)  # in a new process
            if self.is_done(stage, sitting):
                self.note(stage, quick)
        else:
            self.left = -1
            self.note(stage, quick)
            sitting = Sitting.enter(self.study, "P1", self.clock) if again else self.sitting
        self.sitting = sitting

    def take(self, stage: str, quick: bool) -> None:
        sitting = self.sitting
        if stage == "consent":
            sitting.consent(True)
        elif stage == "questions":
            sitting.answer({"age": "30"})
        elif stage in ("training", "trial"):
            finish(sitting, 1.0 if quick else 9.0)
        elif stage == "tlx":
            sitting.rate(RATINGS)
        elif stage == "rest":
            self.clock.now += timedelta(seconds=11)
            sitting.rested()

    def is_done(self, stage: str, sitting: Sitting) -> bool:
        """Whether the step that was killed is in the folder."""
        known = len(self.trained) + self.trials
        if stage in ("training", "trial"):
            assert len(sitting.done) in (known, known + 1)
            return len(sitting.done) > known
        return sitting.stage != stage

    def note(self, stage: str, quick: bool) -> None:
        if stage == "consent":
            self.consented = True
        elif stage == "questions":
            self.answered = True
        elif stage == "training":
            self.trained.append(quick)
        elif stage == "trial":
            self.trials += 1
        elif stage == "tlx":
            self.rated += 1
        elif stage == "rest":
            self.rested += 1

    @precondition(lambda self: self.sitting.stage != "trial")
    @rule()
    def out_of_turn(self) -> None:
        """What is not due is refused and changes nothing."""
        before = {path: path.read_bytes() for path in self.folder.rglob("*.json")}
        wrong = {
            "consent": lambda: self.sitting.answer({"age": "30"}),
            "questions": lambda: self.sitting.consent(True),
            "training": self.sitting.rested,
        }
        with pytest.raises(Refused):
            wrong.get(self.sitting.stage, lambda: finish(self.sitting))()
        assert before == {path: path.read_bytes() for path in self.folder.rglob("*.json")}

    @invariant()
    def nothing_is_lost(self) -> None:
        assert self.sitting.look() == self.due()
        numbers = [one["trial"] for one in self.sitting.done]
        assert numbers == list(range(len(self.trained) + self.trials))
        assert [one["measures"]["time"] < 5 for one in self.sitting.done][: len(self.trained)] == (
            self.trained
        )
        blocks = [one["block"] for one in self.sitting.done if not one["training"]]
        assert blocks == [0, 0, 1, 1][: self.trials]
        conditions = [one["condition"] for one in self.sitting.done if not one["training"]]
        assert conditions == ["a", "a", "b", "b"][: self.trials]


Machine.TestCase.settings = settings(
    max_examples=10, stateful_step_count=30, deadline=None,
    suppress_health_check=list(HealthCheck),
)  # fmt: skip
test_no_kill_loses_a_step = Machine.TestCase


def test_the_order_is_the_row_of_the_participant_s_number(study: Study) -> None:
    sittings = [Sitting.enter(study, f"P{k}") for k in range(3)]
    assert [one.number for one in sittings] == [0, 1, 2]
    assert [one.order for one in sittings] == [["a", "b"], ["b", "a"], ["a", "b"]]
    study.delete("P1")
    assert Sitting.enter(study, "P9").number == 1, "the number of the deleted one is used again"
    assert Sitting.enter(study, " p0 ").number == 0


def test_who_does_not_consent_leaves_nothing(study: Study) -> None:
    sitting = Sitting.enter(study, "P1")
    sitting.consent(False)
    assert not (study.path / "participants" / "P1").exists()
    with pytest.raises(Refused, match="no participant"):
        sitting.answer({})


def test_stopping_keeps_what_was_done_and_ends_it(study: Study) -> None:
    sitting = Sitting.enter(study, "P1")
    sitting.consent(True)
    sitting.answer({"age": 40})
    finish(sitting)
    sitting.withdraw()
    assert Sitting.enter(study, "P1").stage == "withdrawn"
    assert len(sitting.done) == 1
    with pytest.raises(Refused, match="withdrawn"):
        finish(sitting)


@pytest.mark.parametrize("age", ["", "seventeen", "17", "nan", None])
def test_answers_are_checked(study: Study, age: str | None) -> None:
    sitting = Sitting.enter(study, "P1")
    sitting.consent(True)
    with pytest.raises(Refused, match="How old"):
        sitting.answer({"age": age})
    assert sitting.look() == "questions"


def test_a_rest_takes_its_time(study: Study) -> None:
    clock = Clock()
    sitting = Sitting.enter(study, "P1", clock)
    sitting.consent(True)
    sitting.answer({"age": "20"})
    for _ in range(4):
        finish(sitting)
    for wrong in ({}, RATINGS | {"effort": 101}, RATINGS | {"effort": "nan"}):
        with pytest.raises(Refused, match=r"0 to 100|needed"):
            sitting.rate(wrong)
    sitting.rate(RATINGS)
    clock.now += timedelta(seconds=7)
    with pytest.raises(Refused, match="another 3 s"):
        sitting.rested()
    clock.now -= timedelta(hours=1)  # a clock that is set back costs no more than the rest
    assert Sitting(study, "P1", clock).rest_left == 10.0
    clock.now += timedelta(hours=2)
    sitting.rested()
    assert sitting.stage == "trial"
    assert sitting.trial is not None
    assert sitting.trial.block == 1


def test_what_an_unfinished_trial_left_is_kept_beside_it(
    study: Study,
) -> None:
    sitting = Sitting.enter(study, "P1")
    sitting.consent(True)
    sitting.answer({"age": "20"})
    for _ in range(3):
        sitting.files.recording(0).write_text("begun, and killed")
    finish(sitting)
    assert sitting.done[0]["unfinished"] == 2
    left = sorted(path.name for path in sitting.files.path.glob("trials/*.vfrec"))
    assert left == ["000-unfinished-1.vfrec", "000-unfinished-2.vfrec", "000.vfrec"]

"""Where a participant is in a study, without any view.

Everything is in the participant's folder, and is read from there at every step, so that it does not
matter which process takes the next step, or whether the last one was killed. What stage comes next
follows from what is there: answers, finished trials, ratings of workload.
"""

from __future__ import annotations

import contextlib
import fcntl
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from datetime import UTC, datetime, timedelta
from typing import Any

from app.studies.people import plan
from app.studies.people.folder import Participant, Study, checked_code
from app.studies.people.plan import TRAINING, Planned
from app.studies.people.protocol import Training
from app.words import OptionError, Refused

STAGES = ("consent", "questions", "training", "trial", "tlx", "rest", "thanks", "withdrawn")
OVER = ("thanks", "withdrawn")
SCALES = ("mental", "physical", "temporal", "performance", "effort", "frustration")
"""Of the NASA-TLX, 0 to 100 each; of performance 0 is perfect."""

Clock = Callable[[], datetime]
_NUMBERED = re.compile(r"[1-9]\d*")


def utc() -> datetime:
    """Now."""
    return datetime.now(UTC)


class Sitting:
    """A participant's way through a study. Several processes may have one of the same participant.

    Attributes:
        study: the study.
        code: of the participant.
        files: the participant's folder.
        stage: one of `STAGES`, as of the last step or `look`.
        number: of the participant, which sets the order of the conditions.
        order: names of the conditions in this order.
        done: the finished trials, as in their files.
    """

    def __init__(self, study: Study, code: str, clock: Clock = utc) -> None:
        """Go on with a participant who has begun, see `enter`.

        Raises:
            OptionError: there is none of this code, or a file cannot be read.
        """
        self.study = study
        self.code = checked_code(code)
        self.files: Participant = study.participant(self.code)
        self._clock = clock
        self.look()

    @classmethod
    def enter(cls, study: Study, code: str, clock: Clock = utc, simulated: bool = False) -> Sitting:
        """Begin, or go on where this participant was.

        A new participant gets the lowest number that is free, so that the orders of the conditions
        stay balanced when one is deleted.

        Raises:
            Refused: not a code of this study.
        """
        code = checked_code(code, study.protocol)
        files = study.participant(code)
        with study.entering():
            if not files.begun:
                taken = {study.participant(one).sitting()["number"] for one in study.codes}
                number = min(set(range(len(taken) + 1)) - taken)
                files.keep_sitting(
                    {
                        "code": code,
                        "number": number,
                        "started": clock().isoformat(timespec="seconds"),
                        "stage": "consent",
                        "order": plan.order(study.protocol, number),
                        "next_trial": 0,
                        "answers": {},
                        "consent": None,
                        "simulated": simulated,
                        "answered": False,
                        "rested": 0,
                        "rest_from": None,
                        "withdrawn": None,
                    }
                )
        return cls(study, code, clock)

    def look(self) -> str:
        """Read the folder again; returns the stage."""
        self._content = self.files.sitting()
        self.done = self.files.finished()
        self._tlx = self.files.tlx()
        self.number = int(self._content["number"])
        self.order = list(self._content["order"])
        self._blocks = plan.trials(self.study.protocol, self.number, self.order)
        self.stage = self._stage()
        return self.stage

    # What is shown of it

    @property
    def simulated(self) -> bool:
        return bool(self._content["simulated"])

    @property
    def next_trial(self) -> int:
        """Number of the next trial, training included."""
        return len(self.done)

    @property
    def trial(self) -> Planned | None:
        """What is to be done next; None: no trial is."""
        if self.stage == "training":
            number, training, before = self._training_now()
            seed = plan.seed_of(
                self.study.protocol, self.number, TRAINING - number, training.task, before
            )
            return Planned(TRAINING, self._trained, training.task, training.condition, seed)
        if self.stage == "trial":
            return self._blocks[len(self.done) - self._trained]
        return None

    @property
    def block(self) -> int:
        """The block that is done, rated or rested after."""
        done = len(self.done) - self._trained
        per_block = len(self._blocks) // len(self.order)
        between = self.stage in ("tlx", "rest", "thanks")
        return max(done // per_block - between, 0)

    @property
    def progress(self) -> float:
        """Share of the trials of the blocks that is done."""
        return (len(self.done) - self._trained) / len(self._blocks)

    @property
    def of_block(self) -> tuple[int, int]:
        """Number of trials done in this block, and of all its trials."""
        per_block = len(self._blocks) // len(self.order)
        return (len(self.done) - self._trained) % per_block, per_block

    @property
    def training(self) -> tuple[Training, int] | None:
        """The training that goes on and how many of its trials are done; None: there is none."""
        if self.stage != "training":
            return None
        _, training, before = self._training_now()
        return training, before

    @property
    def rest_left(self) -> float:
        """How long the rest still takes at least [s]."""
        since = self._content["rest_from"]
        if self.stage != "rest" or since is None:
            return 0.0
        rest = self.study.protocol.rest
        gone = (self._clock() - datetime.fromisoformat(since)) / timedelta(seconds=1)
        return min(max(rest - gone, 0.0), rest)

    # Steps; each is on disk when it returns

    def consent(self, agreed: bool) -> None:
        """Agree to take part. Who does not agree leaves nothing behind.

        Raises:
            Refused: not the time for it.
        """
        with self._step("consent"):
            if agreed:
                self._keep(consent=self._now())
        if not agreed:
            self.study.delete(self.code)
            self.stage = "withdrawn"

    def answer(self, answers: Mapping[str, Any]) -> None:
        """Answer the questions, by id.

        Raises:
            Refused: not the time for it, or an answer is missing or not valid.
        """
        with self._step("questions"):
            found = {}
            for question in self.study.protocol.questions:
                try:
                    value = question.checked(answers.get(question.id))
                except OptionError as error:
                    raise Refused(str(error)) from None
                if value is not None:
                    found[question.id] = value
            self._keep(answers=found, answered=True)

    def finish(
        self,
        number: int,
        *,
        started: datetime,
        duration: float,
        completed: bool,
        measures: Mapping[str, float],
    ) -> None:
        """Keep a finished trial. Its recording is complete by now.

        Args:
            number: `next_trial` when it began.
            duration: [s].
            completed: whether its goal was reached.

        Raises:
            Refused: another trial is next.
        """
        with self._step("training", "trial"):
            planned = self.trial
            if planned is None or number != self.next_trial:
                raise Refused(f"trial {number} is not the one that is next")
            self.files.keep_trial(
                number,
                {
                    "trial": number,
                    "block": planned.block,
                    "repetition": planned.repetition,
                    "task": planned.task,
                    "condition": planned.condition,
                    "training": planned.training,
                    "started": started.isoformat(timespec="milliseconds"),
                    "duration": duration,
                    "recording": f"{number:03d}.vfrec",
                    "seed": planned.seed,
                    "completed": completed,
                    "measures": dict(measures),
                    "unfinished": self.files.unfinished(number),
                },
            )
            self.look()
            self._keep()

    def rate(self, ratings: Mapping[str, Any]) -> None:
        """Rate the workload of the block, `SCALES`, 0 to 100 each.

        Raises:
            Refused: not the time for it, or a scale is missing or out of range.
        """
        with self._step("tlx"):
            found: dict[str, Any] = {"condition": self.order[self.block]}
            for name in SCALES:
                try:
                    value = float(ratings[name])
                except (KeyError, TypeError, ValueError):
                    raise Refused(f"{name}: a number from 0 to 100 is needed") from None
                if not 0.0 <= value <= 100.0:
                    raise Refused(f"{name}: {value:g} is not from 0 to 100")
                found[name] = value
            # First, as a process that is killed between the two does not come back here.
            self._keep(rest_from=self._now())
            self.files.keep_tlx(self._tlx | {str(self.block): found})
            self.look()
            self._keep()

    def rested(self) -> None:
        """Go on after the rest.

        Raises:
            Refused: not the time for it, or too early.
        """
        with self._step("rest"):
            left = self.rest_left
            if left > 0.0:
                raise Refused(f"Rest for another {left:.0f} s")
            self._keep(rested=self.block + 1, rest_from=None)

    def withdraw(self) -> None:
        """Take part no longer. What was done is kept until it is deleted by the code.

        Raises:
            Refused: it is over already.
        """
        with self._step(*(stage for stage in STAGES if stage not in OVER)):
            self._keep(withdrawn=self._now())

    # Internal

    @contextlib.contextmanager
    def _step(self, *stages: str) -> Iterator[None]:
        """Alone, from the present state of the folder, which must be in one of the stages."""
        try:
            lock = (self.files.path / ".lock").open("w")
        except FileNotFoundError:
            raise Refused(f"There is no participant {self.code} any more") from None
        with lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            if self.look() not in stages:
                raise Refused(f"This is not the time for it: the next is {self.stage}")
            yield

    def _keep(self, **changes: Any) -> None:
        content = self._content | changes
        self._content = content
        self.stage = self._stage()
        content |= {"stage": self.stage, "next_trial": self.next_trial}
        self.files.keep_sitting(content)

    def _now(self) -> str:
        return self._clock().isoformat(timespec="seconds")

    @property
    def _trained(self) -> int:
        """Number of trials done in training."""
        return sum(bool(one["training"]) for one in self.done)

    def _stage(self) -> str:
        content, protocol = self._content, self.study.protocol
        if content["withdrawn"] is not None:
            return "withdrawn"
        if content["consent"] is None:
            return "consent"
        if protocol.questions and not content["answered"]:
            return "questions"
        done = len(self.done) - self._trained
        if not done and self._training_left() is not None:
            return "training"
        per_block = len(self._blocks) // len(self.order)
        if not done or done % per_block:
            return "trial"
        block = done // per_block - 1
        if str(block) not in self._tlx:
            return "tlx"
        if done == len(self._blocks):
            return "thanks"
        return "trial" if content["rested"] > block else "rest"

    def _training_left(self) -> tuple[int, Training, int] | None:
        """Number of the training that goes on, it, and how many of its trials are done."""
        left: Sequence[Mapping[str, Any]] = [one for one in self.done if one["training"]]
        for number, training in enumerate(self.study.protocol.training):
            used = _used(training, left)
            if used is None:
                return number, training, len(left)
            left = left[used:]
        return None

    def _training_now(self) -> tuple[int, Training, int]:
        found = self._training_left()
        assert found is not None
        return found


def _used(training: Training, trials: Sequence[Mapping[str, Any]]) -> int | None:
    """How many of the trials this training took; None: it goes on."""
    row = 0
    for k, one in enumerate(trials[: training.most], start=1):
        row = row + 1 if passed(training, one) else 0
        if row >= training.in_a_row or k == training.most:
            return k
    return None


def passed(training: Training, trial: Mapping[str, Any]) -> bool:
    """Whether a trial, as in its file, keeps the criterion of its training."""
    measures = trial["measures"]
    return bool(trial["completed"]) and all(
        measures.get(name) is not None and measures[name] <= bound
        for name, bound in training.until.items()
    )

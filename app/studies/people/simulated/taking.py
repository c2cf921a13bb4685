"""Simulated operators take a study, with the sitting and the session that people have."""

from __future__ import annotations

import functools
import multiprocessing
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np

from app.console import console as new_console
from app.console import count
from app.console import progress as new_progress
from app.scene import scene as scenes
from app.studies.experiments.operators import Operator
from app.studies.people import tasks
from app.studies.people.folder import Study
from app.studies.people.hand import Hand
from app.studies.people.measures import measure
from app.studies.people.plan import Planned
from app.studies.people.progress import Progress
from app.studies.people.protocol import Protocol, ProtocolError, Question
from app.studies.people.simulated import operators
from app.studies.people.simulated.stepped import Follower, SteppedSession, TrialOver
from app.studies.people.sitting import OVER, SCALES, Sitting
from app.words import OptionError

RATE = 100.0  # ticks per second of simulated control [Hz]
FIRST = datetime(2026, 1, 1, 9, tzinfo=UTC)  # when the first participant comes, in simulated time


def effects_of(protocol: Protocol, words: Sequence[str]) -> dict[str, float]:
    """Factors of the operators' errors by condition, from words such as ``fixture=0.5``.

    Raises:
        OptionError: not such a word, or no such condition.
    """
    names = [one.name for one in protocol.conditions]
    found = {}
    for word in words:
        name, equals, text = word.rpartition("=")
        if name not in names:
            raise OptionError(
                f"effect: unknown condition '{name}': choose one of {', '.join(names)}"
            )
        try:
            factor = float(text)
        except ValueError:
            factor = -1.0
        if not equals or not 0.0 <= factor <= 10.0:
            raise OptionError(
                f"effect: {word}: write a factor from 0 to 10, such as {names[0]}=0.5"
            )
        found[name] = factor
    return found


def simulate(
    protocol: str, out: Path, participants: int, effects: Sequence[str], seed: int, workers: int
) -> int:
    """Let simulated participants take the study; returns the exit code.

    Args:
        workers: processes; 0: one per core.
    """
    study = Study.make(out, protocol)
    factors = effects_of(study.protocol, effects)
    codes = [f"SIM-{number + 1:03d}" for number in range(participants)]
    if study.protocol.codes:
        raise ProtocolError("a protocol with codes of its own cannot be simulated: leave them out")
    for number, code in enumerate(codes):
        sitting = Sitting.enter(study, code, _Clock(number), simulated=True)
        if not sitting.simulated:
            raise OptionError(f"{out}: {code} is a person: give the simulation its own folder")
    console = new_console()
    work = functools.partial(take, out, seed=seed, effects=factors)
    with new_progress(counted=True) as bar:
        task = bar.add_task("participants", total=len(codes))
        for _ in _done(work, codes, workers or len(os.sched_getaffinity(0))):
            bar.advance(task)
    console.print(f"{count(len(codes), 'participant')} took “{study.protocol.name}”: {out}")
    console.print(f"Next: vf-sandbox user-study analyse {out}")
    return 0


def _done(work: Callable[[str], str], codes: Sequence[str], workers: int) -> Iterator[str]:
    if workers == 1:
        yield from map(work, codes)
        return
    scenes.warm_up()  # compiled once, for all of them
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(workers, context) as pool:
        for one in as_completed([pool.submit(work, code) for code in codes]):
            yield one.result()


class _Clock:
    """Simulated time, which the participant's doings advance."""

    def __init__(self, number: int) -> None:
        self._now = FIRST + timedelta(hours=2 * number)

    def __call__(self) -> datetime:
        return self._now

    def advance(self, seconds: float) -> None:
        self._now += timedelta(seconds=seconds)


def take(folder: Path, code: str, *, seed: int, effects: Mapping[str, float]) -> str:
    """Let a simulated participant take the study to its end; returns the code.

    What it does in a trial depends on the seeds alone, so that an interrupted simulation goes on as
    if it had not been interrupted.
    """
    study = Study.open(folder)
    sitting = Sitting(study, code)
    clock = _Clock(sitting.number)
    if sitting.done:
        last = sitting.done[-1]
        clock.advance(
            (datetime.fromisoformat(last["started"]) - clock()).total_seconds() + last["duration"]
        )
    sitting = Sitting(study, code, clock)
    person = operators.operator_of(seed, sitting.number)
    rng = np.random.default_rng(np.random.SeedSequence((seed, 1 << 22, sitting.number)))
    with _Rooms(study.protocol) as rooms:
        while sitting.stage not in OVER:
            clock.advance(20.0)
            if sitting.stage == "consent":
                sitting.consent(True)
            elif sitting.stage == "questions":
                sitting.answer({one.id: answered(one, rng) for one in study.protocol.questions})
            elif sitting.stage == "tlx":
                sitting.rate(rated(sitting, rng))
            elif sitting.stage == "rest":
                clock.advance(sitting.rest_left)
                sitting.rested()
            else:
                one = sitting.trial
                assert one is not None
                do(sitting, one, rooms, person, clock, seed, effects)
    return code


def do(
    sitting: Sitting,
    planned: Planned,
    rooms: _Rooms,
    person: Operator,
    clock: _Clock,
    seed: int,
    effects: Mapping[str, float],
) -> None:
    """Do a trial, and keep it."""
    protocol, number = sitting.study.protocol, sitting.next_trial
    task, condition = protocol.task(planned.task), protocol.condition(planned.condition)
    session = rooms.of(planned)
    goal = tasks.goal(task, planned.seed, session.scene)
    watch = Progress(goal, task.limit)
    session.reset()
    session.tick()
    hand = Hand(session, lambda: session.now)
    hand.delay = condition.delay
    recording = sitting.files.recording(number)
    started = clock()
    tape = session.record(recording)
    follower = Follower(session, hand, watch)
    operator = operators.under(person, condition, effects)
    try:
        operators.act(
            operator, watch, condition, np.array(session.handle.translation), follower,
            session.options.rate, planned.seed ^ seed,
        )  # fmt: skip
    except TrialOver:
        pass
    finally:
        session.stop_recording()
    if tape.note:
        raise OSError(f"{recording}: {tape.note}")
    clock.advance(watch.time)
    sitting.finish(
        number, started=started, duration=watch.time, completed=watch.completed,
        measures=measure(recording, goal, session.scene),
    )  # fmt: skip


class _Rooms:
    """A session for each task, kept as building one takes seconds."""

    def __init__(self, protocol: Protocol) -> None:
        self._protocol = protocol
        self._open: dict[str, SteppedSession] = {}

    def __enter__(self) -> _Rooms:
        return self

    def __exit__(self, *_error: object) -> None:
        for session in self._open.values():
            session.close()

    def of(self, planned: Planned) -> SteppedSession:
        """The session for a trial."""
        task = self._protocol.task(planned.task)
        condition = self._protocol.condition(planned.condition)
        options = replace(tasks.options(self._protocol, task, condition), rate=RATE)
        session = self._open.get(task.task)
        if session is None:
            session = self._open[task.task] = SteppedSession(options)
            session.start()
        tasks.adopt(session, options)
        return session


def answered(question: Question, rng: np.random.Generator) -> str | None:
    """A random answer, as a form has it."""
    if question.kind == "choice":
        return str(rng.choice(question.choices))
    if question.kind == "text":
        return "simulated" if question.required else None
    return str(int(rng.integers(int(np.ceil(question.low)), int(question.high) + 1)))


def rated(sitting: Sitting, rng: np.random.Generator) -> dict[str, float]:
    """Ratings of workload: the longer the trials of the block took, the higher."""
    block = sitting.block
    spent = [one["duration"] for one in sitting.done if one["block"] == block]
    load = 20.0 + 0.5 * float(np.mean(spent))
    return {name: float(np.clip(rng.normal(load, 8.0), 0.0, 100.0).round()) for name in SCALES}

"""The process of one participant: a session with its control process, and a page.

    python -m app.studies.people.served.room DIR CODE HOST FRONT

Prints one line of JSON once the page is served. Ends when its standard input does, when nobody has
looked at it for `PATIENCE`, or when the study is over for the participant.
"""

from __future__ import annotations

import json
import logging
import signal
import sys
import threading
import time
from pathlib import Path

import numpy as np

from app.control.priority import raise_process_priority
from app.session import Session
from app.studies.people import plan, tasks
from app.studies.people.folder import Study
from app.studies.people.hand import Hand
from app.studies.people.measures import measure
from app.studies.people.plan import Planned
from app.studies.people.progress import Progress
from app.studies.people.served.page import TrialPage
from app.studies.people.sitting import OVER, Sitting, utc
from app.words import OptionError, Refused

log = logging.getLogger(__name__)

PATIENCE = 600.0  # without a browser, or a word of the front page [s]
AWAY = 3.0  # a trial ends, unfinished, when the browser is gone for so long [s]
LOOK = 0.02  # between two looks at the tip [s]
TITLES = {
    "tracing": "Trace the slot",
    "targeting": "Touch the targets",
    "cutting": "Cut along the line",
}
SENTENCES = {
    "tracing": "Drag the tip of the instrument into the slot at the orange ball, and along its "
    "bottom to the green one.",
    "targeting": "Drag the tip of the instrument into the ball, and hold it there until the next "
    "ball appears. Touch nothing else.",
    "cutting": "Drag the tip of the instrument into the bone at the orange ball, and along the "
    "line to the green one. Do not go deeper than through the bone.",
}
_PAUSED = "Press the button first"


class Room:
    """Leads a participant through the trials; other stages are the front page's.

    Attributes:
        seen: monotonic time at which somebody was there last [s].
    """

    def __init__(self, sitting: Sitting, host: str, front: str, port: int = 0) -> None:
        self.sitting = sitting
        protocol = sitting.study.protocol
        planned = sitting.trial
        first = protocol.tasks[0] if planned is None else protocol.task(planned.task)
        self._session = Session(
            tasks.options(protocol, first, protocol.conditions[0]), process=True
        )
        self._hand = Hand(self._session)
        self._hand.closed = _PAUSED
        self._session.start()
        self._stop = threading.Event()
        self.seen = time.monotonic()
        try:
            self.page = TrialPage(self._session, self._hand, host, port, front)
        except BaseException:
            self._session.close()
            raise
        self._pump = threading.Thread(target=self._pumping, name="hand", daemon=True)
        self._pump.start()

    def stop(self) -> None:
        """Have `run` return."""
        self._stop.set()
        self.page.begin.set()

    def close(self) -> None:
        """End page, session and control process."""
        self.stop()
        self.page.close()
        self._session.close()

    def run(self) -> None:
        """Lead through the trials, until `stop`, the end of the study, or nobody is there."""
        while not self._stop.is_set():
            if self.page.watched:
                self.seen = time.monotonic()
            try:
                stage = self.sitting.look()
                if stage in OVER or time.monotonic() - self.seen > PATIENCE:
                    return
                planned = self.sitting.trial
                if planned is None:
                    self._between()
                else:
                    self._trial(planned)
            except Refused as reason:
                log.warning("%s", reason)
                self._stop.wait(1.0)
            except OptionError:  # the participant's data were deleted meanwhile
                return

    def _between(self) -> None:
        self.page.clear()
        self.page.tell("Well done", "This part is finished.", link="Continue")
        self._stop.wait(0.5)

    def _trial(self, planned: Planned) -> None:
        """Prepare a trial, wait for the button, and do it; it may end unfinished."""
        session, page, hand, protocol = (
            self._session, self.page, self._hand, self.sitting.study.protocol,
        )  # fmt: skip
        task, condition = protocol.task(planned.task), protocol.condition(planned.condition)
        if session.ended:
            session.restart()
        page.clear()
        page.tell("One moment", "The next task is being prepared.")
        tasks.adopt(session, tasks.options(protocol, task, condition))
        hand.drop()
        hand.delay = condition.delay
        session.reset()
        progress = Progress(tasks.goal(task, planned.seed, session.scene), task.limit)
        page.sound = condition.sound
        page.prepare(progress)
        page.begin.clear()
        title, sentence = TITLES[task.task], task.instruction or SENTENCES[task.task]
        page.tell(title, sentence, self._where(planned), button="Start")
        while not page.begin.wait(0.5):
            if page.watched:
                self.seen = time.monotonic()
            self.sitting.look()
            if self.sitting.trial != planned:  # stopped, or done by another process
                return
            if time.monotonic() - self.seen > PATIENCE:
                return
        self.sitting.look()
        if self._stop.is_set() or self.sitting.trial != planned:
            return
        page.tell(title, sentence, self._where(planned))
        if self._done(progress):
            self._keep(progress)

    def _done(self, progress: Progress) -> bool:
        """Do the trial, recorded; returns whether it is finished."""
        session, page, hand = self._session, self.page, self._hand
        self._started = utc()
        self._number = self.sitting.next_trial
        self._recording = self.sitting.files.recording(self._number)
        tape = session.record(self._recording)
        begun = session.latest().time
        hand.closed, page.hidden = "", False
        there = time.monotonic()
        try:
            while not self._stop.wait(LOOK):
                telemetry = session.latest()
                if page.watched:
                    there = self.seen = time.monotonic()
                if session.ended or tape.note or time.monotonic() - there > AWAY:
                    return False
                if telemetry.step is None:
                    continue
                tip = np.array(telemetry.step.tip.translation)
                if progress.see(telemetry.time - begun, tip):
                    return True
            return False
        finally:
            hand.closed, page.hidden = _PAUSED, True
            hand.drop()
            if tape.running:
                session.stop_recording()

    def _keep(self, progress: Progress) -> None:
        end = "Done" if progress.completed else "Time is over"
        self.page.tell(end, "One moment: this is being kept.")
        measures = measure(self._recording, progress.goal, self._session.scene)
        self.sitting.finish(
            self._number, started=self._started, duration=progress.time,
            completed=progress.completed, measures=measures,
        )  # fmt: skip

    def _where(self, planned: Planned) -> str:
        """Where in the study this trial is, as the participant may know."""
        sitting = self.sitting
        protocol = sitting.study.protocol
        if planned.training:
            return "Training: this is not counted yet."
        done, of = sitting.of_block
        name = plan.shown_name(protocol, sitting.order, planned.condition)
        return (
            f"Part {name if protocol.blinded else planned.block + 1} of {len(sitting.order)}"
            f"{'' if protocol.blinded else f' ({name})'}, task {done + 1} of {of}"
        )

    def _pumping(self) -> None:
        """Pass on what the hand ordered, when it is due."""
        while not self._stop.wait(0.002 if self._hand.delay else 0.1):
            try:
                self._hand.pump()
            except Exception:
                log.exception("an order of the hand failed")


def main(arguments: list[str]) -> int:
    """Run a room until its standard input ends; returns the exit code."""
    folder, code, host, front = arguments
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the front page's
    raise_process_priority()
    sitting = Sitting(Study.open(Path(folder)), code)
    room = Room(sitting, host, front)

    def listen() -> None:
        for _ in sys.stdin:
            room.seen = time.monotonic()
        room.stop()

    threading.Thread(target=listen, name="front", daemon=True).start()
    try:
        print(json.dumps({"port": room.page.port, "token": room.page.token}), flush=True)
        room.run()
    finally:
        room.close()
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

"""A control process as its parent has it: started, given surfaces, ended."""

from __future__ import annotations

import contextlib
import signal
import subprocess
import sys
from collections.abc import Sequence

import vf
from app.control.process import surfaces
from app.control.process.channel import Channel
from app.control.process.shared import ROOM, Memory, Queue, Slot

PATIENCE = 10.0  # for an answer or an end [s]


class Child:
    """A control process: started, talked to, ended."""

    def __init__(self, before: Child | None = None) -> None:
        """Start it; it loads its libraries meanwhile.

        Args:
            before: the process that ended, whose shared memory this one goes on with.

        Raises:
            OSError: it cannot be started.
        """
        size = Slot.SIZE + Queue.HEAD + ROOM
        self.memory: Memory = Memory.create(size) if before is None else before.memory
        memory = self.memory
        # The surfaces of the newest plant, each with the shared memory that has its arrays.
        self.shared: list[tuple[vf.Surface, surfaces.Shared]] = []
        if before is not None:
            self.shared = before.shared
        self.channel, theirs = Channel.pair()
        try:
            # Outside the terminal's process group: Ctrl-C goes to the page's process alone.
            self.process = subprocess.Popen(
                [
                    sys.executable, "-m", "app.control.process.child",
                    str(theirs.fileno()), str(memory.fd),
                ],
                stdin=subprocess.DEVNULL,
                pass_fds=(theirs.fileno(), memory.fd),
                start_new_session=True,
            )  # fmt: skip
        except BaseException:
            self.channel.close()
            raise
        finally:
            theirs.close()
        self.ending = ""  # why it is about to end
        self.thread: int | None = None  # number of its control thread
        self.has: list[surfaces.Shared] = []  # the surfaces it was given last
        self.built = 0  # number of the newest plant it has
        self.failed: dict[int, str] = {}  # why plants could not be built, by number

    def warm_up(self) -> None:
        """Have it load the kernels; call this once they are compiled."""
        with contextlib.suppress(OSError):
            self.channel.send("warm")

    def share(self, wanted: Sequence[vf.Surface]) -> list[surfaces.Shared]:
        """The surfaces in shared memory, which they use themselves from then on.

        Raises:
            OSError: there is no memory for them.
        """
        known = {id(surface): shared for surface, shared in self.shared}
        made: list[tuple[vf.Surface, surfaces.Shared]] = []
        try:
            for surface in wanted:
                shared = known.get(id(surface)) or surfaces.share(surface)
                made.append((surface, shared))
        except BaseException:
            # Those that are new are forgotten; they work on with what they have.
            for surface, shared in made:
                if id(surface) not in known:
                    shared.memory.forget()
            raise
        kept = {id(surface) for surface in wanted}
        for surface, shared in self.shared:
            if id(surface) not in kept:
                shared.memory.forget()
        self.shared = made
        return [shared for _, shared in made]

    def leave(self) -> None:
        """End it for good, and close what there is of shared memory."""
        self.end()
        self.channel.close()
        self.memory.forget()
        for _, shared in self.shared:
            shared.memory.forget()

    def end(self) -> str:
        """Have it end, by force if it does not; returns why it ended if nobody told it to."""
        if self.thread is None:
            self.process.kill()  # it holds nothing yet
        with contextlib.suppress(OSError):
            self.channel.send("close")
        try:
            code = self.process.wait(PATIENCE)
        except subprocess.TimeoutExpired:
            self.process.kill()
            code = self.process.wait()
        if self.ending:
            return self.ending
        return f"signal {signal.Signals(-code).name}" if code < 0 else f"exit code {code}"

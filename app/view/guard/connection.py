"""What a client may do once it is in: how much it may send, and how little it may read."""

from __future__ import annotations

import asyncio
import logging
from typing import Any

from websockets.asyncio.server import ServerConnection
from websockets.frames import Frame

from app.view.guard.allowance import Allowance
from app.view.guard.messages import SMALL, problem_with

log = logging.getLogger(__package__)  # one for the whole guard

# A browser sends up to some 20 messages/s of a drag, 50 of the camera, 20 of a slider, and has them
# in a bunch when something was slow.
MESSAGES = (200.0, 600.0)  # per client [1/s], at once
EXCESS = (10.0, 500.0)  # of those dropped for that reason, before the connection is closed
MISTAKES = (0.2, 20.0)  # messages that no browser would send, likewise
FRAMES = (4000.0, 12_000.0)  # pings and fragments too: beyond, the connection is cut
FILES = (50e6, 10e6)  # parts of files are not dropped but taken later [byte/s], [byte]
STALLED = 20.0  # a client that takes nothing for so long is disconnected [s],
BEHIND = 300.0  # or takes less than there is for it for so long [s],
BACKLOG = 256 * 2**20  # or has so much waiting for it: viser sends up to 128 MB at once [byte]


class Connection(ServerConnection):
    """A WebSocket that hands on sound messages at a bearable rate, and does not wait for ever."""

    def __init__(self, *arguments: Any, **keywords: Any) -> None:
        super().__init__(*arguments, **keywords)
        self._frames = Allowance(*FRAMES)
        self._messages = Allowance(*MESSAGES)
        self._excess = Allowance(*EXCESS)
        self._mistakes = Allowance(*MISTAKES)
        self._files = Allowance(*FILES)
        self._expelled = False
        self._added = 0  # to what waits, since it was looked at [byte]
        self._behind_since = 0.0
        self._watch: asyncio.TimerHandle | None = None

    async def recv(self, decode: bool | None = None) -> Any:
        """The next message that is worth handing on."""
        while True:
            raw = await super().recv(decode)
            if self._expelled:
                continue  # came in before the end was known
            if len(raw) > SMALL:
                # Not reading on holds back the sender, a browser with a file included.
                await asyncio.sleep(self._files.owe(len(raw)))
            elif not self._messages.take():
                if not self._excess.take():
                    await self._expel("too many messages")
                continue
            problem = problem_with(raw)
            if problem is None:
                return raw
            if not self._mistakes.take():
                await self._expel(problem)

    async def _expel(self, reason: str) -> None:
        self._expelled = True
        log.warning("a client was disconnected: %s", reason)
        try:
            async with asyncio.timeout(1.0):
                await self.close(1008, reason)
        except TimeoutError:
            self.transport.abort()

    def process_event(self, event: Any) -> None:
        """Also counts what never becomes a message: pings, and parts of one that never ends."""
        if isinstance(event, Frame) and not self._frames.take():
            self.transport.abort()
            return
        super().process_event(event)

    def data_received(self, data: bytes) -> None:
        """Answers to pings are written without asking whether anybody reads them."""
        super().data_received(data)
        if self.transport.get_write_buffer_size() > BACKLOG:
            self.transport.abort()

    def send_data(self) -> None:
        """Hand over what is to be sent."""
        before = self.transport.get_write_buffer_size()
        super().send_data()
        self._added += self.transport.get_write_buffer_size() - before

    def pause_writing(self) -> None:
        """The client takes less than there is for it: from here on, see that it takes some."""
        super().pause_writing()
        # websockets' own keepalive cannot: its ping waits for the client to read as well.
        self._behind_since = self.loop.time()
        self._look_again()

    def resume_writing(self) -> None:
        """The client keeps up again."""
        self._stop_looking()
        super().resume_writing()

    def connection_lost(self, exc: Exception | None) -> None:
        """Nobody is there any more."""
        self._stop_looking()
        super().connection_lost(exc)

    def _look_again(self) -> None:
        self._added = 0
        waiting = self.transport.get_write_buffer_size()
        self._watch = self.loop.call_later(STALLED, self._look, waiting)

    def _stop_looking(self) -> None:
        if self._watch is not None:
            self._watch.cancel()
            self._watch = None

    def _look(self, before: int) -> None:
        taken = before + self._added - self.transport.get_write_buffer_size()
        if taken <= 0 or self.loop.time() - self._behind_since > BEHIND:
            log.warning("a client was disconnected: it does not read what it is sent")
            self.transport.abort()
        else:
            self._look_again()

"""Limits of one WebSocket: what it may send, and how fast it must read."""

from __future__ import annotations

import asyncio
import logging
from typing import Any

from websockets.asyncio.server import ServerConnection
from websockets.frames import Frame

from app.view.guard.messages import MAX_PLAIN, problem_with
from app.view.guard.token_bucket import TokenBucket

log = logging.getLogger(__package__)  # one for the whole guard

# Rates per client as (average [1/s], burst). A browser sends about 20 messages/s of a drag, 50 of
# the camera and 20 of a slider, in bursts after a delay.
MESSAGES = (200.0, 600.0)  # further messages are dropped
DROPPED = (10.0, 500.0)  # dropped messages; more close the connection
INVALID = (0.2, 20.0)  # messages that no browser sends; more close the connection
FRAMES = (4000.0, 12_000.0)  # WebSocket frames, pings and fragments included; more abort it
FILES = (50e6, 10e6)  # [byte/s], [byte] parts of files are delayed, not dropped
# A client is disconnected when
STALL_TIMEOUT = 20.0  # it has read nothing for so long [s],
BEHIND_TIMEOUT = 300.0  # its write buffer has not drained for so long [s], or
MAX_BACKLOG = 256 * 2**20  # so much waits for it; viser sends up to 128 MB at once [byte]


class Connection(ServerConnection):
    """A WebSocket that passes on valid messages at a limited rate, and drops clients that stall."""

    def __init__(self, *arguments: Any, **keywords: Any) -> None:
        super().__init__(*arguments, **keywords)
        self._frames = TokenBucket(*FRAMES)
        self._messages = TokenBucket(*MESSAGES)
        self._dropped = TokenBucket(*DROPPED)
        self._invalid = TokenBucket(*INVALID)
        self._files = TokenBucket(*FILES)
        self._disconnected = False
        self._added = 0  # to the write buffer since the last check [byte]
        self._behind_since = 0.0
        self._check: asyncio.TimerHandle | None = None

    async def recv(self, decode: bool | None = None) -> Any:
        """The next valid message within the rate."""
        while True:
            raw = await super().recv(decode)
            if self._disconnected:
                continue
            if len(raw) > MAX_PLAIN:
                # While this waits nothing is read, and TCP slows the sender down.
                await asyncio.sleep(self._files.charge(len(raw)))
            elif not self._messages.take():
                if not self._dropped.take():
                    await self._disconnect("too many messages")
                continue
            problem = problem_with(raw)
            if problem is None:
                return raw
            if not self._invalid.take():
                await self._disconnect(problem)

    async def _disconnect(self, reason: str) -> None:
        self._disconnected = True
        log.warning("a client was disconnected: %s", reason)
        try:
            async with asyncio.timeout(1.0):
                await self.close(1008, reason)
        except TimeoutError:
            self.transport.abort()

    def process_event(self, event: Any) -> None:
        """Count frames: pings and fragments never arrive as messages."""
        if isinstance(event, Frame) and not self._frames.take():
            self.transport.abort()
            return
        super().process_event(event)

    def data_received(self, data: bytes) -> None:
        """Check the backlog: answers to pings are written even if the client reads nothing."""
        super().data_received(data)
        if self.transport.get_write_buffer_size() > MAX_BACKLOG:
            self.transport.abort()

    def send_data(self) -> None:
        """Write to the transport, counting what is added to its buffer."""
        before = self.transport.get_write_buffer_size()
        super().send_data()
        self._added += self.transport.get_write_buffer_size() - before

    def pause_writing(self) -> None:
        """The write buffer is above its limit: check from now on that the client reads."""
        super().pause_writing()
        # The keepalive of websockets does not notice: its ping waits in the same buffer.
        self._behind_since = self.loop.time()
        self._schedule_check()

    def resume_writing(self) -> None:
        """The write buffer has drained."""
        self._cancel_check()
        super().resume_writing()

    def connection_lost(self, exc: Exception | None) -> None:
        """The connection is closed: stop the check."""
        self._cancel_check()
        super().connection_lost(exc)

    def _schedule_check(self) -> None:
        self._added = 0
        waiting = self.transport.get_write_buffer_size()
        self._check = self.loop.call_later(STALL_TIMEOUT, self._check_progress, waiting)

    def _cancel_check(self) -> None:
        if self._check is not None:
            self._check.cancel()
            self._check = None

    def _check_progress(self, before: int) -> None:
        taken = before + self._added - self.transport.get_write_buffer_size()
        if taken <= 0 or self.loop.time() - self._behind_since > BEHIND_TIMEOUT:
            log.warning("a client was disconnected: it does not read what it is sent")
            self.transport.abort()
        else:
            self._schedule_check()

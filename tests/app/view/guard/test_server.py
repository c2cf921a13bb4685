"""The server: its port, the patched wake-up, and the check of viser's internals."""

from __future__ import annotations

import asyncio
import sys
import threading

import pytest
from viser import _messages as wire
from viser.infra._async_message_buffer import AsyncMessageBuffer

from app.session import Session
from app.view import Page, guard
from tests.support.clients import asked


def test_a_message_pushed_between_test_and_wait_is_sent(page: Page) -> None:
    async def receive() -> str:
        loop = asyncio.get_running_loop()
        buffer = AsyncMessageBuffer(loop, persistent_messages=True)
        theirs = loop.create_future

        def create_future() -> asyncio.Future[None]:
            # The sender has found no message and is about to wait.
            if sys._getframe(1).f_locals.get("self") is buffer.message_event:
                loop.create_future = theirs
                message = wire.SetGuiPanelLabelMessage("late")
                thread = threading.Thread(target=buffer.push, args=(message,))
                thread.start()
                thread.join()
            return theirs()

        loop.create_future = create_future
        windows = buffer.window_generator(client_id=0)
        try:
            window = await asyncio.wait_for(anext(windows), 5.0)
        finally:
            await windows.aclose()
        return str(window[0].label)

    assert asyncio.run(receive()) == "late"


def test_a_second_server_on_the_port_is_refused(session: Session, page: Page) -> None:
    with pytest.raises(OSError, match=f"port {page.port} on 127.0.0.1 was taken"):
        Page(session, "127.0.0.1", page.port)
    assert asked(page)[0] == 200


def test_a_changed_viser_is_not_served(session: Session, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delattr(wire, "TransformControlsUpdateMessage")
    with pytest.raises(guard.GuardError, match="TransformControlsUpdateMessage missing"):
        Page(session, "127.0.0.1", 0)

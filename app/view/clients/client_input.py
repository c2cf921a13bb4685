"""Input from clients: drags of the proxy and other orders, run in sequence off the event loop."""

from __future__ import annotations

import contextlib
import logging
import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial

import numpy as np
import pinocchio as pin
import viser

from app.control.priority import VIEW_PRIORITY, raise_thread_priority
from app.session import Session
from app.view.clients import client_names
from app.view.drawing.proxy import Proxy
from app.view.units import pose_from_view, same_pose
from app.words import Refused

log = logging.getLogger(__name__)

Notify = Callable[[viser.ClientHandle | None, str], None]

GIZMO = "gizmo"  # what is dragged
# An update takes about 10 ms of the interpreter while everything moves: viser compares and packs
# each node.
FRAME_PERIOD = 1.0 / 25.0  # of the scene's updates [s]
MIN_PAUSE = 0.008  # between two updates, for the other threads [s]
DRAG_DELAY = 0.004  # from a drag message to its update: time for some ticks [s]


class ClientInput:
    """Runs what clients order, and decides which client drags the proxy.

    The first client to grab it, by the gizmo or by the tool, owns it until it releases it or
    disconnects. Drags by other clients are ignored; their gizmo is reset when they release it. If
    the owner disconnects during a drag, its last command becomes stale and the control loop holds
    the tool.

    Attributes:
        moved: set when the handle has moved; the view thread waits for it and draws.
    """

    def __init__(self, session: Session, server: viser.ViserServer, proxy: Proxy, notify: Notify):
        self._session = session
        self._server = server
        self._proxy = proxy
        self._notify = notify
        # Session methods may wait for a lock; the event loop must not. One worker keeps the order.
        self._worker = ThreadPoolExecutor(
            1, "input", initializer=raise_thread_priority, initargs=(VIEW_PRIORITY,)
        )
        self._owner: int | None = None  # written by the worker only
        self._grip = ""  # what the owner drags
        self._shown: pin.SE3 | None = session.handle  # of the gizmo on the pages; None: unknown
        self._refusal_shown = False
        self.moved = threading.Event()

        @proxy.gizmo.on_update
        async def _moved(event: viser.TransformControlsEvent) -> None:
            # Copied on the event loop, so that both are of one update.
            wxyz, position = np.array(event.target.wxyz), np.array(event.target.position)
            read = partial(pose_from_view, wxyz, position)
            self.submit(self.drag, GIZMO, event.client, event.client_id, event.phase, read)

    def submit(self, order: Callable[..., object], *arguments: object) -> None:
        """Queue an order for the worker; ignored after `close`."""
        with contextlib.suppress(RuntimeError):
            self._worker.submit(self._run, order, arguments)

    def close(self) -> None:
        """Finish the running order, drop the others, accept no more."""
        self._worker.shutdown(wait=True, cancel_futures=True)

    @property
    def owner(self) -> int | None:
        """Number of the client that drags the gizmo, or None."""
        return self._owner

    @property
    def owner_name(self) -> str:
        """Name of the client that drags the gizmo."""
        owner = self._owner
        return "nobody" if owner is None else client_names.name(owner)

    def update(self, target: pin.SE3 | None, autopilot: bool) -> None:
        """Each frame, from the view thread: refresh the held command, or place the gizmo.

        Args:
            target: pose that the tool follows; the gizmo shows it under autopilot.
        """
        owner, clients = self._owner, self._server.get_clients()
        self._proxy.holder = self.owner_name if owner is not None and len(clients) > 1 else ""
        if owner is not None:
            if owner in clients:
                self._session.touch()
            else:
                self.submit(self._release, owner)
            if self._grip != GIZMO:
                self._proxy.place(self._session.handle)
            return
        handle = target if autopilot and target is not None else self._session.handle
        if self._shown is None or not same_pose(handle, self._shown):
            # In this order: a drag that ends meanwhile sets `_shown` to None, which must persist.
            self._shown = handle
            self._proxy.place(handle)

    def wait_for_frame(self, began: float, stop: threading.Event) -> float:
        """On the view thread: wait until it is time to draw, or the handle has moved.

        Args:
            began: when the last update began, by the monotonic clock [s].

        Returns:
            When this one begins.
        """
        stop.wait(MIN_PAUSE)
        if self.moved.wait(max(began + FRAME_PERIOD - time.monotonic(), 0.0)):
            stop.wait(DRAG_DELAY)
            self.moved.clear()
        return time.monotonic()

    def release(self) -> None:
        """End the drag, if there is one."""
        self.submit(lambda: self._release(self._owner))

    def _run(self, order: Callable[..., object], arguments: tuple[object, ...]) -> None:
        try:
            order(*arguments)
        except Refused as reason:
            asked = next((a for a in arguments if isinstance(a, viser.ClientHandle)), None)
            self._notify(asked, f"{reason}.")
        except Exception:
            log.exception("an order from the page failed")

    def _release(self, owner: int | None) -> None:
        if self._owner == owner:
            self._owner = self._shown = None

    def drag(
        self,
        grip: str,
        client: viser.ClientHandle | None,
        client_id: int,
        phase: str,
        read: Callable[[], pin.SE3],
    ) -> bool:
        """On the worker: one message of a drag, "start", "update" or "end"; whether it counts.

        Args:
            grip: what is dragged. A pointer may be over two things; the first of them counts.
            read: the pose of the handle, base frame; raises ValueError where it is not one.
        """
        if self._owner is None and phase == "start":
            if self._session.latest().autopilot:
                self._session.set_autopilot(False)
            self._owner, self._grip = client_id, grip
            self._refusal_shown = False
        if self._owner != client_id:
            if phase == "start":
                self._notify(
                    client,
                    f"Another client is dragging: {self.owner_name} has the proxy until it "
                    "lets go.",
                )
            self._shown = None
            return False
        if grip != self._grip:
            self._shown = None
            return False
        if phase == "end" and client_id not in self._server.get_clients():
            self._release(client_id)  # viser itself ends the drags of clients that disconnect
            return False
        try:
            handle = read()
            self._session.drive(handle, held=phase != "end")
            # What the client sees of the gizmo is where it dragged it to, and only then.
            self._shown = handle if grip == GIZMO else None
            self.moved.set()
        except ValueError as error:
            self._shown = None  # the next `update` after the drag restores the pose
            if not self._refusal_shown:
                self._refusal_shown = True
                self._notify(client, f"Proxy refused: {error}.")
            if phase == "end":
                with contextlib.suppress(Refused):
                    self._session.drive(self._session.handle, held=False)
        if phase == "end":
            # The view thread may have placed the gizmo just as it was grabbed: place it again.
            self._owner = self._shown = None
        return True

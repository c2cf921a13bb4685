"""What comes from clients: dragging the gizmo. One hand at a time, in order, off the event loop."""

from __future__ import annotations

import contextlib
import logging
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pinocchio as pin
import viser
from numpy.typing import NDArray

from app.control.loop import VIEW_PRIORITY, prefer_this_thread
from app.refused import Refused
from app.session import Session
from app.view import who
from app.view.proxy import Proxy
from app.view.units import pose_from_view, same_pose

log = logging.getLogger(__name__)

Tell = Callable[[viser.ClientHandle | None, str], None]


class Hand:
    """Who drags, and what they did with the gizmo.

    The first client to grab the gizmo owns it until it lets go or vanishes; what others do with
    it meanwhile is not acted upon, and their gizmo is put right when they let go. A client that
    vanishes in mid-drag leaves a held command behind, which the loop lets go stale: the tool
    holds until somebody takes over.

    Attributes:
        moved: set whenever the handle was moved, for the view thread to draw at once.
    """

    def __init__(self, session: Session, server: viser.ViserServer, proxy: Proxy, tell: Tell):
        self._session = session
        self._server = server
        self._proxy = proxy
        self._tell = tell
        # Session methods may wait for a lock; the event loop must not. One worker keeps order. Like
        # the page's other threads it may not be put aside with the interpreter in its hands.
        self._worker = ThreadPoolExecutor(
            1, "hand", initializer=prefer_this_thread, initargs=(VIEW_PRIORITY,)
        )
        self._owner: int | None = None  # written by the worker only
        self._shown: pin.SE3 | None = session.handle  # where the gizmo is on the clients' pages
        self._complained = False
        self.moved = threading.Event()

        @proxy.gizmo.on_update
        async def _moved(event: viser.TransformControlsEvent) -> None:
            # Both halves at once: on the event loop no other update can come in between.
            wxyz, position = np.array(event.target.wxyz), np.array(event.target.position)
            self.submit(self._drag, event.client, event.client_id, event.phase, wxyz, position)

    def submit(self, order: Callable[..., object], *arguments: object) -> None:
        """Let the worker do something with the session, after everything submitted before."""
        # A closed worker refuses with RuntimeError: there is nobody left to act for.
        with contextlib.suppress(RuntimeError):
            self._worker.submit(self._run, order, arguments)

    def close(self) -> None:
        """Finish what was submitted, accept nothing more."""
        self._worker.shutdown(wait=True, cancel_futures=True)

    @property
    def dragging(self) -> bool:
        """Whether some client has the gizmo in its hand."""
        return self._owner is not None

    @property
    def owner(self) -> int | None:
        """The client that has the gizmo in its hand."""
        return self._owner

    @property
    def name_of_owner(self) -> str:
        """What everybody calls the client that drags."""
        owner = self._owner
        return "nobody" if owner is None else who.name(owner)

    def tend(self, target: pin.SE3 | None, autopilot: bool) -> None:
        """From the view thread, each frame: keep a resting drag alive, the gizmo in its place."""
        owner, clients = self._owner, self._server.get_clients()
        self._proxy.holder = self.name_of_owner if owner is not None and len(clients) > 1 else ""
        if owner is not None:
            if owner in clients:
                self._session.touch()
            else:
                self.submit(self._abandon, owner)
            return
        handle = target if autopilot and target is not None else self._session.handle
        if self._shown is None or not same_pose(handle, self._shown):
            # In this order: whoever moves the gizmo meanwhile, and lets go, has it put back again.
            self._shown = handle
            self._proxy.place(handle)

    def let_go(self) -> None:
        """Whoever drags the gizmo has it no longer."""
        self.submit(self._drop)

    def _drop(self) -> None:
        self._owner = self._shown = None

    def _run(self, order: Callable[..., object], arguments: tuple[object, ...]) -> None:
        try:
            order(*arguments)
        except Refused as reason:
            asked = next((a for a in arguments if isinstance(a, viser.ClientHandle)), None)
            self._tell(asked, f"{reason}.")
        except Exception:
            log.exception("an order from the page failed")

    def _abandon(self, owner: int) -> None:
        if self._owner == owner:
            self._owner = None
            self._shown = None

    def _drag(
        self,
        client: viser.ClientHandle | None,
        client_id: int,
        phase: str,
        wxyz: NDArray[np.float64],
        position: NDArray[np.float64],
    ) -> None:
        if self._owner is None and phase == "start":
            if self._session.latest().autopilot:
                self._session.set_autopilot(False)
            self._owner = client_id
            self._complained = False
        if self._owner != client_id:
            if phase == "start":
                self._tell(
                    client,
                    f"Another client is dragging: {self.name_of_owner} has the proxy until it "
                    "lets go.",
                )
            self._shown = None
            return
        if phase == "end" and client_id not in self._server.get_clients():
            self._abandon(client_id)  # viser ends the drags of clients that vanish
            return
        try:
            handle = pose_from_view(wxyz, position)
            self._session.drive(handle, held=phase != "end")
            self._shown = handle
            self.moved.set()
        except ValueError as error:
            self._shown = None  # put back to where the session has it once let go
            if not self._complained:
                self._complained = True
                self._tell(client, f"Proxy refused: {error}.")
            if phase == "end":
                with contextlib.suppress(Refused):
                    self._session.drive(self._session.handle, held=False)
        if phase == "end":
            # Look once more: the view may have put the gizmo somewhere just as it was grabbed.
            self._shown = None
            self._owner = None

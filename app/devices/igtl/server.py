"""A server of OpenIGTLink on a session: several clients, which may come late and go."""

from __future__ import annotations

import contextlib
import logging
import math
import select
import socket
import threading
import time
from typing import TYPE_CHECKING, Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from app.devices.igtl import wire
from app.devices.page import checked_pose
from app.devices.remote.border import near
from app.kinds.links import Address, parse_address
from app.words import OptionError, Refused

if TYPE_CHECKING:
    from app.session import Session

log = logging.getLogger(__name__)

PERIOD = 1.0 / 30.0  # between two sets of transforms [s]
BACKLOG = 1 << 20  # a client that has more waiting gets no transforms meanwhile [byte]
SETTLED = 0.5  # a registration counts when it has been the same for so long [s]
SAME = 1e-6  # smaller differences of a registration are none [m, rad]
FIRST = 10e-3, 0.35  # the first goal is so near to the tool [m, rad]
PROXY, REGISTRATION, COMMAND = "Proxy", "Registration", "state_command"
TOOL, GOAL, STATE = "Tool", "Goal", "operating_state"


class _Client:
    def __init__(self, link: socket.socket, name: str) -> None:
        self.link, self.name = link, name
        self.heard, self.waiting = b"", bytearray()
        self.scene = 0  # version of the scene whose structures it was sent

    def fileno(self) -> int:
        return self.link.fileno()


class Server:
    """Serves a session until `close`, in a thread of its own.

    To every client: the transforms ``Tool`` and ``Goal`` 30 times a second, the string
    ``operating_state``, and every structure as POLYDATA when it joins and when the scene changes.
    From them: the transform ``Proxy`` moves the tool as a drag on the page does, ``Registration``
    places the mesh, and the string ``state_command`` enables and disables the arm. All poses are in
    the arm's base frame, which is the world's in 3D Slicer.

    Attributes:
        port: that it listens on.
        refused: what was refused last, in a sentence; empty: nothing.
    """

    def __init__(self, session: Session, address: Address) -> None:
        """Listen; `start` serves.

        Raises:
            OptionError: it cannot listen there.
        """
        self._session = session
        self.refused = ""
        where = f"igtl://{address.host}:{address.port}"
        try:
            self._socket = socket.create_server((address.host, address.port))
        except OSError as error:
            raise OptionError(f"{where}: cannot listen there: {error.strerror or error}") from None
        self._socket.setblocking(False)
        self.port: int = self._socket.getsockname()[1]
        self._clients: list[_Client] = []
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="igtl", daemon=True)
        self._proxy: tuple[pin.SE3, float] | None = None
        self._registration: tuple[NDArray[np.float64], float] | None = None
        self._placing: threading.Thread | None = None
        self._structures: tuple[int, list[bytes]] = (0, [])

    def start(self) -> None:
        """Serve."""
        self._thread.start()

    def close(self) -> None:
        """End, and close all connections. Safe to call twice."""
        self._stop.set()
        if self._thread.is_alive():
            self._thread.join()
        for client in self._clients:
            client.link.close()
        self._socket.close()

    def _run(self) -> None:
        due = 0.0
        while not self._stop.is_set():
            pause = max(due - time.monotonic(), 0.0)
            waiting: list[Any] = [self._socket, *self._clients]
            writing = [one for one in self._clients if one.waiting]
            ready, writable, _ = select.select(waiting, writing, [], min(pause, PERIOD))
            try:
                if self._socket in ready:
                    self._accept()
                for client in [one for one in ready if isinstance(one, _Client)]:
                    self._hear(client)
                now = time.monotonic()
                if now >= due:
                    due = now + PERIOD
                    self._tell()
                    self._place(now)
                for client in writable:
                    self._write(client)
            except Exception:
                log.exception("OpenIGTLink")

    def _accept(self) -> None:
        link, address = self._socket.accept()
        link.setblocking(False)
        log.warning("igtl: %s:%d joined", *address[:2])
        self._clients.append(_Client(link, f"{address[0]}:{address[1]}"))

    def _leave(self, client: _Client, why: str) -> None:
        log.warning("igtl: %s left: %s", client.name, why)
        client.link.close()
        self._clients = [one for one in self._clients if one is not client]

    def _hear(self, client: _Client) -> None:
        try:
            data = client.link.recv(1 << 16)
        except BlockingIOError:
            return None
        except OSError as error:
            return self._leave(client, str(error))
        if not data:
            return self._leave(client, "closed")
        client.heard += data
        try:
            while True:
                message, client.heard = wire.split(client.heard)
                if message is None:
                    break
                self._obey(message)
        except wire.Unreadable as error:
            self._leave(client, str(error))
        return None

    def _obey(self, message: wire.Received) -> None:
        try:
            if message.kind == "STRING" and message.name == COMMAND:
                self._session.state_command(message.text)
            elif message.kind == "TRANSFORM" and message.name == PROXY:
                self._drive(checked_pose(_pose(message.transform)))
            elif message.kind == "TRANSFORM" and message.name == REGISTRATION:
                self._register(checked_pose(_pose(message.transform)).homogeneous)
        except (Refused, ValueError) as error:
            self._refuse(str(error))

    def _drive(self, pose: pin.SE3) -> None:
        """Move the proxy, from the tool on."""
        now = time.monotonic()
        before, self._proxy = self._proxy, None
        if before is None or now - before[1] > self._session.options.stale_after:
            step = self._session.latest().step
            if step is None or not _close(step.tip, pose):
                raise Refused("the first Proxy must be at the tool: copy the transform Tool")
        elif not near(before[0], pose, now - before[1]):
            raise Refused("Proxy jumped")
        self._session.drive(pose, held=True)
        self._proxy = pose, now

    def _register(self, T: NDArray[np.float64]) -> None:
        known = self._registration
        if known is None or np.abs(known[0] - T).max() > SAME:
            self._registration = T, time.monotonic()

    def _place(self, now: float) -> None:
        """Place the mesh where a registration that has settled says."""
        if self._registration is None or now - self._registration[1] < SETTLED:
            return None
        if self._placing is not None and self._placing.is_alive():
            return None
        T, self._registration = self._registration[0], None
        if np.abs(self._session.scene.T_base_mesh - T).max() <= 1e-5:
            return None
        report = self._session.devices
        if report is not None and report.arm.url != "sim" and report.state == "ENABLED":
            return self._refuse("a registration is taken while the arm is disabled")
        self._placing = threading.Thread(target=self._change, args=(T,), name="registration")
        self._placing.start()
        return None

    def _change(self, T: NDArray[np.float64]) -> None:
        R = T[:3, :3]
        y = math.asin(min(max(-R[2, 0], -1.0), 1.0))
        turn = (math.atan2(R[2, 1], R[2, 2]), y, math.atan2(R[1, 0], R[0, 0]))
        x, y, z = T[:3, 3].tolist()
        try:
            self._session.change(at=(x, y, z), rotate=turn, up="z")
            log.warning("igtl: the mesh was placed by a registration")
        except ValueError as error:
            self._refuse(str(error))

    def _refuse(self, why: str) -> None:
        if why != self.refused:
            log.warning("igtl: refused: %s", why)
        self.refused = why

    def _tell(self) -> None:
        telemetry, scene = self._session.latest(), self._session.scene
        if not self._clients:
            return
        messages = []
        if telemetry.step is not None:
            messages.append(wire.transform(TOOL, telemetry.step.tip.homogeneous))
        if telemetry.target is not None:
            messages.append(wire.transform(GOAL, telemetry.target.homogeneous))
        report = self._session.devices
        messages.append(wire.string(STATE, "ENABLED" if report is None else report.state))
        if self._structures[0] != scene.version:
            names = [str(own.name) for own in self._session.options.anatomy]
            shown = [(scene.vertices_shown, scene.faces_shown)]
            shown += [(one.vertices_shown, one.faces_shown) for one in scene.structures]
            self._structures = (
                scene.version,
                [
                    wire.polydata(name, vertices, faces)
                    for name, (vertices, faces) in zip(names, shown, strict=True)
                ],
            )
        for client in self._clients:
            if client.scene != scene.version:
                client.scene = scene.version
                client.waiting += b"".join(self._structures[1])
            elif len(client.waiting) < BACKLOG:
                client.waiting += b"".join(messages)

    def _write(self, client: _Client) -> None:
        try:
            sent = client.link.send(client.waiting[: 1 << 18])
        except BlockingIOError:
            return
        except OSError as error:
            with contextlib.suppress(ValueError):
                self._leave(client, str(error))
            return
        del client.waiting[:sent]


def server_of(session: Session) -> Server | None:
    """The server of a session whose master is one of OpenIGTLink; None: it is not.

    Raises:
        OptionError: it cannot listen there.
    """
    address = parse_address("master", session.options.master)
    return Server(session, address) if address.scheme == "igtl" else None


def _pose(T: NDArray[np.float64]) -> pin.SE3:
    return pin.SE3(T[:3, :3].copy(), T[:3, 3].copy())


def _close(tool: pin.SE3, pose: pin.SE3) -> bool:
    if math.dist(tool.translation, pose.translation) > FIRST[0]:
        return False
    return math.hypot(*pin.log3(tool.rotation.T @ pose.rotation)) <= FIRST[1]

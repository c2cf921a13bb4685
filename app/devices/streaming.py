"""Shapes that come from elsewhere, handed to the structure of the scene that is in force."""

from __future__ import annotations

from app.control.host import Host
from app.devices.report import LinkReport
from app.devices.sockets.frames import FrameServer
from app.kinds.links import parse_address
from app.motion.movement import streamed
from app.motion.stream import Single
from app.scene.scene import Scene


class Streaming:
    """Listens where the motions of a scene say, if any; for one thread at a time."""

    def __init__(self, host: Host) -> None:
        self._host = host
        self._server: FrameServer | None = None

    @property
    def report(self) -> LinkReport | None:
        """How the shapes came last; None: none are to come."""
        server = self._server
        return None if server is None else server.report

    def attend(self, scene: Scene) -> None:
        """Hand shapes to this scene's structure from now on.

        Raises:
            OptionError: it cannot be listened for them there; the scene before stays attended.
        """
        form = streamed(scene.courses)
        if form is None:
            self.close()
            return
        stream = form.stream

        def show(vertices: Single, late: float) -> bool:
            return self._host.show(stream, vertices, late)

        address = parse_address("stream", stream.address)
        server = self._server
        if server is None or server.asked != address:
            server = FrameServer(address)
            server.aim(show, form.count, stream.bound)
            server.start()
            self.close()
            self._server = server
        server.aim(show, form.count, stream.bound)

    def close(self) -> None:
        """Listen no more. Safe to call twice."""
        server, self._server = self._server, None
        if server is not None:
            server.close()

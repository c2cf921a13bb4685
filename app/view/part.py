"""Interface of the parts of the page."""

from __future__ import annotations

import viser

from app.scene.moment import Moment
from app.scene.scene import Scene

Clients = dict[int, viser.ClientHandle]


class Part:
    """A part of the page, listed in `app.view.page`. All calls come from the view thread.

    A part overrides the methods that it needs.
    """

    def set_scene(self, scene: Scene) -> None:
        """Called with the first scene, and whenever the mesh or robot has changed."""

    def frame(self, shown: Moment, clients: Clients) -> None:
        """Called about 25 times a second while a client is connected, inside `server.atomic()`.

        Args:
            shown: the newest tick of the session or of a replay; of the scene that is drawn.
            clients: the connected clients by number.
        """

    def read_out(self, shown: Moment) -> None:
        """Called up to 4 times a second while a client is connected, inside `server.atomic()`."""

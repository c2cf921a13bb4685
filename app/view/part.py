"""A part of the page: what follows the scene, the ticks or the read-outs."""

from __future__ import annotations

import viser

from app.recording.playback import Moment
from app.scene.scene import Scene

Clients = dict[int, viser.ClientHandle]


class Part:
    """One of the parts that `app.view.page` lists. All calls come from the view thread.

    What a part has no use for it leaves out.
    """

    def set_scene(self, scene: Scene) -> None:
        """Another mesh or robot is about to be drawn; called once at the start as well."""

    def frame(self, shown: Moment, clients: Clients) -> None:
        """Some 25 times a second while somebody watches, inside `server.atomic()`.

        Args:
            shown: the session's newest tick, or a replay's; of the scene that is drawn.
            clients: those who look on, by their numbers.
        """

    def read_out(self, shown: Moment) -> None:
        """Up to 4 times a second while somebody watches, inside `server.atomic()`."""

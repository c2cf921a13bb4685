"""The clients' cameras: moved to what is to be seen, after the tool, and told near from far."""

from __future__ import annotations

import numpy as np
import viser

from app.recording.playback import Moment
from app.scene.scene import Scene
from app.view import camera
from app.view.client_input import Notify
from app.view.part import Clients, Part
from app.view.source import Source


class Cameras(Part):
    """Moves cameras, each client's for itself.

    Attributes:
        following: whose cameras follow the tool.
    """

    def __init__(self, server: viser.ViserServer, source: Source, notify: Notify) -> None:
        self._server, self._source, self._notify = server, source, notify
        self.following = camera.Following()
        self._composed = False

    def set_scene(self, scene: Scene) -> None:
        """Look at another scene."""
        view = camera.site_view(scene, scene.T_base_start.translation)
        camera.set_initial_camera(self._server, view)
        if self._composed:
            for client_id, client in self._server.get_clients().items():
                self.following.stop(client_id)
                camera.move(client, view)
        self._composed = True

    def frame(self, shown: Moment, clients: Clients) -> None:
        """Go along with the tool, and keep near and far apart."""
        self.following.update(clients, np.array(shown.tip.translation))
        for client in clients.values():
            camera.update_clipping(client)

    def look(self, client: viser.ClientHandle, name: str) -> None:
        """Move a client's camera to a view by its name; "Follow" also goes along, or stops that."""
        shown = self._source.shown
        step = shown.telemetry.step
        followed = client.client_id in self.following.clients
        self.following.stop(client.client_id)
        if name == "Follow" and followed:
            return
        camera.move(client, camera.named_view(name, shown.scene, step))
        if name == "Follow" and step is not None:
            self.following.start(client.client_id, np.array(step.tip.translation))
            self._notify(client, "The camera follows the tool. Follow again, or F, lets it stand.")

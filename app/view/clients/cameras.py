"""The clients' cameras: named views, following the tool, clipping planes."""

from __future__ import annotations

import numpy as np
import viser

from app.scene.moment import Moment
from app.scene.scene import Scene
from app.view import camera
from app.view.clients.client_input import Notify
from app.view.part import Clients, Part
from app.view.source import Source


class Cameras(Part):
    """Moves each client's camera.

    Attributes:
        following: the cameras that follow the tool.
    """

    def __init__(self, server: viser.ViserServer, source: Source, notify: Notify) -> None:
        self._server, self._source, self._notify = server, source, notify
        self.following = camera.Following()
        self._composed = False

    def set_scene(self, scene: Scene) -> None:
        view = camera.site_view(scene, scene.T_base_start.translation)
        camera.set_initial_camera(self._server, view)
        if self._composed:
            for client_id, client in self._server.get_clients().items():
                self.following.stop(client_id)
                camera.move(client, view)
        self._composed = True

    def frame(self, shown: Moment, clients: Clients) -> None:
        self.following.update(clients, np.array(shown.tip.translation))
        for client in clients.values():
            camera.update_clipping(client)

    def look(self, client: viser.ClientHandle, name: str) -> None:
        """Move a client's camera to a named view; "Follow" also starts or stops following."""
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

"""The button that starts the control loop again after it ended."""

from __future__ import annotations

from typing import Any

import viser

from app.scene.moment import Moment
from app.session import Session
from app.view.clients.client_input import ClientInput
from app.view.part import Part

LABEL = "Restart control"


class Restart(Part):
    """There only while the control loop has ended by itself."""

    def __init__(
        self,
        server: viser.ViserServer,
        session: Session,
        client_input: ClientInput,
        order: float,
    ) -> None:
        """`order`: position in the panel of controls."""
        self._server, self._session, self._input = server, session, client_input
        self._order = order
        self._button: Any = None

    def read_out(self, shown: Moment) -> None:
        ended = bool(self._session.ended)
        if ended and self._button is None:
            self._button = self._add()
        elif not ended and self._button is not None:
            self._button.remove()
            self._button = None

    def _add(self) -> Any:
        button = self._server.gui.add_button(
            LABEL,
            order=self._order,
            color="red",
            hint="The tool holds where it was; mesh, settings and handle are as they were.",
        )

        @button.on_click
        async def _clicked(event: viser.GuiEvent[Any]) -> None:
            button.disabled = True

            def restart(_client: viser.ClientHandle | None) -> None:
                try:
                    self._session.restart()
                finally:
                    if self._button is button:
                        button.disabled = False

            self._input.submit(restart, event.client)

        return button

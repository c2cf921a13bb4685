"""What the page gives its parts (inspector, signals, recorder …) to build on."""

from __future__ import annotations

from dataclasses import dataclass

import viser

from app.scenarios.file import Scenario
from app.scene.library import Library
from app.session import Session
from app.view.clients.cameras import Cameras
from app.view.clients.client_input import ClientInput, Notify
from app.view.clients.escape import EscapeKey
from app.view.clients.uploads import Uploads
from app.view.drawing.anatomy import Anatomy
from app.view.drawing.fixture import FixtureDrawing
from app.view.drawing.labels import Labels
from app.view.drawing.proxy import Proxy
from app.view.source import Source


@dataclass(frozen=True)
class PageContext:
    """What a part of the page is built on.

    Attributes:
        server: a part adds its nodes and controls to it once, when it is built.
        session: receives the operator's orders through `client_input.submit`.
        client_input: `submit(order, *arguments)` runs orders in sequence, off the event loop.
        notify: shows a notification on one client's page.
        left: the left-hand panel, for further tabs (`left.add_tab`). Folders added through
            `server.gui` appear in the panel of controls on the right.
        fixture: the planes at the tool; a part may suppress them.
        proxy: the operator's gizmo; a part may suppress it.
        cameras: moves a client's camera.
        escape: registry of open dialogs for the Escape key.
        source: what the page shows; a replay overrides it.
        labels: the texts in the scene.
        library: the mesh files that can be chosen.
        uploads: receives the files of upload buttons.
        anatomy: the drawn structures, with a switch of each.
        scenario: what the page was started with, if anything.
    """

    server: viser.ViserServer
    session: Session
    client_input: ClientInput
    notify: Notify
    left: viser.PanelHandle
    fixture: FixtureDrawing
    proxy: Proxy
    cameras: Cameras
    escape: EscapeKey
    source: Source
    labels: Labels
    library: Library
    uploads: Uploads
    anatomy: Anatomy
    scenario: Scenario | None = None

"""What the page offers to a part of it: inspector, signals, recorder and the like."""

from __future__ import annotations

from dataclasses import dataclass

import viser

from app.scenarios.file import Scenario
from app.scene.library import Library
from app.session import Session
from app.view.cameras import Cameras
from app.view.escape import Escape
from app.view.fixture import FixtureDrawing
from app.view.hand import Hand, Tell
from app.view.labels import Labels
from app.view.proxy import Proxy
from app.view.screen import Screen
from app.view.uploads import Uploads


@dataclass(frozen=True)
class PageContext:
    """What a part of the page is built on.

    Attributes:
        server: the viser server; nodes and controls are added to it once, when the part is built.
        session: what the operator does goes there, through `hand.submit`.
        hand: `hand.submit(order, *arguments)` runs an order in sequence, off the event loop.
        tell: a notification on one client's page.
        left: the panel of read-outs; a part may add a tab to it (`left.add_tab`). Folders added
            through `server.gui` appear in the panel of controls on the right.
        fixture: the planes at the tool, which a part may ask to step back.
        proxy: the operator's gizmo, likewise.
        cameras: moves a client's camera.
        escape: what the Escape key closes; dialogs of a part say there that they are open.
        screen: what is shown; a part may put something else there than the session.
        labels: whatever is written in the scene.
        library: the mesh files that can be chosen.
        uploads: takes files that come through a part's upload button.
        scenario: what the page was started with, if anything.
    """

    server: viser.ViserServer
    session: Session
    hand: Hand
    tell: Tell
    left: viser.PanelHandle
    fixture: FixtureDrawing
    proxy: Proxy
    cameras: Cameras
    escape: Escape
    screen: Screen
    labels: Labels
    library: Library
    uploads: Uploads
    scenario: Scenario | None = None

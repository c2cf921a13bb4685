"""The page: viser server, scene layers, panel, and the one thread that updates them."""

from __future__ import annotations

import logging
import socket
import threading
import time
from collections.abc import Callable
from functools import partial

import numpy as np
import viser
from numpy.typing import NDArray

from app.control.loop import VIEW_PRIORITY, prefer_this_thread
from app.recording.playback import Moment
from app.scenarios.file import Scenario
from app.scene.library import Library
from app.session import Session
from app.view import guard, light, style, who
from app.view.anatomy import Anatomy
from app.view.arm import ArmDrawing
from app.view.cameras import Cameras
from app.view.context import PageContext
from app.view.corridor import CorridorControl
from app.view.crossing import CrossingMark
from app.view.escape import Escape
from app.view.fixture import FixtureDrawing
from app.view.hand import Hand
from app.view.inspector import InspectorTab
from app.view.keys import Keys
from app.view.labels import Labels
from app.view.mesh_tab import MeshTab
from app.view.panel import BANNER, WHO, Panel
from app.view.part import Part
from app.view.proxy import Proxy
from app.view.readout_panel import ReadoutPanel
from app.view.recorder import RecordTab
from app.view.ruler import Rulers
from app.view.scenarios import ScenarioChoice
from app.view.screen import Screen
from app.view.section import Section
from app.view.signals import Signals
from app.view.tool import Tool
from app.view.uploads import Uploads
from app.view.views import Views

log = logging.getLogger(__name__)

# From one update of the scene to the next [s]. One costs the interpreter some 10 ms while all of it
# moves (viser compares and packs each node), next to nothing while nothing does.
FRAME = 1.0 / 25.0
BREATH = 0.008  # left to others between two updates, however long they take [s]
READOUT = 0.25  # between two updates of the read-outs [s]
# A drag is shown at once, after so long: the control thread has then had its ticks [s].
PROMPT = 0.004


class Page:
    """What browsers see of a session. Close it before the session.

    The view thread reads `session.latest()`, `1 / FRAME` times a second and once more after each
    message of a drag, and writes viser's nodes, which costs the interpreter some 0.1 ms each: only
    what changed, and nothing while nobody watches. The control thread is never asked anything.
    """

    def __init__(
        self,
        session: Session,
        host: str = "127.0.0.1",
        port: int = 8080,
        scenario: Scenario | None = None,
    ) -> None:
        """Start serving at once.

        Args:
            host: only those who show the token in `url` are let in, unless it is a loopback one.
            port: taken as given; 0 takes a free one. The caller has made sure that the host can
                be bound: viser hangs on one that cannot.
            scenario: what the session begins with, to be told and seen as it wants.

        Raises:
            OSError: the port is taken.
        """
        self._session = session
        self._host = host
        self._token = guard.token_for(host)
        with guard.quiet_console():
            self._server = guard.serve(host, port, self._token, label="vf-sandbox", verbose=False)
        server, api = self._server, self._server.scene
        style.colour(server.gui, dark=False)
        light.shine(api)
        self._screen = Screen(session)
        self._scene_version = -1
        self._anatomy = Anatomy(api)
        self._labels = Labels(server)
        self._rulers = Rulers(api, self._labels)
        self._arm = ArmDrawing(api)
        self._fixture = FixtureDrawing(api, self._labels)
        self._tool = Tool(api, self._labels)
        self._crossing = CrossingMark(api, self._labels)
        self._proxy = Proxy(api, self._labels, session.handle)
        self._hand = Hand(session, server, self._proxy, self._tell)
        self._cameras = Cameras(server, self._screen, self._tell)
        self._section = Section(self._anatomy)
        escape, library = Escape(server, self._hand), Library()
        panel = Panel(
            server,
            session,
            self._hand,
            self._tell,
            escape,
            self._add_views,
            self._screen,
            library,
        )
        self._who = who.Who(lambda: self._hand.owner, WHO)
        Keys(server, session, self._hand, self._tell, self._views.commands())
        server.gui.main_panel.dock_right()
        server.gui.main_panel.set_width(345)
        left = ReadoutPanel(server, session, self._screen, BANNER)
        context = PageContext(
            server,
            session,
            self._hand,
            self._tell,
            left.panel,
            self._fixture,
            self._proxy,
            self._cameras,
            escape,
            self._screen,
            self._labels,
            library,
            Uploads(server, self._tell),
            scenario,
        )
        # In the order they are called.
        self._parts: tuple[Part, ...] = (
            self._anatomy,
            self._rulers,
            self._arm,
            self._fixture,
            self._tool,
            self._proxy,
            self._crossing,
            self._cameras,
            self._section,
            self._who,
            left,
            panel,
            ScenarioChoice(context),
            Signals(context),
            InspectorTab(context),
            MeshTab(context),
            CorridorControl(context),
            RecordTab(context),
            self._labels,  # after all that set theirs
        )

        self._frame()  # the first client finds everything in place
        self._read_out()
        self._stop = threading.Event()
        # What the browser is told must not wait for the browser's drawing: while one of these two
        # threads is put aside with the interpreter in its hands, the control thread waits for it.
        self._server.get_event_loop().call_soon_threadsafe(prefer_this_thread, VIEW_PRIORITY)
        self._thread = threading.Thread(target=self._run, name="view", daemon=True)
        self._thread.start()

    @property
    def port(self) -> int:
        """The port really taken."""
        return int(self._server.get_port())

    @property
    def url(self) -> str:
        """Where to point a browser."""
        host = "127.0.0.1" if self._host in ("0.0.0.0", "::", "") else self._host
        return self._address(host)

    @property
    def warning(self) -> str:
        """What it means that others can reach the page, for whoever started it; or nothing."""
        if self._token is None:
            return ""
        return (
            f"The page listens on {self._host}: anybody with the address above, token included, "
            "can move the simulated tool, change its settings, and upload and delete files of the "
            "page, unencrypted. "
            "Without the token nobody is let in. "
            f"From other machines: {self._address(socket.gethostname())}"
        )

    def _address(self, host: str) -> str:
        name = f"[{host}]" if ":" in host else host
        shown = "" if self._token is None else f"/?token={self._token}"
        return f"http://{name}:{self.port}{shown}"

    @property
    def server(self) -> viser.ViserServer:
        """The viser server, for tests and for taking pictures."""
        return self._server

    @property
    def gizmo_pose(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """The gizmo as the server has it: wxyz (4,), position (3,) in scene units."""
        return np.array(self._proxy.gizmo.wxyz), np.array(self._proxy.gizmo.position)

    @property
    def shown(self) -> Moment:
        """What was drawn last: the session as it ran, or a replay."""
        return self._screen.shown

    @property
    def dragging(self) -> bool:
        """Whether some client has the gizmo in its hand."""
        return self._hand.dragging

    def told(self, client_id: int) -> str:
        """What that client is told about who has the proxy, as HTML; empty: nothing."""
        return self._who.told(client_id)

    def close(self) -> None:
        """Stop the view thread and the server. Safe to call twice."""
        if self._stop.is_set():
            return
        self._stop.set()
        self._hand.moved.set()
        self._thread.join()
        self._hand.close()
        with guard.quiet_console():
            self._server.stop()

    def _run(self) -> None:
        prefer_this_thread(VIEW_PRIORITY)
        due = began = time.monotonic()
        while not self._stop.is_set():
            self._stop.wait(BREATH)
            if self._hand.moved.wait(max(began + FRAME - time.monotonic(), 0.0)):
                self._stop.wait(PROMPT)
                self._hand.moved.clear()
            began = time.monotonic()
            try:
                if not self._server.get_clients():
                    self._hand.tend(None, False)
                    continue
                self._frame()
                if time.monotonic() >= due:
                    due = time.monotonic() + READOUT
                    self._read_out()
            except Exception:
                # One bad frame (a node removed under our hands) must not end the picture.
                if self._stop.is_set():
                    return
                log.exception("a frame of the page failed")
                self._stop.wait(1.0)

    def _frame(self) -> None:
        """Bring the scene up to the newest tick."""
        shown = self._screen.now()
        scene, telemetry = shown.scene, shown.telemetry
        with self._server.atomic():
            if scene.version != self._scene_version:
                for part in self._parts:
                    part.set_scene(scene)
                self._scene_version = scene.version
            self._hand.tend(telemetry.target, telemetry.autopilot)
            if telemetry.scene != scene.version:
                return  # the loop has not swapped yet
            clients = self._server.get_clients()
            for part in self._parts:
                part.frame(shown, clients)

    def _read_out(self) -> None:
        shown = self._screen.now()
        with self._server.atomic():
            for part in self._parts:
                part.read_out(shown)

    def _tell(self, client: viser.ClientHandle | None, text: str) -> None:
        """A notification on one client's page."""
        if client is not None and client.client_id in self._server.get_clients():
            client.add_notification("vf-sandbox", text, color="orange", auto_close_seconds=6.0)

    def _add_views(self) -> None:
        self._views = Views(
            self._server, self._hand, self._cameras.look, self._section.toggle, self._layers()
        )

    def _layers(self) -> dict[str, tuple[bool, Callable[[bool], None]]]:
        """The layer switches, by their names in the panel, and whether they start switched on."""
        fixture = self._fixture

        def names(on: bool) -> None:
            self._proxy.show_labels(on)
            self._rulers.show(on)

        return {
            "Anatomy": (True, self._anatomy.show),
            "See-through": (False, self._anatomy.set_translucent),
            "Arm": (True, self._arm.show),
            "Motion sphere": (True, partial(setattr, fixture, "show_sphere")),
            "Planes": (True, partial(setattr, fixture, "show_planes")),
            "Normals": (True, partial(setattr, fixture, "show_normals")),
            "Triangles": (True, partial(setattr, fixture, "show_triangles")),
            "Force": (True, self._tool.show_force),
            "Tether": (True, self._proxy.show_tether),
            "Labels": (True, names),
        }

"""The page: viser server, parts, and the one thread that updates them."""

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

from app.control.priority import VIEW_PRIORITY, raise_thread_priority
from app.scenarios.file import Scenario
from app.scene.library import Library
from app.scene.moment import Moment
from app.session import Session
from app.view import guard, style
from app.view.clients import client_names
from app.view.clients.cameras import Cameras
from app.view.clients.client_input import ClientInput
from app.view.clients.escape import EscapeKey
from app.view.clients.grab import Grab
from app.view.clients.uploads import Uploads
from app.view.context import PageContext
from app.view.controls.corridor import CorridorControl
from app.view.controls.feel import Feel
from app.view.controls.keys import Keys
from app.view.controls.margins import MarginLegend
from app.view.controls.motion import MotionControl
from app.view.controls.panel import BANNER, CLIENTS, DEVICES, MARGINS, RESTART, Panel
from app.view.controls.restart import Restart
from app.view.controls.scenarios import ScenarioChoice
from app.view.controls.views import Views
from app.view.device_lamps import DeviceLamps
from app.view.drawing import nodes
from app.view.drawing.anatomy import Anatomy
from app.view.drawing.arm import ArmDrawing
from app.view.drawing.crossing import CrossingMark
from app.view.drawing.fixture import FixtureDrawing
from app.view.drawing.instrument import Instrument
from app.view.drawing.labels import Labels
from app.view.drawing.proxy import Proxy
from app.view.drawing.ruler import Rulers
from app.view.drawing.section import Section
from app.view.drawing.tool import Tool
from app.view.inspector import InspectorTab
from app.view.part import Part
from app.view.slow_motion import SlowMotion
from app.view.source import Source
from app.view.tabs.mesh_tab import MeshTab
from app.view.tabs.readout_panel import ReadoutPanel
from app.view.tabs.recorder import RecordTab
from app.view.tabs.signals import Signals

log = logging.getLogger(__name__)

READOUT_PERIOD = 0.25  # of the read-outs' updates [s]


class Page:
    """Serves a session to browsers. Close it before the session.

    The view thread reads `session.latest()` 25 times a second and after each message of a drag,
    and writes viser's nodes, which takes about 0.1 ms each: only those that changed, and only while
    a client is connected. It never waits for the control thread.
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
            host: unless it is a loopback address, clients need the token in `url`.
            port: 0 takes a free one. The caller ensures that the host can be bound: viser blocks
                on one that cannot.
            scenario: what the session was started with, for its description and camera.

        Raises:
            OSError: the port is taken.
        """
        self._session = session
        self._host = host
        self._token = guard.token_for(host)
        with guard.quiet_console():
            self._server = guard.serve(host, port, self._token, label="vf-sandbox", verbose=False)
        server, api = self._server, self._server.scene
        style.set_theme(server.gui, dark=False)
        nodes.add_lights(api)
        self._source = Source(session)
        self._scene_version = -1
        self._anatomy = Anatomy(api)
        self._labels = Labels(server)
        self._rulers = Rulers(api, self._labels)
        self._fixture = FixtureDrawing(api, self._labels)
        self._instrument = Instrument(api)
        self._tool = Tool(api, self._labels)
        self._crossing = CrossingMark(api, self._labels)
        self._proxy = Proxy(api, self._labels, session.handle)
        self._input = ClientInput(session, server, self._proxy, self._notify)
        by_hand = lambda: bool(self._proxy.gizmo.visible)  # noqa: E731
        grab = Grab(session, self._source, self._input, self._notify, by_hand)
        self._arm = ArmDrawing(api, grab.attach)
        self._cameras = Cameras(server, self._source, self._notify)
        self._section = Section(self._anatomy)
        escape, library = EscapeKey(server, self._input), Library()
        panel = Panel(
            server,
            session,
            self._input,
            self._notify,
            escape,
            self._add_views,
            self._source,
            library,
        )
        self._client_lines = client_names.ClientLines(lambda: self._input.owner, CLIENTS)
        Keys(server, session, self._input, self._notify, self._views.commands())
        server.gui.main_panel.dock_right()
        server.gui.main_panel.set_width(345)
        left = ReadoutPanel(server, session, self._source, BANNER)
        context = PageContext(
            server,
            session,
            self._input,
            self._notify,
            left.panel,
            self._fixture,
            self._proxy,
            self._cameras,
            escape,
            self._source,
            self._labels,
            library,
            Uploads(server, self._notify),
            self._anatomy,
            scenario,
        )
        feel = Feel(context, grab)
        # They are called in this order.
        self._parts: tuple[Part, ...] = (
            self._anatomy,
            self._rulers,
            self._arm,
            self._fixture,
            self._instrument,
            self._tool,
            self._proxy,
            self._crossing,
            self._cameras,
            self._section,
            self._client_lines,
            left,
            MarginLegend(server, self._anatomy, MARGINS),
            Restart(server, session, self._input, RESTART),
            DeviceLamps(server, session, self._input, DEVICES),
            panel,
            ScenarioChoice(context),
            Signals(context),
            InspectorTab(context),
            MeshTab(context),
            CorridorControl(context),
            MotionControl(context),
            feel,
            SlowMotion(context, feel.folder),
            RecordTab(context),
            self._labels,  # after all parts that change a label
        )

        self._frame()  # complete before the first client connects
        self._read_out()
        self._stop = threading.Event()
        # Raised priority for the server's and the view thread, so that a drag does not wait for the
        # browser's rendering on the same cores.
        self._server.get_event_loop().call_soon_threadsafe(raise_thread_priority, VIEW_PRIORITY)
        self._thread = threading.Thread(target=self._run, name="view", daemon=True)
        self._thread.start()

    @property
    def port(self) -> int:
        """The port in use."""
        return int(self._server.get_port())

    @property
    def url(self) -> str:
        """The address for a browser on this machine, with the token."""
        host = "127.0.0.1" if self._host in ("0.0.0.0", "::", "") else self._host
        return self._address(host)

    @property
    def warning(self) -> str:
        """Warning if other machines can reach the page; else empty."""
        if self._token is None:
            return ""
        return (
            f"The page listens on {self._host}: anybody with the address above, token included, "
            "can move the simulated tool, change its settings, and upload and delete files of the "
            "page, unencrypted. "
            "Without the token access is refused. "
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
        """The gizmo's pose on the server: wxyz (4,), position (3,) in scene units."""
        return np.array(self._proxy.gizmo.wxyz), np.array(self._proxy.gizmo.position)

    @property
    def shown(self) -> Moment:
        """What was drawn last, of the session or of a replay."""
        return self._source.shown

    @property
    def dragging(self) -> bool:
        """Whether a client drags the gizmo."""
        return self._input.owner is not None

    def client_line(self, client_id: int) -> str:
        """HTML line about who drags the proxy, on one client's panel."""
        return self._client_lines.text(client_id)

    def close(self) -> None:
        """Stop the view thread and the server. Safe to call twice."""
        if self._stop.is_set():
            return
        self._stop.set()
        self._input.moved.set()
        self._thread.join()
        self._input.close()
        with guard.quiet_console():
            self._server.stop()

    def _run(self) -> None:
        raise_thread_priority(VIEW_PRIORITY)
        due = began = time.monotonic()
        while not self._stop.is_set():
            began = self._input.wait_for_frame(began, self._stop)
            try:
                if not self._server.get_clients():
                    self._input.update(None, False)
                    continue
                self._frame()
                if time.monotonic() >= due:
                    due = time.monotonic() + READOUT_PERIOD
                    self._read_out()
            except Exception:
                # A failed frame, for instance of a node removed meanwhile, must not end the thread.
                if self._stop.is_set():
                    return
                log.exception("a frame of the page failed")
                self._stop.wait(1.0)

    def _frame(self) -> None:
        """Draw the newest tick."""
        shown = self._source.now()
        scene, telemetry = shown.scene, shown.telemetry
        with self._server.atomic():
            if scene.version != self._scene_version:
                for part in self._parts:
                    part.set_scene(scene)
                self._scene_version = scene.version
            self._input.update(telemetry.target, telemetry.autopilot)
            if telemetry.scene != scene.version:
                return  # the control loop still runs the previous scene
            clients = self._server.get_clients()
            for part in self._parts:
                part.frame(shown, clients)

    def _read_out(self) -> None:
        shown = self._source.now()
        with self._server.atomic():
            for part in self._parts:
                part.read_out(shown)

    def _notify(self, client: viser.ClientHandle | None, text: str) -> None:
        """Show a notification on one client's page."""
        if client is not None and client.client_id in self._server.get_clients():
            client.add_notification("vf-sandbox", text, color="orange", auto_close_seconds=6.0)

    def _add_views(self) -> None:
        self._views = Views(
            self._server, self._input, self._cameras.look, self._section.toggle, self._layers()
        )

    def _layers(self) -> dict[str, tuple[bool, Callable[[bool], None]]]:
        """By name in the panel: the initial value of a layer switch, and its setter."""
        fixture = self._fixture

        def names(on: bool) -> None:
            self._proxy.show_labels = on
            self._rulers.show(on)

        return {
            "Anatomy": (True, self._anatomy.show),
            "See-through": (False, self._anatomy.set_translucent),
            "Margins": (True, self._anatomy.show_margins),
            "Ghosts": (True, self._anatomy.show_ghosts),
            "Arm": (True, self._arm.show),
            "Capsules": (False, partial(setattr, self._instrument, "show")),
            "Motion sphere": (True, partial(setattr, fixture, "show_sphere")),
            "Planes": (True, partial(setattr, fixture, "show_planes")),
            "Normals": (True, partial(setattr, fixture, "show_normals")),
            "Triangles": (True, partial(setattr, fixture, "show_triangles")),
            "Force": (True, partial(setattr, self._tool, "show_force")),
            "Tether": (True, partial(setattr, self._proxy, "show_tether")),
            "Labels": (True, names),
        }

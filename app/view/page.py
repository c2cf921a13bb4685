"""The page: viser server, scene layers, panel, and the one thread that updates them."""

from __future__ import annotations

import logging
import socket
import threading
import time
from collections.abc import Callable
from functools import partial

import numpy as np
import pinocchio as pin
import viser
from numpy.typing import NDArray

from app.control.loop import VIEW_PRIORITY, prefer_this_thread
from app.control.messages import Telemetry
from app.control.watch import Crossing
from app.recording.playback import Moment
from app.scenarios.file import Scenario
from app.scene.library import Library
from app.scene.scene import Scene
from app.session import Session
from app.view import camera, guard, light, readouts, style, who
from app.view.anatomy import Anatomy
from app.view.arm import ArmDrawing
from app.view.corridor import CorridorControl
from app.view.crossing import CrossingMark
from app.view.escape import Escape
from app.view.feature import Feature, Maker, Stage
from app.view.fixture import FixtureDrawing
from app.view.hand import Hand
from app.view.inspector import InspectorTab
from app.view.keys import Keys
from app.view.labels import Labels
from app.view.measuring import Measuring
from app.view.mesh_tab import MeshTab
from app.view.panel import WHO, Panel, Readouts
from app.view.proxy import Proxy
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

# Parts of the page that stand on their own, in the order they are built.
FEATURES: tuple[Maker, ...] = (
    ScenarioChoice,
    Signals,
    InspectorTab,
    MeshTab,
    CorridorControl,
    RecordTab,
)


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
        self._following = camera.Following()
        self._escape = Escape(server, self._hand)
        self._section = Section(self._anatomy)
        library = Library()
        self._panel = Panel(
            server,
            session,
            self._hand,
            self._tell,
            self._escape,
            self._add_views,
            self._screen,
            library,
        )
        self._who = who.Who(server, WHO)
        Keys(server, session, self._hand, self._tell, self._views.commands())
        self._readouts = Readouts(server)
        server.gui.main_panel.dock_right()
        server.gui.main_panel.set_width(345)
        self._readouts.panel.dock_left()
        self._readouts.panel.set_width(290)
        stage = Stage(
            server,
            session,
            self._hand,
            self._tell,
            self._readouts.panel,
            self._fixture,
            self._proxy,
            self._look,
            self._escape,
            self._following,
            self._screen,
            self._labels,
            library,
            Uploads(server, self._tell),
            scenario,
        )
        self._features: list[Feature] = [make(stage) for make in FEATURES]

        self._measuring = Measuring()
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
        live = self._screen.live
        shown = self._screen.now()
        scene, options, telemetry = shown.scene, shown.options, shown.telemetry
        with self._server.atomic():
            if scene.version != self._scene_version:
                self._adopt(scene)
            self._hand.tend(telemetry.target, telemetry.autopilot)
            clients, owner = self._server.get_clients(), self._hand.owner
            self._who.update(owner)
            self._proxy.lock_rotation(options.lock_orientation)
            if telemetry.scene != scene.version:
                return  # the loop has not swapped yet
            self._arm.update(telemetry.q)
            step = telemetry.step
            if step is None:
                tip, force = scene.T_base_start, np.zeros(3)
            else:
                tip, force = step.tip, step.force
                self._fixture.update(step, scene.surface)
            self._tool.update(tip.translation, options.tip_radius, force)
            holder = self._hand.name_of_owner if owner is not None and len(clients) > 1 else ""
            handle = self._handle(telemetry) if live else None
            self._proxy.update(handle, telemetry.target, tip.translation, holder)
            self._crossing.update(self._crossing_of(scene) if live else None)
            eyes = [np.asarray(client.camera.position) for client in clients.values()]
            self._anatomy.look_through(eyes, np.array(tip.translation))
            self._following.update(clients, np.array(tip.translation))
            self._section.update(scene, clients, np.array(tip.translation))
            for client in clients.values():
                camera.keep_depth(client)
            for feature in self._features:
                feature.frame(telemetry)
            self._labels.place(clients)

    def _handle(self, telemetry: Telemetry) -> pin.SE3:
        """Where the gizmo is: in the autopilot's hand or in the operator's."""
        if telemetry.autopilot and telemetry.target is not None:
            return telemetry.target
        return self._session.handle

    def _crossing_of(self, scene: Scene) -> Crossing | None:
        """Where the session's tip crossed the mesh that is drawn."""
        crossing = self._session.crossing
        return crossing if crossing is not None and crossing.scene == scene.version else None

    def _adopt(self, scene: Scene) -> None:
        """Draw another scene, and look at it."""
        self._anatomy.set_scene(scene)
        self._rulers.set_scene(scene, camera.site_half_height(scene))
        self._arm.set_scene(scene)
        for feature in self._features:
            feature.set_scene(scene)
        view = camera.site_view(scene, scene.T_base_start.translation)
        camera.compose_first_sight(self._server, view)
        if self._scene_version >= 0:
            for client_id, client in self._server.get_clients().items():
                self._following.stop(client_id)
                camera.move(client, view)
        self._scene_version = scene.version

    def _read_out(self) -> None:
        shown = self._screen.now()
        options, telemetry = shown.options, shown.telemetry
        crossing = self._crossing_of(shown.scene) if self._screen.live else None
        extras = self._measuring.measure(shown, crossing, self._session.unwatched)
        if self._screen.live:
            banner = readouts.banner(telemetry, options, extras, shown.clutched)
        else:
            banner = readouts.note(self._screen.caption)
        with self._server.atomic():
            self._readouts.show(readouts.readouts(telemetry, options, extras))
            self._panel.set_banner(banner)
            self._panel.sync()
            for feature in self._features:
                feature.read_out(telemetry)

    def _look(self, client: viser.ClientHandle, name: str) -> None:
        """Move one client's camera to a preset; "Follow" also lets it go along, or stop that."""
        shown = self._screen.shown
        step = shown.telemetry.step
        followed = client.client_id in self._following.clients
        self._following.stop(client.client_id)
        if name == "Follow" and followed:
            return
        camera.move(client, camera.named_view(name, shown.scene, step))
        if name == "Follow" and step is not None:
            self._following.start(client.client_id, np.array(step.tip.translation))
            self._tell(client, "The camera follows the tool. Follow again, or F, lets it stand.")

    def _tell(self, client: viser.ClientHandle | None, text: str) -> None:
        """A notification on one client's page."""
        if client is not None and client.client_id in self._server.get_clients():
            client.add_notification("vf-sandbox", text, color="orange", auto_close_seconds=6.0)

    def _add_views(self) -> None:
        self._views = Views(
            self._server, self._hand, self._look, self._section.toggle, self._layers()
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

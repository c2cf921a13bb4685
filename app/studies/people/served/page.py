"""The page of a participant's trials: the scene, the task in a sentence, progress, one button."""

from __future__ import annotations

import html
import logging
import threading
import time
from typing import Any, cast

import viser

from app.control.priority import VIEW_PRIORITY, raise_thread_priority
from app.session import Session
from app.studies.people.hand import Hand
from app.studies.people.progress import Progress
from app.studies.people.served.drawing import GoalDrawing, view_of
from app.view import camera, guard, style
from app.view.clients.client_input import ClientInput
from app.view.clients.grab import Grab
from app.view.controls import feel
from app.view.drawing import nodes
from app.view.drawing.anatomy import Anatomy
from app.view.drawing.arm import ArmDrawing
from app.view.drawing.labels import Labels
from app.view.drawing.proxy import Proxy
from app.view.drawing.tool import Tool
from app.view.part import Part
from app.view.source import Source

log = logging.getLogger(__name__)

_STYLE = """<style>
.vf-task { padding: .2em .9em .4em; color: var(--vf-ink); font-size: 14.5px; line-height: 1.45; }
.vf-task h1 { font-size: 19px; line-height: 1.25; margin: .2em 0 .1em; }
.vf-task p { margin: .35em 0; } .vf-task .vf-soft { color: var(--vf-soft); font-size: 13px; }
.vf-bar { height: 10px; border-radius: 5px; background: var(--vf-plate); overflow: hidden; }
.vf-bar div { height: 100%; background: #009e73; border-radius: 5px; }
.vf-task a { display: block; text-align: center; padding: .6em; border-radius: 6px;
  font-weight: 600; background: #0072b2; color: #fff; text-decoration: none; margin: .5em 0; }
.vf-task a.vf-quiet { background: none; color: var(--vf-soft); font-weight: 400; font-size: 12.5px;
  padding: .2em; text-decoration: underline; }
</style>"""


class TrialPage:
    """Serves the trials of one participant. Nothing on it tells of the condition.

    Attributes:
        begin: set when the participant presses the button.
        sound: whether contact is heard.
        hidden: whether the tool cannot be moved now.
    """

    def __init__(self, session: Session, hand: Hand, host: str, port: int, front: str) -> None:
        """Start serving at once; `front`: address of the front page, for links back to it.

        Raises:
            OSError: the port is taken.
        """
        self._session, self._hand, self._front = session, hand, front
        self.token = guard.token_for(host)
        with guard.quiet_console():
            self._server = guard.serve(host, port, self.token, label="Study", verbose=False)
        server, api = self._server, self._server.scene
        style.set_theme(server.gui, dark=False)
        nodes.add_lights(api)
        self.begin = threading.Event()
        self.sound = False
        self.hidden = True
        self._progress: Progress | None = None
        self._text: tuple[str, str, str] = ("", "", "")
        self._said = ""
        self._scene_version = -1
        source = self._source = Source(session)
        labels = self._labels = Labels(server)
        proxy = self._proxy = Proxy(api, labels, hand.handle)
        proxy.show_labels = False
        tool = Tool(api, labels)
        tool.show_force = False
        as_session = cast(Session, hand)
        self._input = ClientInput(as_session, server, proxy, self._notify)
        grab = Grab(as_session, source, self._input, self._notify, lambda: not self.hidden)
        anatomy = Anatomy(api)
        anatomy.show_margins(False)
        self._parts: tuple[Part, ...] = (
            anatomy, ArmDrawing(api, grab.attach), tool, proxy, labels,
        )  # fmt: skip
        self._goal = GoalDrawing(api)
        gui = server.gui
        gui.main_panel.dock_right()
        gui.main_panel.set_width(330)
        gui.add_html(style.sheet() + _STYLE)
        self._senses = feel.Senses(gui, self._input, grab)
        self._panel: Any = gui.add_html("")
        self._button: Any = gui.add_button("Start", visible=False)
        self._below: Any = gui.add_html("")

        @self._button.on_click
        async def _pressed(_event: viser.GuiEvent[Any]) -> None:
            self.begin.set()

        self.tell("One moment", "The next task is being prepared.")
        self._stop = threading.Event()
        self._frame()
        self._thread = threading.Thread(target=self._run, name="view", daemon=True)
        self._thread.start()

    @property
    def port(self) -> int:
        """The port in use."""
        return int(self._server.get_port())

    @property
    def watched(self) -> bool:
        """Whether a browser is connected."""
        return bool(self._server.get_clients())

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

    def tell(
        self, title: str, text: str, below: str = "", button: str = "", link: str = ""
    ) -> None:
        """Say what is to be done.

        Args:
            below: in small letters.
            button: what the button says; empty: there is none.
            link: what the link to the front page says; empty: there is none.
        """
        self._text = title, text, below
        with self._server.atomic():
            self._button.visible = bool(button)
            self._button.label = button or "Start"
            way = f"<a href='{self._front}/go'>{html.escape(link)}</a>" if link else ""
            self._below.content = (
                f"<div class='vf-task'>{way}"
                f"<a class='vf-quiet' href='{self._front}/stop'>I do not want to go on</a></div>"
            )
        self._write()

    def prepare(self, progress: Progress) -> None:
        """Show a trial that has not begun, and bring all cameras to it."""
        self._progress = progress
        self._goal.show(progress.goal)
        view = view_of(progress.goal, self._session.scene.T_base_start.translation)
        camera.set_initial_camera(self._server, view)
        for client in self._server.get_clients().values():
            camera.move(client, view)

    def clear(self) -> None:
        """Show no trial."""
        self._progress = None
        self._goal.show(None)

    def _write(self) -> None:
        title, text, below = self._text
        share = 0.0 if self._progress is None else self._progress.share
        bar = f"<div class='vf-bar'><div style='width:{100 * share:.0f}%'></div></div>"
        said = (
            f"<div class='vf-task'><h1>{html.escape(title)}</h1><p>{html.escape(text)}</p>"
            f"{bar if self._progress is not None else ''}"
            f"<p class='vf-soft'>{html.escape(below)}</p></div>"
        )
        if said != self._said:
            self._said = said
            self._panel.content = said

    def _run(self) -> None:
        raise_thread_priority(VIEW_PRIORITY)
        began = time.monotonic()
        while not self._stop.is_set():
            began = self._input.wait_for_frame(began, self._stop)
            try:
                if self.watched:
                    self._frame()
                else:
                    self._input.update(None, False)
            except Exception:
                # A failed frame, for instance of a node removed meanwhile, must not end the thread.
                if self._stop.is_set():
                    return
                log.exception("a frame of the page failed")
                self._stop.wait(1.0)

    def _frame(self) -> None:
        shown = self._source.now()
        scene, telemetry = shown.scene, shown.telemetry
        with self._server.atomic():
            if scene.version != self._scene_version:
                for part in self._parts:
                    part.set_scene(scene)
                self._scene_version = scene.version
            self._proxy.suppressed = self.hidden
            self._input.update(telemetry.target, telemetry.autopilot)
            if telemetry.scene != scene.version:
                return
            clients = self._server.get_clients()
            for client in clients.values():
                camera.update_clipping(client)
            for part in self._parts:
                part.frame(shown, clients)
            if self._progress is not None:
                self._goal.frame(self._progress)
            self._write()
            self._senses.frame(shown, self.sound)

    def _notify(self, client: viser.ClientHandle | None, text: str) -> None:
        if client is not None and client.client_id in self._server.get_clients():
            client.add_notification("", text, color="orange", auto_close_seconds=6.0)

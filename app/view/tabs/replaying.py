"""Replay of a recording in place of the session, and its controls."""

from __future__ import annotations

import html
import math
import threading
from typing import Any

import numpy as np
import viser

from app.recording.format import Recording
from app.recording.playback import Player, Transport, build_scenes
from app.scene.moment import Moment
from app.scene.scene import Progress
from app.scene.worker import Stop
from app.view import camera
from app.view.context import PageContext
from app.view.source import Source
from app.view.units import VIEW_SCALE
from app.words import Refused

SPEEDS = {"1/10": 0.1, "1/4": 0.25, "1": 1.0, "2": 2.0, "8": 8.0}
FIRST_VERSION = 1_000_000  # of replayed scenes, above all versions of a session's scenes
ORDER = -1.5  # in the panel: between banner and help
BACK = "Back to the session"
SUSPENDED = f"a replay is shown, and the session waits: press “{BACK}” first"
STEPS = {"◀◀": -100, "◀": -1, "▶": 1, "▶▶": 100}

_STYLE = (
    "margin:0 .75em .4em;font-size:12px;line-height:1.35;color:var(--vf-ink);overflow-wrap:anywhere"
)


class Replaying:
    """Shows a recording to all clients.

    Meanwhile the session is suspended, and the panel shows the recorded settings, disabled. After
    the replay the session continues, and cameras that were moved to another scene are restored.
    """

    def __init__(self, context: PageContext) -> None:
        self._context, self._session = context, context.session
        self.replay: Replay | None = None
        self._opened = 0
        self._drawn: Replay | None = None  # the replay that the controls show
        self._views: dict[int, camera.View] = {}  # cameras before the replay, by client
        self._returning = False
        gui = context.server.gui
        with gui.add_folder("Replay", order=ORDER, visible=False) as self._folder:
            self._about = gui.add_html("")
            self._slider: Any = gui.add_slider(
                "Time [s]", min=0.0, max=1.0, step=1e-3, initial_value=0.0
            )
            self._play = gui.add_button("Play", icon=viser.Icon.PLAYER_PLAY)
            steps = gui.add_button_group("Ticks", tuple(STEPS), hint="By 1, or by 100.")
            self._speed: Any = gui.add_dropdown("Speed", tuple(SPEEDS), initial_value="1")
            back = gui.add_button(BACK, color="gray")

        @self._slider.on_update
        async def _scrub(event: viser.GuiEvent[Any]) -> None:
            replay, at = self.replay, event.target.value
            if event.client is not None and replay is not None and np.isfinite(at):
                replay.transport.seek(float(at))

        @self._play.on_click
        async def _toggle(_event: viser.GuiEvent[Any]) -> None:
            replay = self.replay
            if replay is not None:
                replay.transport.play(not replay.transport.playing)

        @steps.on_click
        async def _step(event: viser.GuiEvent[Any]) -> None:
            replay = self.replay
            if replay is not None:
                replay.transport.move(STEPS.get(str(event.target.value), 0))

        @self._speed.on_update
        async def _pace(event: viser.GuiEvent[Any]) -> None:
            replay, name = self.replay, str(event.target.value)
            if event.client is not None and replay is not None and name in SPEEDS:
                replay.transport.pace(SPEEDS[name])

        @back.on_click
        async def _back(_event: viser.GuiEvent[Any]) -> None:
            context.client_input.submit(self.leave)

        context.escape.add_fallback(self.leave)

    def show(self, name: str, recording: Recording, progress: Progress, stop: Stop) -> None:
        """Show a recording instead of the session or of another replay.

        Args:
            progress: called with a short text before each step.
            stop: of the session's work in progress.

        Raises:
            ValueError: the recording has no tick, its mesh is missing or has changed, or it was
                stopped; the page shows what it did before.
        """
        if not len(recording.rows):
            raise Refused("the recording holds no tick")
        if self._context.fixture.suppressed:
            raise Refused("leave “Freeze and explore” first (tab Inspector)")
        self._opened += 1
        version = FIRST_VERSION + 1000 * self._opened
        built = build_scenes(recording, version, self._session.scene, progress, stop)
        replay = Replay(name, Player(recording, built), self._context.source)
        replay.now()  # raises here rather than on the view thread
        if self.replay is None:
            self._session.suspend(SUSPENDED, stop)
            self._context.client_input.release()
            self._views = {
                client_id: camera.View(
                    np.array(client.camera.position) / VIEW_SCALE,
                    np.array(client.camera.look_at) / VIEW_SCALE,
                )
                for client_id, client in self._context.server.get_clients().items()
            }
        self.replay = replay
        self._context.source.override = replay.now

    def leave(self) -> bool:
        """Return to the session; whether a replay was shown."""
        if self.replay is None:
            return False
        shown = self._context.source.shown.scene
        self.replay = None
        self._context.source.override = None
        self._returning = shown.version != self._session.scene.version
        self._session.go_on()
        return True

    def frame(self) -> None:
        """From the view thread, after the scene is drawn: restore cameras after a replay."""
        if self._returning and self._context.source.live:
            self._returning = False
            for client_id, client in self._context.server.get_clients().items():
                if client_id in self._views:
                    camera.move(client, self._views[client_id])

    def read_out(self) -> None:
        """From the view thread: update the controls."""
        replay = self.replay
        if replay is not self._drawn:
            self._drawn = replay
            self._folder.visible = replay is not None
            if replay is not None:
                self._slider.max = max(math.ceil(replay.length * 1e3) / 1e3, 1e-3)
                self._speed.value = "1"
                self._about.content = replay.about()
        if replay is None:
            return
        at = replay.time()
        if abs(self._slider.value - at) > 5e-4:
            self._slider.value = round(at, 3)
        playing = replay.transport.playing
        label = "Pause replay" if playing else "Play"
        if self._play.label != label:
            self._play.label = label
            self._play.icon = viser.Icon.PLAYER_PAUSE if playing else viser.Icon.PLAYER_PLAY


class Replay:
    """A recording that is shown."""

    def __init__(self, name: str, player: Player, source: Source) -> None:
        rows = player.recording.rows
        self._name, self._player, self._source = name, player, source
        self._lock = threading.Lock()  # of the player
        self._times = (rows["tick"] - rows["tick"][0]) * player.recording.dt
        self.transport = Transport(self._times)

    @property
    def length(self) -> float:
        """Duration [s]."""
        return float(self._times[-1])

    def time(self) -> float:
        """Time since the first tick [s]."""
        return float(self._times[self.transport.row()])

    def about(self) -> str:
        """HTML description: name, gaps, and a note about the settings."""
        recording = self._player.recording
        note = f"It ended because {recording.note}." if recording.note else ""
        words = (
            f"{html.escape(f'{recording.cut} {note}'.strip())} The settings below are the "
            "recording’s; they can be changed again in the session."
        )
        return f"<div style='{_STYLE}'><b>{html.escape(self._name)}</b> {words}</div>"

    def now(self) -> Moment:
        """The current moment; also updates the banner's caption."""
        with self._lock:
            row = self.transport.row()
            moment = self._player.moment(row)
        self._source.caption = (
            f"Replay: tick {moment.telemetry.tick:,}, {self._times[row]:.2f} of "
            f"{self.length:.2f} s. The session waits."
        )
        return moment

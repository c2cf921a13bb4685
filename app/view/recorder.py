"""Tab "Record": keep a session in a file, play it, and take pictures for slides."""

from __future__ import annotations

import html
import io
import math
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import platformdirs
import viser
from numpy.typing import NDArray
from PIL import Image

from app.messages import Telemetry
from app.player import Moment, Player, Transport, build_scenes
from app.recording.format import SUFFIX
from app.recording.read import read
from app.scene import Scene
from app.session import Refused
from app.view import palette
from app.view.feature import Stage
from app.view.screen import Screen
from app.view.uploads import harmless

SPEEDS = {"1/10": 0.1, "1/4": 0.25, "1": 1.0, "2": 2.0, "8": 8.0}
MOST = 50  # recordings in the folder: who may click Record must not fill the disk
LARGEST = 200e6  # of a recording that a browser is sent [byte]
PICTURE = (720, 1280)  # height and width of pictures [px]
FRAMES, BETWEEN = 20, 0.2  # of an image sequence, and the time between two [s]
PATIENCE = 20.0  # for a browser to send a picture [s]
REPLAYED = 1_000_000  # versions of replayed scenes begin here; a session never gets that far
NONE = "–"

_STYLE = "margin:0 .75em .4em;font-size:12px;line-height:1.35"


def folder() -> Path:
    """Where the page keeps recordings."""
    return platformdirs.user_data_path("vf-sandbox") / "recordings"


class RecordTab:
    """Record, list, play, and take pictures.

    A replay is put on the screen instead of the session, for every client; the session is paused
    meanwhile and goes on as it was when the replay is left.
    """

    def __init__(self, stage: Stage) -> None:
        self._stage, self._session, self._tell = stage, stage.session, stage.tell
        self._busy = threading.Lock()  # opening a recording, or taking pictures
        self._replay: Replay | None = None
        self._resume = False  # whether the session ran when the replay began
        self._opened = 0
        self._said = ""
        self._doing = ""  # what takes long just now
        self._drawn: Replay | None = None  # the replay that the controls are for
        gui = stage.server.gui
        with stage.left.add_tab("Record"):
            self._record = gui.add_button(
                "Record", hint="Keep every order and tick in a file.", icon=viser.Icon.PLAYER_RECORD
            )
            self._state = gui.add_html("")
            self._list: Any = gui.add_dropdown("Recording", (NONE,), initial_value=NONE)
            self._open = gui.add_button(
                "Replay", hint="The session is paused meanwhile.", icon=viser.Icon.HISTORY
            )
            self._download = gui.add_button("Download", icon=viser.Icon.DOWNLOAD)
            self._play = gui.add_button("Play", icon=viser.Icon.PLAYER_PLAY, visible=False)
            self._slider: Any = gui.add_slider(
                "Time [s]", min=0.0, max=1.0, step=1e-3, initial_value=0.0, visible=False
            )
            self._speed: Any = gui.add_dropdown(
                "Speed", tuple(SPEEDS), initial_value="1", visible=False
            )
            self._leave = gui.add_button("Back to the session", color="gray", visible=False)
            self._picture = gui.add_button(
                "Screenshot", hint="Your view, without the panels.", icon=viser.Icon.CAMERA
            )
            self._sequence = gui.add_button(
                "Image sequence",
                hint=f"{FRAMES} pictures in {FRAMES * BETWEEN:g} s as one animated GIF.",
                icon=viser.Icon.MOVIE,
            )
            self._page = gui.add_button(
                "Scene as HTML", hint="One file that shows the scene in any browser, offline."
            )
        self._bind(self._record, self._toggle)
        self._bind(self._open, self._start)
        self._bind(self._download, self._send)
        self._bind(self._play, lambda _client: self._toggle_play())
        self._bind(self._leave, lambda _client: self._end())
        self._bind(self._picture, self._screenshot)
        self._bind(self._sequence, self._images)
        self._bind(self._page, self._scene_page)

        @self._slider.on_update
        async def _scrub(event: viser.GuiEvent[Any]) -> None:
            replay, at = self._replay, event.target.value
            if event.client is not None and replay is not None and np.isfinite(at):
                replay.transport.seek(float(at))

        @self._speed.on_update
        async def _pace(event: viser.GuiEvent[Any]) -> None:
            replay, name = self._replay, str(event.target.value)
            if event.client is not None and replay is not None and name in SPEEDS:
                replay.transport.pace(SPEEDS[name])

        stage.escape.offer(self._left)
        self._refresh()

    def set_scene(self, scene: Scene) -> None:
        """A replay brings its own."""

    def frame(self, telemetry: Telemetry) -> None:
        """The screen has asked the replay already."""

    def read_out(self, telemetry: Telemetry) -> None:
        """How the recording goes, and where the replay is."""
        tape, replay = self._session.tape, self._replay
        going = tape is not None and tape.running
        # Controls are written here alone, so that no two threads write them in turns.
        self._refresh()
        if replay is not self._drawn:
            if replay is not None:
                self._slider.max = max(math.ceil(replay.length * 1e3) / 1e3, 1e-3)
                self._speed.value = "1"
            for control in (self._play, self._slider, self._speed, self._leave):
                control.visible = replay is not None
            self._record.disabled = replay is not None
            self._drawn = replay
        label = "Stop recording" if going else "Record"
        if self._record.label != label:
            self._record.label = label
            self._record.icon = viser.Icon.PLAYER_STOP if going else viser.Icon.PLAYER_RECORD
        if tape is not None:
            text = f"Recording: {tape.rows:,} ticks." if going else tape.outcome
            color = palette.VERMILION if going or tape.note else palette.BLACK
            self._say(self._doing or text, color)
        else:
            self._say(self._doing, palette.BLACK)
        if replay is not None:
            at = replay.time()
            if abs(self._slider.value - at) > 5e-4:
                self._slider.value = round(at, 3)
            playing = replay.transport.playing
            label = "Pause replay" if playing else "Play"
            if self._play.label != label:
                self._play.label = label
                self._play.icon = viser.Icon.PLAYER_PAUSE if playing else viser.Icon.PLAYER_PLAY

    def _toggle(self, client: viser.ClientHandle) -> None:
        tape = self._session.tape
        if tape is not None and tape.running:
            self._session.stop_recording()
            return
        if self._replay is not None:
            raise Refused("leave the replay first: it is the session that is recorded")
        place = folder()
        place.mkdir(parents=True, exist_ok=True)
        if len(recordings()) >= MOST:
            raise Refused(f"there are {MOST} recordings in {place}: delete some first")
        stamp = time.strftime("%Y-%m-%d_%H-%M-%S")
        name = harmless(f"{stamp}_{self._session.scene.mesh_name}")
        self._session.record(place / f"{name}{SUFFIX}")

    def _start(self, client: viser.ClientHandle) -> None:
        path = self._chosen()
        self._doing = f"Opening {path.name} …"
        recording = read(path)
        if not len(recording.rows):
            raise Refused("the recording holds no tick")
        self._opened += 1
        scene = self._session.scene
        built = build_scenes(recording, REPLAYED + 1000 * self._opened, like=scene)
        replay = Replay(Player(recording, built), self._stage.screen)
        replay.player.moment(0)  # whatever is wrong shows here, not in the picture
        self._end()
        self._resume = not self._session.latest().paused
        self._session.pause()
        self._replay = replay
        self._stage.screen.instead = replay.now

    def _end(self) -> None:
        if self._replay is None:
            return
        self._replay = None
        self._stage.screen.instead = None
        if self._resume:
            self._session.resume()

    def _left(self) -> bool:
        """The Escape key: leave the replay, if there is one."""
        there = self._replay is not None
        self._end()
        return there

    def _toggle_play(self) -> None:
        replay = self._replay
        if replay is not None:
            replay.transport.play(not replay.transport.playing)

    def _send(self, client: viser.ClientHandle) -> None:
        path = self._chosen()
        size = path.stat().st_size
        if size > LARGEST:
            raise Refused(f"{size / 1e6:,.0f} MB are too much for a browser: it is {path}")
        client.send_file_download(path.name, path.read_bytes(), save_immediately=True)

    def _screenshot(self, client: viser.ClientHandle) -> None:
        client.send_file_download(
            f"{self._name()}.png", png(picture(client)), save_immediately=True
        )

    def _images(self, client: viser.ClientHandle) -> None:
        self._doing = f"Taking {FRAMES} pictures …"
        taken = []
        due = time.monotonic()
        for _ in range(FRAMES):
            taken.append(picture(client))
            due = max(due + BETWEEN, time.monotonic())
            time.sleep(max(due - time.monotonic(), 0.0))
        client.send_file_download(f"{self._name()}.gif", gif(taken), save_immediately=True)

    def _scene_page(self, client: viser.ClientHandle) -> None:
        content = self._stage.server.get_scene_serializer().as_html().encode()
        client.send_file_download(f"{self._name()}.html", content, save_immediately=True)

    def _name(self) -> str:
        mesh = self._session.scene.mesh_name
        return harmless(f"vf-sandbox_{mesh}_{time.strftime('%H-%M-%S')}")

    def _chosen(self) -> Path:
        name = str(self._list.value)
        for path in recordings():
            if path.name == name:
                return path
        raise Refused("there is no recording yet: press Record first")

    def _refresh(self) -> None:
        """The newest recording first."""
        names = tuple(path.name for path in reversed(recordings())) or (NONE,)
        if names != tuple(self._list.options):
            self._list.options = names
            self._list.value = names[0]

    def _bind(self, button: Any, job: Callable[[viser.ClientHandle], None]) -> None:
        # A plain function: viser runs it in its pool, where it may take its time.
        @button.on_click
        def _clicked(event: viser.GuiEvent[Any]) -> None:
            client = event.client
            if client is None:
                return
            if not self._busy.acquire(blocking=False):
                self._tell(client, "One thing at a time: the last one is not done yet.")
                return
            try:
                job(client)
            except (ValueError, OSError, TimeoutError) as error:
                self._tell(client, f"{error}")
            finally:
                self._doing = ""
                self._busy.release()

    def _say(self, text: str, color: palette.Rgb) -> None:
        content = f"<div style='{_STYLE};color:{palette.css(color)}'>{html.escape(text)}</div>"
        if content != self._said:
            self._said = content
            self._state.content = content


class Replay:
    """A recording on the screen."""

    def __init__(self, player: Player, screen: Screen) -> None:
        rows = player.recording.rows
        self.player = player
        self._screen = screen
        self._times = (rows["tick"] - rows["tick"][0]) * player.recording.dt
        self.transport = Transport(self._times)

    @property
    def length(self) -> float:
        """From the first tick to the last [s]."""
        return float(self._times[-1])

    def time(self) -> float:
        """Where it stands [s]."""
        return float(self._times[self.transport.row()])

    def now(self) -> Moment:
        """From the view thread: what to show."""
        row = self.transport.row()
        moment = self.player.moment(row)
        self._screen.caption = (
            f"Replay: tick {moment.telemetry.tick:,}, {self._times[row]:.2f} of "
            f"{self.length:.2f} s. The session is paused."
        )
        return moment


def recordings() -> list[Path]:
    """The files in the folder, the oldest first."""
    return sorted(folder().glob(f"*{SUFFIX}"))


def picture(client: viser.ClientHandle) -> NDArray[np.uint8]:
    """What a client sees of the scene (h, w, 3), no larger than its window.

    Raises:
        TimeoutError: the browser sends none (a hidden tab does not draw).
    """
    camera = client.camera
    height, width = (
        min(PICTURE[0], int(camera.image_height) or PICTURE[0]),
        min(PICTURE[1], int(camera.image_width) or PICTURE[1]),
    )
    image = client.get_render(height, width, transport_format="jpeg", timeout=PATIENCE)
    return np.ascontiguousarray(image[..., :3])


def png(image: NDArray[np.uint8]) -> bytes:
    """An image (h, w, 3) as a PNG file."""
    stream = io.BytesIO()
    Image.fromarray(image).save(stream, "PNG")
    return stream.getvalue()


def gif(images: list[NDArray[np.uint8]]) -> bytes:
    """Images (h, w, 3) as an animated GIF that repeats."""
    first, *rest = (Image.fromarray(image).convert("RGB") for image in images)
    stream = io.BytesIO()
    first.save(
        stream, "GIF", save_all=True, append_images=rest, duration=round(1e3 * BETWEEN), loop=0
    )
    return stream.getvalue()

"""Tab "Record": record a session; list, replay, rename and delete recordings."""

from __future__ import annotations

import html
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import platformdirs
import viser

from app import files
from app.recording.format import SUFFIX
from app.recording.outline import outline
from app.recording.read import read, under_way
from app.scene.moment import Moment
from app.view import palette
from app.view.clients.pictures import Pictures
from app.view.context import PageContext
from app.view.controls import dialogs
from app.view.part import Clients, Part
from app.view.tabs.replaying import Replaying
from app.words import Refused

MAX_RECORDINGS = 50  # in the folder, so that clients cannot fill the disk
MAX_DOWNLOAD = 200e6  # size of a recording that is sent to a browser [byte]
NONE = "–"

_STYLE = "margin:0 .75em .4em;font-size:12px;line-height:1.35;overflow-wrap:anywhere"


def folder() -> Path:
    """Folder of the page's recordings."""
    return platformdirs.user_data_path("vf-sandbox") / "recordings"


class RecordTab(Part):
    """Controls of recordings; those of a replay are in `replaying`."""

    def __init__(self, context: PageContext) -> None:
        self._context, self._session, self._notify = context, context.session, context.notify
        self._busy = threading.Lock()  # one job of this tab at a time
        self._opening = False  # a replay is being built; the button stops it
        self._replaying = Replaying(context)
        self._state_shown = ""
        self._progress = ""  # of the running job
        self._moved: set[Path] = set()  # former paths of renamed or deleted files
        self._select_next = ""  # name to select once it is listed
        self._described: tuple[Any, ...] = ()  # name, size and time of the described file
        gui = context.server.gui
        with context.left.add_tab("Record"):
            self._record = gui.add_button(
                "Record", hint="Keep every order and tick in a file.", icon=viser.Icon.PLAYER_RECORD
            )
            self._state = gui.add_html("")
            self._list: Any = gui.add_dropdown("Recording", (NONE,), initial_value=NONE)
            self._about = gui.add_html("")
            self._open = gui.add_button(
                "Replay", hint="The session waits meanwhile.", icon=viser.Icon.HISTORY
            )
            self._others = (
                gui.add_button("Download", icon=viser.Icon.DOWNLOAD),
                gui.add_button("Rename", icon=viser.Icon.EDIT),
                gui.add_button("Delete recording", icon=viser.Icon.TRASH, color="gray"),
            )
            Pictures(context, self._bind, self._set_progress)
        self._bind(self._record, self._toggle)

        # Not by `_bind`: while a replay is being built the button stops that.
        @self._open.on_click
        def _replay(event: viser.GuiEvent[Any]) -> None:
            client = event.client
            if self._opening:
                self._session.work.stop()
            elif client is not None:
                self._run(client, lambda: self._start(client))

        for button, job in zip(
            self._others, (self._send, self._ask_name, self._ask_to_delete), strict=True
        ):
            self._bind(button, job)
        self._refresh()

    def frame(self, shown: Moment, clients: Clients) -> None:
        self._replaying.frame()

    def read_out(self, shown: Moment) -> None:
        tape = self._session.tape
        going = tape is not None and tape.running
        # Only this thread writes the controls.
        self._refresh()
        self._replaying.read_out()
        self._record.disabled = self._session.suspended and not going
        label = "Stop recording" if going else "Record"
        if self._record.label != label:
            self._record.label = label
            self._record.icon = viser.Icon.PLAYER_STOP if going else viser.Icon.PLAYER_RECORD
        label = "Stop opening" if self._opening else "Replay"
        if self._open.label != label:
            self._open.label = label
        if tape is not None:
            text = f"Recording: {tape.rows:,} ticks." if going else tape.outcome
            color = palette.VERMILION if going or tape.note else palette.BLACK
            if tape.path in self._moved:  # its outcome names the former path
                text, color = "", palette.BLACK
            self._set_state(self._progress or text, color)
        else:
            self._set_state(self._progress, palette.BLACK)

    def _toggle(self, client: viser.ClientHandle) -> None:
        tape = self._session.tape
        if tape is not None and tape.running:
            self._session.stop_recording()
            return
        place = folder()
        place.mkdir(parents=True, exist_ok=True)
        if len(recordings()) >= MAX_RECORDINGS:
            raise Refused(f"there are {MAX_RECORDINGS} recordings in {place}: delete some first")
        stamp = time.strftime("%Y-%m-%d_%H-%M-%S")
        name = files.harmless(f"{stamp}_{self._session.scene.mesh_name}", stamp)
        self._session.record(place / f"{name}{SUFFIX}")

    def _start(self, client: viser.ClientHandle) -> None:
        path = self._chosen()
        doing = f"Opening {path.name}"
        self._set_progress(f"{doing} …")

        def progress(text: str) -> None:
            self._set_progress(f"{doing}: {text} …")

        with self._session.work.begin() as stop:
            self._opening = True
            try:
                self._replaying.show(path.stem, read(path), progress, stop)
            finally:
                self._opening = False

    def _send(self, client: viser.ClientHandle) -> None:
        path = self._chosen()
        size = path.stat().st_size
        if size > MAX_DOWNLOAD:
            raise Refused(f"{files.size(size)} are too much for a browser: it is {path}")
        client.send_file_download(path.name, path.read_bytes(), save_immediately=True)

    def _ask_name(self, client: viser.ClientHandle) -> None:
        path = self._chosen(at_rest=True)

        def rename(name: str) -> None:
            new = path.with_name(files.typed(name.removesuffix(SUFFIX), path.stem) + SUFFIX)
            if new == path:
                return
            try:
                files.rename(self._at_rest(path), new)
            except FileExistsError:
                raise Refused(f"there is another recording of the name {new.stem}") from None
            self._moved.add(path)
            self._select_next = new.name

        dialogs.ask_name(
            client,
            self._context.escape,
            "Rename the recording",
            path.stem,
            "Rename",
            lambda name: self._run(client, lambda: rename(name)),
        )

    def _ask_to_delete(self, client: viser.ClientHandle) -> None:
        path = self._chosen(at_rest=True)

        def delete() -> None:
            self._at_rest(path).unlink()
            self._moved.add(path)

        dialogs.ask(
            client,
            self._context.escape,
            "Delete the recording?",
            f"{path.name}, {files.size(path.stat().st_size)}. It cannot be brought back.",
            "Delete",
            lambda: self._run(client, delete),
            color="red",
        )

    def _chosen(self, at_rest: bool = False) -> Path:
        name = str(self._list.value)
        for path in recordings():
            if path.name == name:
                return self._at_rest(path) if at_rest else path
        raise Refused("there is no recording yet: press Record first")

    def _at_rest(self, path: Path) -> Path:
        if under_way(path):
            raise Refused(f"{path.name} is still being recorded: stop that first")
        return path

    def _refresh(self) -> None:
        """Update the list, newest recording first, and the description of the selected one."""
        there = recordings()
        names = tuple(path.name for path in reversed(there)) or (NONE,)
        if names != tuple(self._list.options):
            # A new recording is selected.
            new = names[0] not in self._list.options or self._list.value not in names
            chosen = self._select_next if self._select_next in names else None
            value = chosen or (names[0] if new else self._list.value)
            self._select_next = ""
            self._list.options = names
            self._list.value = value
        self._open.disabled = not there
        for button in self._others:
            button.disabled = not there
        path = folder() / str(self._list.value)
        try:
            stat = path.stat() if path in there else None
        except OSError:
            stat = None
        described = () if stat is None else (path.name, stat.st_size, stat.st_mtime_ns)
        if described == self._described:
            return
        self._described = described
        text = ""
        if stat is not None:
            found = outline(path)
            day = time.strftime("%Y-%m-%d %H:%M", time.localtime(stat.st_mtime))
            state = "" if found.ended else ", still going on" if under_way(path) else ", cut off"
            text = f"{path.stem}: {found.rows:,} ticks, {files.size(stat.st_size)}, {day}{state}"
        self._about.content = _line(text, palette.GREY)

    def _bind(self, button: Any, job: Callable[[viser.ClientHandle], None]) -> None:
        # A plain function: viser runs it in its thread pool, so it may block.
        @button.on_click
        def _clicked(event: viser.GuiEvent[Any]) -> None:
            client = event.client
            if client is not None:
                self._run(client, lambda: job(client))

    def _run(self, client: viser.ClientHandle, job: Callable[[], None]) -> None:
        """Run one job and notify the client of its errors."""
        if not self._busy.acquire(blocking=False):
            self._notify(client, "One thing at a time: the last one is not done yet.")
            return
        try:
            job()
        except (ValueError, TimeoutError) as error:
            self._notify(client, f"{error}")
        except OSError as error:
            self._notify(client, f"{error.strerror or error}: {error.filename or 'the file'}")
        finally:
            self._progress = ""
            self._busy.release()

    def _set_progress(self, text: str) -> None:
        self._progress = text

    def _set_state(self, text: str, color: palette.Rgb) -> None:
        content = _line(text, color)
        if content != self._state_shown:
            self._state_shown = content
            self._state.content = content


def _line(text: str, color: palette.Rgb) -> str:
    return f"<div style='{_STYLE};color:{palette.css(color)}'>{html.escape(text)}</div>"


def recordings() -> list[Path]:
    """The recordings in the folder, oldest first."""

    def begun(path: Path) -> tuple[float, str]:
        try:
            return path.stat().st_mtime, path.name
        except OSError:
            return 0.0, path.name

    return sorted(folder().glob(f"*{SUFFIX}"), key=begun)

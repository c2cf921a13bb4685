"""A tab about the mesh: bring one's own, see what is wrong with it and where, have it mended."""

from __future__ import annotations

import contextlib
import functools
import html
import threading
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import viser

import meshes
from app.messages import Telemetry
from app.scene import Scene
from app.view import health, palette
from app.view.feature import Stage
from app.view.uploads import Uploads

_STYLE = "margin:0 .75em .4em;font-size:12px;line-height:1.35;color:var(--vf-ink)"
GUESS = "guess"
OWN_UNIT = ("glb", "gltf", "3mf", "gii", *meshes.FREESURFER)  # formats that say their unit


class MeshTab:
    """Upload, health report with its problems drawn on the mesh, repair and flip.

    Everything slow runs in a thread of its own, one thing at a time; the old mesh stays until the
    new one is ready, and for good if that fails.
    """

    def __init__(self, stage: Stage) -> None:
        self._session = stage.session
        self._tell = stage.tell
        self._escape = stage.escape
        self._drawing = health.HealthDrawing(stage.server.scene)
        self._busy = threading.Lock()
        self._scene: Scene | None = None  # what is drawn
        self._examined = -1  # version of the scene that the report is on
        server = stage.server
        limit = round(self._session.options.upload_limit * 1e6)
        with stage.left.add_tab("Mesh"):
            self._upload = server.gui.add_upload_button(
                "Bring your own mesh",
                hint=f"{', '.join(meshes.FORMATS).upper()}; at most {limit / 1e6:,.0f} MB.",
                mime_type=",".join(f".{kind}" for kind in (*meshes.FORMATS, "gz")),
                icon=viser.Icon.UPLOAD,
            )
            self._state = server.gui.add_html("")
            self._examine = server.gui.add_button(
                "Examine", hint="Look for what is wrong with the mesh, and show where."
            )
            self._show = server.gui.add_checkbox("Show problems", True)
            self._report = server.gui.add_html("")
            self._repair = server.gui.add_button(
                "Repair",
                hint="Weld, drop what is no face, turn what is wound wrongly. Nothing is moved and "
                "no hole is filled.",
            )
            self._flip = server.gui.add_button(
                "Flip", hint="Turn open sheets over: they have no outside to be known by."
            )
        Uploads(server, self._upload, limit, self._ask, self._tell)
        self._say("")
        self._offer()

        # Plain functions: viser runs them in its pool, where they may take their time.
        @self._examine.on_click
        def _examine(event: viser.GuiEvent[Any]) -> None:
            self._work(event.client, lambda: self._look(self._session.scene))

        @self._repair.on_click
        def _repair(event: viser.GuiEvent[Any]) -> None:
            self._work(event.client, lambda: self._change(repair=True))

        @self._flip.on_click
        def _flip(event: viser.GuiEvent[Any]) -> None:
            flip = not self._session.options.flip
            self._work(event.client, lambda: self._change(flip=flip))

        @self._show.on_update
        async def _show(event: viser.GuiEvent[Any]) -> None:
            self._drawing.show(bool(event.target.value))

    def set_scene(self, scene: Scene) -> None:
        """The report on another mesh is no longer true."""
        self._scene = scene
        if self._examined != scene.version:
            self._forget()

    def frame(self, telemetry: Telemetry) -> None:
        """Nothing moves."""

    def read_out(self, telemetry: Telemetry) -> None:
        """Nothing is counted."""

    def _ask(self, client: viser.ClientHandle, path: Path) -> None:
        """Ask the one who sent a file for what it does not say, then use it."""
        kind = meshes.kind(path.name) or ""
        size = path.stat().st_size
        said = kind in OWN_UNIT
        dialog = client.gui.add_modal("In which unit is this mesh?")
        with dialog:
            client.gui.add_html(
                f"<div style='{_STYLE}'><b>{html.escape(path.name)}</b>, {size / 1e6:,.1f} MB. "
                + (
                    f"{kind.upper()} files say their unit; choose another if yours is wrong."
                    if said
                    else f"{kind.upper()} files do not say their unit."
                )
                + " Choose the side first if another than z is to face the tool.</div>"
            )
            # First: a dropdown that is opened with the focus would hide what is below it.
            units = client.gui.add_button_group(
                "Unit", ("as the file says" if said else GUESS, *meshes.UNITS)
            )
            up = client.gui.add_dropdown(
                "Side facing the tool",
                meshes.UPS,
                initial_value=meshes.UPS[0],
                hint="The mesh's own axis that is turned upwards.",
            )
            cancel = client.gui.add_button("Cancel", hint="Escape does the same.")
        shut = functools.partial(_close, dialog.close)
        self._escape.opened(client.client_id, shut)

        @units.on_click
        def _chosen(event: viser.GuiEvent[Any]) -> None:
            unit = str(event.target.value)
            named, facing = unit if unit in meshes.UNITS else None, str(up.value)
            self._escape.closed(client.client_id, shut)
            shut()
            self._work(
                client, lambda: self._change(mesh=str(path), unit=named, up=facing), path.name
            )

        @cancel.on_click
        def _cancelled(_event: viser.GuiEvent[Any]) -> None:
            self._escape.closed(client.client_id, shut)
            shut()

    def _work(
        self, client: viser.ClientHandle | None, job: Callable[[], None], about: str = ""
    ) -> None:
        """Do one slow thing; whatever comes of it, the page goes on."""
        if not self._busy.acquire(blocking=False):
            self._tell(client, "The mesh is being worked on: wait until that is done.")
            return
        try:
            self._offer(busy=True)
            job()
            self._say("")
        except Exception as error:
            # Whatever a reader of a user's file may raise, the old mesh stays.
            self._say(f"{about}: not taken. {error}".removeprefix(": "), palette.VERMILION)
            self._tell(client, f"Nothing is changed: {error}")
        finally:
            self._busy.release()
            self._offer()

    def _change(self, **wanted: Any) -> None:
        self._look(self._session.change(**wanted, progress=self._progress))

    def _look(self, scene: Scene) -> None:
        """Examine a scene's mesh and show what is found."""
        found = meshes.health(
            scene.surface, progress=lambda stage: self._progress(f"examining: {stage}")
        )
        if scene is not self._session.scene:
            return
        self._examined = scene.version
        self._report.content = health.report(found)
        # Clear of the mesh as drawn, which for large ones is a thinned copy.
        lift = 0.04 * scene.surface.median_edge + (1e-3 * scene.surface.size) * scene.decimated
        self._drawing.set(health.marks(found, scene.surface), lift)

    def _forget(self) -> None:
        self._examined = -1
        self._report.content = (
            f"<div style='{_STYLE};color:var(--vf-faint)'>Not examined yet: press Examine.</div>"
        )
        self._drawing.set(None)
        self._offer()

    def _offer(self, busy: bool | None = None) -> None:
        busy = self._busy.locked() if busy is None else busy
        repaired = self._session.options.repair
        self._examine.disabled = self._flip.disabled = busy
        self._repair.disabled = busy or repaired
        self._repair.label = "Repaired" if repaired else "Repair"
        self._flip.label = "Flip back" if self._session.options.flip else "Flip"

    def _progress(self, text: str) -> None:
        self._say(f"⏳ {text} …", palette.BLUE)

    def _say(self, text: str, color: palette.Rgb = palette.BLACK) -> None:
        # As high with text as without: what comes and goes moves no button from under the mouse.
        style = f"{_STYLE};height:2.7em;overflow-y:auto;color:{palette.css(color)}"
        content = f"<div style='{style}'>{html.escape(text)}</div>"
        if self._state.content != content:
            self._state.content = content


def _close(close: Callable[[], None]) -> None:
    # A double click closes a dialog twice.
    with contextlib.suppress(KeyError), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        close()

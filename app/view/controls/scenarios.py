"""Folder "Scenario": load a scenario, save the current set-up."""

from __future__ import annotations

import html
import itertools
import shutil
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import viser

import meshes
from app.scenarios.file import SIZE_LIMIT, Scenario, Viewpoint, dumps, loads
from app.scenarios.presets import PRESETS
from app.scenarios.staging import present, stage
from app.scene.moment import Moment
from app.scene.scene import Scene
from app.view import camera, palette
from app.view.clients.uploads import Receiver
from app.view.context import PageContext
from app.view.part import Clients, Part
from app.view.units import VIEW_SCALE
from app.words import OptionError, format_length

ORDER = -0.5  # in the panel: below the help, above the settings
FILE_NAME = "scenario.json"
# Of fixed height, so that the controls below keep their place.
_STYLE = "margin:0 .75em .3em;font-size:12px;line-height:1.35;height:5.4em;overflow-y:auto"


class ScenarioChoice(Part):
    """List of scenarios with a description; buttons to load, save and open a file.

    Scenes are built in viser's thread pool, one at a time; the old scene stays if that fails. A
    scenario's camera applies to all clients, and to those that connect later.
    """

    def __init__(self, context: PageContext) -> None:
        self._session, self._server = context.session, context.server
        self._input, self._notify, self._cameras = (
            context.client_input,
            context.notify,
            context.cameras,
        )
        self._source, self._library = context.source, context.library
        self._loading = False  # the description shows the progress
        self._scenarios = dict(PRESETS)
        begun = context.scenario
        if begun is not None:
            self._scenarios[begun.name] = begun
        # The scenario loaded last, and the version of its scene.
        self._shown = None if begun is None else (begun, self._session.scene.version)
        self._camera_due = False  # set the cameras when its scene is drawn
        gui, names = context.server.gui, tuple(self._scenarios)
        with gui.add_folder("Scenario", order=ORDER):
            self._choice: Any = gui.add_dropdown(
                "Show", names, initial_value=names[0] if begun is None else begun.name
            )
            self._buttons = gui.add_button_group(
                "Set-up",
                ("Load", "Save"),
                hint="Load begins the scenario above. Save downloads what is set now and how you "
                "look at it, as a small file to open here again or for --scenario.",
            )
            self._open = gui.add_upload_button(
                "Open a scenario file",
                hint="One that was saved here, or written by hand.",
                mime_type=".json",
                icon=viser.Icon.FOLDER_OPEN,
                color="gray",
            )
            self._text = gui.add_html("")
        self._show_description()

        @self._choice.on_update
        async def _chosen(_event: viser.GuiEvent[Any]) -> None:
            if not self._loading:
                self._show_description()

        # A plain function: viser runs it in its thread pool, so it may block.
        @self._buttons.on_click
        def _clicked(event: viser.GuiEvent[Any]) -> None:
            if event.client is not None:
                order = {"Load": self._load, "Save": self._save}.get(str(event.target.value))
                if order is not None:
                    order(event.client)

        context.uploads.register(
            self._open,
            Receiver(
                ("json",),
                SIZE_LIMIT,
                "",
                lambda: Path(tempfile.mkdtemp(prefix="vf-sandbox-")),
                lambda _length: None,
                self._opened,
            ),
        )

        @context.server.on_client_connect
        async def _connected(client: viser.ClientHandle) -> None:
            self._input.submit(self._apply_camera, client)

    def set_scene(self, scene: Scene) -> None:
        """Update the description: the loaded scenario may be gone."""
        if not self._loading:
            self._show_description()

    def frame(self, shown: Moment, clients: Clients) -> None:
        """Apply the scenario's camera once its scene is drawn."""
        if self._camera_due and self._shown is not None and shown.scene.version == self._shown[1]:
            self._camera_due = False
            for client in clients.values():
                self._apply_camera(client)

    def read_out(self, shown: Moment) -> None:
        live = self._source.live
        self._choice.disabled = self._open.disabled = not live
        self._buttons.visible = live

    def _apply_camera(self, client: viser.ClientHandle) -> None:
        if self._shown is None or self._session.scene.version != self._shown[1]:
            return
        look = self._shown[0].camera
        if isinstance(look, Viewpoint):
            eye, look_at = meshes.transformed(
                self._session.scene.T_base_mesh, [look.eye, look.look_at]
            )
            self._cameras.following.stop(client.client_id)
            camera.move(client, camera.View(eye, look_at))
        elif look is not None:
            self._cameras.look(client, look.capitalize())

    def _load(self, client: viser.ClientHandle) -> None:
        scenario = self._scenarios.get(str(self._choice.value))
        if scenario is not None:
            self._begin(client, scenario)

    def _opened(self, client: viser.ClientHandle, path: Path) -> None:
        """Add the scenario of an uploaded file to the list, and load it."""
        try:
            scenario = loads(path.read_bytes(), find=self._library.find)
        except (OptionError, OSError) as error:
            self._notify(client, f"{path.name} is not opened: {error}.")
            return
        finally:
            shutil.rmtree(path.parent, ignore_errors=True)
        for number in itertools.count(1):
            name = scenario.name if number == 1 else f"{scenario.name}-{number}"
            if self._scenarios.setdefault(name, scenario) == scenario:
                break
        if name not in self._choice.options:
            self._choice.options = (*self._choice.options, name)
        self._choice.value = name
        self._begin(client, self._scenarios[name])

    def _begin(self, client: viser.ClientHandle, scenario: Scenario) -> None:
        try:
            with self._session.work.begin() as stop:
                self._loading = True
                try:
                    stage(scenario, self._session, self._progress, stop)
                    self._shown, self._camera_due = (scenario, self._session.scene.version), True
                finally:
                    self._loading = False
                    self._show_description()
        except Exception as error:
            # The reader of a mesh file may raise anything; the old scene stays.
            self._notify(client, f"Not loaded: {error}")

    def _save(self, client: viser.ClientHandle) -> None:
        options, mesh = self._session.options, self._session.scene.mesh_name
        about = (
            f"Saved from the page: {mesh}, {options.robot}, rule {options.rule}, "
            f"motion sphere {format_length(options.radius)}."
        )
        try:
            scenario = present(self._session, "my-set-up", about)
            text = dumps(replace(scenario, camera=self._seen_by(client)))
        except ValueError as error:
            self._notify(client, f"Not saved: {error}")
            return
        client.send_file_download(FILE_NAME, text.encode(), save_immediately=True)
        if mesh != options.mesh:
            self._notify(
                client,
                f"It names {mesh}, which is known here; for --scenario keep {FILE_NAME} beside it.",
            )

    def _seen_by(self, client: viser.ClientHandle) -> Viewpoint | str:
        """A client's camera as a scenario states it."""
        if client.client_id in self._cameras.following.clients:
            return "follow"
        T_base_mesh = self._session.scene.T_base_mesh
        places = np.array([client.camera.position, client.camera.look_at]) / VIEW_SCALE
        eye, look_at = (places - T_base_mesh[:3, 3]) @ T_base_mesh[:3, :3]
        return Viewpoint(tuple(eye.tolist()), tuple(look_at.tolist()))

    def _show_description(self) -> None:
        chosen = self._scenarios.get(str(self._choice.value))  # clients may send anything
        shown = self._shown
        if chosen is None:
            self._set_text("", palette.BLACK)
        elif shown and shown[0] is chosen and shown[1] == self._session.scene.version:
            self._set_text(chosen.about, palette.BLACK)
        else:
            self._set_text(f"Load shows: {chosen.about}", palette.GREY)

    def _progress(self, text: str) -> None:
        self._set_text(f"{text} …", palette.BLUE)

    def _set_text(self, text: str, color: palette.Rgb) -> None:
        style = f"{_STYLE};color:{palette.css(color)}"
        words = html.escape(text)
        self._text.content = f"<div class='vf-sentence' style='{style}'>{words}</div>"

"""Tab "Mesh": upload a mesh, examine it, show its defects, repair or flip it."""

from __future__ import annotations

import functools
import html
import shutil
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import viser

import meshes
from app.files import size
from app.recording.outline import outline
from app.scene import worker
from app.scene.library import Kept
from app.scene.measure import measure
from app.scene.moment import Moment
from app.scene.scene import Scene
from app.structure import Structure
from app.view import palette
from app.view.clients.uploads import Receiver
from app.view.context import PageContext
from app.view.controls import dialogs
from app.view.part import Clients, Part
from app.view.tabs import health
from app.view.tabs.recorder import recordings
from app.view.tabs.structure_list import StructureList
from app.words import Refused
from meshes.units import choices as choices_of

_STYLE = "margin:0 .75em .4em;font-size:12px;line-height:1.35;color:var(--vf-ink)"
_UNKNOWN = f"<div style='{_STYLE};color:var(--vf-faint)'>Not examined yet: press Examine.</div>"
NONE = "–"
USES = AS_MESH, AS_STRUCTURE = "the mesh", "a further structure"


class MeshTab(Part):
    """Upload, health report with the defects drawn on the mesh, repair and flip.

    Whatever is slow runs on a thread of its own; the old mesh stays if it fails. Changing the mesh
    is the session's work, one at a time; examining is not, so the mesh can be changed meanwhile.
    """

    def __init__(self, context: PageContext) -> None:
        self._session = context.session
        self._notify = context.notify
        self._escape = context.escape
        self._drawing = health.HealthDrawing(context.server.scene)
        self._moved = False  # the marks, with the mesh
        self._examining = threading.Lock()
        self._scene: Scene | None = None  # drawn
        # The examined scene, the report, marks, lift, and number of the structure.
        self._examined: tuple[Scene, str, health.Marks, float, int] | None = None
        self._library, self._anatomy = context.library, context.anatomy
        self._source = context.source
        server = context.server
        limit = round(self._session.options.upload_limit * 1e6)
        with context.left.add_tab("Mesh"):
            self._structures = StructureList(context, self._remove_structure)
            self._upload = server.gui.add_upload_button(
                "Bring your own mesh",
                hint=f"{', '.join(meshes.FORMATS).upper()}; at most {limit / 1e6:,.0f} MB.",
                mime_type=",".join(f".{kind}" for kind in (*meshes.FORMATS, "gz")),
                icon=viser.Icon.UPLOAD,
            )
            self._state = server.gui.add_html("")
            self._stop = server.gui.add_button(
                "Stop", hint="Stop the work on the mesh; nothing is changed.", disabled=True
            )
            self._files: Any = server.gui.add_dropdown(
                "Kept files",
                (NONE,),
                initial_value=NONE,
                hint="Uploaded meshes, also from before a restart. The list Mesh has all of them.",
            )
            self._delete = server.gui.add_button(
                "Delete mesh file", icon=viser.Icon.TRASH, color="gray"
            )
            self._examine = server.gui.add_button(
                "Examine",
                hint="Look for what is wrong with the structure that is chosen above, and show "
                "where.",
            )
            self._show = server.gui.add_checkbox("Show problems", True)
            self._report = server.gui.add_html("")
            self._repair = server.gui.add_button(
                "Repair",
                hint="Weld vertices, remove degenerate faces, correct the winding. No vertex is "
                "moved, no hole filled.",
            )
            self._flip = server.gui.add_button(
                "Flip",
                hint="Reverse the winding of open sheets: their outside is not known.",
            )
        context.uploads.register(
            self._upload,
            Receiver(
                meshes.FORMATS,
                limit,
                "start the sandbox with --upload-limit to allow more",
                self._library.coming,
                self._library.refusal,
                self._ask_unit,
            ),
        )
        self._set_state("")
        self._update_buttons()

        # Plain functions: viser runs them in its thread pool, so they may block.
        @self._examine.on_click
        def _examine(event: viser.GuiEvent[Any]) -> None:
            if self._examining.locked():
                self._notify(event.client, "The mesh is being examined: wait until that is done.")
            else:
                chosen = self._anatomy.chosen
                self._run(event.client, lambda: self._run_examination(self._session.scene, chosen))

        @self._repair.on_click
        def _repair(event: viser.GuiEvent[Any]) -> None:
            self._run(event.client, lambda: self._change(repair=True))

        @self._flip.on_click
        def _flip(event: viser.GuiEvent[Any]) -> None:
            flip = not self._session.options.flip
            self._run(event.client, lambda: self._change(flip=flip))

        @self._stop.on_click
        def _stop(_event: viser.GuiEvent[Any]) -> None:
            self._session.work.stop()

        @self._delete.on_click
        def _delete(event: viser.GuiEvent[Any]) -> None:
            if event.client is not None:
                self._ask_to_delete(event.client)

        @self._show.on_update
        async def _show(event: viser.GuiEvent[Any]) -> None:
            self._drawing.show(bool(event.target.value))

    def set_scene(self, scene: Scene) -> None:
        """Drop the report of another mesh; during a replay the session's is kept."""
        self._scene = scene
        if self._source.live and self._examined and self._examined[0].version != scene.version:
            self._examined = None
        self._show_report()

    def frame(self, shown: Moment, clients: Clients) -> None:
        if shown.moves or self._moved:
            self._moved = shown.moves
            self._drawing.move(shown.pose(0 if self._examined is None else self._examined[4]))

    def read_out(self, shown: Moment) -> None:
        self._structures.read_out(shown)
        names = tuple(_labels(self._library.kept())) or (NONE,)
        if names != tuple(self._files.options):
            value = self._files.value if self._files.value in names else names[0]
            self._files.options = names
            self._files.value = value
        self._files.visible = self._delete.visible = names != (NONE,)
        self._update_buttons()

    def _ask_to_delete(self, client: viser.ClientHandle) -> None:
        file = _labels(self._library.kept()).get(self._files.value)
        if file is None:
            return
        need = [p.name for p in recordings() if str(file.path) in outline(p).meshes]
        text = f"{file.name}, {size(file.size)}. It cannot be brought back."
        if need:
            listed = ", ".join(need[:5]) + (", …" if len(need) > 5 else "")
            text += (
                f" {len(need)} recording{'s' * (len(need) > 1)} cannot be replayed without it: "
                f"{listed}."
            )

        def delete() -> None:
            try:
                self._library.delete(file.name, self._present())
            except OSError as error:
                self._notify(client, f"Not deleted: {error.strerror or error}.")
            except ValueError as error:
                self._notify(client, f"Not deleted: {error}.")

        dialogs.ask(
            client, self._escape, "Delete the mesh file?", text, "Delete", delete, color="red"
        )

    def _ask_unit(self, client: viser.ClientHandle, path: Path) -> None:
        """Ask the client for unit and orientation of an uploaded file, then use it."""
        found: list[tuple[float, str | None]] = []
        self._run(client, lambda: found.append(self._measured(path)), path.name)
        if not found:
            shutil.rmtree(path.parent, ignore_errors=True)
            return
        diagonal, stated = found[0]
        length = path.stat().st_size
        form = (meshes.kind(path.name) or "").upper()
        dialog = client.gui.add_modal("In which unit is this mesh?")
        with dialog:
            client.gui.add_html(
                f"<div style='{_STYLE}'><b>{html.escape(path.name)}</b>, {size(length)}. "
                + (
                    "It says its unit; choose another if that is wrong."
                    if stated
                    else f"This {form} file does not say its unit: choose the size that it has."
                )
                + " Choose first what it is for, and the side if another than z is to face the "
                "tool.</div>"
            )
            # Buttons first: they get the focus, with which a dropdown would open over the rest.
            choices = {
                unit: client.gui.add_button(words)
                for unit, words in choices_of(diagonal, stated).items()
            }
            use = client.gui.add_dropdown(
                "Use it as",
                USES,
                initial_value=AS_MESH,
                hint="A further structure stays where its file has it, in the mesh's own axes.",
            )
            up = client.gui.add_dropdown(
                "Side facing the tool",
                meshes.UPS,
                initial_value=meshes.UPS[0],
                hint="Of the mesh: its own axis that is turned upwards.",
            )
            cancel = client.gui.add_button("Cancel", hint="Escape does the same.")

        def drop() -> None:
            if dialogs.close(dialog):
                shutil.rmtree(path.parent, ignore_errors=True)

        self._escape.opened(client.client_id, drop)

        def choose(unit: str, _event: viser.GuiEvent[Any]) -> None:
            facing, further = str(up.value), use.value == AS_STRUCTURE
            self._escape.closed(client.client_id, drop)
            if not dialogs.close(dialog):
                return
            if further:
                self._run(client, lambda: self._keep(path, self._add_structure, unit), path.name)
            else:
                take = functools.partial(self._use_as_mesh, facing)
                self._run(client, lambda: self._keep(path, take, unit), path.name)

        for unit, button in choices.items():
            button.on_click(functools.partial(choose, unit))

        @cancel.on_click
        def _cancelled(_event: viser.GuiEvent[Any]) -> None:
            self._escape.closed(client.client_id, drop)
            drop()

    def _run(
        self, client: viser.ClientHandle | None, job: Callable[[], None], about: str = ""
    ) -> None:
        """Run one job and report its errors."""
        try:
            job()
            self._set_state("")
        except Refused as error:  # the state line shows the other work
            self._notify(client, f"Nothing is changed: {error}")
        except Exception as error:
            # The reader of a user's file may raise anything.
            self._set_state(f"{about}: not taken. {error}".removeprefix(": "), palette.VERMILION)
            self._notify(client, f"Nothing is changed: {error}")
        finally:
            self._update_buttons()

    def _measured(self, path: Path) -> tuple[float, str | None]:
        """The mesh's diagonal in the unit of the file, and that unit if the file states it."""
        work = functools.partial(measure, str(path))
        with self._session.work.begin() as stop:
            self._update_buttons()
            if worker.light(str(path)):
                return work(progress=self._progress)
            allowed = worker.allowance(str(path))
            found: tuple[float, str | None] = worker.run(work, allowed, self._progress, stop)
            return found

    def _keep(self, path: Path, take: Callable[[str, str], None], unit: str) -> None:
        """Add an uploaded file to the library and take it; remove it if that fails."""
        before = {file.name for file in self._library.kept()}
        kept = self._library.add(path)
        try:
            take(str(kept), unit)
        except Refused:
            raise  # the file itself may be valid
        except Exception:
            if kept.name not in before:
                self._library.delete(kept.name, self._present())
            raise

    def _use_as_mesh(self, up: str, file: str, unit: str) -> None:
        self._change(mesh=file, unit=unit, up=up)

    def _add_structure(self, file: str, unit: str) -> None:
        there = self._session.options.structures
        self._set_structures((*there, Structure(file, unit=unit)))

    def _remove_structure(self, client: viser.ClientHandle | None, number: int) -> None:
        """Take a structure out of the scene; 0 is the mesh, which stays."""
        there = self._session.options.structures
        if 0 < number <= len(there):
            fewer = (*there[: number - 1], *there[number:])
            self._run(client, lambda: self._set_structures(fewer))

    def _set_structures(self, structures: tuple[Structure, ...]) -> None:
        """Build the scene with these beside its mesh, which is not examined anew."""
        with self._session.work.begin() as stop:
            self._update_buttons()
            self._session.change(structures=structures, progress=self._progress, stop=stop)

    def _present(self) -> set[str]:
        """The files that the scene is made of."""
        return {own.file for own in self._session.options.anatomy}

    def _change(self, **wanted: Any) -> None:
        with self._session.work.begin() as stop:
            self._update_buttons()
            scene = self._session.change(**wanted, progress=self._progress, stop=stop)
        self._run_examination(scene)

    def _run_examination(self, scene: Scene, number: int = 0) -> None:
        """Examine a structure of a scene, 0 is the mesh, and show the report."""
        if not number < len(scene.surfaces):
            return
        surface, own = scene.surfaces[number], scene.options.anatomy[number]
        decimated = len(scene.looks(number)[1]) < len(surface.faces)
        with self._examining:
            self._update_buttons()
            found = meshes.health(
                surface, progress=lambda stage: self._progress(f"examining: {stage}")
            )
        if scene.version != self._session.scene.version:
            return
        # Clear of the drawn mesh, which may be decimated.
        lift = 0.04 * surface.median_edge + (1e-3 * surface.size) * decimated
        of = str(own.name) if scene.structures else ""
        self._examined = (
            scene,
            health.report(found, of),
            health.marks(found, surface),
            lift,
            number,
        )
        if self._source.live:
            self._show_report(scene)

    def _show_report(self, scene: Scene | None = None) -> None:
        """Show report and marks of a scene, if it is examined; None: of the drawn one."""
        scene = scene or self._scene
        if (
            scene is not None
            and self._examined is not None
            and self._examined[0].version == scene.version
        ):
            _, self._report.content, marks, lift, _ = self._examined
            self._drawing.set(marks, lift)
        else:
            self._report.content = _UNKNOWN
            self._drawing.set(None)

    def _update_buttons(self) -> None:
        going, live = self._session.work.going, self._source.live
        busy = going or self._examining.locked() or not live
        self._upload.disabled = not live
        repaired = self._session.options.repair
        self._examine.disabled = self._flip.disabled = busy
        self._stop.disabled = not going
        self._repair.disabled = busy or repaired
        self._repair.label = "Repaired" if repaired else "Repair"
        self._flip.label = "Flip back" if self._session.options.flip else "Flip"

    def _progress(self, text: str) -> None:
        self._set_state(f"{text} …", palette.BLUE)

    def _set_state(self, text: str, color: palette.Rgb = palette.BLACK) -> None:
        # Of fixed height, so that the buttons below keep their place.
        style = f"{_STYLE};height:2.7em;overflow-y:auto;color:{palette.css(color)}"
        content = f"<div style='{style}'>{html.escape(text)}</div>"
        if self._state.content != content:
            self._state.content = content


def _labels(kept: list[Kept]) -> dict[str, Kept]:
    """The files by their text in the list."""
    return {f"{file.name} ({size(file.size)})": file for file in kept}

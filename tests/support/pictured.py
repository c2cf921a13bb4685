"""What the page is made of, as text: what the pictures in docs/ were taken of.

A record beside the pictures has a line for each control (where it is, its kind, its label, its
choices), the parts of the scene, the colours, and the digest of each picture. A test compares the
record with the page of today: code may be moved about without another picture, a label may not.
"""

from __future__ import annotations

import hashlib
import json
import os
import tempfile
from pathlib import Path
from typing import Any

import viser

from app.choices import FROM_PACKAGES
from app.session import Session
from app.settings import Options
from app.view import Page, palette

RECORD = "pictures.json"
COMMAND = "python -m tests.browser.take_pictures docs"


def parts_of_the_page() -> list[str]:
    """A line for each control, part of the scene and colour of a page as it opens."""
    with tempfile.TemporaryDirectory() as folder:
        # What the user has recorded or uploaded is not of the page.
        before = os.environ.get("XDG_DATA_HOME")
        os.environ["XDG_DATA_HOME"] = folder
        try:
            with Session(Options()) as session:
                page = Page(session, "127.0.0.1", 0)
                try:
                    return [*_controls(page.server), *_scene(page.server), *_colours()]
                finally:
                    page.close()
        finally:
            if before is None:
                del os.environ["XDG_DATA_HOME"]
            else:
                os.environ["XDG_DATA_HOME"] = before


def _controls(server: viser.ViserServer) -> list[str]:
    buffer = server._websock_server._broadcast_buffer
    with buffer.buffer_lock:
        messages = list(buffer.message_from_id.values())
    places = {"root": ""}
    found = []
    for message in messages:
        kind = type(message).__name__.removeprefix("Gui").removesuffix("Message")
        props: Any = getattr(message, "props", None)
        if not type(message).__name__.startswith("Gui") or props is None:
            continue
        where = places.get(getattr(message, "container_uuid", "root"), "")
        label = str(getattr(props, "label", None) or getattr(props, "_label", None) or "")
        if hasattr(props, "_tab_labels"):
            for tab, inside in zip(props._tab_labels, props._tab_container_ids, strict=True):
                places[inside] = f"{where}{tab} / "
                found.append(f"tab {where}{tab}")
            continue
        if kind == "Folder":
            places[message.uuid] = f"{where}{label} / "
        if kind == "Html":
            continue  # its words change with what is going on
        choices = getattr(props, "options", None) or ()
        # What else is installed on this machine is not of the page either.
        told = ", ".join(str(one) for one in choices if one not in FROM_PACKAGES)
        found.append(f"{kind.lower()} {where}{label}" + (f": {told}" if told else ""))
    return found


def _scene(server: viser.ViserServer) -> list[str]:
    names = {name.split("/")[1] for name in tuple(server.scene._handle_from_node_name)}
    return [f"scene {name}" for name in sorted(names)]


def _colours() -> list[str]:
    return [
        f"colour {name}: {value}"
        for name, value in sorted(vars(palette).items())
        if name.isupper() and isinstance(value, tuple) and len(value) == 3
    ]


def digests(folder: Path, names: list[str]) -> dict[str, str]:
    """SHA-256 of each picture."""
    return {
        name: hashlib.sha256((folder / f"{name}.png").read_bytes()).hexdigest() for name in names
    }


def write_record(folder: Path, names: list[str]) -> None:
    """Note of what page the pictures in the folder are."""
    record = {"page": parts_of_the_page(), "pictures": digests(folder, names)}
    text = json.dumps(record, indent=1, ensure_ascii=False) + "\n"
    (folder / RECORD).write_text(text, encoding="utf-8")

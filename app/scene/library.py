"""Mesh files that can be chosen by name: those that browsers sent, kept until somebody deletes
them, and those that the session was given by path."""

from __future__ import annotations

import contextlib
import filecmp
import json
import os
import shutil
import tempfile
import threading
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import platformdirs

import meshes
from app.files import numbered, size
from app.options import plain
from app.settings import MESH, Options

MOST = 100  # files that are kept
ROOM = 4e9  # for all of them together [byte]: who may send files must not fill the disk
NOTE = "loaded.json"  # beside each file: how it was loaded
_COMING = ".coming-"
_GIVEN_UP = 86_400.0  # a transfer that is left behind for so long is removed [s]


class LibraryError(ValueError):
    """A file that is not kept, or not deleted; the message says why."""


@dataclass(frozen=True)
class Kept:
    """A file that is kept: its name in the list, where it is, and its size [byte]."""

    name: str
    path: Path
    size: int


def folder() -> Path:
    """Where files that browsers sent are kept."""
    return platformdirs.user_data_path("vf-sandbox") / "meshes"


class Library:
    """The list of files, shared by all sessions of a user. Any thread may call.

    Each file is in a folder of its own name, together with a note on how it was loaded last, so
    that it is there again after a restart, and recordings and scenarios find it.
    """

    def __init__(self, place: Path | None = None) -> None:
        """`place`: the folder; None: the user's."""
        self._place = folder() if place is None else place
        self._lock = threading.Lock()
        self._used: dict[str, dict[str, Any]] = {}  # by name: how this session loaded it
        with contextlib.suppress(OSError):
            for left in self._place.glob(f"{_COMING}*"):
                if time.time() - left.stat().st_mtime > _GIVEN_UP:
                    shutil.rmtree(left, ignore_errors=True)

    def kept(self) -> list[Kept]:
        """The files that are kept, by name."""
        found = []
        with contextlib.suppress(OSError):
            for place in self._place.iterdir():
                path = place / place.name
                with contextlib.suppress(OSError):
                    if not place.name.startswith("."):
                        found.append(Kept(place.name, path, path.stat().st_size))
        return sorted(found, key=lambda file: file.name.casefold())

    def names(self) -> tuple[str, ...]:
        """Every file that can be chosen."""
        return tuple(dict.fromkeys([file.name for file in self.kept()] + [*self._used]))

    def settings(self, name: str) -> dict[str, Any] | None:
        """The options (`settings.MESH`) that load the file of this name as it was last.

        None: there is no such file here.
        """
        if name in self._used:
            return self._used[name]
        path = self._place / name / name
        if name != Path(name).name or not path.is_file():
            return None
        found = {"mesh": str(path)}
        with contextlib.suppress(OSError, ValueError):
            note = json.loads((path.parent / NOTE).read_bytes())
            if isinstance(note, dict):
                known = {k: plain(v) for k, v in note.items() if k in MESH and k != "mesh"}
                Options(**known)  # which refuses what is unusable
                found |= known
        return found

    def find(self, name: str) -> str | None:
        """Where the mesh or planned path of this name is; None: it is not known here."""
        found = self.settings(name)
        if found is not None:
            return str(found["mesh"])
        for how in self._used.values():
            if how["path"] is not None and Path(how["path"]).name == name:
                return str(how["path"])
        return None

    def note(self, options: Options) -> None:
        """A session has loaded the file that these options name, as they say."""
        how = {name: getattr(options, name) for name in MESH}
        name = Path(options.mesh).name
        if options.mesh in meshes.catalogue() or self._used.get(name) == how:
            return
        self._used[name] = how
        if Path(options.mesh) == self._place / name / name:
            with contextlib.suppress(OSError, TypeError):
                about = {key: value for key, value in how.items() if key != "mesh"}
                new = self._place / name / f".{NOTE}"
                new.write_text(json.dumps(about))
                new.replace(self._place / name / NOTE)  # the old note or the new one, never half

    def refusal(self, length: int) -> str | None:
        """Why a file of so many bytes is not taken now; None: it is."""
        there = self.kept()
        if len(there) >= MOST:
            return f"{MOST} meshes are kept already: delete some first (tab Mesh)"
        taken = sum(file.size for file in there)
        if taken + length > ROOM:
            return f"{size(taken)} of {size(ROOM)} are taken: delete some meshes first (tab Mesh)"
        return None

    def coming(self) -> Path:
        """A new folder for a file that is on its way; `add` takes it over, or remove it."""
        self._place.mkdir(parents=True, exist_ok=True)
        return Path(tempfile.mkdtemp(prefix=_COMING, dir=self._place))

    def add(self, path: Path) -> Path:
        """Take over a file from the folder that `coming` made; returns where it is kept.

        It keeps its name, with a number if another file has it. The same file is kept once.

        Raises:
            OSError: it cannot be kept.
        """
        with self._lock:
            for target in numbered(path):
                name = target.name
                there = self._place / name / name
                used = self._used.get(name)
                if name in meshes.catalogue() or (used and used["mesh"] != str(there)):
                    continue  # the list has another of this name
                if there.is_file():
                    if filecmp.cmp(path, there, shallow=False):
                        shutil.rmtree(path.parent, ignore_errors=True)
                        return there
                    continue
                path = path.rename(path.with_name(name))
                try:
                    os.rename(path.parent, there.parent)
                except OSError:
                    if there.parent.exists():
                        continue  # another session was quicker
                    raise
                return there
        raise AssertionError("numbers do not end")

    def delete(self, name: str, present: str) -> None:
        """Delete the file of this name that is kept.

        Args:
            present: the mesh that is on the page, which is not deleted.

        Raises:
            LibraryError: there is none, or it is on the page.
            OSError: it cannot be deleted.
        """
        file = next((file for file in self.kept() if file.name == name), None)
        if file is None:
            raise LibraryError(f"no file of the name {name} is kept")
        if Path(present) == file.path:
            raise LibraryError(f"{name} is on the page: choose another mesh first")
        file.path.unlink()
        shutil.rmtree(file.path.parent, ignore_errors=True)
        self._used.pop(name, None)

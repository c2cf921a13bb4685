"""Mesh files that can be selected by name: uploaded files, and files that were given by path."""

from __future__ import annotations

import contextlib
import filecmp
import json
import os
import shutil
import tempfile
import threading
import time
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import platformdirs

import meshes
from app.files import numbered, size
from app.options import plain, raw
from app.settings import DECLARED, MESH, Options

MOST = 100  # number of files
ROOM = 4e9  # total size, so that uploads cannot fill the disk [byte]
NOTE = "loaded.json"  # beside each file: the options it was loaded with
_INCOMING = ".coming-"  # prefix of the folder of an upload in progress
_ABANDONED_AFTER = 86_400.0  # an older upload folder is removed [s]


class LibraryError(ValueError):
    """A file cannot be deleted; the message says why."""


@dataclass(frozen=True)
class Kept:
    """An uploaded file: name, path, and size [byte]."""

    name: str
    path: Path
    size: int


def folder() -> Path:
    """The folder of uploaded files."""
    return platformdirs.user_data_path("vf-sandbox") / "meshes"


class Library:
    """The list of files, shared by all sessions of a user. Thread-safe.

    Each file is in a folder of its own name, together with the options it was last loaded with, so
    that sessions, recordings and scenarios find it after a restart.
    """

    def __init__(self, place: Path | None = None) -> None:
        """`place`: the folder; None: the user's."""
        self._place = folder() if place is None else place
        self._lock = threading.Lock()
        self._used: dict[str, dict[str, Any]] = {}  # by name: the options in this session
        with contextlib.suppress(OSError):
            for left in self._place.glob(f"{_INCOMING}*"):
                if time.time() - left.stat().st_mtime > _ABANDONED_AFTER:
                    shutil.rmtree(left, ignore_errors=True)

    def kept(self) -> list[Kept]:
        """The uploaded files, sorted by name."""
        found = []
        with contextlib.suppress(OSError):
            for place in self._place.iterdir():
                path = place / place.name
                with contextlib.suppress(OSError):
                    if not place.name.startswith("."):
                        found.append(Kept(place.name, path, path.stat().st_size))
        return sorted(found, key=lambda file: file.name.casefold())

    def names(self) -> tuple[str, ...]:
        """Names of all files that can be selected."""
        return tuple(dict.fromkeys([file.name for file in self.kept()] + [*self._used]))

    def settings(self, name: str) -> dict[str, Any] | None:
        """The options (`settings.MESH`) that this file was last loaded with; None: unknown name."""
        if name in self._used:
            return self._used[name]
        path = self._place / name / name
        if name != Path(name).name or not path.is_file():
            return None
        found = {"mesh": str(path)}
        with contextlib.suppress(OSError, ValueError):
            note = json.loads((path.parent / NOTE).read_bytes())
            if isinstance(note, dict):
                known = {
                    key: plain(value, DECLARED[key].kind)
                    for key, value in note.items()
                    if key in MESH and key != "mesh"
                }
                Options(**known)  # raises if one is invalid
                found |= known
        return found

    def find(self, name: str) -> str | None:
        """The path of the mesh, structure or planned path of this name; None: unknown name."""
        found = self.settings(name)
        if found is not None:
            return str(found["mesh"])
        for how in self._used.values():
            if how["path"] is not None and Path(how["path"]).name == name:
                return str(how["path"])
            for one in how["structures"]:
                if Path(one.file).name == name:
                    return str(one.file)
        return None

    def note(self, options: Options) -> None:
        """Store the options with which a session has loaded a file."""
        how = {name: getattr(options, name) for name in MESH}
        name = Path(options.mesh).name
        if options.mesh in meshes.catalogue() or self._used.get(name) == how:
            return
        self._used[name] = how
        if Path(options.mesh) == self._place / name / name:
            with contextlib.suppress(OSError, TypeError):
                about = {key: raw(value) for key, value in how.items() if key != "mesh"}
                new = self._place / name / f".{NOTE}"
                new.write_text(json.dumps(about))
                new.replace(self._place / name / NOTE)  # atomic

    def refusal(self, length: int) -> str | None:
        """Why a file of `length` bytes is refused; None: it is accepted."""
        there = self.kept()
        if len(there) >= MOST:
            return f"{MOST} meshes are kept already: delete some first (tab Mesh)"
        taken = sum(file.size for file in there)
        if taken + length > ROOM:
            return f"{size(taken)} of {size(ROOM)} are taken: delete some meshes first (tab Mesh)"
        return None

    def coming(self) -> Path:
        """A new folder for an upload; the caller passes its file to `add`, or removes it."""
        self._place.mkdir(parents=True, exist_ok=True)
        return Path(tempfile.mkdtemp(prefix=_INCOMING, dir=self._place))

    def add(self, path: Path) -> Path:
        """Move a file from the folder that `coming` made into the library; returns its path.

        A number is appended to a name that is taken. A file with equal content is not added again.

        Raises:
            OSError: it cannot be moved.
        """
        with self._lock:
            for target in numbered(path):
                name = target.name
                there = self._place / name / name
                used = self._used.get(name)
                if name in meshes.catalogue() or (used and used["mesh"] != str(there)):
                    continue  # another mesh has this name
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
                        continue  # another session has just taken the name
                    raise
                return there
        raise AssertionError("numbers do not end")

    def delete(self, name: str, present: Collection[str]) -> None:
        """Delete an uploaded file.

        Args:
            present: the files in use, which are not deleted.

        Raises:
            LibraryError: an unknown name, or a file in use.
            OSError: it cannot be deleted.
        """
        file = next((file for file in self.kept() if file.name == name), None)
        if file is None:
            raise LibraryError(f"no file of the name {name} is kept")
        if file.path in map(Path, present):
            raise LibraryError(
                f"{name} is on the page: choose another mesh first, or remove the structure"
            )
        file.path.unlink()
        shutil.rmtree(file.path.parent, ignore_errors=True)
        self._used.pop(name, None)

"""The folder of a study: files that are written as a whole, or not at all.

DIR/protocol.toml
DIR/participants/CODE/sitting.json      where the participant is
DIR/participants/CODE/tlx.json          by block
DIR/participants/CODE/trials/NNN.json   of a finished trial, written last
DIR/participants/CODE/trials/NNN.vfrec  its recording
"""

from __future__ import annotations

import contextlib
import fcntl
import json
import os
import re
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from app.studies.people import reading
from app.studies.people.protocol import Protocol, ProtocolError
from app.words import OptionError, Refused

CODE = re.compile(r"[A-Z0-9]([A-Z0-9-]{0,22}[A-Z0-9])?")
PROTOCOL, SITTING, TLX = "protocol.toml", "sitting.json", "tlx.json"


def checked_code(text: str, protocol: Protocol | None = None) -> str:
    """A participant's code, in capital letters.

    Raises:
        Refused: not a code, or none of the protocol's; the message is for the participant.
    """
    code = text.strip().upper()
    if not CODE.fullmatch(code):
        raise Refused("A code has 1 to 24 letters, digits or hyphens")
    known = () if protocol is None else tuple(one.upper() for one in protocol.codes)
    if known and code not in known:
        raise Refused(f"The code {code} is not one of this study")
    return code


class Study:
    """The folder of a study.

    Attributes:
        path: of the folder.
        protocol: what it was made with.
    """

    def __init__(self, path: Path, protocol: Protocol) -> None:
        self.path = path
        self.protocol = protocol

    @classmethod
    def make(cls, path: Path, protocol: str) -> Study:
        """The study in a folder, which is made, or goes on if it has the same protocol.

        Args:
            protocol: built-in name, or path of a file.

        Raises:
            OptionError: an invalid protocol, or a folder with another protocol.
            OSError: the folder cannot be made.
        """
        found = reading.read(protocol)
        own = path / PROTOCOL
        if own.exists():
            study = cls.open(path)
            if study.protocol != found:
                raise OptionError(
                    f"{path} has another protocol ({study.protocol.name}): give another folder"
                )
            return study
        (path / "participants").mkdir(parents=True, exist_ok=True)
        write(own, reading.text_of(protocol))
        return cls(path, found)

    @classmethod
    def open(cls, path: Path) -> Study:
        """The study in a folder that has one.

        Raises:
            ProtocolError: there is none, or its protocol is invalid.
        """
        if not (path / PROTOCOL).is_file():
            raise ProtocolError(f"{path} is no folder of a study: it has no {PROTOCOL}")
        return cls(path, reading.read(str(path / PROTOCOL)))

    @property
    def codes(self) -> list[str]:
        """Codes of all participants who have begun."""
        return sorted(path.parent.name for path in self.path.glob(f"participants/*/{SITTING}"))

    def participant(self, code: str) -> Participant:
        """The files of a participant, who may not have begun."""
        return Participant(self.path / "participants" / checked_code(code))

    @contextlib.contextmanager
    def entering(self) -> Iterator[None]:
        """Hold the lock under which participants get their numbers."""
        with (self.path / ".lock").open("w") as file:
            fcntl.flock(file, fcntl.LOCK_EX)
            yield

    def delete(self, code: str) -> None:
        """Remove everything of a participant.

        Raises:
            OptionError: there is no such participant.
        """
        found = self.participant(code)
        if not found.path.is_dir():
            raise OptionError(f"no participant {code}: there are {', '.join(self.codes) or 'none'}")
        with self.entering():
            shutil.rmtree(found.path)
            _sync(found.path.parent)


class Participant:
    """The files of a participant; `path` is their folder."""

    def __init__(self, path: Path) -> None:
        self.path = path

    @property
    def begun(self) -> bool:
        return (self.path / SITTING).is_file()

    def sitting(self) -> dict[str, Any]:
        """The content of sitting.json."""
        return _read(self.path / SITTING)

    def keep_sitting(self, content: dict[str, Any]) -> None:
        """Replace sitting.json."""
        write_json(self.path / SITTING, content)

    def tlx(self) -> dict[str, Any]:
        """The content of tlx.json, by block; empty where there is none."""
        path = self.path / TLX
        return _read(path) if path.is_file() else {}

    def keep_tlx(self, content: dict[str, Any]) -> None:
        """Replace tlx.json."""
        write_json(self.path / TLX, content)

    def finished(self) -> list[dict[str, Any]]:
        """The finished trials by number, without a gap from 0."""
        found: list[dict[str, Any]] = []
        while (path := self.trial(len(found))).is_file():
            found.append(_read(path))
        return found

    def trial(self, number: int) -> Path:
        """The file of a finished trial."""
        return self.path / "trials" / f"{number:03d}.json"

    def recording(self, number: int) -> Path:
        """The recording of a trial; what an unfinished one left is renamed first.

        As it may be of interest why it was not finished, nothing is deleted.
        """
        path = self.trial(number).with_suffix(".vfrec")
        path.parent.mkdir(parents=True, exist_ok=True)
        if path.exists() and not self.trial(number).exists():
            k = 1
            while (left := path.with_name(f"{number:03d}-unfinished-{k}.vfrec")).exists():
                k += 1
            path.rename(left)
        return path

    def unfinished(self, number: int) -> int:
        """How often a trial was begun and not finished."""
        return len(list(self.path.glob(f"trials/{number:03d}-unfinished-*.vfrec")))

    def keep_trial(self, number: int, content: dict[str, Any]) -> None:
        """Write the file of a finished trial."""
        write_json(self.trial(number), content)


def write(path: Path, text: str) -> None:
    """Replace a file as a whole: after a crash it is the old one or the new one, on disk."""
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_name(f".{path.name}.{os.getpid()}.part")
    with partial.open("w", encoding="utf-8") as file:
        file.write(text)
        file.flush()
        os.fsync(file.fileno())
    os.replace(partial, path)
    _sync(path.parent)


def write_json(path: Path, content: Any) -> None:
    """`write` of JSON. A value that is not finite becomes null."""
    write(path, json.dumps(_finite(content), indent=1, ensure_ascii=False, allow_nan=False) + "\n")


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _finite(one) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(one) for one in value]
    if isinstance(value, float) and not abs(value) < float("inf"):
        return None
    return value


def _read(path: Path) -> dict[str, Any]:
    try:
        content = json.loads(path.read_text("utf-8"))
    except (OSError, ValueError) as error:
        raise OptionError(f"{path} cannot be read: {error}") from None
    if not isinstance(content, dict):
        raise OptionError(f"{path} is not a JSON object")
    return content


def _sync(folder: Path) -> None:
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)

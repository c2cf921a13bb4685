"""Removes a participant from a study, with all that was derived from their data."""

from __future__ import annotations

import shutil
from dataclasses import dataclass
from pathlib import Path

from app.studies.people.folder import Study

OUTPUT = "analysis"  # folder of tables and report in that of a study


@dataclass(frozen=True)
class Deleted:
    """What was removed.

    Attributes:
        code: of the participant.
        files: number of files of the participant.
        derived: tables and reports that held data of participants, removed as well.
    """

    code: str
    files: int
    derived: tuple[Path, ...]


def remove(folder: Path, code: str) -> Deleted:
    """Remove all files of a participant, and the tables and reports of the study.

    The derived files go first: were this interrupted, the participant would still be there, and the
    same call would go on.

    Raises:
        OptionError: no folder of a study, or no such participant.
        OSError: something cannot be removed.
    """
    study = Study.open(folder)
    found = study.participant(code)
    files = [path for path in found.path.rglob("*") if path.is_file()]
    if not found.path.is_dir():
        study.delete(code)  # raises, with those there are
    output = folder / OUTPUT
    derived = tuple(sorted(p for p in output.rglob("*") if p.is_file()))
    if output.is_dir():
        shutil.rmtree(output)
    study.delete(code)
    return Deleted(found.path.name, len(files), derived)

"""Measures of a trial, from its recording."""

from __future__ import annotations

from pathlib import Path

from app.studies.people.tasks import Goal


def measure(recording: Path, goal: Goal) -> dict[str, float]:
    """The measures of a trial by name, in SI units; a name that is missing could not be measured.

    Args:
        recording: of the whole trial, from its start to its end.
        goal: what was to be reached.
    """
    raise NotImplementedError

"""Simulated operators take a study."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path


def simulate(
    protocol: str, out: Path, participants: int, effects: Sequence[str], seed: int, workers: int
) -> int:
    """Let simulated participants take the study; returns the exit code."""
    raise NotImplementedError

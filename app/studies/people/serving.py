"""Serves a study: a front page, and for each participant a process with a session and a page."""

from __future__ import annotations

from pathlib import Path


def serve(protocol: str, out: Path, host: str, port: int, show: bool) -> int:
    """Serve the study until Ctrl-C; returns the exit code."""
    raise NotImplementedError

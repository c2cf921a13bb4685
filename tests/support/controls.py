"""Control processes, as the system knows them."""

from __future__ import annotations

from pathlib import Path


def controls_of(parent: int) -> list[int]:
    """Numbers of the control processes that a process started."""
    found = []
    for folder in Path("/proc").iterdir():
        if folder.name.isdigit():
            try:
                words = (folder / "cmdline").read_bytes().split(b"\0")
                stat = (folder / "stat").read_text().rpartition(")")[2].split()
            except OSError:
                continue
            if b"app.control.process.child" in words and int(stat[1]) == parent:
                found.append(int(folder.name))
    return found


def gone(process: int) -> bool:
    """Whether there is no such process any more."""
    return not Path(f"/proc/{process}").exists()

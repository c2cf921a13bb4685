"""What all tests share: how they are spread over two processes, and kernels as they are now."""

from __future__ import annotations

import hashlib
import os
import shutil
import tempfile
from pathlib import Path

import pytest
from xdist.scheduler import LoadScopeScheduling


class ByFile(LoadScopeScheduling):
    """A file's tests in one process, and so are all that drive a browser: one is load enough.

    Marks for pytest-xdist's own groups would be read, but pytest 9.2 has no place for them any
    more, and says nothing.
    """

    def _split_scope(self, nodeid: str) -> str:
        path = nodeid.partition("::")[0]
        return "browser" if "/browser/" in path else path


def pytest_xdist_make_scheduler(config: pytest.Config, log: object) -> ByFile:
    return ByFile(config, log)


def pytest_configure(config: pytest.Config) -> None:
    # What pages keep for their users (recordings, meshes) is not put where this user has theirs.
    os.environ["XDG_DATA_HOME"] = tempfile.mkdtemp(prefix="vf-sandbox-tests-")
    if not hasattr(config, "workerinput"):
        _forget_stale_kernels(Path(__file__).parent.parent)


def pytest_unconfigure(config: pytest.Config) -> None:
    shutil.rmtree(os.environ["XDG_DATA_HOME"], ignore_errors=True)


def _forget_stale_kernels(root: Path) -> None:
    """Drop all compiled kernels if the source of any of them has changed.

    Numba looks at the file of the function it compiled, not at those of the functions that were
    compiled into it: a change of `closest.py` would leave the tree as it was.
    """
    packages = [root / name for name in ("vf", "meshes", "app")]
    sources = [p for package in packages for p in sorted(package.rglob("*.py"))]
    texts = [text for p in sources if "@njit" in (text := p.read_text())]
    digest = hashlib.sha256("".join(texts).encode()).hexdigest()
    note = root / "vf" / "__pycache__" / "kernels.sha256"
    if note.exists() and note.read_text() == digest:
        return
    for package in packages:
        for index in package.rglob("__pycache__/*.nbi"):
            index.unlink(missing_ok=True)
    note.parent.mkdir(exist_ok=True)
    note.write_text(digest)

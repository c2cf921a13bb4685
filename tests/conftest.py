"""What all tests share: how they are spread over two processes, and kernels as they are now."""

from __future__ import annotations

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
    if not hasattr(config, "workerinput"):
        _forget_stale_kernels(Path(__file__).parent.parent)


def _forget_stale_kernels(root: Path) -> None:
    """Drop compiled kernels that are older than the source of any kernel in `vf`.

    Numba looks at the file of the function it compiled, not at those of the functions that were
    compiled into it: a change of `closest.py` would leave the tree as it was.
    """
    sources = [p for p in root.glob("vf/*.py") if "@njit" in p.read_text()]
    newest = max(p.stat().st_mtime for p in sources)
    for package in ("vf", "meshes", "app"):
        for index in root.glob(f"{package}/**/__pycache__/*.nbi"):
            if index.stat().st_mtime < newest:
                index.unlink(missing_ok=True)

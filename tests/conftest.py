"""What all tests share: how they are spread over two processes."""

from __future__ import annotations

import os
import shutil
import tempfile

import hypothesis
import pytest
from xdist.scheduler import LoadScopeScheduling

# How long an example takes says how busy the machine is.
hypothesis.settings.register_profile("untimed", deadline=None)
hypothesis.settings.load_profile("untimed")


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


def pytest_unconfigure(config: pytest.Config) -> None:
    shutil.rmtree(os.environ["XDG_DATA_HOME"], ignore_errors=True)

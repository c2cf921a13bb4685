"""What the tests of recordings share."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.support.runs import a_run


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A short recording."""
    path = tmp_path_factory.mktemp("record") / "run.vfrec"
    a_run(path)
    return path

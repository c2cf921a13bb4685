"""What several files say of the project is the same in all of them."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import vf
from tests.support.smoke import SMOKE

ROOT = Path(__file__).parents[1]


def test_the_version_to_cite_is_the_version() -> None:
    said = re.findall(r"^version: (.*)$", (ROOT / "CITATION.cff").read_text("utf-8"), re.MULTILINE)
    assert said == [vf.__version__]


def test_hosted_ci_tries_every_python_that_is_supported() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    supported = [
        words.removeprefix("Programming Language :: Python :: ")
        for words in project["classifiers"]
        if re.search(r"Python :: 3\.\d+$", words)
    ]
    assert project["requires-python"] == f">={supported[0]}"
    workflow = (ROOT / ".github/workflows/ci.yml").read_text("utf-8")
    (matrix,) = re.findall(r"^ +python: \[(.*)\]$", workflow, re.MULTILINE)
    assert re.findall(r'"([^"]+)"', matrix) == supported
    assert re.search(r"^ +- run: \.ci/run$", workflow, re.MULTILINE)


def test_the_tier_of_half_a_minute_names_files_that_are_there() -> None:
    assert [path for path in SMOKE if not path.is_file()] == []

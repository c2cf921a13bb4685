"""What the documents say runs: their Python, their links, their commands."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

import app.commands

ROOT = Path(__file__).parents[1]
DOCUMENTS = sorted([ROOT / "README.md", ROOT / "CONTRIBUTING.md", *(ROOT / "docs").glob("*.md")])
COMMANDS = {path.stem for path in Path(app.commands.__path__[0]).glob("[a-z]*.py")}


def named(path: Path) -> str:
    return str(path.relative_to(ROOT))


def test_the_library_page_runs_as_it_stands() -> None:
    blocks = re.findall(r"```python\n(.*?)```", (ROOT / "docs/library.md").read_text(), re.DOTALL)
    assert len(blocks) == 3
    names: dict[str, object] = {}
    for block in blocks:
        exec(compile(block, "docs/library.md", "exec"), names)


def test_the_readme_s_example_runs() -> None:
    import numpy as np

    import robots

    (block,) = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(), re.DOTALL)
    arm = robots.load("psm")
    names: dict[str, object] = {
        "x": np.array([0.0, 0.0, -0.13]), "q": arm.neutral, "target": arm.tip(arm.neutral),
    }  # fmt: skip
    exec(compile(block, "README.md", "exec"), names)
    step = names["step"]
    assert step.status.name == "SOLVED"  # type: ignore[attr-defined]


@pytest.mark.parametrize("document", DOCUMENTS, ids=named)
def test_links_lead_somewhere(document: Path) -> None:
    for target in re.findall(r"\]\(([^)\s]+)\)", document.read_text()):
        if not target.startswith(("http://", "https://", "#")):
            assert (document.parent / target.split("#")[0]).exists(), target


@pytest.mark.parametrize("document", DOCUMENTS, ids=named)
def test_commands_exist(document: Path) -> None:
    for word in re.findall(r"vf-sandbox ([a-z]+)\b", document.read_text()):
        assert word in COMMANDS, f"vf-sandbox {word}"

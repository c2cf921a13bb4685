"""What the documents say runs: their Python, their links, their commands."""

from __future__ import annotations

import ast
import difflib
import importlib.util
import json
import re
import shlex
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

import pytest

from app import commands as dispatch
from app import options
from app.commands import COMMANDS
from app.session import Session
from app.settings import Options
from tests.support import pictured
from tests.support.headless import wait_until

ROOT = Path(__file__).parents[1]
DOCUMENTS = sorted([ROOT / "README.md", ROOT / "CONTRIBUTING.md", *(ROOT / "docs").rglob("*.md")])


def named(path: Path) -> str:
    return str(path.relative_to(ROOT))


@pytest.mark.parametrize("page", ["anatomy", "library", "recording"])
def test_the_python_of_a_page_runs_as_it_stands(
    page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    if page == "recording":
        with Session(Options(mesh="gear", robot="point")) as session:
            session.record("gear.vfrec")
            wait_until(lambda: session.latest().tick > 50)
    text = (ROOT / f"docs/{page}.md").read_text("utf-8")
    names: dict[str, object] = {}
    for block in re.findall(r"```python\n(.*?)```", text, re.DOTALL):
        exec(compile(block, f"docs/{page}.md", "exec"), names)
    assert len(names) > 3
    assert names.get("difference") is None


def test_all_pages_with_python_are_run() -> None:
    assert {path.stem for path in DOCUMENTS if "```python" in path.read_text("utf-8")} == {
        "README", "anatomy", "library", "recording",
    }  # fmt: skip


@pytest.mark.parametrize("document", DOCUMENTS, ids=named)
def test_files_and_names_in_the_text_exist(document: Path) -> None:
    text = document.read_text("utf-8")
    for name in re.findall(r"`((?:app|vf|robots|meshes|tests|docs)/[\w/.*-]*)`", text):
        assert list(ROOT.glob(name)), name
    for name in re.findall(r"`((?:app|vf|robots|meshes)\.[\w.]+)[`(]", text):
        assert resolves(name), name


def test_where_things_are_is_where_contributing_says() -> None:
    """Each name in a row of the table is defined in the file or folder that is named before it."""
    rows = re.findall(
        r"^\| (?!to add|-).*\|$", (ROOT / "CONTRIBUTING.md").read_text(), re.MULTILINE
    )
    assert len(rows) > 10
    for row in rows:
        text = ""
        for word in re.findall(r"`([^` ]+)`", row):
            place = ROOT / word
            if "/" in word:
                files = place.rglob("*.py") if place.is_dir() else [place]
                text = "".join(file.read_text("utf-8") for file in files)
            else:
                assert re.search(rf"^ *(def |class )?{word}\b *[(:=]", text, re.MULTILINE), row


def resolves(name: str) -> bool:
    """Whether a dotted name is a module, or something in one, down to a dataclass's field."""
    words = name.split(".")
    at = next(k for k in range(len(words), 0, -1) if find_spec_of(".".join(words[:k])))
    found: Any = importlib.import_module(".".join(words[:at]))
    for word in words[at:]:
        if word in getattr(found, "__dataclass_fields__", ()):
            return True
        if not hasattr(found, word):
            return False
        found = getattr(found, word)
    return True


def find_spec_of(module: str) -> bool:
    try:
        return importlib.util.find_spec(module) is not None
    except ModuleNotFoundError:  # its parent is no package
        return False


def test_the_readme_s_python_runs_as_it_stands() -> None:
    blocks = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(), re.DOTALL)
    assert len(blocks) == 1
    # As a user does it: copied into a file, without anything that is not in it.
    done = subprocess.run(
        [sys.executable, "-c", blocks[0] + "\nprint(step.status.name, len(planes))"],
        capture_output=True, text=True, timeout=120, cwd=ROOT,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    status, planes = done.stdout.split()
    assert status == "SOLVED"
    assert int(planes) > 0


def commands(text: str) -> list[list[str]]:
    """The words after `vf-sandbox` of every line of a code block that calls it."""
    shown = re.findall(r"^ {4}(.*)$", text, re.MULTILINE)
    shown += "\n".join(re.findall(r"```(?:sh|bash|console)?\n(.*?)```", text, re.DOTALL)).split(
        "\n"
    )
    shown += re.findall(r"`(vf-sandbox [^`]+)`", text)
    found = []
    for line in shown:
        for part in line.split("&&"):
            called = part.strip().startswith("vf-sandbox")
            words = shlex.split(part, comments=True) if called else []
            if words and words[0] == "vf-sandbox":
                found.append(words[1:])
    return found


@pytest.mark.parametrize("document", DOCUMENTS, ids=named)
def test_the_commands_shown_are_understood(document: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Up to where they would begin to work: options, choices, units and ranges are right."""

    class Understood(Exception):
        pass

    def understood(kind: type, *arguments: Any, **keywords: Any) -> None:
        options.parse_as(kind, *arguments, **keywords)
        raise Understood

    monkeypatch.setattr(dispatch, "parse_as", understood)
    for words in commands(document.read_text("utf-8")):
        if "--help" in words or "--version" in words or "…" in words or len(words) == 1:
            continue
        name, rest = (words[0], words[1:]) if words and words[0] in COMMANDS else (None, words)
        try:
            if name is None:
                understood(Options, "vf-sandbox", rest, "")
            else:
                dispatch.call(name, rest)
        except Understood:
            continue
        pytest.fail(f"not understood: vf-sandbox {' '.join(words)}")


def test_the_readme_names_the_extras() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())
    readme = (ROOT / "README.md").read_text()
    for extra in project["project"]["optional-dependencies"]:
        assert f"`{extra}`" in readme, extra
    assert "git clone" in readme
    assert "synthetic" in readme


def test_the_pictures_are_of_todays_page() -> None:
    folder = ROOT / "docs"
    record = json.loads((folder / pictured.RECORD).read_text("utf-8"))
    changed = [
        line
        for line in difflib.ndiff(record["page"], pictured.parts_of_the_page())
        if line[0] in "+-"
    ]
    assert not changed, (
        "the page is not that of the pictures in docs/: take them again with\n"
        f"    {pictured.COMMAND}\n" + "\n".join(changed)
    )
    assert pictured.digests(folder, list(record["pictures"])) == record["pictures"], (
        f"a picture was taken without the others: {pictured.COMMAND}"
    )
    shown = {
        target
        for document in DOCUMENTS
        for target in re.findall(r"!\[[^\]]*\]\(([^)\s]+\.png)\)", document.read_text("utf-8"))
    }
    of_the_page = {Path(target).name for target in shown} - {
        "performance.png",
        "certified-blocked.png",
    }
    assert of_the_page <= {f"{name}.png" for name in record["pictures"]}


@pytest.mark.parametrize("document", DOCUMENTS, ids=named)
def test_links_lead_somewhere(document: Path) -> None:
    for target in re.findall(r"\]\(([^)\s]+)\)", document.read_text()):
        if not target.startswith(("http://", "https://", "#")):
            assert (document.parent / target.split("#")[0]).exists(), target


@pytest.mark.parametrize("document", DOCUMENTS, ids=named)
def test_commands_exist(document: Path) -> None:
    for word in re.findall(r"vf-sandbox ([a-z]+(?:-[a-z]+)*)\b", document.read_text()):
        assert word in COMMANDS, f"vf-sandbox {word}"


# What `vf` may import, and which of its modules more than that, as CONTRIBUTING.md says.
ARITHMETIC = {
    "__future__", "collections", "dataclasses", "enum", "fractions", "functools", "hashlib",
    "itertools", "math", "numpy", "osqp", "pinocchio", "scipy", "typing", "vf",
}  # fmt: skip
MORE = {
    "controller": {"time"},  # the stopwatch of `Step.timings`
    # SIGINT while OSQP solves; DAQP; solvers that are imported when they are asked for.
    "qp/solver_osqp": {"ctypes", "signal"},
    "qp/solver_daqp": {"daqp"},
    "qp/solver": {"importlib"},
    "kernels": {
        "llvmlite",
        "numba",
        "os",
        "pathlib",
        "pickle",
        "tempfile",
        "time",
        "types",
        "warnings",
    },
    "tick/attempts": {"numba"},  # arrays in one block of memory
    "tick/moving": {"numba"},
    "tick/report": {"numba"},
    "tick/search": {"numba"},
    "tick/sweep": {"numba"},
    "tick/tick": {"numba"},
    "tick/yielding": {"numba"},
    "qp/active_set": {"numba"},
    "tree/shapes": {"numba"},
    "tree/memory": {"sys"},  # whether memory is still referred to
}


@pytest.mark.parametrize("path", sorted((ROOT / "vf").rglob("*.py")), ids=named)
def test_the_library_has_no_threads_no_files_and_no_app(path: Path) -> None:
    tree = ast.parse(path.read_text("utf-8"))
    more = MORE.get(path.relative_to(ROOT / "vf").with_suffix("").as_posix(), set())
    for node in ast.walk(tree):
        names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
        if isinstance(node, ast.ImportFrom):
            names = [str(node.module)]
            if node.module == "time":
                assert [alias.name for alias in node.names] == ["monotonic"]
        for name in names:
            assert name.partition(".")[0] in ARITHMETIC | more, name
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
            assert node.func.id not in {"open", "print", "input"}

"""What may import what: vf, robots and meshes nothing of app, nor do their tests; vf's folders."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
# What each may import. An arm describes its joints as the kernels of vf read them.
BELOW_APP = {"vf": {"vf"}, "robots": {"robots", "vf"}, "meshes": {"meshes", "vf"}}
# What each folder of vf may import of vf; what is at its top may import all of them.
BASE = {"vf.adjacency", "vf.kernels", "vf.layout", "vf.planes", "vf.status"}
WITHIN_VF = {
    "tree": BASE,
    "qp": BASE,
    "rules": BASE | {"vf.surface", "vf.tree"},
    "tick": BASE | {"vf.surface", "vf.tree", "vf.rules", "vf.qp"},
}
MOST = 12  # modules in a folder of vf


def imported(path: Path) -> set[str]:
    """Dotted names of the modules that a file imports, wherever in it, and of what it takes."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text("utf-8"))):
        if isinstance(node, ast.Import):
            found |= {name.name for name in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: a relative import"
            found |= {f"{node.module}.{name.name}" for name in node.names}
    return found


def reached(path: Path, seen: set[Path]) -> set[str]:
    """The same, with what the modules of tests/support import that it imports."""
    seen.add(path)
    names = imported(path)
    for module in (ROOT / "tests/support").glob("*.py"):
        inside = f"tests.support.{module.stem}"
        if module not in seen and any(f"{name}.".startswith(f"{inside}.") for name in names):
            names |= reached(module, seen)
    return names


@pytest.mark.parametrize("package", BELOW_APP)
def test_a_package_imports_only_those_below_it(package: str) -> None:
    files = list((ROOT / package).rglob("*.py"))
    assert files
    others = {"app", "vf", "robots", "meshes", "tests"} - BELOW_APP[package]
    for path in files:
        tops = {name.split(".")[0] for name in imported(path)}
        assert not tops & others, path


@pytest.mark.parametrize("folder", WITHIN_VF)
def test_a_folder_of_vf_imports_only_those_below_it(folder: str) -> None:
    files = list((ROOT / "vf" / folder).glob("*.py"))
    assert files
    allowed = WITHIN_VF[folder] | {f"vf.{folder}"}
    for path in files:
        for name in imported(path):
            if name.split(".")[0] == "vf":
                assert any(f"{name}.".startswith(f"{one}.") for one in allowed), (path, name)


def test_folders_of_vf_stay_small() -> None:
    folders = [path for path in (ROOT / "vf").rglob("*") if list(path.glob("*.py"))]
    assert len(folders) == len(WITHIN_VF)
    for folder in (ROOT / "vf", *folders):
        assert len(list(folder.glob("[!_]*.py"))) <= MOST, folder


@pytest.mark.parametrize("package", BELOW_APP)
def test_tests_of_a_package_import_nothing_of_app(package: str) -> None:
    files = list((ROOT / "tests" / package).rglob("*.py"))
    assert files
    for path in files:
        tops = {name.split(".")[0] for name in reached(path, set())}
        assert "app" not in tops, path


def test_tests_share_what_is_in_support_and_nothing_else() -> None:
    """No test module imports another."""
    for path in (ROOT / "tests").rglob("*.py"):
        for name in imported(path):
            assert not name.startswith("test_"), path
            assert not name.startswith("tests.") or name.startswith("tests.support"), path


# What is in app/, from the ground up: each imports its own level and those below.
LEVELS = (
    {"choices", "console", "files", "interrupts", "judges", "kinds", "motion", "options",
     "settings", "structure", "words"},
    {"control", "devices", "recording", "scenarios", "scene", "session"},
    {"studies", "view"},
    {"bench", "serving"},
    {"commands"},
    {"cli"},
    {"__main__"},
)  # fmt: skip
# The same for the page.
PAGE_LEVELS = ({"drawing"}, {"clients"}, {"controls", "inspector"}, {"tabs"})


@pytest.mark.parametrize(("package", "levels"), [("app", LEVELS), ("app.view", PAGE_LEVELS)])
def test_no_import_leads_back_up(package: str, levels: tuple[set[str], ...]) -> None:
    level = {name: k for k, names in enumerate(levels) for name in names}
    folder = ROOT.joinpath(*package.split("."))
    for path in folder.rglob("*.py"):
        own = path.relative_to(folder).parts[0].removesuffix(".py")
        if package == "app":
            assert own in level or own == "__init__", f"{own} has no level yet"
        for name in imported(path):
            part = name.removeprefix(f"{package}.").split(".")[0]
            if own in level and name.startswith(f"{package}.") and part in level:
                assert level[part] <= level[own], f"{path} imports {name}"


@pytest.mark.parametrize("package", ["app", "meshes", "robots"])
def test_a_folder_has_a_dozen_modules_at_most(package: str) -> None:
    """More are two things."""
    for folder in {path.parent for path in (ROOT / package).rglob("*.py")}:
        modules = [path.name for path in folder.glob("*.py") if path.name != "__init__.py"]
        assert len(modules) <= 12, folder


@pytest.mark.parametrize("package", ["app", "meshes", "robots", "vf"])
def test_a_module_has_400_lines_at_most(package: str) -> None:
    for path in (ROOT / package).rglob("*.py"):
        assert len(path.read_text("utf-8").splitlines()) <= 400, path

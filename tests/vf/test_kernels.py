"""Compiled kernels on disk: whatever happens to the files, answers are those of the source."""

from __future__ import annotations

import importlib.util
import os
import subprocess
import sys
import tempfile
import warnings
from pathlib import Path
from types import ModuleType

import numba
import numpy as np
import pytest

from vf import kernels

HELPER = """
from vf.kernels import njit

FACTOR = 3

@njit(cache=True)
def helper(x):
    return FACTOR * x + 1.0
"""
CALLER = """
import numpy as np
from {helper} import helper
from vf.kernels import njit

TABLE = np.array([1.0, 2.0])

@njit(cache=True)
def caller(x):
    return TABLE[1] * later(x)

@njit(cache=True)
def later(x):
    return helper(x) + 0.5
"""
BY_MODULE = """
import {helper} as at
from vf.kernels import njit

@njit(cache=True)
def caller(x):
    return 2.0 * (at.FACTOR * x + at.helper(0.0) + 0.5)
"""
OF_THREE = 2.0 * (3.0 * 3.0 + 1.0 + 0.5)


@pytest.fixture(autouse=True)
def own_folder(monkeypatch, tmp_path):
    """Kernels beside their source, whatever folder this run is told to use."""
    monkeypatch.setattr(numba.config, "CACHE_DIR", "")
    monkeypatch.setattr(kernels, "_said", set())
    monkeypatch.syspath_prepend(str(tmp_path))


def start(folder: Path, helper: str = HELPER, caller: str = CALLER) -> ModuleType:
    """The two modules as a new process would find them: nothing of them is in memory."""
    names = f"helper_{folder.name}", f"caller_{folder.name}"
    for name, text in zip(names, (helper, caller), strict=True):
        path = folder / f"{name}.py"
        text = text.replace("{helper}", names[0])
        if not path.exists() or path.read_text() != text:
            path.write_text(text)
        spec = importlib.util.spec_from_file_location(name, path)
        assert spec is not None
        module = importlib.util.module_from_spec(spec)
        sys.modules[name] = module
        exec(compile(text, str(path), "exec"), module.__dict__)
    return module


def loaded(module: ModuleType) -> bool:
    """Whether the caller's machine code came from disk."""
    return bool(module.caller.stats.cache_hits)


def files(folder: Path) -> list[Path]:
    return sorted(p for p in (folder / "__pycache__").glob("*.caller-*.nb?"))


def test_a_second_start_loads_what_the_first_compiled(tmp_path):
    first = start(tmp_path)
    assert first.caller(3.0) == OF_THREE
    assert not loaded(first)
    second = start(tmp_path)
    assert second.caller(3.0) == OF_THREE
    assert loaded(second)
    assert second.caller(3) == OF_THREE  # another kind of argument is compiled and kept as well
    third = start(tmp_path)
    assert third.caller(3) == third.caller(3.0) == OF_THREE
    assert sum(third.caller.stats.cache_misses.values()) == 0


def test_whatever_is_cut_off_or_flipped_is_compiled_anew_and_mended(tmp_path):
    start(tmp_path).caller(3.0)
    rng = np.random.default_rng(1)
    for path in files(tmp_path):
        whole = path.read_bytes()
        spots = [0, len(whole) - 1, *rng.integers(len(whole), size=2)]
        damaged = [whole[:spot] for spot in spots[1:]]
        damaged += [whole + b"\0", b"", bytes(len(whole)), whole[32:]]
        for spot in spots:
            flipped = bytearray(whole)
            flipped[spot] ^= 1 << int(rng.integers(8))
            damaged.append(bytes(flipped))
        for data in damaged:
            path.write_bytes(data)
            module = start(tmp_path)
            assert module.caller(3.0) == OF_THREE
            assert not loaded(module)
            assert path.read_bytes() != data
    mended = start(tmp_path)
    assert mended.caller(3.0) == OF_THREE
    assert loaded(mended)


def test_a_file_that_names_a_module_that_has_moved_is_compiled_anew(tmp_path):
    module = start(tmp_path)
    module.caller(3.0)
    for path in files(tmp_path):
        content = b"cno.such.module\nThing\n."  # a pickle of a global name
        seal = module.caller._cache._cache_file._seal(path.name, content)
        path.write_bytes(seal + content)
        again = start(tmp_path)
        assert again.caller(3.0) == OF_THREE
        assert not loaded(again)
    mended = start(tmp_path)
    assert mended.caller(3.0) == OF_THREE
    assert loaded(mended)


def test_no_file_stands_for_another(tmp_path):
    module = start(tmp_path)
    module.caller(3.0)
    module.caller(3)
    one, other = (p for p in files(tmp_path) if p.suffix == ".nbc")
    a, b = one.read_bytes(), other.read_bytes()
    one.write_bytes(b)
    other.write_bytes(a)
    swapped = start(tmp_path)
    assert swapped.caller(3.0) == swapped.caller(3) == OF_THREE
    assert not loaded(swapped)


@pytest.mark.parametrize(
    ("old", "new", "value"),
    [
        ("+ 1.0", "+ 2.0", 2.0 * (9.0 + 2.0 + 0.5)),  # a constant in a callee's code
        ("FACTOR = 3", "FACTOR = 4", 2.0 * (12.0 + 1.0 + 0.5)),  # … or of its module
        ("* x", "/ x", 2.0 * (1.0 + 1.0 + 0.5)),
    ],
)
def test_a_changed_callee_is_noticed(tmp_path, old, new, value):
    start(tmp_path).caller(3.0)
    changed = start(tmp_path, helper=HELPER.replace(old, new))
    assert changed.caller(3.0) == value
    assert not loaded(changed)
    again = start(tmp_path, helper=HELPER.replace(old, new))
    assert again.caller(3.0) == value
    assert loaded(again)


@pytest.mark.parametrize(
    ("old", "new", "value"),
    [("FACTOR = 3", "FACTOR = 4", 2.0 * (12.0 + 1.5)), ("+ 1.0", "+ 2.0", 2.0 * (9.0 + 2.5))],
)
def test_changed_constants_and_kernels_of_a_module_are_noticed(tmp_path, old, new, value):
    assert start(tmp_path, caller=BY_MODULE).caller(3.0) == OF_THREE
    again = start(tmp_path, caller=BY_MODULE)
    assert again.caller(3.0) == OF_THREE
    assert loaded(again)
    changed = start(tmp_path, HELPER.replace(old, new), BY_MODULE)
    assert changed.caller(3.0) == value
    assert not loaded(changed)


def test_changed_arrays_are_noticed_and_comments_are_not(tmp_path):
    start(tmp_path).caller(3.0)
    other = start(tmp_path, caller=CALLER.replace("1.0, 2.0", "1.0, 4.0"))
    assert other.caller(3.0) == 2.0 * OF_THREE
    same = start(tmp_path, caller=CALLER.replace("1.0, 2.0", "1.0, 4.0") + "# the end\n")
    assert same.caller(3.0) == 2.0 * OF_THREE
    assert loaded(same)


def test_checked_and_unchecked_code_are_not_mixed_up(tmp_path, monkeypatch):
    start(tmp_path).caller(3.0)
    monkeypatch.setattr(numba.config, "BOUNDSCHECK", 1)
    checked = start(tmp_path)
    checked.caller(3.0)
    assert not loaded(checked)


def nowhere(folder: Path, monkeypatch) -> None:
    """Neither beside the source nor in the user's own folder can anything be written."""
    (folder / "__pycache__").write_text("in the way")
    monkeypatch.setenv("XDG_CACHE_HOME", "/dev/null/nowhere")
    monkeypatch.setattr(tempfile, "tempdir", str(folder))


def test_a_folder_for_temporary_files_is_the_last_resort_and_said_once(tmp_path, monkeypatch):
    nowhere(tmp_path, monkeypatch)
    with pytest.warns(RuntimeWarning, match="kept in .*vf-kernels") as said:
        assert start(tmp_path).caller(3.0) == OF_THREE
    assert len(said) == 1
    folder = tmp_path / f"vf-kernels-{os.getuid()}"
    assert folder.stat().st_mode & 0o777 == 0o700
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        second = start(tmp_path)
    assert second.caller(3.0) == OF_THREE
    assert loaded(second)


@pytest.mark.parametrize("kind", ["others may write", "link", "file"])
def test_a_temporary_folder_that_is_not_the_users_own_is_not_used(tmp_path, monkeypatch, kind):
    nowhere(tmp_path, monkeypatch)
    folder = tmp_path / f"vf-kernels-{os.getuid()}"
    if kind == "others may write":
        folder.mkdir()
        folder.chmod(0o777)
    elif kind == "link":
        (tmp_path / "elsewhere").mkdir(mode=0o700)
        folder.symlink_to(tmp_path / "elsewhere")
    else:
        folder.write_text("")
    with pytest.warns(RuntimeWarning, match="compiled anew at every start") as said:
        module = start(tmp_path)
    assert len(said) == 1
    assert module.caller(3.0) == OF_THREE
    assert not list(tmp_path.rglob("*.nb?"))


def test_a_full_disk_is_said_and_no_error(tmp_path, monkeypatch):
    def full(*_anything: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(kernels._SealedFiles, "_open_for_write", full)
    with pytest.warns(RuntimeWarning, match="could not be kept.*No space left"):
        assert start(tmp_path).caller(3.0) == OF_THREE


def test_what_is_no_part_of_a_kernel_is_refused(tmp_path):
    odd = CALLER.replace("return TABLE", "print(Path)\n    return TABLE")
    odd = odd.replace("import numpy", "from pathlib import Path\nimport numpy")
    module = start(tmp_path, caller=odd)
    with pytest.raises(TypeError, match="caller uses Path"):
        list(kernels.ingredients(module.caller.py_func))


def test_every_kernel_of_the_project_has_this_cache():
    root = Path(__file__).parents[2]
    for package in ("vf", "meshes", "robots", "app"):
        for path in (root / package).rglob("*.py"):
            if path != root / "vf" / "kernels.py":
                assert "from numba import" not in path.read_text(), path


@pytest.mark.slow
def test_the_library_starts_where_nothing_can_be_written(tmp_path):
    """As root writes everywhere, files stand where the folders would be."""
    source = Path(kernels.__file__).parent
    target = tmp_path / "vf"
    for path in source.rglob("*.py"):
        copy = target / path.relative_to(source)
        copy.parent.mkdir(exist_ok=True)
        copy.write_text(path.read_text())
        (copy.parent / "__pycache__").write_text("in the way")
    temporary = tmp_path / "temporary"
    temporary.mkdir()
    environment = {
        "PATH": os.environ["PATH"], "HOME": "/dev/null", "XDG_CACHE_HOME": "/dev/null/nowhere",
        "TMPDIR": str(temporary), "PYTHONPATH": str(tmp_path),
    }  # fmt: skip
    program = (
        "import vf; print(vf.__file__, vf.closest_point([[0,0,0],[1,0,0],[0,1,0]], [0,0,2])[2])"
    )
    result = subprocess.run(
        [sys.executable, "-B", "-c", program],
        capture_output=True, text=True, timeout=300, cwd=tmp_path, env=environment,
    )  # fmt: skip
    assert result.returncode == 0, result.stderr
    assert result.stdout.split() == [str(target / "__init__.py"), "2.0"]
    assert result.stderr.count("vf-kernels") == 1

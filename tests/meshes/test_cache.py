"""Generated meshes are kept between runs, and nothing in the cache can do harm."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

import meshes
from meshes.builtin import cache
from meshes.builtin.catalogue import Entry
from meshes.builtin.shapes import Arrays, torus


class Maker:
    """Counts how often the mesh is really made."""

    def __init__(self) -> None:
        self.runs = 0

    def __call__(self) -> Arrays:
        self.runs += 1
        return torus()


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    place = tmp_path / "not" / "there" / "yet"
    monkeypatch.setattr(cache, "folder", lambda: place)
    return place


def same(one: Arrays, other: Arrays) -> bool:
    return np.array_equal(one[0], other[0]) and np.array_equal(one[1], other[1])


def test_made_once_then_read(folder: Path) -> None:
    make = Maker()
    get = cache.cached("ring", make)
    assert same(get(), torus())
    assert same(get(), torus())
    assert make.runs == 1
    assert get()[1].dtype == np.int64
    assert [file.name for file in folder.iterdir()] == [cache.path("ring").name]


@pytest.mark.parametrize("damage", ["cut", "flipped", "text", "empty", "other arrays", "bad index"])
def test_damaged_file_is_made_anew(folder: Path, damage: str) -> None:
    make = Maker()
    get = cache.cached("ring", make)
    get()
    file = cache.path("ring")
    sound = file.read_bytes()
    if damage == "cut":
        file.write_bytes(sound[: len(sound) // 2])
    elif damage == "flipped":
        middle = len(sound) // 2
        file.write_bytes(sound[:middle] + bytes([sound[middle] ^ 0xFF]) + sound[middle + 1 :])
    elif damage == "text":
        file.write_text("not an archive")
    elif damage == "empty":
        file.write_bytes(b"")
    elif damage == "other arrays":
        np.savez(file, points=np.zeros(3))
    else:
        np.savez(file, vertices=np.zeros((3, 3)), faces=np.array([[0, 1, 3]]))
    assert same(get(), torus())
    assert make.runs == 2
    assert same(get(), torus())  # and mended on disk
    assert make.runs == 2


def test_no_pickle_is_ever_opened(folder: Path) -> None:
    make = Maker()
    folder.mkdir(parents=True)
    np.savez(cache.path("ring"), vertices=np.array([{}], dtype=object), faces=np.zeros((1, 3)))
    assert same(cache.cached("ring", make)(), torus())
    assert make.runs == 1


def test_unusable_folder_only_costs_time(folder: Path) -> None:
    folder.parent.parent.mkdir(parents=True)
    folder.parent.write_text("a file where the folder should be")
    make = Maker()
    get = cache.cached("ring", make)
    assert same(get(), torus())
    assert same(get(), torus())
    assert make.runs == 2


def test_a_new_recipe_has_a_new_file(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    make = Maker()
    get = cache.cached("ring", make)
    get()
    monkeypatch.setattr(cache, "RECIPES", cache.RECIPES + 1)
    get()
    assert make.runs == 2


def test_first_use_is_announced_and_later_ones_are_quick(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    make = Maker()
    entry = Entry("slow", cache.cached("slow", make), "here", "none", "Slow.", None, "slow")
    monkeypatch.setattr(sys.modules["meshes.load"], "catalogue", lambda: {"slow": entry})
    for uses in (1, 2):
        said: list[str] = []
        meshes.arrays("slow", progress=said.append)
        assert any("for the first time" in text for text in said) == (uses == 1)
    assert make.runs == 1

"""Files that users bring: their names, that they stay, and that nothing else is touched."""

from __future__ import annotations

import os
import time
import unicodedata
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from app import files
from app.scene import library
from app.scene.library import Library, LibraryError
from app.settings import MESH, Options


@pytest.mark.parametrize(
    ("given_", "kept"),
    [
        ("../../etc/passwd.stl", "passwd.stl"),
        ("C:\\Users\\me\\scan.ply", "scan.ply"),
        ("my scan (left).ply", "my scan (left).ply"),
        ("Schädel – Ötzi.stl", "Schädel – Ötzi.stl"),
        ("Scha\u0308del.stl", "Schädel.stl"),  # as macOS writes it
        ("頭蓋骨.obj", "頭蓋骨.obj"),
        ("جمجمة.stl", "جمجمة.stl"),
        ("череп.stl", "череп.stl"),
        ("skull 💀.stl", "skull 💀.stl"),
        ("gnp.\u202elts", "gnp._lts"),  # would be shown from right to left
        ("two\nlines.stl", "two_lines.stl"),
        ("a\u00a0b.stl", "a b.stl"),
        (".hidden.stl", "hidden.stl"),
        ("..", "mesh"),
        ("", "mesh"),
        ("   ", "mesh"),
        ("///", "mesh"),
        ("a\0b<c>.stl", "a_b_c_.stl"),
        ("x" * 500 + ".stl", "x" * 116 + ".stl"),
        ("骨" * 200 + ".stl", "骨" * 38 + ".stl"),
    ],
)
def test_names_that_lead_elsewhere_become_names_and_others_stay(given_: str, kept: str) -> None:
    assert files.harmless(given_, "mesh") == kept


@pytest.mark.parametrize(
    ("typed", "kept"),
    [
        ("né 3/4", "né 3_4"),
        ("left\\right", "left_right"),
        ("../../etc/passwd", "_.._etc_passwd"),
        ("/", "before"),
    ],
)
def test_a_slash_in_a_typed_name_drops_nothing_before_it(typed: str, kept: str) -> None:
    assert files.typed(typed, "before") == kept


@given(st.text(max_size=400))
def test_whatever_a_name_is_it_is_one_of_a_file(name: str) -> None:
    clean = files.harmless(name, "mesh")
    assert Path(clean).name == clean
    assert clean not in ("", ".", "..")
    assert clean.isprintable()
    assert not clean.startswith((".", " "))
    assert len(clean.encode()) <= 120
    assert unicodedata.normalize("NFC", clean) == clean
    assert files.harmless(clean, "mesh") == clean


def test_a_file_is_renamed_but_not_onto_another(tmp_path: Path) -> None:
    one, two = tmp_path / "one", tmp_path / "two"
    one.write_text("1")
    two.write_text("2")
    with pytest.raises(FileExistsError):
        files.rename(one, two)
    files.rename(one, tmp_path / "three")
    assert {p.name: p.read_text() for p in tmp_path.iterdir()} == {"two": "2", "three": "1"}
    with pytest.raises(OSError, match="No such file"):
        files.rename(one, tmp_path / "four")
    assert not (tmp_path / "four").exists()


def brought(there: Library, name: str, content: bytes) -> Path:
    path = there.coming() / name
    path.write_bytes(content)
    return there.add(path)


def test_what_was_brought_stays_and_is_found_after_a_restart(tmp_path: Path) -> None:
    place = tmp_path / "meshes"
    there = Library(place)
    assert there.kept() == []
    paths = [brought(there, f"scan {k} ü.stl", bytes([k]) * 10) for k in range(10)]
    how = replace(Options(), mesh=str(paths[3]), unit="mm", up="-y", repair=True, rotate=(1, 2, 3))
    there.note(how)
    for later in (there, Library(place)):
        assert [file.name for file in later.kept()] == [f"scan {k} ü.stl" for k in range(10)]
        assert {file.size for file in later.kept()} == {10}
        assert later.names() == tuple(f"scan {k} ü.stl" for k in range(10))
        found = later.settings("scan 3 ü.stl")
        assert found == {name: getattr(how, name) for name in MESH}
        assert later.settings("scan 4 ü.stl") == {"mesh": str(paths[4])}
        assert Path(str(found["mesh"])).read_bytes() == bytes([3]) * 10
        assert later.find("scan 3 ü.stl") == str(paths[3])


def test_another_file_of_the_same_name_gets_a_number_and_the_same_one_none(tmp_path: Path) -> None:
    there = Library(tmp_path / "meshes")
    one = brought(there, "scan.stl", b"one")
    two = brought(there, "scan.stl", b"two")
    assert brought(there, "scan.stl", b"one") == one
    assert brought(there, "scan.stl", b"two") == two
    assert [file.name for file in there.kept()] == ["scan-2.stl", "scan.stl"]
    assert (one.read_bytes(), two.read_bytes()) == (b"one", b"two")
    assert not list((tmp_path / "meshes").glob(".*"))
    # A name in the list stands for one file: those given by path count, and the catalogue.
    there.note(Options(mesh="/data/skull.stl"))
    assert brought(there, "skull.stl", b"s").name == "skull-2.stl"
    assert there.settings("skull.stl") is not None
    assert there.settings("skull.stl")["mesh"] == "/data/skull.stl"  # type: ignore[index]


def test_deleting_takes_one_file_and_never_the_one_on_the_page(tmp_path: Path) -> None:
    there = Library(tmp_path / "meshes")
    outside = tmp_path / "outside.stl"
    outside.write_text("mine")
    one, two = brought(there, "a.stl", b"1"), brought(there, "b.stl", b"2")
    there.note(Options(mesh=str(outside)))
    with pytest.raises(LibraryError, match=r"a\.stl is on the page"):
        there.delete("a.stl", {"cube", str(one)})
    for name in ("outside.stl", "../outside.stl", "..", "", "none.stl", str(outside)):
        with pytest.raises(LibraryError, match="is kept"):
            there.delete(name, {"cube"})
    there.delete("b.stl", {str(one)})
    assert one.exists()
    assert outside.exists()
    assert not two.parent.exists()
    assert there.names() == ("a.stl", "outside.stl")
    assert there.settings("b.stl") is None


@pytest.mark.parametrize("name", ["../a.stl", "/etc/passwd", "..", ".", "", "a/b.stl", "no.stl"])
def test_only_names_in_the_list_are_found(tmp_path: Path, name: str) -> None:
    place = tmp_path / "meshes"
    there = Library(place)
    brought(there, "a.stl", b"1")
    (tmp_path / "a.stl").write_text("not kept")
    assert there.settings(name) is None
    assert there.find(name) is None


@pytest.mark.parametrize(
    "note", ["", "[]", "{", '{"unit": 5}', '{"mesh": "/etc/passwd"}', '{"nonsense": {}}', "null"]
)
def test_a_note_that_is_damaged_costs_no_more_than_the_note(tmp_path: Path, note: str) -> None:
    there = Library(tmp_path / "meshes")
    path = brought(there, "a.stl", b"1")
    (path.parent / library.NOTE).write_text(note)
    assert Library(tmp_path / "meshes").settings("a.stl") == {"mesh": str(path)}


def test_there_is_an_end_to_what_is_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    there = Library(tmp_path / "meshes")
    assert there.refusal(10**8) is None
    monkeypatch.setattr(library, "ROOM", 1000.0)
    brought(there, "a.stl", bytes(600))
    assert there.refusal(300) is None
    assert there.refusal(500) == (
        "600 bytes of 1 kB are taken: delete some meshes first (tab Mesh)"
    )
    monkeypatch.setattr(library, "MOST", 1)
    assert "1 meshes are kept already" in str(there.refusal(1))


def test_only_transfers_that_were_given_up_are_swept_away(tmp_path: Path) -> None:
    place = tmp_path / "meshes"
    there = Library(place)
    fresh, stale = there.coming(), there.coming()
    (stale / "half.stl").write_bytes(b"1")
    kept = brought(there, "a.stl", b"1")
    ages_ago = time.time() - 2 * 86_400
    for path in (stale, kept.parent, kept):
        os.utime(path, (ages_ago, ages_ago))
    assert [file.name for file in Library(place).kept()] == ["a.stl"]
    assert fresh.exists()
    assert not stale.exists()


@pytest.mark.parametrize(
    ("count", "text"),
    [(0, "0 bytes"), (999, "999 bytes"), (1000, "1 kB"), (1_300_000, "1.3 MB"), (4e9, "4 GB"),
     (999_700, "1 MB"), (123_456_789, "123 MB")],
)  # fmt: skip
def test_sizes_for_people(count: float, text: str) -> None:
    assert files.size(count) == text

"""What is printed: tables that fit, numbers with their nouns, errors in words, any encoding."""

from __future__ import annotations

import errno
import io
import threading
import webbrowser

import pytest
from hypothesis import given
from hypothesis import settings as examples
from hypothesis import strategies as st
from rich.console import Console

from app.console import Column, console, count, prepare, reason, show_table
from app.options import parse_as
from app.serving import open_browser
from app.settings import Options

numbers = st.text("0123456789,.-+e% µ", min_size=1, max_size=14).map(
    lambda text: f"{text.strip()}0"
)


@examples(max_examples=60)
@given(
    st.integers(40, 200),
    st.integers(1, 16).flatmap(
        lambda n: st.lists(st.lists(numbers, min_size=n, max_size=n), min_size=1, max_size=4)
    ),
    st.booleans(),
)
def test_a_table_fits_and_cuts_no_number(width: int, rows: list[list[str]], words: bool) -> None:
    names = [f"column {k} [mm]" for k in range(len(rows[0]))]
    columns = [Column("what", left=True), *map(Column, names)]
    cells = [[f"row {k}", *row] for k, row in enumerate(rows)]
    if words:
        columns.append(Column("note", left=True))
        cells = [[*row, "some words that may be broken between lines " * 3] for row in cells]
    out = io.StringIO()
    show_table(Console(file=out, width=width), columns, cells, title="Title")
    lines = out.getvalue().splitlines()
    assert all(len(line) <= width for line in lines)
    text = "\n".join(lines)
    for name in names:
        assert name in text
    for k, row in enumerate(cells):
        mine = [line for line in lines if line.startswith(f"row {k} ") or line == f"row {k}"]
        for cell in row[1 : len(names) + 1]:
            assert any(cell in line for line in mine), (cell, mine)


def test_a_number_has_its_noun() -> None:
    assert count(1, "trial") == "1 trial"
    assert count(0, "trial") == "0 trials"
    assert count(12_345, "query", "queries") == "12,345 queries"
    assert count(1, "query", "queries") == "1 query"


@pytest.mark.parametrize(
    ("error", "text"),
    [
        (FileNotFoundError(errno.ENOENT, "No such file or directory", "x.stl"),
         "x.stl: no such file or directory"),
        (OSError(errno.EINVAL, "Invalid argument"), "invalid argument"),
        (PermissionError(errno.EACCES, "Permission denied", b"a\xff.stl"),
         "a\udcff.stl: permission denied"),
        (OSError("the scheduler is gone"), "the scheduler is gone"),
        (ValueError("two\nlines"), "two lines"),
        (KeyError(), "KeyError"),
    ],
)  # fmt: skip
def test_an_error_is_a_line_without_its_number(error: Exception, text: str) -> None:
    assert reason(error) == text


@pytest.mark.parametrize(
    ("letters", "plain"),
    [("80 × 80 mm", b"80 x 80 mm"), ("5 µm ± 1", b"5 um +- 1"), ("cm³ – …", b"cm3 - ..."),
     ("Schädel", b"Schadel"), ("头骨.stl", b"??.stl"), ("a\udcff", b"a?")],
)  # fmt: skip
def test_letters_that_an_output_lacks_are_written_plainly(letters: str, plain: bytes) -> None:
    prepare()
    assert letters.encode("ascii", "plain") == plain


def test_the_width_is_that_of_columns(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "123")
    assert console().width == 123


def test_the_browser_is_opened_without_waiting_for_it(monkeypatch: pytest.MonkeyPatch) -> None:
    assert parse_as(Options, "vf-sandbox", ["--open"]).open
    assert not parse_as(Options, "vf-sandbox", []).open
    opened, leave = threading.Event(), threading.Event()
    seen = []

    def browse(url: str) -> bool:
        seen.append(url)
        opened.set()
        return leave.wait(20.0) and False  # as a browser in a terminal, which then fails

    monkeypatch.setattr(webbrowser, "open", browse)
    out = io.StringIO()
    open_browser("http://127.0.0.1:8080", Console(file=out))
    assert opened.wait(20.0)
    assert seen == ["http://127.0.0.1:8080"]
    leave.set()
    for thread in threading.enumerate():
        if thread.name == "browser":
            thread.join(20.0)
    assert "no browser was found" in out.getvalue()

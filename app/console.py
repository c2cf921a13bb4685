"""What commands print: on any terminal, in any encoding, in 80 columns, into any pipe."""

from __future__ import annotations

import codecs
import contextlib
import os
import sys
import unicodedata
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from rich.console import Console
from rich.markup import escape
from rich.progress import Progress, ProgressColumn
from rich.table import Table

GAP = 2  # between two columns
WORDS = 30  # width that a column of words is given before another part of the table is begun
_PLAIN = {
    "×": "x", "·": "*", "µ": "u", "μ": "u", "±": "+-", "–": "-", "—": "-", "−": "-", "→": "->",
    "…": "...", "≥": ">=", "≤": "<=", "°": " deg", "⌀": "dia. ", "✓": "ok", "✗": "x", "“": '"',
    "”": '"', "‘": "'", "’": "'", "Δ": "delta ",
}  # fmt: skip


def prepare() -> None:
    """Let nothing that is printed fail for its letters, whatever the output's encoding has."""
    codecs.register_error("plain", _in_plain_letters)
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="plain")


def _in_plain_letters(error: UnicodeError) -> tuple[str, int]:
    assert isinstance(error, UnicodeEncodeError)
    plain = ""
    for letter in error.object[error.start : error.end]:
        near = _PLAIN.get(letter) or unicodedata.normalize("NFKD", letter)
        plain += near if near.isascii() else near.encode("ascii", "ignore").decode() or "?"
    return plain, error.end


class _Console(Console):
    def on_broken_pipe(self) -> None:
        """Leave it to `closing`, which knows of all that is printed."""
        raise BrokenPipeError


def console(stderr: bool = False, soft_wrap: bool = False) -> Console:
    """A console that colours nothing by itself; as wide as the terminal, COLUMNS, or 80."""
    return _Console(highlight=False, stderr=stderr, soft_wrap=soft_wrap)


def progress(*columns: ProgressColumn | str, refresh: float = 10) -> Progress:
    """A progress bar on a terminal's stderr, which goes away in the end; none in a log."""
    out = console(stderr=True)
    return Progress(
        *columns, console=out, transient=True, disable=not out.is_terminal,
        refresh_per_second=refresh,
    )  # fmt: skip


def count(number: int, thing: str, things: str | None = None) -> str:
    """A number with its noun, such as `1 trial` and `1,000 trials`."""
    return f"{number:,} {thing if number == 1 else things or thing + 's'}"


def reason(error: BaseException) -> str:
    """An error in one line for a user: of a file its name and why, without a number of errno."""
    if isinstance(error, OSError) and error.strerror:
        name = error.filename
        why = error.strerror[:1].lower() + error.strerror[1:]
        return why if name is None else f"{os.fsdecode(name)}: {why}"
    return " ".join(str(error).split()) or type(error).__name__


@dataclass(frozen=True)
class Column:
    """Heading of a column; `left`: of words, which may be broken into lines, not of numbers."""

    name: str
    left: bool = False


def show_table(
    out: Console,
    columns: Sequence[Column],
    rows: Sequence[Sequence[str]],
    *,
    labels: int = 1,
    title: str | None = None,
) -> None:
    """Print a table in full: where it is too wide, in parts that repeat the first columns.

    Args:
        rows: cells, as markup of rich.
        labels: how many columns say what a row is about; these are repeated.
        title: a line or more above.
    """
    if title:
        out.print(title)
    for part in parts(out, columns, rows, labels):
        table = Table(box=None, pad_edge=False, padding=(0, GAP, 0, 0))
        for k in part:
            table.add_column(
                escape(columns[k].name),
                justify="left" if columns[k].left else "right",
                no_wrap=not columns[k].left,
                overflow="fold",
            )
        for row in rows:
            table.add_row(*(row[k] for k in part))
        out.print(table)


def parts(
    out: Console, columns: Sequence[Column], rows: Sequence[Sequence[str]], labels: int
) -> list[list[int]]:
    """Which columns stand beside each other, so that each part is no wider than the console."""
    widths = [_width(out, column, [row[k] for row in rows]) for k, column in enumerate(columns)]
    found: list[list[int]] = []
    for k in range(labels, len(columns)):
        longer = [*(found[-1] if found else range(labels)), k]
        if not found or sum(widths[i] + GAP for i in longer) - GAP > out.width:
            found.append([*range(labels), k])
        else:
            found[-1] = longer
    return found or [[*range(labels)]]


def _width(out: Console, column: Column, cells: Sequence[str]) -> int:
    """What a column needs: numbers all of it, words enough not to be a column of single words."""
    sizes = [out.measure(text) for text in (escape(column.name), *cells)]
    most = max(size.maximum for size in sizes)
    return min(most, max(WORDS, *(size.minimum for size in sizes))) if column.left else most


@contextlib.contextmanager
def closing() -> Iterator[None]:
    """Whoever reads the output may stop: what is not read then is not printed, nor complained of.

    Raises:
        SystemExit: 141, as of a program that the system ends for that.
    """
    try:
        yield
        for stream in (sys.stdout, sys.stderr):
            if stream is not None:
                stream.flush()
    except BrokenPipeError:
        _forget_output()
        raise SystemExit(141) from None


def _forget_output() -> None:
    """What is left in the buffers goes nowhere, instead of failing at the very end."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError, ValueError, AttributeError):
            os.dup2(nowhere, stream.fileno())

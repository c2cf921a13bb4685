"""Output of the commands: any terminal width and encoding, and pipes that close early."""

from __future__ import annotations

import codecs
import contextlib
import os
import sys
import unicodedata
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

from rich.console import Console
from rich.markup import escape
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    ProgressColumn,
    SpinnerColumn,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.table import Table

GAP = 2  # between two columns
WORDS = 30  # least width of a text column before the table is split into parts
_PLAIN = {
    "×": "x", "·": "*", "µ": "u", "μ": "u", "±": "+-", "–": "-", "—": "-", "−": "-", "→": "->",
    "…": "...", "≥": ">=", "≤": "<=", "°": " deg", "⌀": "dia. ", "✓": "ok", "✗": "x", "“": '"',
    "”": '"', "‘": "'", "’": "'", "Δ": "delta ",
}  # fmt: skip


def prepare() -> None:
    """Replace characters that the output's encoding lacks, instead of raising an error."""
    codecs.register_error("plain", _to_ascii)
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="plain")


def _to_ascii(error: UnicodeError) -> tuple[str, int]:
    assert isinstance(error, UnicodeEncodeError)
    plain = ""
    for letter in error.object[error.start : error.end]:
        near = _PLAIN.get(letter) or unicodedata.normalize("NFKD", letter)
        plain += near if near.isascii() else near.encode("ascii", "ignore").decode() or "?"
    return plain, error.end


class _Console(Console):
    def on_broken_pipe(self) -> None:
        raise BrokenPipeError  # handled by `flushed_output`, which covers `print` too


def console(stderr: bool = False, soft_wrap: bool = False) -> Console:
    """A console without automatic highlighting; as wide as the terminal, COLUMNS, or 80."""
    return _Console(highlight=False, stderr=stderr, soft_wrap=soft_wrap)


def progress(*, counted: bool = False, bar: bool = True, refresh: float = 10) -> Progress:
    """The progress of some work on stderr, removed at the end; nothing if that is no terminal.

    Args:
        counted: show how many items are done.
        bar: show the share that is done; else it is not known.
        refresh: [1/s].
    """
    columns: list[ProgressColumn] = [TextColumn("{task.description}"), TimeElapsedColumn()]
    if bar:
        columns[1:1] = [BarColumn(), *([MofNCompleteColumn()] if counted else [])]
        columns.append(TimeRemainingColumn())
    else:
        columns.insert(0, SpinnerColumn())
    out = console(stderr=True)
    return Progress(
        *columns, console=out, transient=True, disable=not out.is_terminal,
        refresh_per_second=refresh,
    )  # fmt: skip


def run_counted(
    name: str,
    work: int,
    run: Callable[[Callable[[str], None], Callable[[int], None]], None],
) -> bool:
    """Do some work under a bar; whether Ctrl-C interrupted it.

    Args:
        name: of the work, until it says otherwise.
        work: number of items.
        run: called once, with what to call with the name of the present part of the work, and with
            the number of items just done.
    """
    bar = progress(counted=True)
    try:
        with bar:
            task = bar.add_task(name, total=work)
            run(
                lambda part: bar.update(task, description=part),
                lambda done: bar.advance(task, done),
            )
    except KeyboardInterrupt:
        return True
    return False


def count(number: int, thing: str, things: str | None = None) -> str:
    """A number with its noun, such as `1 trial` and `1,000 trials`."""
    return f"{number:,} {thing if number == 1 else things or thing + 's'}"


def reason(error: BaseException) -> str:
    """An error in one line for a user; for a file its name and the reason, without the errno."""
    if isinstance(error, OSError) and error.strerror:
        name = error.filename
        why = error.strerror[:1].lower() + error.strerror[1:]
        return why if name is None else f"{os.fsdecode(name)}: {why}"
    return " ".join(str(error).split()) or type(error).__name__


@dataclass(frozen=True)
class Column:
    """Heading of a column; `left`: a text column, left-aligned and wrapped; else numbers."""

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
    """Print a table; one that is too wide is split into parts that repeat the label columns.

    Args:
        rows: cells, as markup of rich.
        labels: number of leading columns that identify a row and are repeated in each part.
        title: printed above.
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
    """Indices of the columns of each part, so that no part is wider than the console."""
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
    """Width of a column: numbers are never wrapped; text may be wrapped at `WORDS` or more."""
    sizes = [out.measure(text) for text in (escape(column.name), *cells)]
    most = max(size.maximum for size in sizes)
    return min(most, max(WORDS, *(size.minimum for size in sizes))) if column.left else most


@contextlib.contextmanager
def flushed_output() -> Iterator[None]:
    """Flush the output at the end; a closed pipe (`… | head`) is no error.

    Raises:
        SystemExit: the pipe was closed; 141, the shell's code for SIGPIPE.
    """
    try:
        yield
        for stream in (sys.stdout, sys.stderr):
            if stream is not None:
                stream.flush()
    except BrokenPipeError:
        _discard_output()
        raise SystemExit(141) from None


def _discard_output() -> None:
    """Redirect the output to the null device, so that the interpreter's last flush succeeds."""
    null = os.open(os.devnull, os.O_WRONLY)
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError, ValueError, AttributeError):
            os.dup2(null, stream.fileno())

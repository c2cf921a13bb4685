"""Names of files that users choose, and files that are moved without writing over another."""

from __future__ import annotations

import contextlib
import itertools
import os
import re
import unicodedata
from collections.abc import Iterator
from pathlib import Path

LONGEST = 120  # of a name [byte]; file systems allow 255, and numbers and suffixes come behind
_NOT_IN_NAMES = '<>:"|?*'  # on some file system or other


def harmless(name: str, fallback: str) -> str:
    """The last part of a path from any system, in its own script, to be used as a file's name.

    What cannot be seen or is not in names everywhere becomes `_`; the end of a long name is kept.
    `fallback`: where nothing is left.
    """
    last = re.split(r"[/\\]", unicodedata.normalize("NFC", name))[-1]
    seen = (" " if unicodedata.category(c) == "Zs" else c for c in last)
    clean = "".join(c if c.isprintable() and c not in _NOT_IN_NAMES else "_" for c in seen)
    clean = re.sub("_{2,}", "_", clean).strip().lstrip(".").rstrip(". ")
    if not clean.strip("_ "):
        return fallback
    short = clean.encode()[-LONGEST:].decode(errors="ignore")
    # A letter's accents, which may be characters of their own, do not begin a name.
    while short != clean and short and unicodedata.combining(short[0]):
        short = short[1:]
    return short.strip() or fallback


def typed(name: str, fallback: str) -> str:
    """A name as somebody typed it, `harmless`; a slash in it begins no path, and becomes `_`."""
    return harmless(re.sub(r"[/\\]", "_", name), fallback)


def shown(name: str) -> str:
    """A name or path as it may stand in a message: of one line, and nothing in it acts."""
    return "".join(c if c.isprintable() else "\N{REPLACEMENT CHARACTER}" for c in name)


def numbered(path: Path) -> Iterator[Path]:
    """The path, and the same with 2, 3, … behind its stem."""
    for number in itertools.count(1):
        if number == 1:
            yield path
        else:
            yield path.with_name(f"{path.stem}-{number}{path.suffix}")


def rename(path: Path, new: Path) -> None:
    """Give a file another name, which nothing has.

    Raises:
        FileExistsError: something has it.
        OSError: it cannot be done.
    """
    os.close(os.open(new, os.O_WRONLY | os.O_CREAT | os.O_EXCL))  # to have the name
    try:
        os.replace(path, new)
    except OSError:
        with contextlib.suppress(OSError):
            new.unlink()
        raise


def size(count: float) -> str:
    """A number of bytes, for people."""
    for unit in ("bytes", "kB", "MB"):
        if count < 999.5:
            return f"{count:.0f} {unit}" if unit == "bytes" else f"{count:.3g} {unit}"
        count /= 1e3
    return f"{count:.3g} GB"

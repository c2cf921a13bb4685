"""Safe file names from user input, unused names, and renaming that overwrites nothing."""

from __future__ import annotations

import contextlib
import itertools
import os
import re
import unicodedata
from collections.abc import Iterator
from pathlib import Path

LONGEST = 120  # of a name [byte]; file systems allow 255, numbers and suffixes are appended
_NOT_IN_NAMES = '<>:"|?*'  # on some file system or other


def harmless(name: str, fallback: str) -> str:
    """The last component of a path from any system, as a file name valid on every system.

    Unprintable and reserved characters become `_`; a long name is shortened at its beginning.
    `fallback`: the name if nothing is left.
    """
    last = re.split(r"[/\\]", unicodedata.normalize("NFC", name))[-1]
    seen = (" " if unicodedata.category(c) == "Zs" else c for c in last)
    clean = "".join(c if c.isprintable() and c not in _NOT_IN_NAMES else "_" for c in seen)
    clean = re.sub("_{2,}", "_", clean).strip().lstrip(".").rstrip(". ")
    if not clean.strip("_ "):
        return fallback
    short = clean.encode()[-LONGEST:].decode(errors="ignore")
    # Do not begin with a combining character whose base letter was cut off.
    while short != clean and short and unicodedata.combining(short[0]):
        short = short[1:]
    return short.strip() or fallback


def typed(name: str, fallback: str) -> str:
    """`harmless` for a name that a user typed: a slash is part of the name and becomes `_`."""
    return harmless(re.sub(r"[/\\]", "_", name), fallback)


def shown(name: str) -> str:
    """A name or path for a message: control characters are replaced."""
    return "".join(c if c.isprintable() else "\N{REPLACEMENT CHARACTER}" for c in name)


def numbered(path: Path) -> Iterator[Path]:
    """The path, then the path with -2, -3, … appended to its stem."""
    for number in itertools.count(1):
        if number == 1:
            yield path
        else:
            yield path.with_name(f"{path.stem}-{number}{path.suffix}")


def rename(path: Path, new: Path) -> None:
    """Rename a file without overwriting another.

    Raises:
        FileExistsError: the new name is taken.
        OSError: the file cannot be renamed.
    """
    os.close(os.open(new, os.O_WRONLY | os.O_CREAT | os.O_EXCL))  # reserves the name atomically
    try:
        os.replace(path, new)
    except OSError:
        with contextlib.suppress(OSError):
            new.unlink()
        raise


def size(count: float) -> str:
    """A number of bytes with a readable unit."""
    for unit in ("bytes", "kB", "MB"):
        if count < 999.5:
            return f"{count:.0f} {unit}" if unit == "bytes" else f"{count:.3g} {unit}"
        count /= 1e3
    return f"{count:.3g} GB"

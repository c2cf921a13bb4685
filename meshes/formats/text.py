"""Text files: detection, encodings, line ends and numbers."""

from __future__ import annotations

import codecs
import warnings
from typing import Any

import numpy as np
from numpy.typing import NDArray

from meshes.errors import MeshError

_SAMPLE = 4096  # [byte] examined to tell text from binary
# Characters that text never holds; tab, line ends, form feed and Ctrl-Z may occur.
_CONTROL = bytes(c for c in range(32) if c not in b"\t\n\v\f\r\x1a") + b"\x7f"
_MARKS = {
    codecs.BOM_UTF32_LE: "utf-32",  # before UTF-16, whose mark it begins with
    codecs.BOM_UTF32_BE: "utf-32",
    codecs.BOM_UTF16_LE: "utf-16",
    codecs.BOM_UTF16_BE: "utf-16",
    codecs.BOM_UTF8: "utf-8-sig",
}


def plain(data: bytes) -> bytes | None:
    r"""A text's bytes with "\n" as line ends and without a byte-order mark; None of binary data.

    UTF-16 and UTF-32 are taken as such if they begin with their mark.

    Raises:
        MeshError: a mark, but not the encoding that it stands for.
    """
    for mark, encoding in _MARKS.items():
        if data.startswith(mark) and (encoding != "utf-8-sig"):
            try:
                data = data.decode(encoding).encode()
            except UnicodeDecodeError:
                name = encoding.upper()
                raise MeshError(f"begins as {name} text, but is not: cut off or damaged") from None
            break
    data = data.removeprefix(codecs.BOM_UTF8)
    sample = data[:_SAMPLE]
    if len(sample.translate(None, _CONTROL)) != len(sample):
        return None
    if b"\r" in data:
        data = data.replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    return data.rstrip(b"\x1a")


def required(data: bytes) -> bytes:
    """As `plain`.

    Raises:
        MeshError: it is binary.
    """
    found = plain(data)
    if found is None:
        raise MeshError("binary data where text should be")
    return found


def numbers(text: bytes, what: str) -> NDArray[np.float64]:
    """All numbers of a text with white space between them.

    Raises:
        MeshError: a word that is no number; ``what`` names the place.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("error", DeprecationWarning)  # numpy's report of unread data
        try:
            return np.fromstring(text, dtype=np.float64, sep=" ") if text.strip() else np.empty(0)
        except (DeprecationWarning, ValueError):
            pass
    for word in text.split():
        number(word, what)
    raise MeshError(f"{what}: not numbers with spaces between them")


def number(word: bytes, what: str) -> float:
    """One number.

    Raises:
        MeshError: it is none; ``what`` names the place.
    """
    try:
        return float(word)
    except ValueError:
        hint = "; a decimal comma is not read" if b"," in word else ""
        raise MeshError(f"{what}: {quoted(word)} is not a number{hint}") from None


def whole(values: NDArray[np.float64], what: str) -> NDArray[np.int64]:
    """Whole numbers that were read as floating point.

    Raises:
        MeshError: one is not whole, or 2⁵³ or more.
    """
    good = np.isfinite(values) & (np.abs(values) < 2.0**53) & (values == np.floor(values))
    if not good.all():
        raise MeshError(f"{what}: {values[good.argmin()]:g} is not a whole number")
    return values.astype(np.int64)


def quoted(word: Any) -> str:
    """The first bytes of a file's word or line for a message: quoted, printable."""
    text = bytes(word)[:40].decode("utf-8", "replace").strip()
    return repr(text)


def open_end(text: bytes) -> tuple[str, ...]:
    """A note if a text does not end with a line end: its last number may be truncated."""
    if text[-1:] in (b"\n", b"\r", b""):
        return ()
    return ("The file ends within a line: if it was cut off there, its last triangle is wrong.",)

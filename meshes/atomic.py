"""Files that are put in place when they are complete."""

from __future__ import annotations

import contextlib
import os
import secrets
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO


@contextlib.contextmanager
def replacing(file: Path) -> Iterator[BinaryIO]:
    """A stream whose content becomes ``file`` at the end; after an exception nothing has changed.

    Raises:
        OSError: the folder cannot be written to.
    """
    temporary = file.with_name(f".{file.stem[:50]}-{secrets.token_hex(8)}")
    try:
        with open(temporary, "xb") as stream:
            yield stream
        os.replace(temporary, file)
    except BaseException:
        with contextlib.suppress(OSError):
            temporary.unlink()
        raise

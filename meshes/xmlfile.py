"""XML of mesh files by events, without a tree, entities or external files."""

from __future__ import annotations

from collections.abc import Callable
from typing import NoReturn
from xml.parsers import expat

from meshes.errors import MeshError

_PIECE = 1 << 20  # [byte] parsed at a time


def parse(
    data: bytes,
    start: Callable[[str, dict[str, str]], None],
    end: Callable[[str], None],
    text: Callable[[str], None] | None = None,
) -> None:
    """Call ``start``, ``end`` and ``text`` with local names, attributes and pieces of text.

    Raises:
        MeshError: no XML, cut off, or it declares entities.
    """
    parser = expat.ParserCreate()
    parser.StartElementHandler = lambda name, found: start(name.rpartition(":")[2], found)
    parser.EndElementHandler = lambda name: end(name.rpartition(":")[2])
    parser.EntityDeclHandler = _entity
    if text is not None:
        parser.buffer_text = True
        parser.buffer_size = _PIECE
        parser.CharacterDataHandler = text
    try:
        for place in range(0, len(data), _PIECE):
            parser.Parse(data[place : place + _PIECE], False)
        parser.Parse(b"", True)
    except expat.ExpatError as error:
        reason = expat.ErrorString(error.code)
        raise MeshError(
            f"its XML cannot be read from line {error.lineno} on ({reason}): cut off or damaged"
        ) from None


def _entity(*_declaration: object) -> NoReturn:
    raise MeshError("its XML declares entities, which no mesh needs: not read")

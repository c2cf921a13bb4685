"""Copies of a recording with something changed in them, in any version of the format.

Written from the description of the format alone, to be read by the program.
"""

from __future__ import annotations

import io
import json
import struct
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from app.recording.format import ORDERS, ROWS
from app.recording.read import read

MAGIC = b"vf-sandbox recording 7\n"
# By version: the options that those before it do not have.
LATER = {
    3: ("guard", "trocar"),
    4: ("structures", "margin", "guarded", "colour", "opacity"),
    5: ("motions", "tracker"),
    6: ("registration",),
    7: ("approach", "arm"),
}
COLUMNS = {
    5: ("orders/moving", "orders/pace", "rows/00000/phase", "rows/00000/lost"),
    7: ("orders/state", "rows/00000/sensed", "rows/00000/measured"),
}
"""By version: the columns that those before it do not have."""
Change = Callable[[dict[str, Any], dict[str, bytes]], None]


def npy(array: np.ndarray) -> bytes:
    stream = io.BytesIO()
    np.save(stream, array)
    return stream.getvalue()


def blocks(path: Path) -> list[tuple[bytes, int, bytes]]:
    """Kind, rows and content of every block of a sound file."""
    data = path.read_bytes()
    assert data.startswith(MAGIC)
    at, found = len(MAGIC), []
    while at < len(data):
        kind, size, rows, _ = struct.unpack_from("<4sIII", data, at)
        found.append((kind, rows, data[at + 16 : at + 16 + size]))
        at += 16 + size
    assert at == len(data)
    return found


def chain(parts: list[tuple[bytes, int, bytes]], magic: bytes = MAGIC) -> bytes:
    """A file of these blocks, their checksums right."""
    crc, data = zlib.crc32(magic), magic
    for kind, rows, content in parts:
        crc = zlib.crc32(struct.pack("<4sIII", kind, len(content), rows, 0) + content, crc)
        data += struct.pack("<4sIII", kind, len(content), rows, crc) + content
    return data


def pack(about: dict[str, Any], tables: bytes) -> bytes:
    words = json.dumps(about).encode()
    return zlib.compress(struct.pack("<I", len(words)) + words + tables)


def unpack(content: bytes) -> tuple[dict[str, Any], bytes]:
    raw = zlib.decompress(content)
    (length,) = struct.unpack_from("<I", raw)
    return json.loads(raw[4 : 4 + length]), raw[4 + length :]


def forged(
    sound: Path, folder: Path, change: Change = lambda header, members: None, version: int = 7
) -> Path:
    """A copy of a recording with its header and columns changed, in this version."""
    recording = read(sound)
    parts = blocks(sound)
    header = json.loads(parts[0][2])
    header["version"] = version
    header |= {"places": [], "plants": [], "orders": len(recording.orders), "note": ""}
    header["chunks"] = [len(recording.rows)]
    for kind, _, content in parts:
        if kind == b"PART":
            about, _ = unpack(content)
            header["places"] += about["places"]
            header["plants"] += about["plants"]
    for since, names in LATER.items():
        for entry in header["places"] + header["plants"]:
            for name in names:
                if version < since:
                    del entry["options"][name]
    for entry in header["places"] + header["plants"]:
        for motion in entry["options"].get("motions", []):
            if version < 7:
                del motion["stream"]
    for entry in header["places"]:
        if version < 4:
            del entry["structures"]
        if version < 5:
            del entry["poses"]
    if version < 5:
        del header["state"]["phase"]
    members = {f"orders/{n}.npy": npy(recording.orders[n]) for n in ORDERS.names or ()}
    members |= {f"rows/00000/{n}.npy": npy(recording.rows[n]) for n in ROWS.names or ()}
    for since, names in COLUMNS.items():
        for name in names:
            if version < since:
                del members[f"{name}.npy"]
    change(header, members)
    path = folder / "forged.vfrec"
    if version == 1:
        with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
            archive.writestr("header.json", json.dumps(header))
            for name, data in members.items():
                archive.writestr(name, data)
        return path
    about = {name: header.pop(name) for name in ("places", "plants", "orders")}
    tables = b"".join(np.load(io.BytesIO(data)).tobytes() for data in members.values())
    (n,) = header.pop("chunks")
    end = json.dumps({"note": header.pop("note")}).encode()
    path.write_bytes(
        chain(
            [
                (b"HEAD", 0, json.dumps(header).encode()),
                (b"PART", n, pack(about, tables)),
                (b"LAST", n, end),
            ],
            MAGIC.replace(b"7", b"%d" % version),
        )
    )
    return path

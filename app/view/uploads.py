"""Files that browsers send: written to disk as they arrive, within limits that the server sets.

viser itself collects an upload's parts in memory until the last one came, however many that are.
"""

from __future__ import annotations

import logging
import re
import shutil
import tempfile
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import viser
from viser import _messages as wire

import meshes
from app.view.hand import Tell

log = logging.getLogger(__name__)

AT_ONCE = 4  # transfers under way, of all clients together
SILENCE = 30.0  # a transfer that sent nothing for so long is given up [s]
KEPT = 3  # files; older ones are deleted

Arrived = Callable[[viser.ClientHandle, Path], None]


@dataclass
class _Transfer:
    client_id: int
    path: Path
    stream: BinaryIO
    size: int  # [byte] declared
    parts: int  # declared
    got: int = 0  # [byte]
    part: int = 0  # the one due next
    heard: float = 0.0  # monotonic time [s]


class Uploads:
    """Takes the files that come through one upload button.

    What a client says is not believed: names are reduced to harmless ones, a file ends where its
    declared size ends, and that must be within the limit before the first byte is kept.
    """

    def __init__(
        self,
        server: viser.ViserServer,
        button: viser.GuiUploadButtonHandle,
        limit: int,
        arrived: Arrived,
        tell: Tell,
    ) -> None:
        """Take over from viser's own collecting.

        Args:
            limit: of one file [byte].
            arrived: called with each complete file, in a thread of its own.
            tell: tells a client why its file was not taken.
        """
        self._server = server
        self._button = button._impl.uuid
        self._limit = limit
        self._arrived = arrived
        self._tell = tell
        self._folder = tempfile.TemporaryDirectory(prefix="vf-sandbox-")
        self._count = 0
        self._kept: deque[Path] = deque()
        self._transfers: dict[str, _Transfer] = {}  # touched by the event loop alone
        gui, connection = server.gui, server.gui._websock_interface
        for kind, theirs, ours in (
            (wire.FileTransferStartUpload, gui._handle_file_transfer_start, self._start),
            (wire.FileTransferPart, gui._handle_file_transfer_part, self._part),
        ):
            connection.unregister_handler(kind, theirs)  # type: ignore[arg-type]
            connection.register_handler(kind, ours)  # type: ignore[arg-type]

        @server.on_client_disconnect
        async def _gone(client: viser.ClientHandle) -> None:
            for key, transfer in tuple(self._transfers.items()):
                if transfer.client_id == client.client_id:
                    self._drop(key)

    def _start(self, client_id: int, message: wire.FileTransferStartUpload) -> None:
        if (
            message.source_component_uuid != self._button
            or message.transfer_uuid in self._transfers
        ):
            return
        now = time.monotonic()
        for key, transfer in tuple(self._transfers.items()):
            if now - transfer.heard > SILENCE:
                self._drop(key)
        size, parts = message.size_bytes, message.part_count
        name = harmless(str(message.filename)[-300:])
        reason = self._refusal(client_id, name, size, parts)
        if reason is not None:
            self._refuse(client_id, message.transfer_uuid, f"“{name}” was not taken: {reason}")
            return
        self._count += 1
        place = Path(self._folder.name) / str(self._count)
        place.mkdir()
        path = place / name
        stream = path.open("wb")
        self._transfers[message.transfer_uuid] = _Transfer(
            client_id, path, stream, size, parts, heard=now
        )

    def _refusal(self, client_id: int, name: str, size: int, parts: int) -> str | None:
        kinds = ", ".join(f".{kind}" for kind in meshes.FORMATS)
        if meshes.kind(name) is None:
            return f"choose a mesh file ({kinds})"
        if not (isinstance(size, int) and isinstance(parts, int)) or size <= 0 or parts <= 0:
            return "the file is empty"
        if size > self._limit:
            return (
                f"{size / 1e6:,.0f} MB are more than the {self._limit / 1e6:,.0f} MB allowed "
                "(start the sandbox with --upload-limit to allow more)"
            )
        if any(transfer.client_id == client_id for transfer in self._transfers.values()):
            return "another file of yours is still on its way"
        if len(self._transfers) >= AT_ONCE:
            return "others are sending files: try again in a moment"
        return None

    def _part(self, client_id: int, message: wire.FileTransferPart) -> None:
        transfer = self._transfers.get(message.transfer_uuid)
        if transfer is None or transfer.client_id != client_id:
            return
        content = message.content
        transfer.heard = time.monotonic()
        # Browsers send the parts in order over one connection.
        sound = (
            isinstance(content, bytes)
            and message.part_index == transfer.part
            and transfer.part < transfer.parts
            and transfer.got + len(content) <= transfer.size
        )
        if not sound:
            self._fail(message.transfer_uuid, "it came in damaged")
            return
        try:
            transfer.stream.write(content)
        except OSError as error:
            self._fail(message.transfer_uuid, f"it could not be kept ({error.strerror or error})")
            return
        transfer.got += len(content)
        transfer.part += 1
        self._acknowledge(client_id, message.transfer_uuid, transfer.got, transfer.size)
        if transfer.part == transfer.parts:
            if transfer.got != transfer.size:
                self._fail(message.transfer_uuid, "it came in cut off")
                return
            self._complete(message.transfer_uuid)

    def _complete(self, key: str) -> None:
        transfer = self._transfers.pop(key)
        transfer.stream.close()
        self._kept.append(transfer.path.parent)
        while len(self._kept) > KEPT:
            shutil.rmtree(self._kept.popleft(), ignore_errors=True)
        client = self._server.get_clients().get(transfer.client_id)
        if client is None:
            return
        threading.Thread(
            target=self._hand_on, args=(client, transfer.path), name="upload", daemon=True
        ).start()

    def _hand_on(self, client: viser.ClientHandle, path: Path) -> None:
        try:
            self._arrived(client, path)
        except Exception:
            log.exception("a file that arrived could not be handed on")

    def _fail(self, key: str, reason: str) -> None:
        transfer = self._transfers[key]
        self._drop(key)
        self._refuse(transfer.client_id, key, f"“{transfer.path.name}” was not taken: {reason}.")

    def _drop(self, key: str) -> None:
        transfer = self._transfers.pop(key)
        transfer.stream.close()
        shutil.rmtree(transfer.path.parent, ignore_errors=True)

    def _refuse(self, client_id: int, key: str, reason: str) -> None:
        # The browser's progress display ends only when all is acknowledged.
        self._acknowledge(client_id, key, 1, 1)
        self._tell(self._server.get_clients().get(client_id), reason)

    def _acknowledge(self, client_id: int, key: str, got: int, size: int) -> None:
        client = self._server.get_clients().get(client_id)
        if client is not None:
            client.gui._websock_interface.queue_message(
                wire.FileTransferPartAck(self._button, key, got, size)
            )


def harmless(name: str) -> str:
    """The last part of a path from any system, of letters, digits and `._-` alone."""
    last = re.split(r"[/\\]", name)[-1]
    cleaned = re.sub(r"[^\w.\-]+", "_", last, flags=re.ASCII).lstrip(".")
    return cleaned[-80:] or "mesh"

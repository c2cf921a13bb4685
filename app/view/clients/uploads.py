"""Uploaded files: written to disk as they arrive, within the server's limits.

viser would collect all parts of an upload in memory.
"""

from __future__ import annotations

import contextlib
import logging
import shutil
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import viser
from viser import _messages as wire

import meshes
from app.files import harmless, size
from app.view.clients.client_input import Notify

log = logging.getLogger(__name__)

MAX_TRANSFERS = 4  # at a time, of all clients together
TIMEOUT = 30.0  # a transfer without a part for so long is discarded [s]


@dataclass(frozen=True)
class Receiver:
    """How the files of one upload button are received.

    Attributes:
        kinds: accepted extensions, without the dot.
        limit: size of one file [byte].
        limit_hint: how to raise the limit, for the refusal; may be empty.
        make_folder: makes a new folder for one file.
        refusal: why a file of so many bytes is refused now; None: it is accepted.
        on_complete: called with each complete file, on a thread of its own; it owns the file and
            its folder.
    """

    kinds: tuple[str, ...]
    limit: int
    limit_hint: str
    make_folder: Callable[[], Path]
    refusal: Callable[[int], str | None]
    on_complete: Callable[[viser.ClientHandle, Path], None]


@dataclass
class _Transfer:
    client_id: int
    button: str
    path: Path
    stream: BinaryIO
    size: int  # [byte] declared
    parts: int  # declared
    received: int = 0  # [byte]
    part: int = 0  # index of the next one
    last_part_at: float = 0.0  # monotonic time [s]


class Uploads:
    """Receives the files of all upload buttons.

    File names are sanitized; the declared size must be within the limit, and no more than that is
    written.
    """

    def __init__(self, server: viser.ViserServer, notify: Notify) -> None:
        """Replace viser's upload handlers. `notify` tells a client why a file is refused."""
        self._server = server
        self._notify = notify
        self._receivers: dict[str, Receiver] = {}  # by button
        self._transfers: dict[str, _Transfer] = {}  # used by the event loop only
        gui, connection = server.gui, server.gui._websock_interface
        for kind, theirs, ours in (
            (wire.FileTransferStartUpload, gui._handle_file_transfer_start, self._start),
            (wire.FileTransferPart, gui._handle_file_transfer_part, self._part),
        ):
            connection.unregister_handler(kind, theirs)  # type: ignore[arg-type]
            connection.register_handler(kind, ours)  # type: ignore[arg-type]

        @server.on_client_disconnect
        async def _disconnected(client: viser.ClientHandle) -> None:
            for key, transfer in tuple(self._transfers.items()):
                if transfer.client_id == client.client_id:
                    self._discard(key)

    def register(self, button: viser.GuiUploadButtonHandle, receiver: Receiver) -> None:
        """Set the receiver of a button's files."""
        self._receivers[button._impl.uuid] = receiver

    def _start(self, client_id: int, message: wire.FileTransferStartUpload) -> None:
        button = message.source_component_uuid
        receiver = self._receivers.get(button)
        if receiver is None or message.transfer_uuid in self._transfers:
            return
        now = time.monotonic()
        for key, transfer in tuple(self._transfers.items()):
            if now - transfer.last_part_at > TIMEOUT:
                self._discard(key)
        length, parts = message.size_bytes, message.part_count
        name = harmless(str(message.filename)[-300:], "file")
        reason = self._refusal(client_id, receiver, name, length, parts)
        if reason is None:
            try:
                path = receiver.make_folder() / name
                stream = path.open("wb")
            except OSError as error:
                reason = f"it cannot be kept ({error.strerror or error})"
        if reason is not None:
            self._report_refusal(
                client_id, button, message.transfer_uuid, f"“{name}” was not taken: {reason}."
            )
            return
        self._transfers[message.transfer_uuid] = _Transfer(
            client_id, button, path, stream, length, parts, last_part_at=now
        )

    def _refusal(
        self, client_id: int, receiver: Receiver, name: str, length: int, parts: int
    ) -> str | None:
        if not {meshes.kind(name), Path(name).suffix[1:].lower()} & set(receiver.kinds):
            kinds = ", ".join(f".{kind}" for kind in receiver.kinds)
            return f"choose a file that ends with {kinds}"
        if not (isinstance(length, int) and isinstance(parts, int)) or length <= 0 or parts <= 0:
            return "the file is empty"
        if length > receiver.limit:
            more = f" ({receiver.limit_hint})" if receiver.limit_hint else ""
            return f"{size(length)} are more than the {size(receiver.limit)} allowed{more}"
        if any(transfer.client_id == client_id for transfer in self._transfers.values()):
            return "another file of yours is still being uploaded"
        if len(self._transfers) >= MAX_TRANSFERS:
            return "others are sending files: try again in a moment"
        return receiver.refusal(length)

    def _part(self, client_id: int, message: wire.FileTransferPart) -> None:
        transfer = self._transfers.get(message.transfer_uuid)
        if transfer is None or transfer.client_id != client_id:
            return
        content = message.content
        transfer.last_part_at = time.monotonic()
        # Browsers send the parts in order over one connection.
        sound = (
            isinstance(content, bytes)
            and message.part_index == transfer.part
            and transfer.part < transfer.parts
            and transfer.received + len(content) <= transfer.size
        )
        if not sound:
            self._fail(message.transfer_uuid, "a part of it is invalid")
            return
        try:
            transfer.stream.write(content)
        except OSError as error:
            self._fail(message.transfer_uuid, f"it could not be kept ({error.strerror or error})")
            return
        transfer.received += len(content)
        transfer.part += 1
        self._acknowledge(
            client_id, transfer.button, message.transfer_uuid, transfer.received, transfer.size
        )
        if transfer.part == transfer.parts:
            if transfer.received != transfer.size:
                self._fail(message.transfer_uuid, "it is incomplete")
                return
            self._complete(message.transfer_uuid)

    def _complete(self, key: str) -> None:
        transfer = self._transfers[key]
        try:
            transfer.stream.close()
        except OSError as error:
            self._fail(key, f"it could not be kept ({error.strerror or error})")
            return
        client = self._server.get_clients().get(transfer.client_id)
        if client is None:
            self._discard(key)
            return
        del self._transfers[key]
        on_complete = self._receivers[transfer.button].on_complete
        threading.Thread(
            target=self._deliver,
            args=(on_complete, client, transfer.path),
            name="upload",
            daemon=True,
        ).start()

    def _deliver(
        self,
        on_complete: Callable[[viser.ClientHandle, Path], None],
        client: viser.ClientHandle,
        path: Path,
    ) -> None:
        try:
            on_complete(client, path)
        except Exception:
            log.exception("an uploaded file could not be processed")

    def _fail(self, key: str, reason: str) -> None:
        transfer = self._transfers[key]
        self._discard(key)
        text = f"“{transfer.path.name}” was not taken: {reason}."
        self._report_refusal(transfer.client_id, transfer.button, key, text)

    def _discard(self, key: str) -> None:
        transfer = self._transfers.pop(key)
        with contextlib.suppress(OSError):
            transfer.stream.close()
        shutil.rmtree(transfer.path.parent, ignore_errors=True)

    def _report_refusal(self, client_id: int, button: str, key: str, reason: str) -> None:
        # The browser's progress display ends when the whole file is acknowledged.
        self._acknowledge(client_id, button, key, 1, 1)
        self._notify(self._server.get_clients().get(client_id), reason)

    def _acknowledge(
        self, client_id: int, button: str, key: str, received: int, length: int
    ) -> None:
        client = self._server.get_clients().get(client_id)
        if client is not None:
            client.gui._websock_interface.queue_message(
                wire.FileTransferPartAck(button, key, received, length)
            )

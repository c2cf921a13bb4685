"""Files that browsers send: written to disk as they arrive, within limits that the server sets.

viser itself collects an upload's parts in memory until the last one came, however many that are.
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
from app.view.hand import Tell

log = logging.getLogger(__name__)

AT_ONCE = 4  # transfers under way, of all clients together
SILENCE = 30.0  # a transfer that sent nothing for so long is given up [s]


@dataclass(frozen=True)
class Receiver:
    """What becomes of the files of one upload button.

    Attributes:
        kinds: what their names may end with, without the dot.
        limit: of one file [byte].
        enlarge: what allows more, to be said with the limit; empty: nothing does.
        coming: makes a new folder for a file on its way.
        refusal: why a file of so many bytes is not taken now; None: it is.
        arrived: called with each complete file, in a thread of its own. Whoever is called has the
            file and its folder from then on.
    """

    kinds: tuple[str, ...]
    limit: int
    enlarge: str
    coming: Callable[[], Path]
    refusal: Callable[[int], str | None]
    arrived: Callable[[viser.ClientHandle, Path], None]


@dataclass
class _Transfer:
    client_id: int
    button: str
    path: Path
    stream: BinaryIO
    size: int  # [byte] declared
    parts: int  # declared
    got: int = 0  # [byte]
    part: int = 0  # the one due next
    heard: float = 0.0  # monotonic time [s]


class Uploads:
    """Takes the files that come through the upload buttons.

    What a client says is not believed: names are reduced to harmless ones, a file ends where its
    declared size ends, and that must be within the limit before the first byte is kept.
    """

    def __init__(self, server: viser.ViserServer, tell: Tell) -> None:
        """Take over from viser's own collecting. `tell`: why a file was not taken."""
        self._server = server
        self._tell = tell
        self._receivers: dict[str, Receiver] = {}  # by button
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

    def take(self, button: viser.GuiUploadButtonHandle, receiver: Receiver) -> None:
        """Let a receiver have what comes through this button."""
        self._receivers[button._impl.uuid] = receiver

    def _start(self, client_id: int, message: wire.FileTransferStartUpload) -> None:
        button = message.source_component_uuid
        receiver = self._receivers.get(button)
        if receiver is None or message.transfer_uuid in self._transfers:
            return
        now = time.monotonic()
        for key, transfer in tuple(self._transfers.items()):
            if now - transfer.heard > SILENCE:
                self._drop(key)
        length, parts = message.size_bytes, message.part_count
        name = harmless(str(message.filename)[-300:], "file")
        reason = self._refusal(client_id, receiver, name, length, parts)
        if reason is None:
            try:
                path = receiver.coming() / name
                stream = path.open("wb")
            except OSError as error:
                reason = f"it cannot be kept ({error.strerror or error})"
        if reason is not None:
            self._refuse(
                client_id, button, message.transfer_uuid, f"“{name}” was not taken: {reason}."
            )
            return
        self._transfers[message.transfer_uuid] = _Transfer(
            client_id, button, path, stream, length, parts, heard=now
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
            more = f" ({receiver.enlarge})" if receiver.enlarge else ""
            return f"{size(length)} are more than the {size(receiver.limit)} allowed{more}"
        if any(transfer.client_id == client_id for transfer in self._transfers.values()):
            return "another file of yours is still on its way"
        if len(self._transfers) >= AT_ONCE:
            return "others are sending files: try again in a moment"
        return receiver.refusal(length)

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
        self._acknowledge(
            client_id, transfer.button, message.transfer_uuid, transfer.got, transfer.size
        )
        if transfer.part == transfer.parts:
            if transfer.got != transfer.size:
                self._fail(message.transfer_uuid, "it came in cut off")
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
            self._drop(key)
            return
        del self._transfers[key]
        arrived = self._receivers[transfer.button].arrived
        threading.Thread(
            target=self._hand_on, args=(arrived, client, transfer.path), name="upload", daemon=True
        ).start()

    def _hand_on(
        self,
        arrived: Callable[[viser.ClientHandle, Path], None],
        client: viser.ClientHandle,
        path: Path,
    ) -> None:
        try:
            arrived(client, path)
        except Exception:
            log.exception("a file that arrived could not be handed on")

    def _fail(self, key: str, reason: str) -> None:
        transfer = self._transfers[key]
        self._drop(key)
        said = f"“{transfer.path.name}” was not taken: {reason}."
        self._refuse(transfer.client_id, transfer.button, key, said)

    def _drop(self, key: str) -> None:
        transfer = self._transfers.pop(key)
        with contextlib.suppress(OSError):
            transfer.stream.close()
        shutil.rmtree(transfer.path.parent, ignore_errors=True)

    def _refuse(self, client_id: int, button: str, key: str, reason: str) -> None:
        # The browser's progress display ends only when all is acknowledged.
        self._acknowledge(client_id, button, key, 1, 1)
        self._tell(self._server.get_clients().get(client_id), reason)

    def _acknowledge(self, client_id: int, button: str, key: str, got: int, length: int) -> None:
        client = self._server.get_clients().get(client_id)
        if client is not None:
            client.gui._websock_interface.queue_message(
                wire.FileTransferPartAck(button, key, got, length)
            )

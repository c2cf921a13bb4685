"""A stand-in for 3D Slicer as a client of OpenIGTLink, for a process of its own.

It writes messages of version 2, with an extended header and metadata, as Slicer does, and checks
the CRC of what it reads bit by bit. Nothing of the application is used.

    python -m tests.support.slicer 127.0.0.1 18944

Lines on stdin: ``tool`` prints the newest transform, ``wait POLYDATA 2`` waits for so many, ``proxy
X Y Z`` [mm] streams a goal from the tool by so much, ``register X Y Z DEG`` sends a registration,
``say WORD`` a state command, ``raw HEX`` bytes, ``quit``.
"""

from __future__ import annotations

import json
import math
import socket
import struct
import sys
import time

HEADER = struct.Struct(">H12s20sQQQ")


def crc64(data: bytes) -> int:
    crc = 0
    for byte in data:
        crc ^= byte << 56
        for _ in range(8):
            crc = ((crc << 1) ^ 0x42F0E1EBA9EA3693 if crc >> 63 else crc << 1) & (2**64 - 1)
    return crc


class Slicer:
    def __init__(self, host: str, port: int) -> None:
        self.link = socket.create_connection((host, port), timeout=20.0)
        self.buffer = b""
        self.newest: dict[str, list[float]] = {}
        self.counts: dict[str, int] = {}
        self.models: list[tuple[str, int, int, list[float], list[float]]] = []
        self.state = ""
        self.checked = 0

    def read(self, seconds: float) -> None:
        until = time.monotonic() + seconds
        while time.monotonic() < until:
            self.link.settimeout(max(until - time.monotonic(), 1e-3))
            try:
                data = self.link.recv(1 << 16)
            except TimeoutError:
                return
            if not data:
                raise SystemExit("closed")
            self.buffer += data
            while len(self.buffer) >= HEADER.size:
                version, kind, name, _, size, crc = HEADER.unpack_from(self.buffer)
                end = HEADER.size + size
                if len(self.buffer) < end:
                    break
                body, self.buffer = self.buffer[HEADER.size : end], self.buffer[end:]
                assert version == 1
                if size < 1000 and self.checked < 200:
                    self.checked += 1
                    assert crc64(body) == crc
                self.take(kind.strip(b"\0").decode(), name.strip(b"\0").decode(), body)

    def take(self, kind: str, name: str, body: bytes) -> None:
        self.counts[kind] = self.counts.get(kind, 0) + 1
        if kind == "TRANSFORM":
            self.newest[name] = list(struct.unpack(">12f", body))
        elif kind == "STRING":
            self.state = body[4:].decode()
        elif kind == "POLYDATA":
            head = struct.unpack_from(">10I", body)
            points, cells, size = head[0], head[5], head[6]
            assert head[1:5] == (0, 0, 0, 0)
            assert size == 16 * cells
            assert len(body) == 40 + 12 * points + size
            values = struct.unpack_from(f">{3 * points}f", body, 40)
            indices = struct.unpack_from(f">{4 * cells}I", body, 40 + 12 * points)
            assert set(indices[::4]) == {3}
            assert max(indices) < points
            low = [min(values[k::3]) for k in range(3)]
            high = [max(values[k::3]) for k in range(3)]
            self.models.append((name, points, cells, low, high))

    def send(self, kind: str, name: str, content: bytes) -> None:
        metadata = struct.pack(">H", 1) + struct.pack(">HHI", 3, 3, 3), b"keyabc"
        body = struct.pack(">HHII", 12, len(metadata[0]), len(metadata[1]), 7) + content
        body += metadata[0] + metadata[1]
        head = HEADER.pack(2, kind.encode(), name.encode(), 0, len(body), crc64(body))
        self.link.sendall(head + body)


def main() -> None:
    slicer = Slicer(sys.argv[1], int(sys.argv[2]))
    print("ready", flush=True)
    for line in sys.stdin:
        word, *rest = line.split()
        if word == "quit":
            break
        if word == "tool":
            slicer.read(0.3)
            print(
                json.dumps([slicer.newest, slicer.state, slicer.models, slicer.counts]), flush=True
            )
        elif word == "wait":
            until = time.monotonic() + 20.0
            while slicer.counts.get(rest[0], 0) < int(rest[1]) and time.monotonic() < until:
                slicer.read(0.1)
        elif word == "proxy":
            slicer.read(0.3)
            start = slicer.newest["Tool"]
            for k in range(61):
                goal = [*start[:9], *(start[9 + i] + float(rest[i]) * k / 60 for i in range(3))]
                slicer.send("TRANSFORM", "Proxy", struct.pack(">12f", *goal))
                slicer.read(0.016)
        elif word == "register":
            x, y, z, angle = map(float, rest)
            c, s = math.cos(math.radians(angle)), math.sin(math.radians(angle))
            columns = (c, s, 0.0, -s, c, 0.0, 0.0, 0.0, 1.0, x, y, z)
            for _ in range(5):  # streamed, as Slicer does
                slicer.send("TRANSFORM", "Registration", struct.pack(">12f", *columns))
                slicer.read(0.02)
        elif word == "say":
            data = rest[0].encode()
            slicer.send("STRING", "state_command", struct.pack(">HH", 3, len(data)) + data)
        elif word == "raw":
            slicer.link.sendall(bytes.fromhex(rest[0]))
    print("done", flush=True)


if __name__ == "__main__":
    main()

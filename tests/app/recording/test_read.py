"""Files that nobody should trust: each is refused in one line, or harmless."""

from __future__ import annotations

import io
import math
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from forgery import forged, npy

from app import replay
from app.recording.format import Recording, RecordingError
from app.recording.read import read


def hostile() -> Iterator[tuple[str, Callable[[dict[str, Any], dict[str, bytes]], None], str]]:
    def case(name: str, match: str) -> Callable:
        def add(change: Callable[[dict[str, Any], dict[str, bytes]], None]) -> None:
            cases.append((name, change, match))

        return add

    cases: list = []

    @case("version", "version 2 of the format")
    def _(header: dict[str, Any], members: dict[str, bytes]) -> None:
        header["version"] = 2

    @case("format", "the format is not")
    def _(header: dict[str, Any], members: dict[str, bytes]) -> None:
        header["format"] = "something else"

    @case("missing", "orders/clutch.npy is missing")
    def _(header: dict[str, Any], members: dict[str, bytes]) -> None:
        del members["orders/clutch.npy"]

    @case("surplus", "do not belong")
    def _(header: dict[str, Any], members: dict[str, bytes]) -> None:
        members["../../evil"] = b"x"

    @case("bomb", "unpacks to 10,000,000 bytes")
    def _(header: dict[str, Any], members: dict[str, bytes]) -> None:
        members["rows/00000/q.npy"] = bytes(10_000_000)

    @case("sizes", "at most 4,000,000 are read")
    def _(header: dict[str, Any], members: dict[str, bytes]) -> None:
        header["chunks"] = [4096] * 1000

    @case("chunk", "rows of a chunk is 1000000000000")
    def _(header: dict[str, Any], members: dict[str, bytes]) -> None:
        header["chunks"] = [10**12]

    @case("orders", "number of orders is -1")
    def _(header: dict[str, Any], members: dict[str, bytes]) -> None:
        header["orders"] = -1

    @case("nan joints", "rows/q of row 7 is not finite")
    def _(header: dict[str, Any], members: dict[str, bytes]) -> None:
        q = np.load(io.BytesIO(members["rows/00000/q.npy"]))
        q[7, 0] = np.nan
        members["rows/00000/q.npy"] = npy(q)

    @case("nan command", "orders/target of row 1 is not finite")
    def _(header: dict[str, Any], members: dict[str, bytes]) -> None:
        target = np.load(io.BytesIO(members["orders/target.npy"]))
        target[1] = np.inf
        members["orders/target.npy"] = npy(target)

    @case("nan header", "NaN in the header")
    def _(header: dict[str, Any], members: dict[str, bytes]) -> None:
        header["state"]["q"][0] = math.nan

    @case("pickle", "is damaged")
    def _(header: dict[str, Any], members: dict[str, bytes]) -> None:
        stream = io.BytesIO()
        np.save(stream, np.array([{}] * 3, dtype=object), allow_pickle=True)
        members["rows/00000/tick.npy"] = stream.getvalue()

    @case("dtype", "is float32")
    def _(header: dict[str, Any], members: dict[str, bytes]) -> None:
        q = np.load(io.BytesIO(members["rows/00000/q.npy"]))
        members["rows/00000/q.npy"] = npy(q.astype(np.float32))

    @case("mirror", "is not a rotation")
    def _(header: dict[str, Any], members: dict[str, bytes]) -> None:
        rotation = np.load(io.BytesIO(members["orders/rotation.npy"]))
        members["orders/rotation.npy"] = npy(3.0 * rotation)

    @case("plant", "orders/plant of row 1 is not one of the plants")
    def _(header: dict[str, Any], members: dict[str, bytes]) -> None:
        plant = np.load(io.BytesIO(members["orders/plant.npy"]))
        plant[1] = 9
        members["orders/plant.npy"] = npy(plant)

    @case("ticks", "does not count on")
    def _(header: dict[str, Any], members: dict[str, bytes]) -> None:
        tick = np.load(io.BytesIO(members["rows/00000/tick.npy"]))
        tick[5] += 10**6
        members["rows/00000/tick.npy"] = npy(tick)

    @case("range", "radius 1e")
    def _(header: dict[str, Any], members: dict[str, bytes]) -> None:
        header["plants"][0]["options"]["radius"] = 1e9

    @case("option kind", "option rule in the header is not usable")
    def _(header: dict[str, Any], members: dict[str, bytes]) -> None:
        header["plants"][0]["options"]["rule"] = ["certified"]

    @case("unknown option", "not those of a session")
    def _(header: dict[str, Any], members: dict[str, bytes]) -> None:
        header["plants"][0]["options"]["host"] = "0.0.0.0"

    for name, value, line in (
        ("times", [0.0, 0.0], "do not rise from 0"),
        ("times", [1.0, 2.0], "do not rise from 0"),
        ("times", "soon", "not 1 to 1000 finite numbers"),
        ("points", [[0.0] * 3], "not 2 rows"),
        ("points", [[0.0] * 2] * 2, "not of three columns"),
        ("rotation", [[2.0, 0, 0], [0, 1, 0], [0, 0, 1]], "rotation of a course"),
        ("rotation", [[-1, 0, 0], [0, 1, 0], [0, 0, 1]], "rotation of a course"),
    ):

        @case(f"course: {name} {value}", line)
        def _(
            header: dict[str, Any],
            members: dict[str, bytes],
            name: str = name,
            value: object = value,
        ) -> None:
            course = {
                "times": [0.0, 1.0],
                "points": [[0.0] * 3] * 2,
                "rotation": np.eye(3).tolist(),
            }
            header["plants"][0]["course"] = {**course, name: value}

    @case("checksum", "not a SHA-256")
    def _(header: dict[str, Any], members: dict[str, bytes]) -> None:
        header["places"][0]["checksum"] = 5

    @case("pose", "no pose")
    def _(header: dict[str, Any], members: dict[str, bytes]) -> None:
        header["state"]["target"] = np.zeros((4, 4)).tolist()

    @case("pose kind", "target in the header is not")
    def _(header: dict[str, Any], members: dict[str, bytes]) -> None:
        header["state"]["target"] = [1, 2, 3, 4]

    @case("huge number", "joints in the header is not")
    def _(header: dict[str, Any], members: dict[str, bytes]) -> None:
        header["state"]["q"] = [10**400]

    @case("nothing", "'places' in the header")
    def _(header: dict[str, Any], members: dict[str, bytes]) -> None:
        header["places"] = []

    yield from cases


@pytest.mark.parametrize(("name", "change", "match"), list(hostile()), ids=lambda x: str(x)[:20])
def test_a_hostile_file_is_refused_in_one_line(
    name: str,
    change: Callable[[dict[str, Any], dict[str, bytes]], None],
    match: str,
    sound: Path,
    tmp_path: Path,
) -> None:
    path = forged(sound, tmp_path, change)
    with pytest.raises(RecordingError, match=match) as caught:
        read(path)
    assert "\n" not in str(caught.value)
    assert str(path) in str(caught.value)


def test_a_forged_copy_without_changes_is_sound(sound: Path, tmp_path: Path) -> None:
    copy: Recording = read(forged(sound, tmp_path, lambda header, members: None))
    assert replay.first_difference(copy) is None


@pytest.mark.parametrize("content", [b"", b"PK", b"not a zip at all" * 50])
def test_a_file_of_another_kind_is_refused(content: bytes, tmp_path: Path) -> None:
    path = tmp_path / "some.vfrec"
    path.write_bytes(content)
    with pytest.raises(RecordingError, match="not a readable recording"):
        read(path)


def test_a_flipped_byte_anywhere_is_refused_or_harmless(sound: Path, tmp_path: Path) -> None:
    data = sound.read_bytes()
    whole = read(sound)
    rng = np.random.default_rng(1)
    refused = 0
    for at in rng.integers(0, len(data), 60):
        path = tmp_path / "flipped.vfrec"
        path.write_bytes(data[:at] + bytes([data[at] ^ 0x55]) + data[at + 1 :])
        try:
            found = read(path)
        except RecordingError:
            refused += 1
        else:
            assert found.rows.tobytes() == whole.rows.tobytes()
    assert refused > 30

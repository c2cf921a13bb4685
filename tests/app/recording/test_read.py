"""Files that nobody should trust: each is refused in one line, or harmless."""

from __future__ import annotations

import io
import math
import re
import zlib
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from app.recording import rerun
from app.recording.format import ROWS, RecordingError
from app.recording.read import read
from tests.support.forgery import MAGIC, Change, blocks, chain, forged, npy, pack

# What there is in archives alone.
ARCHIVED = ("missing", "surplus", "bomb", "sizes", "chunk", "orders", "pickle", "dtype")


def hostile() -> Iterator[tuple[str, Change, str]]:
    def case(name: str, match: str) -> Callable:
        def add(change: Change) -> None:
            cases.append((name, change, match))

        return add

    cases: list[tuple[str, Change, str]] = []

    @case("version", "version 8 of the format")
    def _(header: dict[str, Any], members: dict[str, bytes]) -> None:
        header["version"] = 8

    @case("format", "the format is not")
    def _(header: dict[str, Any], members: dict[str, bytes]) -> None:
        header["format"] = "something else"

    @case("missing", "orders/clutch.npy is missing")
    def _(header: dict[str, Any], members: dict[str, bytes]) -> None:
        del members["orders/clutch.npy"]

    @case("surplus", "does not have")
    def _(header: dict[str, Any], members: dict[str, bytes]) -> None:
        members["../../evil"] = b"x"

    @case("bomb", "unpacks to 10,000,000 bytes")
    def _(header: dict[str, Any], members: dict[str, bytes]) -> None:
        members["rows/00000/q.npy"] = bytes(10_000_000)

    @case("sizes", "at most 4,000,000 are read")
    def _(header: dict[str, Any], members: dict[str, bytes]) -> None:
        header["chunks"] = [4096] * 1000

    @case("chunk", "Expected `int` <= 4096 - at `\\$.chunks")
    def _(header: dict[str, Any], members: dict[str, bytes]) -> None:
        header["chunks"] = [10**12]

    @case("orders", "Expected `int` >= [01] - at `\\$.orders`")
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

    @case("nan header", "the header is damaged: NaN is no number")
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

    @case("option kind", "option in the header is not usable: unknown rule")
    def _(header: dict[str, Any], members: dict[str, bytes]) -> None:
        header["plants"][0]["options"]["rule"] = ["certified"]

    for option, setting, words in (
        ("unit", "parsec", "unknown unit 'parsec': choose one of"),
        ("rule", "soft", "unknown rule 'soft': choose one of certified"),
        ("up", "w", "unknown axis 'w'"),
        ("damage", "smashed", "unknown damage 'smashed'"),
        ("robot", "r2d2", "unknown robot 'r2d2'"),
        ("at", [0.0, 0.0, 1e300], "is more than 2 m from the origin"),
        ("rotate", [1e298, 0.0, 0.0], "outside -720 to 720 degrees"),
        ("seed", -1, "seed -1 is outside 0"),
        ("rate", 1e300, "rate 1e.300 Hz is outside"),
        ("force_gain", -1.0, "force_gain -1 N/m is outside"),
    ):

        @case(f"option: {option} {setting}", words)
        def _(
            header: dict[str, Any],
            members: dict[str, bytes],
            option: str = option,
            setting: object = setting,
        ) -> None:
            for kind in ("plants", "places"):
                header[kind][0]["options"][option] = setting

    @case("scale", "orders/scale of row 1 is out of range")
    def _(header: dict[str, Any], members: dict[str, bytes]) -> None:
        scale = np.load(io.BytesIO(members["orders/scale.npy"]))
        scale[1] = 1e300
        members["orders/scale.npy"] = npy(scale)

    @case("unknown option", "not those of a session")
    def _(header: dict[str, Any], members: dict[str, bytes]) -> None:
        header["plants"][0]["options"]["host"] = "0.0.0.0"

    for name, value, line in (
        ("times", [0.0, 0.0], "do not rise from 0"),
        ("times", [1.0, 2.0], "do not rise from 0"),
        ("times", "soon", "Expected `array`, got `str` - at `\\$.plants.*times`"),
        ("points", [[0.0] * 3], "not 2 rows"),
        ("points", [[0.0] * 2] * 2, "Expected `array` of length 3, got 2 - at `\\$.plants.*points"),
        ("times", [0.0, 1e300], "goes on for 1e.300 s, at most 600 s"),
        ("points", [[0.0] * 3, [0.0, 0.0, 1e300]], "is more than 4 m from the base"),
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

    @case("checksum", "Expected `str`, got `int` - at `\\$.places.*checksum`")
    def _(header: dict[str, Any], members: dict[str, bytes]) -> None:
        header["places"][0]["checksum"] = 5

    @case("pose", "no pose")
    def _(header: dict[str, Any], members: dict[str, bytes]) -> None:
        header["state"]["target"] = np.zeros((4, 4)).tolist()

    @case("pose kind", "Expected `array`, got `int` - at `\\$.state.target")
    def _(header: dict[str, Any], members: dict[str, bytes]) -> None:
        header["state"]["target"] = [1, 2, 3, 4]

    @case("huge number", "header is damaged: .*ange")
    def _(header: dict[str, Any], members: dict[str, bytes]) -> None:
        header["state"]["q"] = [10**400]

    @case("nothing", "at `\\$.places`|place of a plant is 0, of 0")
    def _(header: dict[str, Any], members: dict[str, bytes]) -> None:
        header["places"] = []

    yield from cases


@pytest.mark.parametrize(
    ("version", "change", "match"),
    [
        pytest.param(version, change, match, id=f"{version}-{name[:20]}-{match[:20]}")
        for version in (1, 7)
        for name, change, match in hostile()
        if version == 1 or name not in ARCHIVED
    ],
)
def test_a_hostile_file_is_refused_in_one_line(
    version: int, change: Change, match: str, sound: Path, tmp_path: Path
) -> None:
    refused(forged(sound, tmp_path, change, version), match)


def refused(path: Path, match: str) -> None:
    with pytest.raises(RecordingError, match=match) as caught:
        read(path)
    assert "\n" not in str(caught.value)
    assert str(path) in str(caught.value)


def part(about: dict[str, Any], tables: bytes = b"") -> bytes:
    return pack({"places": [], "plants": [], "orders": 0, **about}, tables)


HOSTILE_BLOCKS: dict[str, tuple[Callable[[list], list], str]] = {
    "a bomb": (
        lambda b: [*b[:2], (b"PART", 1, zlib.compress(bytes(40_000_000)))],
        "unpacks to more than",
    ),
    "no zlib": (lambda b: [*b[:2], (b"PART", 1, b"nothing packed")], "a part of it is damaged"),
    "nothing": (lambda b: [*b[:2], (b"PART", 1, zlib.compress(b""))], "a part of it is empty"),
    "no JSON": (
        lambda b: [*b[:2], (b"PART", 0, zlib.compress(b"\xff\xff\xff\xff{"))],
        "a part of it is damaged",
    ),
    "no object": (lambda b: [*b[:2], (b"PART", 0, pack([], b""))], "got `array`"),  # type: ignore[arg-type]
    "more rows than said": (
        lambda b: [*b[:2], (b"PART", 1, part({}, bytes(2 * ROWS.itemsize)))],
        "bytes, not",
    ),
    "many orders": (
        lambda b: [*b[:2], (b"PART", 0, part({"orders": 10**9}))],
        "Expected `int` <= 4097 - at `\\$.orders`",
    ),
    "orders below none": (
        lambda b: [*b[:2], (b"PART", 0, part({"orders": -1}))],
        "Expected `int` >= 0 - at `\\$.orders`",
    ),
    "two heads": (lambda b: [b[0], *b], "HEAD is out of place"),
    "no head": (lambda b: b[1:], "PART is out of place"),
    "two ends": (lambda b: [*b, b[-1]], "LAST is out of place"),
    "another number of rows": (lambda b: [*b[:-1], (b"LAST", 5, b[-1][2])], "rows, not 5"),
    "a note that is none": (
        lambda b: [*b[:-1], (b"LAST", b[-1][1], b'{"note": ["x"]}')],
        "Expected `str`, got `array` - at `\\$.note`",
    ),
    "a note of two lines": (
        lambda b: [*b[:-1], (b"LAST", b[-1][1], b'{"note": "a\\nb"}')],
        "note in the header is no text",
    ),
    "a joint without bounds": (
        lambda b: [(*b[0][:2], re.sub(rb'"q": ?\[[^],]*', b'"q":[1e999', b[0][2])), *b[1:]],
        "Expected `float` <= 1.797.* - at `\\$.state.q",
    ),
    "no note": (lambda b: [*b[:-1], (b"LAST", b[-1][1], b"null")], "got `null`"),
}


@pytest.mark.parametrize("name", HOSTILE_BLOCKS)
def test_blocks_with_right_checksums_are_not_believed(
    name: str, sound: Path, tmp_path: Path
) -> None:
    change, match = HOSTILE_BLOCKS[name]
    path = tmp_path / "hostile.vfrec"
    path.write_bytes(chain(change(blocks(sound))))
    refused(path, match)


def test_what_follows_the_end_is_refused(sound: Path, tmp_path: Path) -> None:
    path = tmp_path / "longer.vfrec"
    path.write_bytes(sound.read_bytes() + b"more")
    refused(path, "4 bytes follow its end")


@pytest.mark.parametrize("version", [1, 2, 3, 4, 5, 6, 7])
def test_a_copy_in_any_version_is_sound_and_before_the_third_guards_the_tip(
    sound: Path, tmp_path: Path, version: int
) -> None:
    """The recorded arm is a tip alone, for which both guards are the same."""
    copy, whole = read(forged(sound, tmp_path, version=version)), read(sound)
    assert {options.guard for _, options in whole.plants} == {"tool"}
    if version < 3:
        whole = replace(whole, plants=tuple((k, replace(o, guard="tip")) for k, o in whole.plants))
    assert copy.cut == ""
    assert copy.orders.tobytes() == whole.orders.tobytes()
    assert copy.rows.tobytes() == whole.rows.tobytes()
    assert copy.plants == whole.plants
    assert rerun.first_difference(copy) is None


@pytest.mark.parametrize("content", [b"PK", b"not a zip at all" * 50])
def test_a_file_of_another_kind_is_refused(content: bytes, tmp_path: Path) -> None:
    path = tmp_path / "some.vfrec"
    path.write_bytes(content)
    refused(path, "not a readable recording")


def test_files_without_a_tick_of_a_later_version_or_unreadable_say_so(
    sound: Path, tmp_path: Path
) -> None:
    path = tmp_path / "some.vfrec"
    for content in (b"", MAGIC[:7], MAGIC):
        path.write_bytes(content)
        refused(path, "cut off.* before its first tick")
    path.write_bytes(sound.read_bytes().replace(b"recording 7", b"recording 8", 1))
    refused(path, "reads versions 1 to 7")
    refused(tmp_path / "none.vfrec", "cannot be read .No such file")
    refused(tmp_path, "cannot be read .Is a directory")


def test_a_file_cut_off_anywhere_is_read_up_to_its_last_complete_block(
    sound: Path, tmp_path: Path
) -> None:
    data, whole = sound.read_bytes(), read(sound)
    ends, at = [], len(MAGIC)
    for _, rows, content in blocks(sound):
        at += 16 + len(content)
        ends.append((at, rows))
    path = tmp_path / "cut.vfrec"
    seen = set()
    near = [end + d for end, _ in ends[:-1] for d in (-1, 0, 1, 15, 16, 17)]
    anywhere = np.random.default_rng(2).integers(0, len(data), 60).tolist()
    for length in [*near, *anywhere, 0, len(data) - 1]:
        path.write_bytes(data[:length])
        there = sum(rows for end, rows in ends[:-1] if end <= length)
        if length < ends[1][0]:  # head, and the part that the first row needs
            refused(path, "before its first tick")
            continue
        found = read(path)
        assert found.rows.tobytes() == whole.rows[:there].tobytes()
        assert found.cut.startswith(f"The recording was cut off: {there * 1e-3:.2f} ")
        assert found.cut.endswith("s are readable.")
        seen.add(there)
    assert len(seen) > 3


@pytest.mark.parametrize("version", [1, 7])
def test_a_flipped_byte_anywhere_is_noticed_or_harmless(
    sound: Path, tmp_path: Path, version: int
) -> None:
    if version == 1:
        sound = forged(sound, tmp_path, version=1)
    data, whole = sound.read_bytes(), read(sound)
    rng = np.random.default_rng(1)
    noticed = 0
    for at in rng.integers(0, len(data), 100):
        path = tmp_path / "flipped.vfrec"
        path.write_bytes(data[:at] + bytes([data[at] ^ 0x55]) + data[at + 1 :])
        try:
            found = read(path)
        except RecordingError:
            noticed += 1
            continue
        noticed += found.cut != ""
        assert found.rows.tobytes() == whole.rows[: len(found.rows)].tobytes()
        if version == 7:
            assert "is damaged from byte" in found.cut or "was cut off" in found.cut
        else:
            assert len(found.rows) == len(whole.rows)
    assert noticed == 100 if version == 7 else noticed > 50


def test_how_much_of_a_damaged_recording_is_left_is_said(sound: Path, tmp_path: Path) -> None:
    data, whole = bytearray(sound.read_bytes()), read(sound)
    parts = blocks(sound)
    rows = [n for kind, n, _ in parts if kind == b"PART"]
    at = len(MAGIC) + sum(16 + len(content) for _, _, content in parts[:3])
    data[at + 30] ^= 1
    path = tmp_path / "spoilt.vfrec"
    path.write_bytes(data)
    left, all_ = sum(rows[:2]) * 1e-3, len(whole.rows) * 1e-3
    assert read(path).cut == (
        f"The recording is damaged from byte {at:,} on: {left:.2f} of {all_:.2f} s are readable."
    )

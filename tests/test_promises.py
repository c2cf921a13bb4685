"""Numbers that the documents promise are those in the code."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from app.recording import capture
from app.recording.format import MAX_ROWS
from app.scenarios import file as scenario_file
from app.scenarios import values
from app.scene import library
from app.settings import Options
from app.studies.experiments import operators, protocol
from app.view.clients import pictures
from app.view.controls import help, keys, views
from app.view.drawing import section
from app.view.guard import access, connection
from app.view.guard import messages as guarded
from app.view.inspector import compare, inspection, region, tab
from app.view.tabs import recorder, replaying
from meshes import content, volume
from meshes.checks import health
from meshes.place import GAP

DOCS = Path(__file__).parents[1] / "docs"
KIB, MIB = 2**10, 2**20


def counted(rate_and_most: tuple[float, float]) -> list[str]:
    return [f"{number:,.0f}".replace(",", "") for number in rate_and_most]


PROMISES = [
    ("server", f"of {len(guarded.INBOUND)} known kinds"),
    ("server", f"strings up to {guarded.MAX_TEXT} characters, lists up to {guarded.MAX_ITEMS} "),
    ("server", f"{guarded.MAX_PLAIN // KIB} KiB; parts of files and rendered pictures "
               f"{guarded.MAX_MESSAGE // MIB} MiB"),
    ("server", "{} messages/s and {} at once".format(*counted(connection.MESSAGES))),
    ("server", f"after {connection.DROPPED[1]:.0f} dropped, or {connection.INVALID[1]:.0f} inv"),
    ("server", f"{connection.FILES[0] / 1e6:.0f} MB/s for each client"),
    ("server", f"{connection.FRAMES[0]:.0f}/s, {connection.FRAMES[1]:,.0f} at once"),
    ("server", f"{access.CLIENTS}; {access.CONNECTIONS[0]:.0f} more per second, "
               f"{access.CONNECTIONS[1]:.0f} at once"),
    ("server", f"reads nothing for {connection.STALL_TIMEOUT:.0f} s, does not catch up for "
               f"{connection.BEHIND_TIMEOUT / 60:.0f} min, or has "
               f"{connection.MAX_BACKLOG // MIB} MiB"),
    ("anatomy", f"takes a file up to {Options().upload_limit:.0f} MB"),
    ("anatomy", f"At most {library.MOST} files and {library.ROOM / 1e9:.0f} GB are kept"),
    ("anatomy", f"may grow to {content.RATIO} times its size "
                f"({content.UNPACKED / 1e6:.0f} MB are always allowed)"),
    ("anatomy", f"top of the bounding box {GAP * 1e3:.0f} mm below the tip"),
    ("anatomy", f"at all faces up to {health.EXAMINED:,}"),
    ("anatomy", f"At most {volume.MOST_TRIANGLES / 1e6:.0f} million triangles"),
    ("anatomy", f"at most {volume.MOST_VOXELS / 1e6:.0f} million voxels, and "
                f"{volume.MOST_BYTES / 1e9:.0f} GB"),
    ("scenarios", f"more than {scenario_file.SIZE_LIMIT:,} bytes"),
    ("scenarios", f"up to {values.MOST_WAYPOINTS} waypoints"),
    ("scenarios", f"rising to at most {values.LONGEST:.0f}"),
    ("scenarios", f"(a camera's within {values.FARTHEST_EYE:.0f} m)"),
    ("recording", f"{1 / capture.PERIOD:.0f} times a second"),
    ("recording", f"falls {capture.BEHIND:,} ticks behind"),
    ("recording", f"reaches {MAX_ROWS:,} ticks ({MAX_ROWS / 60e3:.0f} minutes at 1 kHz)"),
    ("recording", f"With {recorder.MAX_RECORDINGS} files"),
    ("recording", f"more than {recorder.MAX_DOWNLOAD / 1e6:.0f} MB is not sent"),
    ("recording", "a speed from {} to {}".format(*(list(replaying.SPEEDS)[k] for k in (0, -1)))),
    ("recording", f"{pictures.FRAMES} pictures in about {pictures.FRAMES * pictures.INTERVAL:g} s"),
    ("inspector", f"polyhedron of {region.FACETS} facets"),
    ("inspector", f"(up to {compare.SAMPLES:,} points)"),
    ("inspector", f"({compare.PATHS} paths, against the nearest {compare.MAX_TRIANGLES:,} tri"),
    ("inspector", f"The nearest {inspection.MAX_TRIANGLES:,} triangles are examined"),
    ("inspector", f"at most every {tab.REQUEST_PERIOD:g} s"),
    ("guide", f"{Options().force_gain:.0f} N/m times"),
    ("guide", f"standoff of {Options().standoff * 1e6:.0f} µm"),
    ("guide", f"up to {1 / section.PERIOD:.1f} times a second"),
    ("guide", f"nudge the proxy left, right, away, near, down, up by {keys.FINE * 1e3:g} mm; with "
              f"Shift by {keys.COARSE * 1e3:g} mm"),
    ("experiments", f"presses inwards with {operators.Operator().press:g} N"),
    ("experiments", f"with {protocol.Trial('cutting', 'off', 0).noise * 1e3:g} mm of localisation"),
]  # fmt: skip


@pytest.mark.parametrize(("document", "promise"), PROMISES)
def test_a_number_of_the_documents_is_that_of_the_code(document: str, promise: str) -> None:
    text = " ".join((DOCS / f"{document}.md").read_text("utf-8").split())
    assert " ".join(promise.split()) in text


def test_the_keys_of_the_guide_are_those_of_the_page() -> None:
    text = (DOCS / "guide.md").read_text("utf-8")
    table = text[text.index("| key | does |") :].split("\n\n")[0]
    told = set(re.findall(r"`([A-Z0-9])`", table))
    told |= {str(n) for n in range(1, keys.KEYED + 1)}  # `1` to `4`
    views_keys = {*views.KEYS.values(), views.SECTION_KEY, views.LENS_KEY, views.DARK_KEY}
    rules = {str(number) for number in range(1, keys.KEYED + 1)}
    assert told == {*keys.NUDGES, *"PNRCG", help.KEY, *rules, *views_keys}

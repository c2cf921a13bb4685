"""`bench structures`: its rows and what is in reach, no timings."""

from __future__ import annotations

from pathlib import Path

import pytest

from app.bench import structures
from app.bench.tools import settings
from app.commands import call


def test_structures_in_reach_give_planes_and_those_out_of_reach_none(tmp_path: Path) -> None:
    options = settings.Structures(
        size=1_024, large=2_048, count=3, ticks=200, passes=2, out=tmp_path
    )
    shares: list[float] = []
    result = structures.run(options, lambda _: None, shares.append)
    assert shares == [0.5, 1.0]
    rows = {row["what"]: row for row in result["rows"]}
    assert [row["structures"] for row in rows.values()] == [1, 1, 3, 3, 3]
    assert [row["triangles"] for row in rows.values()] == [2_048, 1_024, 3_072, 3_072, 3_072]
    one, beyond, some, reached = (rows[name]["planes"] for name in list(rows)[1:])
    assert one < some < reached
    assert one > 0.0
    assert reached > 2.0 * one
    assert beyond == one
    assert set(result["ratio to the large mesh"]) == set(list(rows)[1:])


def test_the_whole_instrument_is_guarded_on_request(tmp_path: Path) -> None:
    alone, whole = (
        structures.run(
            settings.Structures(
                size=1_024, large=2_048, count=2, ticks=200, passes=1, guard=guard, out=tmp_path
            ),
            lambda _: None,
            lambda _: None,
        )
        for guard in ("tip", "tool")
    )
    for one, other in zip(alone["rows"], whole["rows"], strict=True):
        assert other["planes"] > one["planes"]


def test_the_command_prints_the_rows(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["structures", "--size", "1024", "--large", "2048", "--count", "2", "--ticks", "200",
             "--passes", "1", "--out", str(tmp_path)]  # fmt: skip
    assert call("bench", words) == 0
    assert "each out of reach" in capsys.readouterr().out
    assert (tmp_path / "structures.json").exists()

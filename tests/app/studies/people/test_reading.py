"""Protocols are checked at every key; the messages say where and what is valid."""

from __future__ import annotations

from pathlib import Path

import pytest

from app.studies.people import reading
from app.studies.people.protocol import ProtocolError

GOOD = """
format = 1
name = "N"
about = "A."
title = "T"
[consent]
text = "C."
[[tasks]]
task = "cutting"
length = "6mm"
[[conditions]]
name = "a"
delay = "80ms"
[[training]]
task = "cutting"
condition = "a"
until = { path_deviation = "1mm", time = 60 }
"""


def test_lengths_and_times_have_units_and_become_si() -> None:
    protocol = reading.loads(GOOD)
    assert protocol.tasks[0].length == 6e-3
    assert protocol.conditions[0].delay == 0.08
    assert protocol.training[0].until == {"path_deviation": 1e-3, "time": 60.0}


@pytest.mark.parametrize("name", reading.BUILT_IN)
def test_the_built_in_ones_are_valid(name: str) -> None:
    protocol = reading.read(name)
    assert protocol.blinded
    assert protocol.training
    assert len(protocol.conditions) >= 2
    assert "stop at any time" in " ".join(protocol.consent.text.split())


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("format = 1", "format = 2", "format must be 1"),
        ("format = 1", "", "it has none"),
        ('name = "N"', 'nome = "N"', "unknown key 'nome': did you mean name?"),
        ("length", "lenght", "tasks 1 has an unknown key 'lenght': did you mean length?"),
        ('"6mm"', "6", "tasks 1.length = 6: must be a text"),
        ('"6mm"', '"6"', "has no unit"),
        ('"6mm"', '"60mm"', "outside 1mm to 30mm"),
        ('"cutting"\nlength', '"sewing"\nlength', "choose one of tracing, targeting, cutting"),
        ('"80ms"', '"80"', "not a time"),
        ('"80ms"', '"3s"', "outside 0 s to 2 s"),
        ('delay = "80ms"', 'rule = "firm"', "unknown rule 'firm'"),
        ('condition = "a"', 'condition = "b"', "condition of a training 'b': choose one of a"),
        ("path_deviation", "sal", "unknown measure 'sal'"),
        ('[consent]\ntext = "C."', "", "has no consent"),
        ("[[tasks]]", "[tasks]", "must be a list of tables"),
        ('name = "a"', 'name = "a<b>"', "letters, digits"),
        ('name = "a"', 'name = "a"\n[[conditions]]\nname = "a"', "'a' is there twice"),
        ("format = 1", "format = [", "this is not TOML"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_said_in_a_line(old: str, new: str, said: str) -> None:
    assert old in GOOD
    with pytest.raises(ProtocolError) as wrong:
        reading.loads(GOOD.replace(old, new, 1))
    assert said in str(wrong.value)
    assert "\n" not in str(wrong.value)


def test_files_that_are_none_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ProtocolError, match="did you mean 'paper-tracing'"):
        reading.read("paper-traceing")
    with pytest.raises(ProtocolError, match="cannot be read"):
        reading.read(str(tmp_path / "none.toml"))
    (tmp_path / "a.toml").write_bytes(b"\xff")
    with pytest.raises(ProtocolError, match="not UTF-8"):
        reading.read(str(tmp_path / "a.toml"))
    (tmp_path / "b.toml").write_text("#" * 300_000)
    with pytest.raises(ProtocolError, match="no protocol"):
        reading.read(str(tmp_path / "b.toml"))

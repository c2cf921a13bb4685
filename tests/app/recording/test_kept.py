"""Recordings made by an earlier version of the program repeat bit for bit in this one.

Those in `kept` were made by version 0.1.0 on x86-64 from an engine driven by the autopilot, every
rule in turn: psm on "stairs" and point on "cube", panda on "l-block", ur5 on "thin-plate".
"""

from __future__ import annotations

import platform
from pathlib import Path

import numpy as np
import pytest

import vf
from app.recording.read import read
from app.recording.rerun import first_difference

KEPT = sorted((Path(__file__).parent / "kept").glob("*.vfrec"))


def test_every_robot_and_every_rule_is_kept() -> None:
    recordings = [read(path) for path in KEPT]
    plants = [options for recording in recordings for _, options in recording.plants]
    assert {options.robot for options in plants} == {"psm", "point", "panda", "ur5"}
    assert {options.rule for options in plants} == set(vf.RULES)


@pytest.mark.skipif(platform.machine() != "x86_64", reason="the last bit depends on the processor")
@pytest.mark.parametrize("path", KEPT, ids=lambda path: path.stem)
def test_a_kept_recording_repeats_to_the_last_bit(path: Path) -> None:
    recording = read(path)
    assert recording.cut == ""
    assert np.mean(recording.rows["planes"] > 0) > 0.25  # not only free space
    assert first_difference(recording) is None

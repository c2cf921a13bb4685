"""A session is brought into a scenario, and saved as one."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from app.recording import rerun
from app.recording.read import read as read_recording
from app.scenarios.file import (
    Scenario,
    dumps,
    loads,
)
from app.scenarios.presets import PRESETS
from app.scenarios.staging import present, stage
from app.session import Session
from app.settings import Options
from tests.support.headless import wait_until


def test_a_session_is_brought_into_a_scenario_and_says_which_it_is_in() -> None:
    with Session(Options(mesh="cube", robot="point", rate=2000.0)) as session:
        stage(PRESETS["thin-plate-both-sides"], session)
        assert session.options.mesh == "thin-plate"
        assert session.options.rate == 2000.0
        wait_until(lambda: session.latest().step.planes.rules.size > 0)
        assert session.latest().autopilot
        saved = loads(dumps(present(session, "mine", "The plate.")))
        assert saved.options == PRESETS["thin-plate-both-sides"].options
        ends = [waypoint.at for waypoint in saved.proxy[1:]]
        np.testing.assert_allclose(
            ends, [w.at for w in PRESETS["thin-plate-both-sides"].proxy], atol=1e-12
        )
        # Begun again from the file it is the same: the tool is back at its start.
        stage(saved, session)
        wait_until(lambda: session.latest().target is not None)
        np.testing.assert_allclose(
            session.scene.autopilot.pose(0.0).translation,
            session.scene.T_base_start.translation,
            atol=1e-12,
        )


def test_a_proxy_put_down_by_hand_is_saved_and_found_again_elsewhere() -> None:
    turn = pin.SE3(pin.utils.rotate("y", 0.3), np.zeros(3))
    options = Options(mesh="cube", rotate=(0.0, 0.0, 0.7), rule="off", scale=0.2)
    with Session(options) as session:
        session.drive(pin.SE3((session.handle * turn).rotation, session.handle.translation))
        session.nudge([0.0, 0.01, -0.02])
        wait_until(lambda: session.latest().target is not None)
        wait_until(
            lambda: np.abs(session.latest().step.tip.translation
                           - session.latest().target.translation).max() < 1e-6
        )  # fmt: skip
        session.pause()
        wait_until(lambda: session.latest().paused)
        before = session.latest()
        saved = loads(dumps(present(session, "mine", "A cube.")))
        assert saved.paused
        assert len(saved.proxy) == 1
        session.resume()
        session.change(mesh="torus", rule="certified", scale=1.0)
        stage(saved, session)
        wait_until(lambda: session.latest().paused)
        assert session.options.rule == "off"
        wait_until(lambda: session._writer.orders.command.target is not None)
        again = session._writer.orders.command.target
        np.testing.assert_allclose(again.homogeneous, before.target.homogeneous, atol=1e-9)
        np.testing.assert_allclose(session.handle.homogeneous, again.homogeneous, atol=1e-9)


def test_a_recorded_scenario_is_repeated_bit_for_bit(tmp_path: Path) -> None:
    with Session(Options(mesh="cube", robot="point")) as session:
        tape = session.record(tmp_path / "plate.vfrec")
        stage(PRESETS["thin-plate-both-sides"], session)
        session.set(radius=2e-3)
        begun = session.latest().tick
        wait_until(lambda: session.latest().tick > begun + 1800)
        assert np.linalg.norm(session.latest().step.tip.translation) > 0.01
        session.set_autopilot(False)
        wait_until(lambda: not session.latest().autopilot)
        session.stop_recording()
    assert tape.rows > 1500
    recording = read_recording(tmp_path / "plate.vfrec")
    assert any(way is not None for way in recording.courses)
    assert rerun.first_difference(recording) is None
    # And only because the course is in it.
    without = replace(recording, courses=(None,) * len(recording.courses))
    found = rerun.first_difference(without)
    assert found is not None
    assert found.field in ("target", "turns_crc", "q")


def test_a_scenario_that_cannot_be_leaves_the_session_as_it_is() -> None:
    bad = Scenario("bad", "No such mesh.", Options(mesh="skul"))
    with Session(Options(mesh="cube", robot="point")) as session:
        scene, options = session.scene, session.options
        with pytest.raises(ValueError, match="unknown mesh 'skul'"):
            stage(bad, session)
        assert session.scene is scene
        assert session.options == options
        assert not session.latest().paused

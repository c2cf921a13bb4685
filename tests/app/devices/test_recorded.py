"""Sessions with arms and masters that are elsewhere, recorded and repeated bit for bit."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

from app.bench.counterparts.running import counterpart, free_port, guarded
from app.control.messages import STATES
from app.recording import rerun
from app.recording.export import bag, table
from app.recording.format import MEASURED, UNKNOWN
from app.recording.playback import Player, build_scenes
from app.recording.read import read
from app.recording.write import Recorder
from app.session import Session
from tests.support.headless import moved, wait_until
from tests.support.wired import Bench, Make


class Recorded(Bench):
    """A bench whose ticks are recorded."""

    recorder: Recorder

    def tick(self, content: dict[str, Any] | None = None) -> Any:
        engine, station = self.engine, self.station
        before = station.before

        def noted(orders: Any, latest: Any) -> Any:
            self.made = before(orders, latest)
            return self.made

        station.before = noted  # type: ignore[method-assign]
        seen, state = engine.seen, engine.state
        telemetry = super().tick(content)
        station.before = before  # type: ignore[method-assign]
        if not self.recorder.rows:
            self.recorder.begin(seen, state)
        self.recorder.add(self.made, telemetry, True)
        return telemetry


def test_what_entered_the_ticks_is_recorded_and_repeats(make: Make, tmp_path: Path) -> None:
    bench = make()
    bench.__class__ = Recorded
    bench.recorder = Recorder(tmp_path / "run.vfrec")
    bench.lag = 0.15
    bench.enabled()
    start = bench.tool
    measured = []
    for k in range(300):
        bench.goal(moved(start, dx=0.01 * math.sin(0.02 * k), dz=-3e-4 * k))
        measured.append(bench.q.copy())
        # Joints that are not finite: the tick knows none.
        bench.tick(bench.measured(Position=[math.nan] * 6) if k % 50 == 49 else None)
    bench.order("disable")
    bench.ticks(5)
    bench.recorder.close()
    recording = read(bench.recorder.path)
    rows = recording.rows
    np.testing.assert_array_equal(rows["measured"][2, :6], measured[0])
    assert (rows["sensed"] == UNKNOWN).sum() == 6
    assert (rows["sensed"] == MEASURED).sum() == len(rows) - 6
    states = recording.orders["state"][rows["order"]]
    assert STATES[states[0]] == "DISABLED"
    assert STATES[states[100]] == "ENABLED"
    assert STATES[states[-1]] == "DISABLED"
    assert np.abs(rows["force"]).max() > 0.1  # it was pushed back
    assert rerun.first_difference(recording) is None
    # The planes of a moment are those at the joints that were measured.
    player = Player(recording, build_scenes(recording, 1))
    for row in (150, 250):
        step = player.moment(row).telemetry.step
        assert step is not None
        assert len(step.planes) == rows["planes"][row]
        assert step.radius == rows["radius"][row]
    # Another measurement is another tick.
    rows["measured"][200, 0] += 1e-9
    found = rerun.first_difference(recording)
    assert found is not None
    assert found.row == 200
    assert bag.write(recording, tmp_path / "run.mcap") > 0
    with (tmp_path / "run.mcap").open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        told = [one for _, _, _, one in reader.iter_decoded_messages(["/psm/measured_js"])]
        file.seek(0)
        words = [
            one.data
            for _, _, _, one in make_reader(
                file, decoder_factories=[DecoderFactory()]
            ).iter_decoded_messages(["/psm/operating_state"])
        ]
    known = rows[rows["sensed"] == MEASURED]
    np.testing.assert_array_equal([one.position for one in told], known["measured"][:, :6])
    assert words == [STATES[k] for k in states]
    table.write(recording, tmp_path / "run.csv")
    lines = (tmp_path / "run.csv").read_text().splitlines()
    assert lines[0].endswith(",state")
    assert lines[101].endswith(",ENABLED")
    assert repr(float(rows["measured"][100, 0])) in lines[101].split(",")


@pytest.mark.parametrize("process", [False, True], ids=["thread", "process"])
def test_a_session_over_sockets_is_recorded(process: bool, tmp_path: Path) -> None:
    arm, console = free_port(), free_port()
    with (
        Session(guarded(arm, console, "200ms"), process=process) as session,
        counterpart("arm", arm) as hardware,
        counterpart("console", console, "--follow", "--enable") as operator,
    ):
        tape = session.record(tmp_path / "run.vfrec")
        wait_until(lambda: session.latest().target is not None)
        begun = tape.rows
        wait_until(lambda: tape.rows > begun + 1000)
        session.stop_recording()
        operator.quit()
        hardware.quit()
    recording = read(tape.path)
    assert recording.cut == ""
    assert len(recording.rows) > 1000
    assert (recording.rows["driven"] > 0).any()
    assert len(np.unique(recording.rows["measured"], axis=0)) > 100
    assert rerun.first_difference(recording) is None

"""The export as MCAP, read by the libraries that read such files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

import vf
from app.bench.counterparts.kinematics import tips
from app.commands import call
from app.recording.export import bag
from app.recording.format import RecordingError
from app.recording.read import read
from app.settings import Options
from tests.support.runs import a_run


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("bag") / "run.vfrec"
    a_run(path, Options(mesh="cube", robot="psm"), ticks=120)
    return path


def test_every_tick_is_in_the_bag_as_ros_has_it(run: Path, tmp_path: Path) -> None:
    out = tmp_path / "run.mcap"
    assert call("replay", [str(run), "--mcap", str(out)]) == 0
    recording = read(run)
    rows = recording.rows[recording.rows["ticked"] > 0]
    seen: dict[str, list] = {}
    with out.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        assert reader.get_header().profile == "ros2"
        for schema, channel, message, content in reader.iter_decoded_messages():
            assert channel.message_encoding == "cdr"
            seen.setdefault(channel.topic, []).append((schema.name, message.log_time, content))
    of_devices = {"measured_js", "operating_state"}
    assert set(seen) == {f"/psm/{name}" for name in set(bag.TOPICS) - of_devices} | {"/tf"}
    joints = [content for _, _, content in seen["/psm/setpoint_js"]]
    assert [schema for schema, _, _ in seen["/psm/setpoint_js"]] == [
        "sensor_msgs/msg/JointState"
    ] * len(rows)
    q = np.array([one.position for one in joints])
    np.testing.assert_array_equal(q, rows["q"][:, :6])
    assert list(joints[0].name)[:2] == ["yaw", "pitch"]
    assert joints[0].header.frame_id == "base"
    times = [at for _, at, _ in seen["/psm/setpoint_js"]]
    assert times == [round((t - rows["tick"][0]) * 1e6) for t in rows["tick"]]
    assert [one.header.stamp.sec * 10**9 + one.header.stamp.nanosec for one in joints] == times
    poses = [content.pose for _, _, content in seen["/psm/setpoint_cp"]]
    found = np.array([[p.position.x, p.position.y, p.position.z] for p in poses])
    np.testing.assert_allclose(found, tips(q), atol=1e-12)
    turn = poses[0].orientation
    assert np.hypot(np.hypot(turn.x, turn.y), np.hypot(turn.z, turn.w)) == pytest.approx(1.0)
    words = [content.data for _, _, content in seen["/psm/status"]]
    stepped = rows[rows["stepped"] > 0]
    assert words == [vf.Status(s).name for s in stepped["status"]]
    force = [content.wrench.force for _, _, content in seen["/psm/body/servo_cf"]]
    np.testing.assert_array_equal([[f.x, f.y, f.z] for f in force], stepped["force"])
    tf = seen["/tf"][5][2].transforms[0]
    assert (tf.header.frame_id, tf.child_frame_id) == ("base", "tip")
    assert tf.transform.translation.z == found[5, 2]
    goals = [content.point for _, _, content in seen["/psm/goal_point"]]
    np.testing.assert_array_equal(
        [[g.x, g.y, g.z] for g in goals], rows[rows["driven"] > 0]["target"]
    )


def test_no_file_is_overwritten(run: Path, tmp_path: Path) -> None:
    out = tmp_path / "there.mcap"
    out.write_text("mine")
    with pytest.raises(RecordingError, match="exists already"):
        bag.write(read(run), out)
    assert out.read_text() == "mine"

"""Messages into a bag and back, and the determinism that the shipped bag relies on."""

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import CameraInfo, JointState, PointCloud2, PointField
from std_msgs.msg import Float64MultiArray, Header, String
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from pattern_gen import default_pattern
from pattern_gen.ros_conversions import pattern_to_message
from sl_bringup.bag.reader import BagReader
from sl_bringup.bag.types import serialise, type_name
from sl_bringup.bag.writer import BackgroundWriter, BagWriter
from sl_bringup.errors import BagError
from sl_msgs.msg import Correspondences, PositionerStatus

MESSAGES = {
    "joint states without velocities": JointState(name=["a", "b"], position=[1.0, -2.0]),
    "text beyond ASCII": String(data="90\N{DEGREE SIGN}"),
    "pattern": pattern_to_message(default_pattern(), Header(frame_id="projector_optical_frame")),
    "diagnostics": DiagnosticArray(status=[DiagnosticStatus(level=b"\x01", values=[KeyValue(key="k", value="v")])]),
    "numbers": Float64MultiArray(data=[0.5, float("inf")]),
    "correspondences": Correspondences(row=np.array([3], np.uint16), camera_u=np.array([1.5], np.float32)),
    "status": PositionerStatus(code=16, message="stopped", distance=0.25),
    "camera": CameraInfo(k=np.arange(9.0), d=[0.1, 0.2]),
    "cloud": PointCloud2(fields=[PointField(name="x", datatype=7, count=1)], data=b"\x00\x01\x02\x03"),
    "trajectory": JointTrajectory(joint_names=["a"], points=[JointTrajectoryPoint(positions=[1.0])]),
}


@pytest.mark.parametrize("message", MESSAGES.values(), ids=MESSAGES.keys())
def test_a_message_comes_back_as_it_was_and_serialises_the_same_each_time(message):
    data = serialise(message)
    assert data == serialise(message)
    assert deserialize_message(data, type(message)) == message


def test_a_bag_gives_messages_back_in_time_with_their_types_and_latching(tmp_path):
    with BagWriter(tmp_path / "bag") as bag:
        bag.write("/text", String(data="late"), 30)
        bag.write("/text", String(data="early"), 10)
        bag.write("/description", String(data="urdf"), 20, latched=True)
    with BagReader(tmp_path / "bag") as bag:
        assert {(t.name, t.type_name, t.count, t.latched) for t in bag.topics} == {
            ("/text", "std_msgs/msg/String", 2, False),
            ("/description", "std_msgs/msg/String", 1, True),
        }
        seen = [(t, s, deserialize_message(d, String).data) for t, s, d in bag.messages()]
    assert seen == [("/text", 10, "early"), ("/description", 20, "urdf"), ("/text", 30, "late")]


def test_a_background_writer_keeps_everything_and_tells_of_failure(tmp_path):
    writer = BackgroundWriter(tmp_path / "bag")
    for k in range(200):
        writer.write("/n", Float64MultiArray(data=[float(k)]), k)
    writer.close()
    assert writer.counts == {"/n": 200}
    broken = BackgroundWriter(tmp_path / "other")
    broken.write("/n", object(), 0)
    with pytest.raises(BagError, match="incomplete"):
        broken.close()


def test_an_existing_bag_is_not_overwritten(tmp_path):
    with pytest.raises(BagError, match="exists already"):
        BagWriter(tmp_path)


def test_type_names_are_those_of_ros():
    assert type_name(JointState) == "sensor_msgs/msg/JointState"
    assert type_name(Correspondences) == "sl_msgs/msg/Correspondences"

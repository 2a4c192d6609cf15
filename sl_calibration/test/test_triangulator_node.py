import time

import numpy as np
import pytest

rclpy = pytest.importorskip("rclpy")
pytest.importorskip("sl_msgs.msg")

from nav_msgs.msg import Odometry  # noqa: E402
from rclpy.executors import SingleThreadedExecutor  # noqa: E402
from rclpy.parameter import Parameter  # noqa: E402
from rclpy.qos import DurabilityPolicy, QoSProfile  # noqa: E402
from sensor_msgs.msg import CameraInfo, JointState, PointCloud2  # noqa: E402
from std_msgs.msg import Header, String  # noqa: E402
from std_srvs.srv import Trigger  # noqa: E402

from sl_calibration.geometric_checks import Mark  # noqa: E402
from sl_calibration.nodes.triangulator import Triangulator  # noqa: E402
from sl_common import calibration_files, transforms  # noqa: E402
from sl_common.cameras import CameraModel  # noqa: E402
from sl_common.kinematics import Kinematics  # noqa: E402
from sl_common.ros import clouds  # noqa: E402
from sl_common.ros.qos import STREAM_PUBLISH, STREAM_SUBSCRIBE  # noqa: E402
from sl_common.ros.stamps import from_ns  # noqa: E402
from sl_msgs.msg import Correspondences  # noqa: E402

pytestmark = pytest.mark.processes
DOMAIN = 36

JOINTS = ("shoulder", "elbow", "wrist")


def urdf():
    links = "".join(f'<link name="{name}"/>' for name in ("base_link", "upper", "lower", "tool0"))
    parents, axes = ("base_link", "upper", "lower"), ("0 0 1", "0 1 0", "1 0 0")
    joints = "".join(
        f'<joint name="{name}" type="revolute"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="0 0.05 0.3"/><axis xyz="{axis}"/><limit lower="-3" upper="3" velocity="2" effort="9"/></joint>'
        for name, parent, child, axis in zip(JOINTS, parents, ("upper", "lower", "tool0"), axes, strict=True)
    )
    return f'<robot name="arm">{links}{joints}</robot>'


CAMERA = CameraModel(640, 480, np.array([[820.0, 0, 325.3], [0, 815, 236.8], [0, 0, 1]]), "pers", (1.2,))
PROJECTOR = CameraModel(1024, 768, np.array([[2000.0, 0, 514.5], [0, 2000, 698.9], [0, 0, 1]]))
HAND_EYE = transforms.exp(np.array([0.02, -0.03, 0.1, 0.1, -0.2, 0.4]))
Q0, Q1 = np.array([0.1, 0.2, -0.1]), np.array([0.14, 0.17, -0.12])
STAMP = 1_000_000_000_000


class Cell:
    """A triangulator in this process with everything it listens to."""

    def __init__(self, folder, **parameters):
        self.context = rclpy.Context()
        rclpy.init(context=self.context, domain_id=DOMAIN)
        overrides = {"calibration_folder": str(folder), **parameters}
        # Parameters of a node under test come as they do from the command line.
        arguments = ["--ros-args"]
        for name, value in overrides.items():
            arguments += ["-p", f"{name}:={value}"]
        rclpy.init(args=arguments, domain_id=DOMAIN)
        self.node = Triangulator()
        self.peer = rclpy.create_node("peer", context=self.context)
        self.executors = [SingleThreadedExecutor(), SingleThreadedExecutor(context=self.context)]
        self.executors[0].add_node(self.node)
        self.executors[1].add_node(self.peer)
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self.description = self.peer.create_publisher(String, "robot_description", latched)
        self.joints = self.peer.create_publisher(JointState, "joint_states", 10)
        self.info = self.peer.create_publisher(CameraInfo, "camera/camera_info", STREAM_PUBLISH)
        self.dots = self.peer.create_publisher(Correspondences, "correspondences", STREAM_PUBLISH)
        self.clouds, self.marked = [], []
        self.peer.create_subscription(PointCloud2, "points", self.clouds.append, STREAM_SUBSCRIBE)
        self.peer.create_subscription(PointCloud2, "/triangulator/marked", self.marked.append, STREAM_SUBSCRIBE)
        self.reload = self.peer.create_client(Trigger, "/triangulator/reload")
        self.description.publish(String(data=urdf()))
        matched = lambda: self.dots.get_subscription_count() and self.joints.get_subscription_count()  # noqa: E731
        self.spin(5.0, lambda: self.node._robot.kinematics and matched() and self.node._points.get_subscription_count())

    def spin(self, seconds, until=lambda: False):
        end = time.monotonic() + seconds
        while time.monotonic() < end and not until():
            for executor in self.executors:
                executor.spin_once(timeout_sec=0.01)

    def close(self):
        self.peer.destroy_node()
        self.node.destroy_node()
        rclpy.shutdown(context=self.context)
        rclpy.shutdown()

    def move(self, stamp, q, names=JOINTS):
        message = JointState(name=list(names), position=[float(x) for x in q])
        message.header.stamp = from_ns(stamp)
        self.joints.publish(message)

    def show(self, message):
        before = len(self.clouds)
        self.dots.publish(message)
        self.spin(0.6, lambda: len(self.clouds) > before)
        return clouds.from_message(self.clouds[-1]) if len(self.clouds) > before else None


def write_calibration(folder, base_from_projector, pattern_id="p1"):
    calibration_files.save_camera(folder / "camera.yaml", CAMERA)
    calibration_files.save_camera(
        folder / "projector.yaml", PROJECTOR, name="projector", extra={"pattern_id": pattern_id}
    )
    pose = calibration_files.PoseCalibration
    calibration_files.save_pose(folder / "hand_eye.yaml", "flange_from_camera", pose(HAND_EYE))
    calibration_files.save_pose(folder / "projector_pose.yaml", "base_from_projector", pose(base_from_projector))


def view(fraction=0.5, pattern_id="p1"):
    """base_from_projector, points in the base frame, and their correspondences at a fraction between Q0 and Q1."""
    rng = np.random.default_rng(0)
    kinematics = Kinematics(urdf(), "base_link", "tool0")
    base_from_camera = kinematics.forward((1 - fraction) * Q0 + fraction * Q1) @ HAND_EYE
    middle = kinematics.forward((Q0 + Q1) / 2) @ HAND_EYE
    points = np.column_stack([rng.uniform(-0.2, 0.2, (80, 2)), rng.uniform(1.0, 1.4, 80)])
    base_from_projector = middle @ transforms.look_at([0.35, 0.1, 0.0], [0, 0, 1.2], [0, 1, 0])
    in_base = transforms.apply(base_from_camera, points)
    camera = CAMERA.project(points)
    projector = PROJECTOR.project(transforms.apply(transforms.inverse(base_from_projector), in_base))
    message = Correspondences(
        header=Header(stamp=from_ns(STAMP + round(fraction * 4e7)), frame_id="camera_optical_frame"),
        pattern_id=pattern_id,
        camera_u=camera[:, 0].astype(np.float32),
        camera_v=camera[:, 1].astype(np.float32),
        projector_u=projector[:, 0].astype(np.float32),
        projector_v=projector[:, 1].astype(np.float32),
        row=np.arange(80, dtype=np.uint16),
        col=np.arange(80, dtype=np.uint16)[::-1].copy(),
        confidence=np.ones(80, dtype=np.float32),
    )
    return base_from_projector, in_base, points, message


@pytest.fixture
def make_cell(tmp_path):
    cells = []

    def make(calibrated=True, **parameters):
        if calibrated:
            write_calibration(tmp_path, view()[0])
        cells.append(Cell(tmp_path, **parameters))
        return cells[-1]

    yield make
    for cell in cells:
        cell.close()


def test_points_are_metric_in_the_base_frame_at_the_interpolated_joint_state(make_cell):
    cell = make_cell()
    _, in_base, _, message = view(0.5)
    cell.move(STAMP, Q0)
    cell.dots.publish(message)  # before the later joint state: must wait for it, not extrapolate
    cell.spin(0.04)
    assert cell.clouds == []
    cell.move(STAMP + 40_000_000, Q1)
    cell.spin(2.0, lambda: cell.clouds)
    cloud = clouds.from_message(cell.clouds[0])
    assert list(cloud) == ["x", "y", "z", "rgb", "confidence", "row", "col"]
    np.testing.assert_allclose(np.stack([cloud["x"], cloud["y"], cloud["z"]], -1), in_base, atol=1e-5)
    np.testing.assert_array_equal(cloud["row"], np.arange(80))
    np.testing.assert_array_equal(cloud["col"], np.arange(80)[::-1])
    assert cell.clouds[0].header.frame_id == "base_link"
    assert cell.clouds[0].header.stamp == message.header.stamp


def test_camera_frame_on_request(make_cell):
    cell = make_cell(output_frame="camera")
    _, _, points, message = view(0.0)
    cell.move(STAMP, Q0)
    cell.spin(0.2)
    cloud = cell.show(message)
    np.testing.assert_allclose(np.stack([cloud["x"], cloud["y"], cloud["z"]], -1), points, atol=1e-5)
    assert cell.clouds[0].header.frame_id == "camera_optical_frame"


def test_a_wrong_dot_is_marked_with_the_reason(make_cell):
    cell = make_cell()
    message = view(0.0)[3]
    message.projector_u[7] += 60.0
    message.projector_v[7] -= 45.0
    cell.move(STAMP, Q0)
    cell.spin(0.2)
    cloud = cell.show(message)
    cell.spin(1.0, lambda: cell.marked)
    marked = clouds.from_message(cell.marked[0])
    assert list(marked) == ["x", "y", "z", "camera_u", "camera_v", "row", "col", "mark", "distance"]
    assert marked["row"].tolist() == [7]
    assert marked["mark"].tolist() == [Mark.EPIPOLAR]
    assert marked["distance"][0] > 2.0
    assert 7 not in cloud["row"]
    assert len(cloud["row"]) == 79


def test_bad_messages_publish_nothing_and_the_node_lives(make_cell):
    cell = make_cell()
    message = view(0.5)[3]

    assert cell.show(message) is None  # no joint state at all
    cell.move(STAMP, [0.1, np.nan, 0.0])  # not finite
    cell.move(STAMP + 40_000_000, Q1, names=("a", "b", "c"))  # unknown joints
    cell.spin(0.2)
    assert cell.show(message) is None
    cell.move(STAMP - 500_000_000, Q0)
    cell.move(STAMP + 500_000_000, Q1)  # a gap of a second around the image
    cell.spin(0.2)
    assert cell.show(message) is None
    cell.move(STAMP, Q0)
    cell.move(STAMP + 40_000_000, Q1)
    cell.spin(0.2)
    assert cell.show(view(0.5, "another")[3]) is None  # another pattern
    broken = view(0.5)[3]
    broken.row = broken.row[:-3]
    assert cell.show(broken) is None  # arrays of different length
    assert len(cell.show(message)["x"]) == 80  # and the node still works


def test_calibration_made_while_running_is_picked_up(make_cell, tmp_path):
    cell = make_cell(calibrated=False)
    message = view(0.0)[3]
    cell.move(STAMP, Q0)
    cell.spin(0.2)
    assert cell.show(message) is None
    write_calibration(tmp_path, view()[0])
    cell.spin(0.5, lambda: cell.reload.service_is_ready())
    answer = cell.reload.call_async(Trigger.Request())
    cell.spin(2.0, answer.done)
    assert answer.result().success
    assert len(cell.show(message)["x"]) == 80


def test_unreadable_calibration_keeps_the_last_one(make_cell, tmp_path):
    cell = make_cell()
    (tmp_path / "hand_eye.yaml").write_text("flange_from_camera: [[1, 2\n")
    answer = cell.reload.call_async(Trigger.Request())
    cell.spin(2.0, answer.done)
    assert not answer.result().success
    assert "hand_eye.yaml" in answer.result().message
    cell.move(STAMP, Q0)
    cell.spin(0.2)
    assert len(cell.show(view(0.0)[3])["x"]) == 80


def test_wrong_parameter_names_itself(make_cell):
    cell = make_cell()
    assert cell.node.get_parameter("output_frame").value == "base"
    result = cell.node.set_parameters([Parameter("output_frame", value="moon")])[0]
    assert not result.successful


def test_object_is_published_as_odometry_when_tracked(make_cell):
    cell = make_cell(track_object="true")
    seen = []
    cell.peer.create_subscription(Odometry, "/triangulator/object", seen.append, 10)
    base_from_projector, _, _, message = view(0.0)
    cell.move(STAMP, Q0)
    # A bent sheet that a grid of rays meets: connected in the pattern, as the scattered points of view() are not.
    row, col = (a.ravel() for a in np.meshgrid(np.arange(12), np.arange(14), indexing="ij"))
    pixels = np.column_stack([200 + 40.0 * col, 300 + 35.0 * row])
    rays = PROJECTOR.rays(pixels)
    in_base = transforms.apply(
        base_from_projector, rays * (1.2 + 0.05 * np.sin(0.7 * row) * np.cos(0.6 * col))[:, None]
    )
    kinematics = Kinematics(urdf(), "base_link", "tool0")
    camera = CAMERA.project(transforms.apply(transforms.inverse(kinematics.forward(Q0) @ HAND_EYE), in_base))
    message.camera_u, message.camera_v = camera.T.astype(np.float32)
    message.projector_u, message.projector_v = pixels.T.astype(np.float32)
    message.row, message.col = row.astype(np.uint16), col.astype(np.uint16)
    message.confidence = np.ones(len(row), dtype=np.float32)
    cell.spin(0.3)
    assert cell.show(message) is not None
    cell.spin(1.0, lambda: seen)
    assert seen[0].header.frame_id == "base_link"
    assert seen[0].header.stamp == message.header.stamp
    p = seen[0].pose.pose.position
    np.testing.assert_allclose([p.x, p.y, p.z], in_base.mean(0), atol=0.02)
    assert seen[0].pose.pose.orientation.w == pytest.approx(1.0, abs=1e-3)

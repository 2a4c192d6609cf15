import sys
import time
from pathlib import Path

import numpy as np
import pytest

rclpy = pytest.importorskip("rclpy")
pytest.importorskip("sl_msgs.msg")
sys.path.insert(0, str(Path(__file__).parent))

from rclpy.action import ActionServer  # noqa: E402
from rclpy.executors import SingleThreadedExecutor  # noqa: E402
from rclpy.qos import DurabilityPolicy, QoSProfile  # noqa: E402
from scipy.optimize import least_squares  # noqa: E402
from sensor_msgs.msg import CameraInfo, JointState  # noqa: E402
from std_msgs.msg import Header, String  # noqa: E402
from std_srvs.srv import Trigger  # noqa: E402
from synthetic_views import SIZE, centers, hit_surface  # noqa: E402

from sl_calibration.motion_plan import Estimate, orbit  # noqa: E402
from sl_calibration.nodes.calibrator import Calibrator  # noqa: E402
from sl_common import calibration_files, transforms  # noqa: E402
from sl_common.cameras import CameraModel  # noqa: E402
from sl_common.kinematics import Kinematics  # noqa: E402
from sl_common.ros import camera_info  # noqa: E402
from sl_common.ros.qos import STREAM_PUBLISH  # noqa: E402
from sl_common.ros.stamps import from_ns  # noqa: E402
from sl_msgs.action import PositionArm  # noqa: E402
from sl_msgs.msg import CalibrationProgress, Correspondences, Pattern  # noqa: E402
from sl_msgs.srv import ComputeCalibration, ListSamples, LoadCalibration, RemoveSample, SaveCalibration, TakeSample  # noqa: E402

pytestmark = pytest.mark.processes
DOMAIN = 37
JOINTS = tuple(f"joint{i}" for i in range(6))
CAMERA = CameraModel(640, 480, np.array([[760.0, 0, 322.0], [0, 760, 238.0], [0, 0, 1]]))
PROJECTOR = CameraModel(*SIZE, np.array([[1900.0, 0, 512.0], [0, 1900, 700.0], [0, 0, 1]]))
HAND_EYE = transforms.make(transforms.rotation_exp(np.array([0.1, -0.2, 0.9])), np.array([0.03, -0.05, 0.1]))
START = np.array([0.1, -1.2, 1.4, -1.5, -1.4, 0.2])


def urdf():
    """An arm of six revolute joints with the proportions of a small industrial one."""
    links = "".join(f'<link name="{n}"/>' for n in ("base_link", "l1", "l2", "l3", "l4", "l5", "tool0"))
    chain = ("base_link", "l1", "l2", "l3", "l4", "l5", "tool0")
    offsets = ("0 0 0.16", "0 0.13 0", "0 -0.12 0.42", "0 0 0.39", "0 0.1 0", "0 0 0.1")
    axes = ("0 0 1", "0 1 0", "0 1 0", "0 1 0", "0 0 1", "0 1 0")
    joints = "".join(
        f'<joint name="{name}" type="revolute"><parent link="{chain[i]}"/><child link="{chain[i + 1]}"/>'
        f'<origin xyz="{offsets[i]}"/><axis xyz="{axes[i]}"/>'
        '<limit lower="-6.2" upper="6.2" velocity="3" effort="9"/></joint>'
        for i, name in enumerate(JOINTS)
    )
    return f'<robot name="arm">{links}{joints}</robot>'


class World:
    """A real arm, scene and projector behind the topics of a cell, and the clients of the calibrator."""

    def __init__(self, folder, **parameters):
        self.kinematics = Kinematics(urdf(), "base_link", "tool0")
        rng = np.random.default_rng(0)
        base_from_scene = self.kinematics.forward(START) @ HAND_EYE @ transforms.make(np.eye(3), [0, 0, 0.85])
        scene_from_projector = transforms.look_at([0.35, -0.2, -1.4], [0, 0, 0], [0.05, 1, 0])
        self.base_from_projector = base_from_scene @ scene_from_projector
        self.centers = centers(22, 29, 2)
        self.points = transforms.apply(
            base_from_scene, hit_surface(PROJECTOR, scene_from_projector, self.centers.reshape(-1, 2), 0.1, rng)
        )
        self.rng = rng
        self.move(START)
        arguments = ["--ros-args"]
        settings = {"calibration_folder": folder / "calibration", "session_folder": folder / "session", **parameters}
        for name, value in settings.items():
            arguments += ["-p", f"{name}:={value}"]
        self.context = rclpy.Context()
        rclpy.init(context=self.context, domain_id=DOMAIN)
        rclpy.init(args=arguments, domain_id=DOMAIN)
        self.node = Calibrator()
        self.peer = rclpy.create_node("peer", context=self.context)
        self.executors = [SingleThreadedExecutor(), SingleThreadedExecutor(context=self.context)]
        self.executors[0].add_node(self.node)
        self.executors[1].add_node(self.peer)
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self.joints = self.peer.create_publisher(JointState, "joint_states", 10)
        self.dots = self.peer.create_publisher(Correspondences, "correspondences", STREAM_PUBLISH)
        self.progress = []
        self.peer.create_subscription(CalibrationProgress, "/calibrator/progress", self.progress.append, latched)
        self.clients = {
            name: self.peer.create_client(kind, f"/calibrator/{name}")
            for name, kind in {
                "take_sample": TakeSample,
                "remove_sample": RemoveSample,
                "list_samples": ListSamples,
                "compute": ComputeCalibration,
                "save": SaveCalibration,
                "load": LoadCalibration,
                "run_motion": Trigger,
            }.items()
        }
        description = self.peer.create_publisher(String, "robot_description", latched)
        pattern = self.peer.create_publisher(Pattern, "pattern", latched)
        self.info = self.peer.create_publisher(CameraInfo, "camera/camera_info", STREAM_PUBLISH)
        description.publish(String(data=urdf()))
        pattern.publish(
            Pattern(
                pattern_id="p",
                rows=22,
                cols=29,
                center_u=self.centers[..., 0].ravel().astype(np.float32),
                center_v=self.centers[..., 1].ravel().astype(np.float32),
                projector_width=SIZE[0],
                projector_height=SIZE[1],
                spot_diameter=8.0,
            )
        )
        self.live = False
        self.moving_q = False
        self.peer.create_timer(0.03, self.publish)
        ready = lambda: self.node._session.pattern and self.node._session.camera and self.node._robot.kinematics  # noqa: E731
        self.spin(5.0, ready)
        assert ready()
        self.live = True

    def move(self, q):
        """Stand at joint positions q. Each stop has its own noise, however many images are taken there."""
        self.q = np.array(q, dtype=float)
        self.noise = self.rng.normal(scale=0.05, size=(len(self.points), 2))

    def publish(self):
        self.info.publish(camera_info.to_message(CAMERA, Header()))
        if not self.live:
            return
        now = self.peer.get_clock().now().nanoseconds
        if self.moving_q:
            self.q = self.q + 0.002
        state = JointState(name=list(JOINTS), position=self.q.tolist())
        state.header.stamp = from_ns(now)
        self.joints.publish(state)
        base_from_camera = self.kinematics.forward(self.q) @ HAND_EYE
        pixels = CAMERA.project(transforms.apply(transforms.inverse(base_from_camera), self.points))
        seen = np.flatnonzero(np.isfinite(pixels).all(-1) & CAMERA.contains(pixels))
        noisy = (pixels + self.noise)[seen].astype(np.float32)
        shown = self.centers.reshape(-1, 2)[seen].astype(np.float32)
        self.dots.publish(
            Correspondences(
                header=Header(stamp=from_ns(now - 30_000_000), frame_id="camera_optical_frame"),
                pattern_id="p",
                camera_u=noisy[:, 0],
                camera_v=noisy[:, 1],
                projector_u=shown[:, 0],
                projector_v=shown[:, 1],
                row=(seen // 29).astype(np.uint16),
                col=(seen % 29).astype(np.uint16),
                confidence=np.ones(len(seen), dtype=np.float32),
            )
        )

    def spin(self, seconds, until=lambda: False):
        end = time.monotonic() + seconds
        while time.monotonic() < end and not until():
            for _ in range(8):
                self.executors[0].spin_once(timeout_sec=0.0)
            for _ in range(3):
                self.executors[1].spin_once(timeout_sec=0.002)

    def call(self, name, request=None, timeout=60.0):
        client = self.clients[name]
        self.spin(5.0, client.service_is_ready)
        future = client.call_async(request or client.srv_type.Request())
        self.spin(timeout, future.done)
        assert future.done(), f"no answer from {name} within {timeout} s"
        return future.result()

    def go(self, q):
        self.move(q)
        self.spin(0.15)

    def solve(self, target):
        """Joint positions for a flange pose, and whether it is reached."""
        solution = least_squares(
            lambda q: transforms.difference(target, self.kinematics.forward(q)) * [10, 10, 10, 1, 1, 1], self.q
        )
        return solution.x, bool(solution.cost < 1e-10)

    def take_around(self, count):
        start = self.kinematics.forward(START)
        around = Estimate(HAND_EYE, self.points.mean(axis=0), 0.0)
        for pose in [*orbit(start, around), start][:count]:
            self.go(self.solve(pose)[0])
            answer = self.call("take_sample")
            assert answer.success, answer.message

    def close(self):
        self.peer.destroy_node()
        self.node.destroy_node()
        rclpy.shutdown(context=self.context)
        rclpy.shutdown()


@pytest.fixture
def make_world(tmp_path):
    worlds = []

    def make(**parameters):
        while worlds:
            worlds.pop().close()
        worlds.append(World(tmp_path, **parameters))
        return worlds[-1]

    yield make
    for world in worlds:
        world.close()


def check_files(folder, world, *, millimetres, degrees):
    """Both poses are as sure as they should be, and no further from the truth than they say."""
    calibration = calibration_files.load_calibration(folder)
    for found, truth in (
        (calibration.flange_from_camera, HAND_EYE),
        (calibration.base_from_projector, world.base_from_projector),
    ):
        sigma = np.sqrt(np.diag(found.covariance))
        assert 1e3 * np.linalg.norm(sigma[:3]) < millimetres
        assert np.degrees(np.linalg.norm(sigma[3:])) < degrees
        assert (abs(transforms.difference(truth, found.transform)) < 4 * sigma).all()
    assert calibration.projector.matrix[0, 0] == pytest.approx(1900, rel=2e-3)


def test_samples_survive_a_restart_and_give_the_calibration(make_world, tmp_path):
    world = make_world(left_out_errors="false")
    assert world.call("compute").success is False  # nothing yet, and said so
    assert not world.call("save").success
    assert not list((tmp_path / "calibration").glob("*"))

    world.take_around(8)
    listed = world.call("list_samples")
    assert list(listed.index) == list(range(8))
    assert min(listed.points) > 60
    assert np.isnan(listed.residual).all()
    removed = world.call("remove_sample", RemoveSample.Request(index=-1))
    assert (removed.success, removed.samples) == (True, 7)
    assert not world.call("remove_sample", RemoveSample.Request(index=7)).success
    world.spin(0.5, lambda: world.progress and world.progress[-1].samples == 7)
    assert world.progress[-1].samples == 7
    assert world.progress[-1].coverage_image > 0.3
    assert world.progress[-1].coverage_rotation > 0.1
    q = world.progress[-1].suggested.orientation
    assert np.linalg.norm([q.x, q.y, q.z, q.w]) == pytest.approx(1.0, abs=1e-6)

    again = make_world(left_out_errors="false")
    assert len(again.call("list_samples").index) == 7
    computed = again.call("compute", timeout=90)
    assert computed.success, computed.message
    assert computed.samples == 7
    assert 0.03 < computed.rms < 0.12
    assert 0 <= computed.worst_sample < 7
    assert (np.array(computed.hand_eye_sigma) > 0).all()
    saved = again.call("save")
    assert saved.success
    assert {Path(f).name for f in saved.files} >= {
        "camera.yaml",
        "projector.yaml",
        "hand_eye.yaml",
        "projector_pose.yaml",
    }
    assert all(Path(f).is_absolute() and Path(f).exists() for f in saved.files)
    check_files(tmp_path / "calibration", again, millimetres=2.0, degrees=0.1)
    loaded = again.call("load")
    assert loaded.success
    assert "samples" in loaded.message


def test_unusable_views_are_refused_with_the_reason(make_world):
    world = make_world()
    world.live = False
    answer = world.call("take_sample", TakeSample.Request(timeout=0.3))
    assert not answer.success
    assert "no correspondences" in answer.message
    world.live = world.moving_q = True
    answer = world.call("take_sample", TakeSample.Request(timeout=0.5))
    assert not answer.success
    assert "moves at" in answer.message
    world.moving_q = False
    world.points = world.points[:30]
    world.go(START)
    answer = world.call("take_sample", TakeSample.Request(timeout=0.5))
    assert not answer.success
    assert "are needed" in answer.message
    assert answer.samples == 0
    assert not world.call("run_motion").success  # no positioner


def test_it_drives_the_motion_itself_through_the_positioner(make_world, tmp_path):
    world = make_world(left_out_errors="false", motion_settle="0.1")
    goals = []

    def execute(handle):
        goal = handle.request.goal_pose.pose
        p, o = goal.position, goal.orientation
        target = transforms.from_quaternion([p.x, p.y, p.z], [o.x, o.y, o.z, o.w])
        goals.append(target)
        q, reached = world.solve(target)
        world.move(q)
        handle.succeed()
        return PositionArm.Result(success=reached)

    server = ActionServer(world.peer, PositionArm, "positioner/position_arm", execute)
    answer = world.call("run_motion", timeout=60)
    assert answer.success, answer.message
    poses = np.array(goals)
    turned = np.degrees(transforms.rotation_angle(poses[:, :3, :3] @ world.kinematics.forward(START)[:3, :3].T))
    assert turned.max() > 30  # beyond the first small motions
    delta = transforms.difference(world.kinematics.forward(START), poses[-1])
    assert np.linalg.norm(delta) < 1e-6  # back at the start
    listed = world.call("list_samples")
    assert len(listed.index) >= 10
    assert min(listed.points) > 60
    computed = world.call("compute", timeout=90)
    assert computed.success, computed.message
    assert world.call("save").success
    check_files(tmp_path / "calibration", world, millimetres=0.8, degrees=0.05)
    server.destroy()

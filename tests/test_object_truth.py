"""The triangulator's ~/object against the true motion: a simulated object's dots through the real process."""

import numpy as np
import pytest
from geometry_msgs.msg import Pose
from nav_msgs.msg import Odometry
from sensor_msgs.msg import CameraInfo, JointState
from stack_testing.running import wait_for
from std_msgs.msg import Header, String

from pattern_gen import default_pattern
from sl_bringup import nominal_calibration
from sl_common import transforms
from sl_common.calibration_files import Calibration, PoseCalibration
from sl_common.ros import camera_info
from sl_common.ros.qos import LATCHED, STREAM_PUBLISH, STREAM_SUBSCRIBE
from sl_common.ros.stamps import from_ns, to_ns
from sl_msgs.msg import Correspondences
from sl_sim import arm
from sl_sim.cell import Cell, CellSettings

pytestmark = pytest.mark.processes

PATIENCE = 120.0
IMAGES = 16
PERIOD = 0.3


class MovingObject:
    """A cell whose object sways and swings: joint states, and the dots that a perfect decoder finds, 0.05 px noise."""

    def __init__(self, stack):
        self.cell = Cell(CellSettings(scene="bust", seed=2, sway=(0.03, 0.02, 0.01), swing=6.0, sway_period=6.0))
        self.truth: dict[int, np.ndarray] = {}
        self._peer = stack.peer
        self._rng = np.random.default_rng(0)
        self._joints = self._peer.publisher(JointState, "joint_states", STREAM_PUBLISH)
        self._info = self._peer.publisher(CameraInfo, "camera/camera_info", STREAM_PUBLISH)
        self._dots = self._peer.publisher(Correspondences, "correspondences", STREAM_PUBLISH)
        self._peer.publisher(String, "robot_description", LATCHED).publish(String(data=arm.urdf()))
        self._peer.node.create_timer(0.02, self._tell_joints)
        pattern = default_pattern()
        self._row, self._col = (a.ravel() for a in np.mgrid[: pattern.rows, : pattern.cols])
        self._pixels = pattern.centers.reshape(-1, 2)

    def calibration(self):
        cell = self.cell
        poses = (PoseCalibration(cell.flange_from_camera), PoseCalibration(cell.base_from_projector))
        return Calibration(cell.camera, cell.projector, *poses)

    def _tell_joints(self):
        message = JointState(name=list(self.cell.kinematics.joint_names), position=list(self.cell.start_positions))
        message.header.stamp = self._peer.node.get_clock().now().to_msg()
        self._joints.publish(message)
        self._info.publish(camera_info.to_message(self.cell.camera, Header()))

    def seen(self, base_from_object):
        """Which dots the camera sees, and where (N, 2)."""
        cell = self.cell
        camera = cell.base_from_camera(np.array(cell.start_positions))
        spots, normals = cell.spots_in_base(self._pixels, base_from_object=base_from_object)
        rays = spots - camera[:3, 3]
        known = np.isfinite(rays).all(axis=1)
        hits, _ = cell.surface_along_rays(
            camera[:3, 3], np.where(known[:, None], rays, 1.0), base_from_object=base_from_object
        )
        at = cell.camera.project(transforms.apply(transforms.inverse(camera), spots))
        ok = known & cell.camera.contains(at) & (np.linalg.norm(hits - spots, axis=1) < 1e-3)
        ok &= -np.sum(rays * normals, axis=1) > 0.3 * np.linalg.norm(rays, axis=1)
        return np.flatnonzero(ok), at[ok]

    def show(self, time):
        """Publish the dots of the object as it is ``time`` [s] after it began to move."""
        pose = self.cell.base_from_object_at(time)
        index, at = self.seen(pose)
        stamp = self._peer.node.get_clock().now().nanoseconds
        self.truth[stamp] = pose
        u, v = (at + self._rng.normal(scale=0.05, size=at.shape)).astype(np.float32).T
        light = self._pixels[index].astype(np.float32)
        self._dots.publish(
            Correspondences(
                header=Header(stamp=from_ns(stamp), frame_id="camera_optical_frame"),
                pattern_id="p",
                camera_u=u,
                camera_v=v,
                projector_u=light[:, 0],
                projector_v=light[:, 1],
                row=self._row[index].astype(np.uint16),
                col=self._col[index].astype(np.uint16),
                confidence=np.ones(len(index), dtype=np.float32),
            )
        )


def as_array(pose: Pose):
    p, o = pose.position, pose.orientation
    return transforms.from_quaternion([p.x, p.y, p.z], [o.x, o.y, o.z, o.w])


@pytest.mark.timeout(300)
def test_the_motion_of_the_object_is_the_true_one(stack, tmp_path):
    world = MovingObject(stack)
    nominal_calibration.save(tmp_path, world.calibration(), note="exact")
    stack.start("sl_calibration", "triangulator", calibration_folder=tmp_path, track_object=True)
    found = stack.peer.listen(Odometry, "triangulator/object", STREAM_SUBSCRIBE)

    def first():
        world.show(0.0)  # until the node has heard of arm and camera
        return found

    wait_for(first, PATIENCE, "~/object")
    for k in range(IMAGES):
        before = len(found)
        world.show(PERIOD * k)
        wait_for(lambda n=before: len(found) > n, PATIENCE, "the object in the next cloud")
    truth = [world.truth[to_ns(m.header.stamp)] for m in found]
    poses = [as_array(m.pose.pose) for m in found]
    middle = poses[0][:3, 3]
    travelled, off, turned = [], [], []
    for pose, true in zip(poses, truth, strict=True):
        wanted = true @ transforms.inverse(truth[0])
        motion = pose @ transforms.inverse(poses[0])
        travelled.append(np.linalg.norm(transforms.apply(wanted, middle[None])[0] - middle))
        off.append(np.linalg.norm(transforms.apply(wanted, middle[None]) - transforms.apply(motion, middle[None])))
        turned.append(np.degrees(transforms.rotation_angle(wanted[:3, :3].T @ motion[:3, :3])))
    print(f"travelled {1e3 * max(travelled):.1f} mm, off by {1e3 * max(off):.2f} mm and {max(turned):.2f} deg at most")
    assert max(travelled) > 0.015
    assert max(off) < 1e-3
    assert max(turned) < 0.5

"""Procedures camera and hand_eye of the node calibrator, over real processes: photographs of a board, a moving arm."""

import sys
import threading
from pathlib import Path

import numpy as np
import pytest
import yaml
from sensor_msgs.msg import Image, JointState
from stack_testing.running import wait_for
from std_msgs.msg import Header, String

from sl_common import transforms
from sl_common.calibration_files import load_camera, load_hand_eye
from sl_common.ros import images
from sl_common.ros.qos import LATCHED, STREAM_PUBLISH
from sl_common.ros.stamps import from_ns
from sl_msgs.srv import ComputeCalibration, SaveCalibration, TakeSample
from sl_sim import arm
from sl_sim.cell import inverse_kinematics

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "sl_calibration" / "test"))
import board_scenes

pytestmark = pytest.mark.processes

PATIENCE = 120.0
BOARD, CAMERA = board_scenes.BOARD, board_scenes.CAMERA
HAND_EYE = transforms.make(transforms.rotation_exp([0.1, -0.2, 0.9]), [0.03, -0.05, 0.1])
START = np.array([0.2, -1.9, 2.2, -0.3, 1.4, 0.3])


class ArmWithCamera:
    """An arm that carries a camera around a board that stands still: joint states and photographs."""

    def __init__(self, stack):
        self._kinematics, self._lock = arm.kinematics(), threading.Lock()
        self._node = stack.peer.node
        self._joints = stack.peer.publisher(JointState, "joint_states", STREAM_PUBLISH)
        self._images = stack.peer.publisher(Image, "camera/image_raw", STREAM_PUBLISH)
        self._base_from_board = None
        self._q, self._image = START, None
        description = stack.peer.publisher(String, "robot_description", LATCHED)
        description.publish(String(data=arm.urdf()))

    def go(self, camera_from_board):
        """Stand where the board is seen like this; the first time the board is put there."""
        if self._base_from_board is None:
            self._base_from_board = self._kinematics.forward(START) @ HAND_EYE @ camera_from_board
        flange = self._base_from_board @ transforms.inverse(camera_from_board) @ transforms.inverse(HAND_EYE)
        q = inverse_kinematics(self._kinematics, flange, self._q)
        grey = np.clip(250 * board_scenes.board_albedo(CAMERA, camera_from_board, BOARD), 0, 255).astype(np.uint8)
        with self._lock:
            begins = self._image is None
            self._q, self._image = q, np.repeat(grey[..., None], 3, axis=-1)
        if begins:
            self._node.create_timer(0.02, self._state)
            self._node.create_timer(0.15, self._photograph)

    def _state(self):
        with self._lock:
            message = JointState(name=list(self._kinematics.joint_names), position=self._q.tolist())
            message.header.stamp = self._node.get_clock().now().to_msg()
        self._joints.publish(message)

    def _photograph(self):
        with self._lock:
            now = self._node.get_clock().now().nanoseconds
            header = Header(stamp=from_ns(now), frame_id="camera_optical_frame")
            message = images.to_message(self._image, header)
        self._images.publish(message)


def calibrate(stack, cell, views, **parameters):
    """Take a sample of each view, compute and save; returns the answers and what the process was."""
    process = stack.start("sl_calibration", "calibrator", **parameters)

    def ask(kind, name, **fields):
        return stack.peer.call(kind, f"/calibrator/{name}", kind.Request(**fields), timeout=PATIENCE)

    for k, view in enumerate(views):
        cell.go(view)
        # The node may not have heard of arm and camera yet; it then says so.
        taken = wait_for(
            lambda: (a := ask(TakeSample, "take_sample", timeout=20.0)).success and a, PATIENCE, "a sample"
        )
        assert taken.samples == k + 1
    computed, saved = ask(ComputeCalibration, "compute"), ask(SaveCalibration, "save")
    process.stop()
    assert computed.success, computed.message
    assert saved.success, saved.message
    return computed, saved


@pytest.mark.timeout(420)
def test_a_board_gives_the_camera_and_then_its_mount_on_the_flange(stack, tmp_path):
    views = board_scenes.poses(8, tilt=0.45, seed=5)
    cell = ArmWithCamera(stack)
    common = {
        "board": f"{BOARD.columns}x{BOARD.rows}",
        "square": BOARD.square,
        "calibration_folder": tmp_path / "calibration",
    }
    computed, saved = calibrate(
        stack, cell, views, procedure="camera", camera_model="plumb_bob", session_folder=tmp_path / "camera", **common
    )
    assert [Path(f).name for f in saved.files] == ["camera.yaml"]
    assert computed.rms < 0.3
    found = load_camera(saved.files[0])
    sigma = yaml.safe_load(Path(saved.files[0]).read_text())["uncertainty_one_sigma"]
    for name, i, j in (("fx", 0, 0), ("cx", 0, 2), ("cy", 1, 2)):
        assert abs(found.matrix[i, j] - CAMERA.matrix[i, j]) < 4 * sigma[name] + 0.2

    computed, saved = calibrate(
        stack, cell, views, procedure="hand_eye", session_folder=tmp_path / "hand_eye", **common
    )
    assert [Path(f).name for f in saved.files] == ["hand_eye.yaml"]
    assert computed.samples == len(views)
    mount = load_hand_eye(tmp_path / "calibration")
    delta = transforms.difference(mount.transform, HAND_EYE)
    assert np.linalg.norm(delta[:3]) < 2e-3
    assert np.degrees(np.linalg.norm(delta[3:])) < 0.1

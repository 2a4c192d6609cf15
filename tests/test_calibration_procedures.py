"""Calibrations through the node calibrator, over real processes: colours in the cell, Gray code on a board."""

import sys
import threading
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from sensor_msgs.msg import Image
from stack_testing.running import wait_for
from std_msgs.msg import Header

from pattern_gen import default_pattern
from sl_calibration.colour_letters import least_distance
from sl_common import transforms
from sl_common.calibration_files import load_camera, load_pose
from sl_common.ros import images
from sl_common.ros.qos import LATCHED, STREAM_PUBLISH, STREAM_SUBSCRIBE
from sl_common.ros.stamps import from_ns, to_ns
from sl_msgs.msg import CalibrationProgress, Correspondences
from sl_msgs.srv import ComputeCalibration, ListSamples, RemoveSample, SaveCalibration, TakeSample
from sl_sim.cell import Cell, CellSettings
from sl_sim.spot_truth import spot_truth

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "sl_calibration" / "test"))
import board_scenes

pytestmark = pytest.mark.processes

PATIENCE = 120.0


def ask(stack, kind, name, **fields):
    return stack.peer.call(kind, f"/calibrator/{name}", kind.Request(**fields), timeout=PATIENCE)


def done(answer):
    assert answer.success, answer.message
    return answer


class Seen:
    """What the cell's camera and the decoder show, judged by the truth."""

    def __init__(self, stack, cell, pattern):
        self._pattern, self._cell = pattern, cell
        base_from_camera = cell.base_from_camera(cell.start_positions)
        projector = (cell.projector, cell.base_from_projector, np.asarray(pattern.centers))
        truth = spot_truth(cell.caster, cell.camera, base_from_camera, *projector, pattern.spot_diameter)
        self.visible = np.asarray(truth.visible & ~truth.edge)
        points, _ = cell.spots_in_base(np.asarray(pattern.centers).reshape(-1, 2))
        pixels = cell.camera.project(transforms.apply(transforms.inverse(base_from_camera), points))
        self._pixels = pixels.reshape(*self.visible.shape, 2)
        self._images = stack.peer.listen(Image, "camera/image_raw", STREAM_SUBSCRIBE)
        self._dots = stack.peer.listen(Correspondences, "correspondences", STREAM_SUBSCRIBE)

    def image(self):
        """The mean of four images from now on, BGR."""
        begin = len(self._images)
        wait_for(lambda: len(self._images) >= begin + 5, PATIENCE, "images")
        # The first may have been exposed before.
        return np.mean([images.to_bgr(m) for m in self._images[begin + 1 : begin + 5]], axis=0)

    def wait_for_other_letters(self, image, least=10.0):
        """Wait until the camera sees a letter `least` grey levels off what it is in `image`; light takes its time."""
        old = self.letters(image, 0.0)

        def shown():
            return np.abs(self.letters(images.to_bgr(self._images[-1]), 0.0) - old).max() > least

        wait_for(shown, PATIENCE, "the new letters in the camera's images")

    def letters(self, image, black):
        """Camera values above black (A, 3), R G B: the median over the visible dots of each letter."""
        rows, cols = np.nonzero(self.visible)
        u, v = self._pixels[rows, cols].astype(np.float32).T
        there = cv2.remap((image - black).astype(np.float32), u[:, None], v[:, None], cv2.INTER_LINEAR)
        values, symbols = there[:, 0, ::-1], self._pattern.symbols[rows, cols]
        return np.array([np.median(values[symbols == k], axis=0) for k in range(self._pattern.alphabet)])

    def decoded(self):
        """Numbers of right and wrong dots, mean of five messages from now on."""
        begin = len(self._dots)
        wait_for(lambda: len(self._dots) >= begin + 6, PATIENCE, "correspondences")
        right, wrong = [], []
        for message in self._dots[begin + 1 : begin + 6]:
            truth = self._pixels[np.array(message.row, int), np.array(message.col, int)]
            error = np.linalg.norm(truth - np.stack([message.camera_u, message.camera_v], -1), axis=-1)
            right.append((error < 2).sum())
            wrong.append((~(error < 2)).sum())
        return float(np.mean(right)), float(np.mean(wrong))


@pytest.mark.timeout(420)
def test_colours_calibrated_in_the_cell_part_the_letters_and_help_the_decoder(stack, tmp_path):
    """Overlapping filters on both sides, gamma, dim light, noise, JPEG: the worst that the cell offers by a name."""
    settings = CellSettings(scene="bust", seed=3)
    pattern, cell = default_pattern(), Cell(settings)
    stack.start("sl_sim", "cell", scene="bust", seed=3, effects="budget", exposure=0.5, camera_rate=5.0)
    # Frames reach the cell as messages: on a busy machine later than light would.
    nodes = [stack.start("pattern_gen", "pattern_publisher"), stack.start("sl_decoder", "decoder")]
    stack.start(
        "sl_calibration",
        "calibrator",
        procedure="colours",
        calibration_folder=tmp_path / "calibration",
        session_folder=tmp_path / "session",
        projection_settle=1.5,
    )
    seen = Seen(stack, cell, pattern)
    wait_for(lambda: stack.peer.received["correspondences"], PATIENCE, "the first correspondences")
    image = seen.image()
    right, wrong = seen.decoded()

    taken = done(ask(stack, TakeSample, "take_sample", timeout=20.0))
    assert taken.samples == 1
    computed = done(ask(stack, ComputeCalibration, "compute"))
    assert "least distance of two letters" in computed.message
    saved = done(ask(stack, SaveCalibration, "save"))
    assert saved.files == [str(tmp_path / "calibration" / "colours.yaml")]

    for node in nodes:
        node.stop()
    stack.start("pattern_gen", "pattern_publisher", colours_file=saved.files[0])
    stack.start("sl_decoder", "decoder", colours_file=saved.files[0])
    seen.wait_for_other_letters(image)
    begin = len(stack.peer.received["correspondences"])
    wait_for(lambda: len(stack.peer.received["correspondences"]) > begin + 2, PATIENCE, "dots of the new letters")
    new_image = seen.image()
    new_right, new_wrong = seen.decoded()

    black = np.percentile(image, 5, axis=(0, 1))
    before = least_distance(seen.letters(image, black), ("disc",) * pattern.alphabet)
    after = least_distance(seen.letters(new_image, black), ("disc",) * pattern.alphabet)
    total = seen.visible.sum()
    print(
        f"least distance of two letters {before:.1f} -> {after:.1f} grey levels; of {total} dots undecoded"
        f" {total - right:.0f} -> {total - new_right:.0f}, wrong {wrong:.1f} -> {new_wrong:.1f}"
    )
    assert after > 1.5 * before
    assert total - new_right < 0.95 * (total - right)
    assert new_wrong <= wrong + 2


class BoardCamera:
    """A camera and a projector before a board: answers every projected frame with a photograph."""

    def __init__(self, stack, camera_from_board):
        self._publisher = stack.peer.publisher(Image, "camera/image_raw", STREAM_PUBLISH)
        self._lock, self._stamp = threading.Lock(), 0
        self._rng = np.random.default_rng(0)
        self._light = np.zeros((board_scenes.PROJECTOR.height, board_scenes.PROJECTOR.width), np.uint8)
        self.show_board(camera_from_board)
        stack.peer.node.create_subscription(Image, "projector/image", self._on_projector, LATCHED)
        stack.peer.node.create_timer(0.06, self._photograph)

    def show_board(self, camera_from_board):
        albedo, place = board_scenes.lit_board(camera_from_board)
        with self._lock:
            self._albedo, self._place = albedo, place

    def _on_projector(self, message):
        with self._lock:
            self._light, self._stamp = images.to_bgr(message)[..., 1], to_ns(message.header.stamp)

    def _photograph(self):
        """Light is there at once, messages are not: a photograph is stamped by the frame that lights it."""
        with self._lock:
            grey = board_scenes.photograph(self._light, self._albedo, self._place, 1.0, self._rng)
            header = Header(stamp=from_ns(self._stamp + 55_000_000), frame_id="camera_optical_frame")
        self._publisher.publish(images.to_message(np.repeat(grey[..., None], 3, axis=-1), header))


@pytest.mark.timeout(420)
def test_gray_code_on_a_board_calibrates_camera_and_projector_also_across_a_restart(stack, tmp_path):
    """Every frame goes through pattern_publisher, every photograph through camera/image_raw."""
    poses = board_scenes.poses(4, tilt=0.45, seed=31)
    pattern = board_scenes.small_pattern()
    pattern.save(tmp_path / "pattern.yaml")
    camera = BoardCamera(stack, poses[0])
    stack.start("pattern_gen", "pattern_publisher", pattern_file=tmp_path / "pattern.yaml")
    board = board_scenes.BOARD
    parameters = {
        "procedure": "procam",
        "board": f"{board.columns}x{board.rows}",
        "square": board.square,
        "calibration_folder": tmp_path / "calibration",
        "session_folder": tmp_path / "session",
        "projection_settle": 0.05,
    }
    node = stack.start("sl_calibration", "calibrator", **parameters)
    progress = stack.peer.listen(CalibrationProgress, "calibrator/progress", LATCHED)
    wait_for(lambda: progress, PATIENCE, "progress")
    assert "no samples yet" in progress[-1].message
    assert not ask(stack, ComputeCalibration, "compute").success
    assert not ask(stack, SaveCalibration, "save").success

    # The node may not have heard of the pattern yet; it then says so at once.
    wait_for(lambda: ask(stack, TakeSample, "take_sample", timeout=10.0).success, PATIENCE, "the first sample")
    for k, pose in enumerate(poses[1:3]):
        camera.show_board(pose)
        taken = done(ask(stack, TakeSample, "take_sample", timeout=10.0))
        assert taken.samples == k + 2
    removed = done(ask(stack, RemoveSample, "remove_sample", index=0))
    assert removed.samples == 2
    node.stop()
    stack.start("sl_calibration", "calibrator", **parameters)
    listed = ask(stack, ListSamples, "list_samples")
    assert len(listed.index) == 2
    assert min(listed.points) > 50
    camera.show_board(poses[3])
    wait_for(lambda: ask(stack, TakeSample, "take_sample", timeout=10.0).success, PATIENCE, "another sample")
    wait_for(lambda: progress[-1].samples == 3, PATIENCE, "progress of three samples")
    assert 0.2 < progress[-1].coverage_image <= 1.0
    assert progress[-1].coverage_rotation > 0.1

    computed = done(ask(stack, ComputeCalibration, "compute"))
    assert computed.samples == 3
    assert computed.rms < 0.3
    saved = done(ask(stack, SaveCalibration, "save"))
    names = [Path(f).name for f in saved.files]
    assert names == ["camera.yaml", "projector.yaml", "camera_from_projector.yaml"]
    projector = load_camera(saved.files[1])
    sigma = yaml.safe_load(Path(saved.files[1]).read_text())["uncertainty_one_sigma"]
    truth = board_scenes.PROJECTOR.matrix
    for name, i, j in (("fx", 0, 0), ("cx", 0, 2), ("cy", 1, 2)):
        assert abs(projector.matrix[i, j] - truth[i, j]) < 3 * sigma[name]
    pose = load_pose(saved.files[2], "camera_from_projector")
    delta = transforms.difference(pose.transform, transforms.inverse(board_scenes.PROJECTOR_FROM_CAMERA))
    assert (np.abs(delta) < 3 * np.sqrt(np.diag(pose.covariance))).all()

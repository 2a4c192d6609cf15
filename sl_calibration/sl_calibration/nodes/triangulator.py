"""Node triangulator: correspondences and joint states in, a metric point cloud out."""

import time
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rclpy.node import Node
from sensor_msgs.msg import CameraInfo, PointCloud2
from std_msgs.msg import Header
from std_srvs.srv import Trigger

from sl_calibration.nodes.dot_checks import DotChecks
from sl_calibration.nodes.messages import colours_from_message, dots_from_message
from sl_calibration.nodes.object_odometry import ObjectTracking
from sl_calibration.nodes.robot import Pairing, Robot
from sl_calibration.triangulation import Triangulation, TriangulationOptions, camera_from_projector, triangulate
from sl_common import transforms
from sl_common.calibration_files import (
    CAMERA_FILE,
    HAND_EYE_FILE,
    PROJECTOR_FILE,
    PROJECTOR_POSE_FILE,
    load_camera,
    load_hand_eye,
    load_projector_pose,
)
from sl_common.cameras import CameraModel
from sl_common.errors import InvalidInputError, StructuredLightError
from sl_common.files import read_yaml
from sl_common.ros import camera_info, clouds
from sl_common.ros.diagnostics import ERROR, OK, WARN, Diagnostics
from sl_common.ros.parameters import declare
from sl_common.ros.qos import LATCHED, STREAM_PUBLISH, STREAM_SUBSCRIBE
from sl_common.ros.run import run_node
from sl_common.ros.stamps import to_ns
from sl_common.ros.waiting import InputWatch
from sl_msgs.msg import Correspondences, Pattern

_GREY = 200


class Triangulator(Node):
    """Pairs each image's correspondences with the joint state at its stamp and publishes the points."""

    def __init__(self) -> None:
        super().__init__("triangulator")
        self._folder = Path(
            declare(
                self,
                "calibration_folder",
                "calibration",
                "Folder with projector.yaml, hand_eye.yaml, projector_pose.yaml",
            )
        ).expanduser()
        self._base_frame = declare(self, "base_frame", "base_link", "Base frame of the robot")
        flange = declare(self, "flange_frame", "tool0", "Flange frame of the robot")
        self._output = declare(
            self,
            "output_frame",
            "base",
            "Frame of the cloud: the robot's base or the camera",
            choices=("base", "camera"),
        )
        self._options = TriangulationOptions(
            max_epipolar_distance=declare(
                self,
                "max_epipolar_distance",
                2.0,
                "Dots farther from their epipolar line are refused; nearer ones too if they are far off for the image",
                unit="px",
                minimum=0.01,
            ),
            min_depth=declare(
                self, "min_depth", 0.01, "Points nearer to the camera are refused", unit="m", minimum=0.0
            ),
            max_depth=declare(
                self, "max_depth", 10.0, "Points farther from the camera are refused", unit="m", minimum=0.02
            ),
        )
        self._min_confidence = declare(
            self, "min_confidence", 0.5, "Dots of lower confidence are left out", minimum=0.0, maximum=1.0
        )
        self._any_pattern = declare(
            self, "accept_any_pattern", False, "Accept another pattern than the projector was calibrated with"
        )
        self._tracking = ObjectTracking(self, self._base_frame) if self._track_parameter() else None
        max_gap = declare(
            self, "max_joint_gap", 0.1, "Joint states farther apart are not interpolated", unit="s", minimum=0.001
        )
        wait = declare(
            self, "joint_wait", 0.1, "How long to wait for the joint state after an image", unit="s", minimum=0.0
        )

        self._extrinsic: tuple[NDArray[np.float64], NDArray[np.float64]] | None = None
        self._projector: CameraModel | None = None
        self._camera_file: CameraModel | None = None
        self._camera_topic: CameraModel | None = None
        self._calibrated_pattern = ""
        self._loaded: dict[str, int] = {}
        self._shown_pattern = ""
        self._colours: NDArray[np.uint8] | None = None

        self._diagnostics = Diagnostics(self)
        self._checks = DotChecks(self, self._diagnostics, max_epipolar_distance=self._options.max_epipolar_distance)
        self._watch = InputWatch(self)
        self._robot = Robot(self, self._watch, base_frame=self._base_frame, flange_frame=flange, max_gap=max_gap)
        self._pairing: Pairing[Correspondences] = Pairing(
            self, self._robot, wait=wait, deliver=self._deliver, refuse=lambda _, reason: self._refuse(reason)
        )
        self._watch.expect("correspondences", Correspondences, STREAM_SUBSCRIBE)
        self.create_subscription(Correspondences, "correspondences", self._on_correspondences, STREAM_SUBSCRIBE)
        self.create_subscription(CameraInfo, "camera/camera_info", self._on_camera_info, STREAM_SUBSCRIBE)
        self.create_subscription(Pattern, "pattern", self._on_pattern, LATCHED)
        self._points = self.create_publisher(PointCloud2, "points", STREAM_PUBLISH)
        self.create_service(Trigger, "~/reload", self._on_reload)
        self.create_timer(1.0, self._reload_if_changed)
        self._reload_if_changed()

    def _track_parameter(self) -> bool:
        return declare(self, "track_object", False, "Publish the motion of the nearest object on ~/object")

    # Calibration files

    def _stamps_of_files(self) -> dict[str, int]:
        stamps = {}
        for name in (CAMERA_FILE, PROJECTOR_FILE, HAND_EYE_FILE, PROJECTOR_POSE_FILE):
            path = self._folder / name
            stamps[name] = path.stat().st_mtime_ns if path.exists() else 0
        return stamps

    def _reload_if_changed(self) -> None:
        stamps = self._stamps_of_files()
        if self._extrinsic is None:
            self.get_logger().info(
                f"waiting for {PROJECTOR_FILE}, {HAND_EYE_FILE} and {PROJECTOR_POSE_FILE} in {self._folder}",
                throttle_duration_sec=5.0,
            )
        if stamps == self._loaded:
            return
        self._loaded = stamps
        if not any(stamps[name] for name in (PROJECTOR_FILE, HAND_EYE_FILE, PROJECTOR_POSE_FILE)):
            self._diagnostics.level(WARN, f"no calibration in {self._folder} yet")
            return
        try:
            self._load()
        except StructuredLightError as error:
            kept = "; keeping the last one" if self._extrinsic is not None else ""
            self.get_logger().error(f"calibration not usable: {error}{kept}")
            self._diagnostics.level(ERROR, f"calibration not usable: {error}")

    def _load(self) -> None:
        camera = load_camera(self._folder / CAMERA_FILE) if (self._folder / CAMERA_FILE).exists() else None
        projector = load_camera(self._folder / PROJECTOR_FILE)
        pattern_id = str(read_yaml(self._folder / PROJECTOR_FILE).get("pattern_id", ""))
        hand_eye, pose = load_hand_eye(self._folder), load_projector_pose(self._folder)
        self._camera_file, self._projector = camera, projector
        self._calibrated_pattern = pattern_id
        self._extrinsic = (hand_eye.transform, pose.transform)
        self._checks.forget()
        self.get_logger().info(
            f"calibration loaded from {self._folder}, made {pose.extra.get('date', 'at an unknown date')}"
        )
        self._diagnostics.level(OK, "calibration loaded")

    def _on_reload(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._loaded = self._stamps_of_files()
        try:
            self._load()
            response.success, response.message = True, f"calibration loaded from {self._folder}"
        except StructuredLightError as error:
            response.success, response.message = False, str(error)
        return response

    # Inputs

    def _on_camera_info(self, message: CameraInfo) -> None:
        try:
            self._camera_topic = camera_info.from_message(message)
        except StructuredLightError as error:
            self.get_logger().warning(f"camera_info refused: {error}", throttle_duration_sec=5.0)

    def _on_pattern(self, message: Pattern) -> None:
        try:
            self._colours = colours_from_message(message)
            self._shown_pattern = message.pattern_id
        except StructuredLightError as error:
            self.get_logger().error(f"pattern refused: {error}")

    def _on_correspondences(self, message: Correspondences) -> None:
        self._watch.seen("correspondences")
        self._diagnostics.tick("correspondences")
        self._pairing.add(to_ns(message.header.stamp), message)

    def _camera(self) -> CameraModel:
        """The camera of the calibration folder, with its own lens model; else the one of camera_info."""
        if self._camera_file is None and self._camera_topic is None:
            raise InvalidInputError(
                f"no camera model: neither {self._folder / CAMERA_FILE} nor camera/camera_info is there"
            )
        camera = self._camera_file or self._camera_topic
        assert camera is not None
        seen = self._camera_topic
        if seen is not None and (seen.width, seen.height) != (camera.width, camera.height):
            raise InvalidInputError(
                f"images are {seen.width}x{seen.height} px but {CAMERA_FILE} says {camera.width}x{camera.height}:"
                " calibrate at the resolution in use"
            )
        return camera

    def _check_pattern(self, pattern_id: str) -> None:
        if self._shown_pattern and pattern_id != self._shown_pattern:
            raise InvalidInputError(f"correspondences of pattern '{pattern_id}', but '{self._shown_pattern}' is shown")
        if self._calibrated_pattern and pattern_id != self._calibrated_pattern and not self._any_pattern:
            raise InvalidInputError(
                f"correspondences of pattern '{pattern_id}', but the projector was calibrated with"
                f" '{self._calibrated_pattern}': recalibrate or set accept_any_pattern"
            )

    # Output

    def _refuse(self, reason: str) -> None:
        self._diagnostics.tick("refused")
        self._diagnostics.level(WARN, reason)
        self.get_logger().warning(f"no points: {reason}", throttle_duration_sec=5.0)

    def _deliver(self, message: Correspondences, base_from_flange: NDArray[np.float64]) -> None:
        start = time.perf_counter()
        try:
            self._publish(message, base_from_flange)
        except StructuredLightError as error:
            self._refuse(str(error))
        self._diagnostics.set("time per cloud [s]", time.perf_counter() - start)

    def _publish(self, message: Correspondences, base_from_flange: NDArray[np.float64]) -> None:
        if self._extrinsic is None or self._projector is None:
            raise InvalidInputError(f"no calibration in {self._folder} yet: run the calibrator or self_calibrate")
        self._check_pattern(message.pattern_id)
        camera, dots = self._camera(), dots_from_message(message)
        flange_from_camera, base_from_projector = self._extrinsic
        extrinsics = camera_from_projector(base_from_flange, flange_from_camera, base_from_projector)
        result = triangulate(camera, self._projector, extrinsics, dots.camera, dots.projector, self._options)
        base_from_camera = base_from_flange @ flange_from_camera
        result, confidence = self._checks.apply(message.header, result, dots, camera, base_from_camera)
        use = result.valid & (dots.confidence >= self._min_confidence)
        points, frame = result.points[use], message.header.frame_id
        row, col = dots.row[use], dots.col[use]
        if self._tracking is not None:
            in_base = transforms.apply(base_from_camera, points)
            self._tracking.update(message.header.stamp, in_base, row, col, base_from_camera[:3, 3])
        if self._output == "base":
            points, frame = transforms.apply(base_from_camera, points), self._base_frame
        xyz = points.astype(np.float32)
        cloud = clouds.to_message(
            Header(stamp=message.header.stamp, frame_id=frame),
            x=xyz[:, 0],
            y=xyz[:, 1],
            z=xyz[:, 2],
            rgb=clouds.pack_rgb(self._colour(row, col)),
            confidence=confidence[use].astype(np.float32),
            row=row.astype(np.uint16),
            col=col.astype(np.uint16),
        )
        self._points.publish(cloud)
        self._report(result, len(points))

    def _colour(self, row: NDArray[np.int64], col: NDArray[np.int64]) -> NDArray[np.uint8]:
        colours = self._colours
        if colours is None or len(row) == 0 or row.max() >= colours.shape[0] or col.max() >= colours.shape[1]:
            return np.full((len(row), 3), _GREY, dtype=np.uint8)
        return colours[row, col]

    def _report(self, result: Triangulation, published: int) -> None:
        self._diagnostics.tick("points")
        self._diagnostics.set("points in the last cloud", published)
        counts = result.counts()
        for reason, count in counts.items():
            if reason != "none":
                self._diagnostics.set(f"rejected, {reason}", count)
        total = len(result.rejection)
        if total and np.isfinite(result.epipolar_distance).any():
            self._diagnostics.set("median epipolar distance [px]", float(np.nanmedian(result.epipolar_distance)))
        if total and counts["epipolar"] > total / 2:
            text = (
                f"{counts['epipolar']} of {total} dots are off their epipolar lines: was the projector or camera moved?"
            )
            self._diagnostics.level(WARN, text)
            self.get_logger().warning(text, throttle_duration_sec=5.0)
        else:
            self._diagnostics.level(OK, f"{published} points of {total} dots")


def main() -> int:
    """Run the node."""
    return run_node(Triangulator)

"""Node calibrator: takes samples, keeps them in a session, computes and saves the self-calibration."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.node import Node
from sensor_msgs.msg import CameraInfo
from std_msgs.msg import Header
from std_srvs.srv import Trigger

from sl_calibration.motion_plan import Estimate, coverage, first_estimate, next_pose
from sl_calibration.nodes import calibration_reports
from sl_calibration.nodes import calibrator_parameters as parameters
from sl_calibration.nodes.background import Background
from sl_calibration.nodes.guided_motion import GuidedMotion
from sl_calibration.nodes.messages import centers_from_message
from sl_calibration.nodes.robot import Robot
from sl_calibration.nodes.sampling import Sampler
from sl_calibration.self_calibration.calibrate import SelfCalibrationOptions, self_calibrate
from sl_calibration.self_calibration.files import save
from sl_calibration.self_calibration.result import SelfCalibration
from sl_calibration.self_calibration.views import View
from sl_calibration.sessions import Session, SessionPattern
from sl_common.calibration_files import CAMERA_FILE, load_calibration, load_camera, load_hand_eye
from sl_common.cameras import CameraModel
from sl_common.errors import InvalidInputError, StructuredLightError
from sl_common.ros import camera_info
from sl_common.ros.diagnostics import OK, WARN, Diagnostics
from sl_common.ros.qos import LATCHED, STREAM_SUBSCRIBE
from sl_common.ros.run import run_node
from sl_common.ros.stamps import from_ns
from sl_common.ros.waiting import InputWatch
from sl_msgs.msg import CalibrationProgress, Correspondences, Pattern
from sl_msgs.srv import ComputeCalibration, ListSamples, LoadCalibration, RemoveSample, SaveCalibration, TakeSample


class Calibrator(Node):
    """Services around a session of samples."""

    def __init__(self) -> None:
        super().__init__("calibrator")
        self._settings = p = parameters.read(self)
        self._folder = p.calibration_folder
        self._result: SelfCalibration | None = None
        self._estimate: Estimate | None = None
        self._moving = False
        self._open(p.session_folder)
        self._camera_from_file()

        self._diagnostics = Diagnostics(self)
        self._watch = InputWatch(self)
        self._background = Background(self)
        self._robot = Robot(
            self, self._watch, base_frame=p.base_frame, flange_frame=p.flange_frame, max_gap=p.max_joint_gap
        )
        self._sampler = Sampler(self, self._robot, p.limits, wait=p.joint_wait)
        self._motion = GuidedMotion(
            self,
            base_frame=p.base_frame,
            calibration_folder=self._folder,
            options=p.plan,
            duration=p.motion_duration,
            settle=p.motion_settle,
        )
        self._watch.expect("correspondences", Correspondences, STREAM_SUBSCRIBE)
        self._watch.expect("pattern", Pattern, LATCHED)
        self.create_subscription(Correspondences, "correspondences", self._on_correspondences, STREAM_SUBSCRIBE)
        self.create_subscription(Pattern, "pattern", self._on_pattern, LATCHED)
        self.create_subscription(CameraInfo, "camera/camera_info", self._on_camera_info, STREAM_SUBSCRIBE)
        self._progress = self.create_publisher(CalibrationProgress, "~/progress", LATCHED)
        # Coroutines that wait must not hold back the subscriptions and timers that they wait for.
        group = ReentrantCallbackGroup()
        for kind, name, callback in (
            (TakeSample, "~/take_sample", self._on_take),
            (RemoveSample, "~/remove_sample", self._on_remove),
            (ListSamples, "~/list_samples", self._on_list),
            (ComputeCalibration, "~/compute", self._on_compute),
            (SaveCalibration, "~/save", self._on_save),
            (LoadCalibration, "~/load", self._on_load),
            (Trigger, "~/run_motion", self._on_run_motion),
        ):
            self.create_service(kind, name, callback, callback_group=group)
        self._publish_progress()

    def destroy_node(self) -> None:
        """End the background thread too."""
        self._background.close()
        super().destroy_node()

    # Session and inputs

    def _open(self, folder: Path) -> None:
        self._session = Session(folder, self._settings.procedure)
        self._result = None
        for note in self._session.notes:
            self.get_logger().warning(note)
        self.get_logger().info(f"session in {self._session.folder} with {len(self._session)} samples")

    def _camera_from_file(self) -> None:
        """A camera.yaml of the calibration folder knows the lens better than camera_info."""
        path = self._folder / CAMERA_FILE
        if path.exists():
            self._use_camera(load_camera(path))

    def _use_camera(self, camera: CameraModel) -> None:
        try:
            self._session.set_camera(camera)
        except StructuredLightError as error:
            self.get_logger().warning(str(error), throttle_duration_sec=5.0)

    def _on_camera_info(self, message: CameraInfo) -> None:
        if self._session.camera is None:
            try:
                self._use_camera(camera_info.from_message(message))
            except StructuredLightError as error:
                self.get_logger().warning(f"camera_info refused: {error}", throttle_duration_sec=5.0)

    def _on_pattern(self, message: Pattern) -> None:
        self._watch.seen("pattern")
        known = self._session.pattern
        if known is not None and known.pattern_id == message.pattern_id and len(self._session):
            return
        try:
            size = (message.projector_width, message.projector_height)
            pattern = SessionPattern(message.pattern_id, centers_from_message(message), size, message.spot_diameter)
            self._session.set_pattern(pattern)
        except StructuredLightError as error:
            self.get_logger().error(str(error))

    def _on_correspondences(self, message: Correspondences) -> None:
        self._watch.seen("correspondences")
        self._diagnostics.tick("correspondences")
        self._sampler.add(message)

    # Services

    async def _take(self, timeout: float) -> View:
        """Take a sample and return its view; raises StructuredLightError with the reason."""
        if self._session.pattern is None:
            raise InvalidInputError("no pattern received yet: is pattern_publisher running?")
        sample = await self._sampler.next(timeout, self._session.pattern.pattern_id)
        index = self._session.add(sample)
        self._changed()
        self.get_logger().info(f"sample {index}: {len(sample.view.row)} dots")
        return sample.view

    async def _on_take(self, request: TakeSample.Request, response: TakeSample.Response) -> TakeSample.Response:
        try:
            view = await self._take(request.timeout or 2.0)
            response.success, response.index = True, len(self._session) - 1
            response.message = f"sample {response.index} with {len(view.row)} dots in {self._session.folder}"
        except StructuredLightError as error:
            response.success, response.message = False, str(error)
        response.samples = len(self._session)
        return response

    def _on_remove(self, request: RemoveSample.Request, response: RemoveSample.Response) -> RemoveSample.Response:
        try:
            name = self._session.remove(request.index)
            response.success, response.message = True, f"{name} removed"
            self._changed()
        except StructuredLightError as error:
            response.success, response.message = False, str(error)
        response.samples = len(self._session)
        return response

    def _on_list(self, _request: ListSamples.Request, response: ListSamples.Response) -> ListSamples.Response:
        views = self._session.views
        rms = calibration_reports.residuals(self._result)
        response.session = str(self._session.folder)
        response.index = list(range(len(views)))
        response.stamp = [from_ns(view.stamp) for view in views]
        response.points = [len(view.row) for view in views]
        response.residual = [rms.get(view.name, float("nan")) for view in views]
        return response

    async def _on_compute(
        self, _request: ComputeCalibration.Request, response: ComputeCalibration.Response
    ) -> ComputeCalibration.Response:
        response.rms = response.rms_left_out = response.worst_rms = float("nan")
        response.worst_sample, response.suggested = -1, calibration_reports.suggestion(self._next_pose())
        try:
            if self._background.busy:
                raise InvalidInputError("a computation is running")
            self._result = await self._background.run(self._computation())
            calibration_reports.fill(response, self._result, self._session)
            self._diagnostics.level(OK, response.message)
        except StructuredLightError as error:
            self._result = None
            response.success, response.message = False, str(error)
            self._diagnostics.level(WARN, str(error))
        self.get_logger().info(f"compute: {response.message}")
        self._publish_progress()
        return response

    def _on_save(
        self, request: SaveCalibration.Request, response: SaveCalibration.Response
    ) -> SaveCalibration.Response:
        try:
            pattern = self._session.pattern
            if self._result is None or pattern is None:
                raise InvalidInputError("nothing computed from these samples: call ~/compute first")
            folder = request.folder or self._folder
            files = save(self._result, folder, pattern_id=pattern.pattern_id)
            response.success, response.files = True, [str(path) for path in files]
            response.message = f"wrote {len(files)} files to {files[0].parent}"
            self.get_logger().info(response.message)
        except StructuredLightError as error:
            response.success, response.message = False, str(error)
        return response

    def _on_load(
        self, request: LoadCalibration.Request, response: LoadCalibration.Response
    ) -> LoadCalibration.Response:
        folder = Path(request.folder).expanduser() if request.folder else self._folder
        try:
            if Session.is_session(folder):
                self._open(folder)
                self._changed()
                response.message = f"session resumed from {self._session.folder}"
            else:
                load_calibration(folder)
                extra = load_hand_eye(folder).extra
                response.message = (
                    f"calibration of {extra.get('date', 'unknown date')} from {extra.get('samples', '?')} samples,"
                    f" residuals {extra.get('residuals', 'unknown')}"
                )
            response.success = True
        except StructuredLightError as error:
            response.success, response.message = False, str(error)
        response.samples = len(self._session)
        return response

    async def _on_run_motion(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        if self._moving:
            response.success, response.message = False, "a motion is running"
            return response
        self._moving = True
        try:
            response.message = await self._motion.run(
                lambda: self._take(self._settings.sample_timeout),
                lambda: self._estimate,
                lambda: self._settings.limits.least_dots,
            )
            response.success = True
        except StructuredLightError as error:
            response.success, response.message = False, str(error)
        self._moving = False
        self.get_logger().info(f"run_motion: {response.message}")
        return response

    # Results

    def _computation(self) -> Callable[[], SelfCalibration]:
        """Return the computation on the samples as they are now; raises InvalidInputError for what is missing."""
        camera, pattern, views = self._session.camera, self._session.pattern, self._session.views
        if camera is None:
            raise InvalidInputError(f"no camera model: neither {self._folder / CAMERA_FILE} nor camera/camera_info")
        if pattern is None:
            raise InvalidInputError("no pattern received yet: is pattern_publisher running?")
        options = SelfCalibrationOptions(
            robot=self._settings.robot_noise,
            refine_camera=self._settings.refine_camera,
            left_out=self._settings.left_out_errors,
            spot_diameter=pattern.spot_diameter,
        )
        return lambda: self_calibrate(views, camera, pattern.centers, pattern.size, options)

    def _next_pose(self) -> NDArray[np.float64] | None:
        poses = [view.base_from_flange for view in self._session.views]
        return next_pose(poses, self._estimate, self._settings.plan)

    def _changed(self) -> None:
        """The samples changed: forget the result, estimate again, publish."""
        self._result, self._estimate = None, None
        session = self._session
        if session.camera is not None and session.pattern is not None:
            self._estimate = first_estimate(session.views[-8:], session.camera, session.pattern.centers)
        self._publish_progress()

    def _publish_progress(self) -> None:
        session = self._session
        header = Header(stamp=self.get_clock().now().to_msg(), frame_id=self._settings.base_frame)
        covered = coverage(session.views, session.camera, self._estimate)
        suggested = calibration_reports.suggestion(self._next_pose())
        self._progress.publish(calibration_reports.progress(header, session, covered, self._result, suggested))
        self._diagnostics.set("samples", len(session))


def main() -> int:
    """Run the node."""
    return run_node(Calibrator)

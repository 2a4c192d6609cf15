"""Node calibrator: takes samples of a calibration procedure, keeps them in a session, computes and saves."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.node import Node
from sensor_msgs.msg import CameraInfo
from std_msgs.msg import Header
from std_srvs.srv import Trigger

from sl_calibration.motion_plan import Estimate, next_pose
from sl_calibration.nodes import calibration_reports
from sl_calibration.nodes import calibrator_parameters as parameters
from sl_calibration.nodes.background import Background, end_process
from sl_calibration.nodes.guided_motion import GuidedMotion
from sl_calibration.nodes.messages import session_pattern
from sl_calibration.nodes.robot import Robot
from sl_calibration.nodes.sampling import Sampler, Shots
from sl_calibration.procedures.procedure import Outcome, Setup, flange_poses
from sl_calibration.sessions import Sample, Session
from sl_common.calibration_files import CAMERA_FILE, load_camera
from sl_common.cameras import CameraModel
from sl_common.errors import InvalidInputError, StructuredLightError
from sl_common.ros import camera_info
from sl_common.ros.diagnostics import OK, WARN, Diagnostics
from sl_common.ros.qos import LATCHED, STREAM_SUBSCRIBE
from sl_common.ros.run import run_node
from sl_common.ros.waiting import InputWatch
from sl_msgs.msg import CalibrationProgress, Pattern
from sl_msgs.srv import ComputeCalibration, ListSamples, LoadCalibration, RemoveSample, SaveCalibration, TakeSample


class Calibrator(Node):
    """Services around a session of samples; what a sample is and what comes out of them is the procedure's."""

    def __init__(self) -> None:
        super().__init__("calibrator")
        self._settings = p = parameters.read(self)
        self._procedure = p.procedure
        self._folder = p.calibration_folder
        self._outcome: Outcome | None = None
        self._estimate: Estimate | None = None
        self._moving = False
        self._open(p.session_folder)
        self._camera_from_file()

        self._diagnostics = Diagnostics(self)
        self._watch = InputWatch(self)
        self._background = Background(self)
        self._robot: Robot | None = None
        if p.procedure.robot:
            self._robot = Robot(
                self, self._watch, base_frame=p.base_frame, flange_frame=p.flange_frame, max_gap=p.max_joint_gap
            )
        shots = Shots(
            self,
            self._watch,
            p.procedure.source,
            self._robot,
            max_joint_speed=p.max_joint_speed,
            wait=p.joint_wait,
            seen=self._diagnostics.tick,
        )
        self._sampler = Sampler(self, p.procedure, shots, self._background, projection_settle=p.projection_settle)
        self._motion = GuidedMotion(
            self,
            base_frame=p.base_frame,
            calibration_folder=self._folder,
            options=p.plan,
            duration=p.motion_duration,
            settle=p.motion_settle,
            points=p.procedure.points,
            least_points=p.least_points,
        )
        if p.procedure.uses_pattern:
            self._watch.expect("pattern", Pattern, LATCHED)
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
        self._changed()

    def destroy_node(self) -> None:
        """End the background thread too."""
        self._background.close()
        super().destroy_node()

    # Session and inputs

    def _open(self, folder: Path) -> None:
        self._session = Session(folder, self._procedure.name)
        self._outcome = None
        for note in self._session.notes:
            self.get_logger().warning(note)
        self.get_logger().info(f"session in {self._session.folder} with {len(self._session)} samples")

    def _setup(self) -> Setup:
        return Setup(self._session.camera, self._session.pattern, self._folder)

    def _camera_from_file(self) -> None:
        """A camera.yaml of the calibration folder knows the lens better than camera_info."""
        path = self._folder / CAMERA_FILE
        if self._procedure.uses_camera and path.exists():
            self._use_camera(load_camera(path))

    def _use_camera(self, camera: CameraModel) -> None:
        try:
            self._session.set_camera(camera)
        except StructuredLightError as error:
            self.get_logger().warning(str(error), throttle_duration_sec=5.0)

    def _on_camera_info(self, message: CameraInfo) -> None:
        if self._procedure.uses_camera and self._session.camera is None:
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
            self._session.set_pattern(session_pattern(message))
        except StructuredLightError as error:
            self.get_logger().error(str(error))

    # Services

    async def _take(self, timeout: float) -> Sample:
        """Take a sample and keep it; raises StructuredLightError with the reason."""
        sample = await self._sampler.take(timeout, self._setup())
        index = self._session.add(sample)
        self._changed()
        self.get_logger().info(f"sample {index}: {self._procedure.points(sample)} points")
        return sample

    async def _on_take(self, request: TakeSample.Request, response: TakeSample.Response) -> TakeSample.Response:
        try:
            sample = await self._take(request.timeout or 2.0)
            response.success, response.index = True, len(self._session) - 1
            points = self._procedure.points(sample)
            response.message = f"sample {response.index} with {points} points in {self._session.folder}"
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
        return calibration_reports.list_samples(response, self._session, self._procedure, self._outcome)

    async def _on_compute(
        self, _request: ComputeCalibration.Request, response: ComputeCalibration.Response
    ) -> ComputeCalibration.Response:
        response.rms = response.rms_left_out = response.worst_rms = float("nan")
        response.worst_sample, response.suggested = -1, calibration_reports.suggestion(self._next_pose())
        try:
            if self._background.busy:
                raise InvalidInputError("a computation is running")
            samples, setup = self._session.samples, self._setup()
            self._outcome = await self._background.run(lambda: self._procedure.compute(samples, setup))
            calibration_reports.fill(response, self._outcome, self._session)
            self._diagnostics.level(OK, response.message)
        except StructuredLightError as error:
            self._outcome = None
            response.success, response.message = False, str(error)
            self._diagnostics.level(WARN, str(error))
        self.get_logger().info(f"compute: {response.message}")
        self._publish_progress()
        return response

    def _on_save(
        self, request: SaveCalibration.Request, response: SaveCalibration.Response
    ) -> SaveCalibration.Response:
        try:
            if self._outcome is None:
                raise InvalidInputError("nothing computed from these samples: call ~/compute first")
            folder = Path(request.folder).expanduser() if request.folder else self._folder
            files = self._procedure.save(self._outcome, folder, self._setup())
            response.success, response.files = True, [str(path) for path in files]
            response.message = f"wrote {', '.join(path.name for path in files)} to {files[0].parent}"
            self.get_logger().info(response.message)
        except (StructuredLightError, OSError) as error:
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
                response.message = calibration_reports.describe_files(folder, self._procedure.writes)
            response.success = True
        except StructuredLightError as error:
            response.success, response.message = False, str(error)
        response.samples = len(self._session)
        return response

    async def _on_run_motion(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        if self._moving or not self._procedure.robot:
            response.success = False
            response.message = (
                "a motion is running" if self._moving else f"procedure {self._procedure.name} moves no robot"
            )
            return response
        self._moving = True
        try:
            response.message = await self._motion.run(
                lambda: self._take(self._settings.sample_timeout), lambda: self._estimate
            )
            response.success = True
        except StructuredLightError as error:
            response.success, response.message = False, str(error)
        self._moving = False
        self.get_logger().info(f"run_motion: {response.message}")
        return response

    # Progress

    def _next_pose(self) -> NDArray[np.float64] | None:
        return next_pose(flange_poses(self._session.samples), self._estimate, self._settings.plan)

    def _changed(self) -> None:
        """The samples changed: forget the result, estimate again, publish."""
        self._outcome = None
        self._estimate = self._procedure.estimate(self._session.samples, self._setup())
        self._publish_progress()

    def _publish_progress(self) -> None:
        session, procedure = self._session, self._procedure
        header = Header(stamp=self.get_clock().now().to_msg(), frame_id=self._settings.base_frame)
        covered = procedure.coverage(session.samples, self._setup(), self._estimate)
        suggested = calibration_reports.suggestion(self._next_pose())
        self._progress.publish(
            calibration_reports.progress(header, session, procedure, covered, self._outcome, suggested)
        )
        self._diagnostics.set("samples", len(session))


def main() -> int:
    """Run the node until SIGINT or SIGTERM."""
    return end_process(run_node(Calibrator))

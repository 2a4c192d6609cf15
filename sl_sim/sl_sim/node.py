"""Node `cell`: a simulated arm, camera, projector and object behind the topics of a real cell."""

import json
import sys

import numpy as np
from geometry_msgs.msg import Pose, PoseStamped
from rclpy.node import Node
from rclpy.qos import QoSProfile
from sensor_msgs.msg import CameraInfo, Image, JointState
from std_msgs.msg import Float64MultiArray, Header, String
from std_srvs.srv import SetBool, Trigger
from trajectory_msgs.msg import JointTrajectory

from sl_common import transforms
from sl_common.errors import StructuredLightError
from sl_common.ros import camera_info, diagnostics, images, qos, stamps
from sl_common.ros.run import run_node
from sl_common.ros.waiting import InputWatch
from sl_sim import arm, scenes
from sl_sim.camera_worker import CameraWorker
from sl_sim.cell import Cell
from sl_sim.clockwork import Clockwork
from sl_sim.driver import ArmDriver
from sl_sim.errors import CellError
from sl_sim.exposures import Exposure, Taken
from sl_sim.ros.commanding import trajectory_setpoints
from sl_sim.ros.parameters import declare_all

CAMERA_FRAME = "camera_optical_frame"
SETPOINTS = QoSProfile(depth=200)
_NS = 1_000_000_000


class CellNode(Node):
    """See the module; the simulation itself is in cell, driver, clockwork and camera_worker."""

    def __init__(self) -> None:
        super().__init__("cell")
        names = list(arm.kinematics().joint_names)
        self._p = p = declare_all(self, names)
        if sorted(p.joints) != sorted(names):
            raise CellError(f"parameter joints must name {', '.join(names)} in any order, got {', '.join(p.joints)}")
        self._order = [p.joints.index(name) for name in names]
        self._worker = CameraWorker(p.settings, p.effects, self_shadow=p.self_shadow)
        self._cell = cell = Cell(p.settings)
        self._driver = ArmDriver(cell.limits, cell.start_positions, **p.driver_options)
        self._encoder = np.random.default_rng([p.settings.seed, 3])
        self._projected: np.ndarray | None = None
        self._moves_since: int | None = None
        self._images = self._skipped = 0

        self._image_pub = self.create_publisher(Image, "camera/image_raw", qos.STREAM_PUBLISH)
        self._info_pub = self.create_publisher(CameraInfo, "camera/camera_info", qos.STREAM_PUBLISH)
        self._joint_pub = self.create_publisher(JointState, "joint_states", QoSProfile(depth=50))
        self._description_pub = self.create_publisher(String, "robot_description", qos.LATCHED)
        self._truth_pub = self.create_publisher(String, "~/truth", qos.LATCHED)
        self._camera_pose_pub = self.create_publisher(PoseStamped, "~/truth/camera_pose", QoSProfile(depth=10))
        self._object_pose_pub = self.create_publisher(PoseStamped, "~/truth/object_pose", QoSProfile(depth=10))
        self.create_subscription(Image, "projector/image", self._on_projector, qos.LATCHED)
        self.create_subscription(Float64MultiArray, "commands", self._on_commands, SETPOINTS)
        self.create_subscription(JointTrajectory, "joint_trajectory", self._on_trajectory, SETPOINTS)
        self.create_service(Trigger, "~/reset", self._on_reset)
        self.create_service(SetBool, "~/move_object", self._on_move_object)
        self._watch = InputWatch(self)
        self._watch.expect("projector/image", Image, qos.LATCHED)
        self._diagnostics = diagnostics.Diagnostics(self, "simulated cell")

        self._description_pub.publish(String(data=arm.urdf()))
        self._start(self._now())
        if p.object_moves:
            self._moves_since = self._clockwork.now
        self.create_timer(1.0 / p.control_rate, self._on_period)
        self.create_timer(1.0, self._report)
        self._report()
        self.get_logger().info(
            f"scene '{p.settings.scene}' (seed {p.settings.seed}): {scenes.describe(p.settings.scene)}; "
            f"setpoints at {p.control_rate:g} Hz on commands or joint_trajectory; "
            "the projector is dark until projector/image arrives"
        )

    def _now(self) -> int:
        return self.get_clock().now().nanoseconds

    def _start(self, now: int) -> None:
        self._clockwork = Clockwork(self._driver, now)
        self._next_state = self._next_image = now
        self._shutter: int | None = None

    def _on_projector(self, message: Image) -> None:
        try:
            image = images.to_bgr(message)
            expected = (self._cell.projector.height, self._cell.projector.width, 3)
            if image.shape != expected:
                raise CellError(
                    f"projector/image is {image.shape[1]}x{image.shape[0]}, "
                    f"the projector has {expected[1]}x{expected[0]}"
                )
        except StructuredLightError as error:
            self.get_logger().warning(f"projector/image ignored: {error}", throttle_duration_sec=2.0)
            return
        self._watch.seen("projector/image")
        self._projected = image

    def _on_commands(self, message: Float64MultiArray) -> None:
        values = np.asarray(message.data, float)
        self._receive([values[self._order] if values.size == len(self._order) else values])

    def _on_trajectory(self, message: JointTrajectory) -> None:
        try:
            self._receive(trajectory_setpoints(message, self._cell.limits.names, self._driver.period))
        except StructuredLightError as error:
            self._driver.refuse()
            self.get_logger().warning(f"joint_trajectory refused: {error}", throttle_duration_sec=2.0)

    def _receive(self, setpoints: list[np.ndarray]) -> None:
        for setpoint in setpoints:
            try:
                outside = self._driver.receive(setpoint)
            except StructuredLightError as error:
                self.get_logger().warning(f"setpoint refused: {error}", throttle_duration_sec=2.0)
                continue
            self._diagnostics.tick("setpoints")
            if outside:
                self.get_logger().warning(
                    f"setpoint outside the limits in {', '.join(outside)}", throttle_duration_sec=2.0
                )

    def _on_reset(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._driver.reset(self._cell.start_positions)
        self._start(self._now())
        self._moves_since = self._clockwork.now if self._p.object_moves else None
        response.success, response.message = True, "the arm rests at the start pose, all counts are zero"
        return response

    def _on_move_object(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        response.success = self._p.settings.moves
        response.message = "the object moves" if request.data else "the object is back where it started"
        if not response.success:
            response.message = "the object cannot move: set object_sway or object_swing"
        else:
            self._moves_since = self._clockwork.now if request.data else None
        return response

    def _on_period(self) -> None:
        for stamp, positions in self._clockwork.advance(self._now()):
            if stamp >= self._next_state:
                self._next_state += round(_NS / self._p.joint_state_rate)
                self._publish_joints(stamp, positions)
            if stamp >= self._next_image and not self._worker.busy and self._shutter is None:
                period = round(_NS / self._p.camera_rate)
                missed = (stamp - self._next_image) // period
                self._skipped += missed if self._images else 0  # not while the scene is being built
                self._next_image += (missed + 1) * period
                self._shutter = stamp
        taken = self._worker.poll()
        if taken is not None:
            self._publish_image(taken)
        half = round(0.5 * self._p.exposure_time * _NS)
        if self._shutter is not None and not self._worker.busy and self._clockwork.now >= self._shutter + half:
            self._expose(self._shutter, half)

    def _expose(self, stamp: int, half: int) -> None:
        self._shutter = None
        times = np.clip(stamp + np.linspace(-half, half, 7).astype(int), self._clockwork.oldest, None)
        self._worker.submit(Exposure(stamp, self._clockwork.at(times), self._object_at(stamp), self._projected))
        self._projected = None  # the worker keeps it

    def _object_at(self, stamp: int) -> np.ndarray:
        since = self._moves_since
        return self._cell.base_from_object_at((stamp - since) / _NS if since is not None else 0.0)

    def _publish_joints(self, stamp: int, positions: np.ndarray) -> None:
        p, servo = self._p, self._driver.servo
        measured = positions + p.encoder_noise * self._encoder.standard_normal(len(positions))
        if p.encoder_step > 0:
            measured = np.round(measured / p.encoder_step) * p.encoder_step
        message = JointState(
            name=list(self._cell.limits.names), position=measured.tolist(), velocity=servo.velocities.tolist()
        )
        message.header = Header(stamp=stamps.from_ns(stamp))
        self._joint_pub.publish(message)
        self._diagnostics.tick("joint states")

    def _publish_image(self, taken: Taken) -> None:
        header = Header(stamp=stamps.from_ns(taken.stamp), frame_id=CAMERA_FRAME)
        self._image_pub.publish(images.to_message(taken.image, header))
        self._info_pub.publish(camera_info.to_message(self._cell.camera, header))
        base = Header(stamp=header.stamp, frame_id=arm.BASE_FRAME)
        self._camera_pose_pub.publish(_stamped(taken.base_from_camera, base))
        self._object_pose_pub.publish(_stamped(taken.base_from_object, base))
        self._images += 1
        self._diagnostics.tick("images")

    def report(self) -> dict[str, object]:
        """Counts of the driver and of the camera."""
        return {**self._driver.report(), "images": self._images, "images_skipped": self._skipped}

    def _report(self) -> None:
        report = self.report()
        truth = {**self._cell.truth(), "control_period": self._driver.period, "report": report}
        self._truth_pub.publish(String(data=json.dumps(truth)))
        total = report["violations_total"]
        self._diagnostics.level(
            diagnostics.WARN if total else diagnostics.OK,
            f"{total} setpoints outside the limits" if total else "running",
        )
        for key in (
            "setpoints",
            "violations_total",
            "streams",
            "first_setpoint_jumps",
            "gaps",
            "stopped_while_moving",
            "refused",
        ):
            self._diagnostics.set(key, report[key])

    def destroy_node(self) -> None:
        """Log the counts, end the rendering process."""
        r = self.report()
        self.get_logger().info(
            f"{r['setpoints']} setpoints in {r['streams']} streams; violations {r['violations']}; first-setpoint jumps "
            f"{r['first_setpoint_jumps']}, gaps {r['gaps']}, stopped while moving {r['stopped_while_moving']}, "
            f"refused {r['refused']}; {r['images']} images"
        )
        self._worker.close()
        super().destroy_node()


def _stamped(transform: np.ndarray, header: Header) -> PoseStamped:
    position, quaternion = transforms.to_quaternion(transform)
    pose = Pose()
    pose.position.x, pose.position.y, pose.position.z = (float(x) for x in position)
    o = pose.orientation
    o.x, o.y, o.z, o.w = (float(x) for x in quaternion)
    return PoseStamped(header=header, pose=pose)


def main() -> int:
    """Entry point of `ros2 run sl_sim cell`."""
    return run_node(CellNode)


if __name__ == "__main__":
    sys.exit(main())

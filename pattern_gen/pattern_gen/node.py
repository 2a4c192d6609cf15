"""The node pattern_publisher: shows the pattern, or a calibration frame, and publishes what is shown."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from rclpy.node import Node
from sensor_msgs.msg import CameraInfo, Image
from std_msgs.msg import Header

from pattern_gen.catalogue import default_pattern
from pattern_gen.colours_file import with_calibrated_colours
from pattern_gen.errors import PatternError, ProjectionError
from pattern_gen.gray_code import Arrangement, Axis
from pattern_gen.pattern import Pattern
from pattern_gen.projection import FrameRequest, Mode, SpotLimits, adapted_diameter, render_frame
from pattern_gen.ros_conversions import pattern_to_message
from sl_common.calibration_files import PROJECTOR_FILE, load_camera
from sl_common.cameras import CameraModel
from sl_common.errors import StructuredLightError
from sl_common.ros import camera_info, images, qos
from sl_common.ros.diagnostics import OK, Diagnostics
from sl_common.ros.parameters import declare
from sl_common.ros.run import run_node
from sl_common.ros.stamps import to_ns
from sl_msgs.msg import Pattern as PatternMessage
from sl_msgs.srv import SetProjection

NOMINAL_THROW = 1.5  # distance over image width of an ordinary projector: its focal length over the width in px


def nominal_projector(width: int, height: int) -> CameraModel:
    """Intrinsics of an ordinary projector, for display only, until one is calibrated."""
    focal = NOMINAL_THROW * width
    matrix = np.array([[focal, 0.0, (width - 1) / 2.0], [0.0, focal, (height - 1) / 2.0], [0.0, 0.0, 1.0]])
    return CameraModel(width, height, matrix)


class PatternPublisher(Node):
    """Publishes projector/image, projector/camera_info and pattern, latched; ~/set_projection changes the frame."""

    def __init__(self) -> None:
        super().__init__("pattern_publisher")
        self._declare_parameters()
        self._pattern = self._load_pattern()
        self._projector = self._load_projector()
        self._image = self.create_publisher(Image, "projector/image", qos.LATCHED)
        self._info = self.create_publisher(CameraInfo, "projector/camera_info", qos.LATCHED)
        self._message = self.create_publisher(PatternMessage, "pattern", qos.LATCHED)
        self._service = self.create_service(SetProjection, "~/set_projection", self._set_projection)
        self._diagnostics = Diagnostics(self)
        self._resized_at: int | None = None
        self._frame = FrameRequest(mode=Mode.PATTERN)
        self._show(self._pattern, self._frame)
        self._publish_pattern()
        pattern = self._pattern
        self.get_logger().info(
            f"showing pattern {pattern.pattern_id}: {pattern.rows}x{pattern.cols} {pattern.grid.value}, "
            f"{pattern.alphabet} letters, distance {pattern.min_hamming}, "
            f"{pattern.projector_width}x{pattern.projector_height} px"
        )

    def _declare_parameters(self) -> None:
        self._pattern_file = declare(self, "pattern_file", "", "pattern file (YAML); empty: the shipped 44x58 pattern")
        self._colours_file = declare(
            self,
            "colours_file",
            "",
            "colours.yaml of a colour calibration: drive values of the letters; empty: the pattern's",
        )
        self._calibration_folder = declare(
            self,
            "calibration_folder",
            "",
            f"folder whose {PROJECTOR_FILE} gives projector/camera_info; empty: see projector_info",
        )
        self._projector_info = declare(
            self,
            "projector_info",
            "",
            "camera_info file of the projector; empty: a nominal projector of the pattern's size",
        )
        self._frame_id = declare(self, "frame_id", "projector_optical_frame", "frame of the messages' headers")
        self._arrangement = Arrangement(
            declare(self, "gray_code_arrangement", "reflected", "neighbouring code words differ in one bit, or in most",
                    choices=[arrangement.value for arrangement in Arrangement])
        )  # fmt: skip
        self._resize_period = declare(
            self, "spot_resize_period", 0.5, "least time between two changes of the spot size", unit="s", minimum=0.0
        )
        self._limits = SpotLimits(
            smallest=declare(self, "spot_diameter_min", 2.0, "smallest spots", unit="projector px", minimum=0.5),
            largest_fraction=declare(
                self,
                "spot_fraction_max",
                0.75,
                "largest spot diameter over the spots' distance",
                minimum=0.05,
                maximum=1.0,
            ),
            tolerance=declare(
                self,
                "spot_tolerance",
                0.03,
                "relative change of the spot size below which nothing is done",
                minimum=0.0,
                maximum=1.0,
            ),
        )

    def _load_pattern(self) -> Pattern:
        pattern = Pattern.load(self._pattern_file) if self._pattern_file else default_pattern()
        return with_calibrated_colours(pattern, self._colours_file) if self._colours_file else pattern

    def _load_projector(self) -> CameraModel:
        width, height = self._pattern.projector_width, self._pattern.projector_height
        path = self._projector_info
        if self._calibration_folder:
            if path:
                raise PatternError("give calibration_folder or projector_info, not both")
            path = str(Path(self._calibration_folder) / PROJECTOR_FILE)
        if not path:
            self.get_logger().info("projector not calibrated: projector/camera_info is nominal; set calibration_folder")
            return nominal_projector(width, height)
        projector = load_camera(path)
        if (projector.width, projector.height) != (width, height):
            raise PatternError(
                f"{path}: projector of {projector.width}x{projector.height}, the pattern is for {width}x{height}: "
                "generate the pattern with --projector of the right size"
            )
        return projector

    def _header(self) -> Header:
        return Header(stamp=self.get_clock().now().to_msg(), frame_id=self._frame_id)

    def _publish_pattern(self) -> None:
        self._message.publish(pattern_to_message(self._pattern, self._header()))

    def _show(self, pattern: Pattern, frame: FrameRequest) -> tuple[Header, int, str]:
        """Render and publish a frame; raises ProjectionError and leaves the old one when there is no such frame."""
        image, frames, text = render_frame(pattern, frame, self._arrangement)
        header = self._header()
        self._image.publish(images.to_message(image, header, "rgb8"))
        self._info.publish(camera_info.to_message(self._projector, header))
        self._pattern, self._frame = pattern, frame
        self._diagnostics.tick("frames")
        self._diagnostics.set("pattern_id", pattern.pattern_id)
        self._diagnostics.set("spot diameter [projector px]", pattern.spot_diameter)
        self._diagnostics.level(OK, f"showing {text}")
        return header, frames, text

    def _set_projection(
        self, request: SetProjection.Request, response: SetProjection.Response
    ) -> SetProjection.Response:
        try:
            frame = self._frame_request(request)
            pattern, resized = self._resized(request) if frame.mode is Mode.PATTERN else (self._pattern, False)
            header, response.frames, response.message = self._show(pattern, frame)
            if resized:
                self._publish_pattern()
                self._resized_at = to_ns(header.stamp)
            response.stamp = header.stamp
            response.success = True
            self.get_logger().debug(f"showing {response.message}")
        except StructuredLightError as error:
            response.success, response.message = False, f"{error}; the frame was not changed"
            self.get_logger().warning(response.message)
        response.spot_diameter = float(self._pattern.spot_diameter)
        return response

    @staticmethod
    def _frame_request(request: SetProjection.Request) -> FrameRequest:
        if request.mode not in list(Mode):
            raise ProjectionError(
                f"unknown mode {request.mode}; known: {', '.join(f'{m.value} {m.name}' for m in Mode)}"
            )
        axes = {SetProjection.Request.COLUMNS: Axis.COLUMNS, SetProjection.Request.ROWS: Axis.ROWS}
        if request.axis not in axes:
            raise ProjectionError(f"unknown axis {request.axis}; known: 0 COLUMNS, 1 ROWS")
        return FrameRequest(
            mode=Mode(request.mode),
            axis=axes[request.axis],
            bit=request.bit,
            inverse=request.inverse,
            channel=request.channel,
            step=request.step,
        )

    def _resized(self, request: SetProjection.Request) -> tuple[Pattern, bool]:
        """The pattern with the spot size asked for, and whether it differs from the present one."""
        pattern = self._pattern
        if request.spot_camera_px == 0.0:
            return pattern, False
        diameter = adapted_diameter(pattern, request.spot_camera_px, request.camera_px_per_projector_px, self._limits)
        if abs(diameter - pattern.spot_diameter) <= self._limits.tolerance * pattern.spot_diameter:
            return pattern, False
        if self._resized_at is not None:
            since = (self.get_clock().now().nanoseconds - self._resized_at) * 1e-9
            if 0.0 <= since < self._resize_period:
                raise ProjectionError(
                    f"the spot size was changed {since:.2f} s ago, at most every {self._resize_period:g} s is allowed: "
                    f"ask again in {self._resize_period - since:.2f} s"
                )
        return pattern.with_spot_diameter(diameter), True


def main() -> int:
    """Entry point."""
    return run_node(PatternPublisher)


if __name__ == "__main__":
    sys.exit(main())

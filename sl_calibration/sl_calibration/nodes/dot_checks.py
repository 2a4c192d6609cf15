"""The triangulator's checks of every image: what is marked goes out on ~/marked, with the reason."""

import numpy as np
from numpy.typing import NDArray
from rclpy.node import Node
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Header

from sl_calibration.geometric_checks import (
    CheckOptions,
    Mark,
    PreviousCloud,
    displacements,
    epipolar_gate,
    jumped_alone,
    keys,
    refuse_off_line,
    remember,
)
from sl_calibration.nodes.messages import Dots
from sl_calibration.triangulation import Triangulation
from sl_common import transforms
from sl_common.cameras import CameraModel
from sl_common.ros import clouds
from sl_common.ros.diagnostics import Diagnostics
from sl_common.ros.qos import STREAM_PUBLISH
from sl_common.ros.stamps import to_ns

JUMPED_CONFIDENCE = 0.5
"""The most that is left to a dot that jumped alone: as often a wrong code as the rim of something that moves."""


class DotChecks:
    """Keeps the previous cloud, marks the dots of each image and publishes those that are marked."""

    def __init__(self, node: Node, diagnostics: Diagnostics, *, max_epipolar_distance: float) -> None:
        self._options = CheckOptions()
        self._largest = max_epipolar_distance
        self._previous = PreviousCloud()
        self._diagnostics = diagnostics
        self._publisher = node.create_publisher(PointCloud2, "~/marked", STREAM_PUBLISH)

    def forget(self) -> None:
        """Forget the previous cloud: the calibration or the pattern is another one."""
        self._previous = PreviousCloud()

    def apply(
        self,
        header: Header,
        result: Triangulation,
        dots: Dots,
        camera: CameraModel,
        base_from_camera: NDArray[np.float64],
    ) -> tuple[Triangulation, NDArray[np.float64]]:
        """Return the triangulation without dots off their lines, and every dot's confidence (N,) after the checks."""
        gate = epipolar_gate(result.epipolar_distance, self._largest, self._options)
        result = refuse_off_line(result, gate)
        key, good = keys(dots.row, dots.col), result.valid
        moved = displacements(self._previous, camera, base_from_camera, key, dots.camera)
        moved[~good] = np.nan
        jumped, distance = jumped_alone(key, moved, self._options)
        in_base = transforms.apply(base_from_camera, result.points[good])
        self._previous = remember(self._previous, key[good], in_base, to_ns(header.stamp), self._options)
        mark = np.where(jumped, Mark.JUMPED, result.rejection).astype(np.uint8)
        self._diagnostics.set("epipolar gate [px]", gate)
        self._diagnostics.set("marked, jumped", int(jumped.sum()))
        self._publish(header, result, dots, mark, np.where(jumped, distance, result.epipolar_distance))
        return result, np.where(jumped, np.minimum(dots.confidence, JUMPED_CONFIDENCE), dots.confidence)

    def _publish(
        self,
        header: Header,
        result: Triangulation,
        dots: Dots,
        mark: NDArray[np.uint8],
        distance: NDArray[np.float64],
    ) -> None:
        some = mark != Mark.NONE
        xyz = result.points[some].astype(np.float32)
        self._publisher.publish(
            clouds.to_message(
                header,
                x=xyz[:, 0],
                y=xyz[:, 1],
                z=xyz[:, 2],
                camera_u=dots.camera[some, 0].astype(np.float32),
                camera_v=dots.camera[some, 1].astype(np.float32),
                row=dots.row[some].astype(np.uint16),
                col=dots.col[some].astype(np.uint16),
                mark=mark[some],
                distance=distance[some].astype(np.float32),
            )
        )

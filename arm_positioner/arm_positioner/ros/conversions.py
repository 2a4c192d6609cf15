"""Messages to and from the core's arrays."""

import numpy as np
from geometry_msgs.msg import Point, Pose, PoseStamped
from numpy.typing import NDArray
from sensor_msgs.msg import PointCloud2
from visualization_msgs.msg import Marker, MarkerArray

from arm_positioner.errors import InvalidGoalError
from arm_positioner.sight import Sighting
from arm_positioner.target import Target
from sl_common import transforms
from sl_common.errors import InvalidInputError
from sl_common.ros import clouds
from sl_common.ros.stamps import from_ns

Array = NDArray[np.float64]

_AXES = ((1.0, 0.2, 0.2), (0.2, 1.0, 0.2), (0.2, 0.4, 1.0))


def pose_to_array(pose: Pose) -> Array:
    """Return the transform (4, 4) of a pose; raises InvalidGoalError where a number is not finite or not a rotation."""
    p, q = pose.position, pose.orientation
    numbers = np.array([p.x, p.y, p.z, q.x, q.y, q.z, q.w])
    if not np.isfinite(numbers).all():
        raise InvalidGoalError(f"pose is not finite: {numbers.tolist()}")
    if abs(float(np.linalg.norm(numbers[3:])) - 1) > 0.05:
        raise InvalidGoalError(f"quaternion has length {np.linalg.norm(numbers[3:]):.3f}, expected 1 (x y z w)")
    try:
        return transforms.from_quaternion(numbers[:3], numbers[3:])
    except InvalidInputError as error:
        raise InvalidGoalError(str(error)) from None


def array_to_pose(transform: Array) -> Pose:
    """Return the pose of a transform (4, 4)."""
    pose = Pose()
    translation, quaternion = transforms.to_quaternion(transform)
    pose.position.x, pose.position.y, pose.position.z = translation.tolist()
    o = pose.orientation
    o.x, o.y, o.z, o.w = quaternion.tolist()
    return pose


def stamped(transform: Array, frame: str, stamp_ns: int) -> PoseStamped:
    """Return a transform (4, 4) as PoseStamped."""
    message = PoseStamped(pose=array_to_pose(transform))
    message.header.frame_id, message.header.stamp = frame, from_ns(stamp_ns)
    return message


def sighting(
    message: PointCloud2, time: float, base_from_camera: Array, projector: Array | None, *, in_camera_frame: bool
) -> Sighting:
    """Return a cloud of either frame as points in the base frame; raises InvalidInputError for a malformed cloud."""
    fields = clouds.from_message(message)
    points = np.stack([fields[k].astype(np.float64) for k in "xyz"], axis=1)
    if in_camera_frame:
        points = transforms.apply(base_from_camera, points)
    extra = {name: fields.get(name) for name in ("confidence", "row", "col")}
    return Sighting(time, points, base_from_camera, **extra, projector=projector)


def markers(
    frame: str, stamp_ns: int, target: Array | None, seen: Target | None, text: str, *, good: bool
) -> MarkerArray:
    """Return what RViz shows: the target's axes, the surface with its normal, the status in words."""

    def marker(kind: int, name: str, index: int, rgb: tuple[float, float, float]) -> Marker:
        m = Marker(type=kind, ns=name, id=index)
        m.header.frame_id, m.header.stamp = frame, from_ns(stamp_ns)
        m.pose.orientation.w = 1.0
        m.color.r, m.color.g, m.color.b, m.color.a = (*rgb, 0.9)
        return m

    array = MarkerArray()
    if target is None:
        array.markers.append(Marker(action=Marker.DELETEALL))
        array.markers[0].header.frame_id = frame
        return array
    origin = target[:3, 3]
    for i, rgb in enumerate(_AXES):
        arrow = marker(Marker.ARROW, "target", i, rgb)
        arrow.points = [_point(origin), _point(origin + 0.08 * target[:3, i])]
        arrow.scale.x, arrow.scale.y = 0.006, 0.012
        array.markers.append(arrow)
    if seen is not None:
        patch = seen.surface
        disc = marker(Marker.CYLINDER, "surface", 0, (0.9, 0.7, 0.1))
        disc.pose = array_to_pose(_standing_on(patch.point, patch.normal))
        disc.scale.x = disc.scale.y = 2 * patch.radius
        disc.scale.z, disc.color.a = 0.001, 0.5
        normal = marker(Marker.ARROW, "surface", 1, (0.9, 0.7, 0.1))
        normal.points = [_point(patch.point), _point(patch.point + 0.1 * patch.normal)]
        normal.scale.x, normal.scale.y = 0.004, 0.008
        array.markers += [disc, normal]
    label = marker(Marker.TEXT_VIEW_FACING, "status", 0, (1.0, 1.0, 1.0) if good else (1.0, 0.3, 0.3))
    label.pose.position = _point(origin + np.array([0.0, 0.0, 0.1]))
    label.scale.z, label.text = 0.025, text
    array.markers.append(label)
    return array


def _point(p: Array) -> Point:
    return Point(x=float(p[0]), y=float(p[1]), z=float(p[2]))


def _standing_on(point: Array, normal: Array) -> Array:
    x = np.cross(normal, np.eye(3)[np.argmin(np.abs(normal))])
    x /= np.linalg.norm(x)
    return transforms.make(np.stack([x, np.cross(normal, x), normal], axis=1), point)

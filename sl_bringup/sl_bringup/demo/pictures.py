"""The pictures of a run."""

from pathlib import Path

import cv2
import matplotlib
import numpy as np
from numpy.typing import NDArray

matplotlib.use("Agg")  # no display is needed

from matplotlib import pyplot as plt
from sensor_msgs.msg import Image

from sl_bringup.demo.acts import Motion
from sl_bringup.demo.record import Cloud, Record, pose_from_message
from sl_common import transforms
from sl_common.files import atomic_path
from sl_common.kinematics import Kinematics
from sl_common.ros import images

Array = NDArray[np.float64]


def save_image(path: Path, message: Image) -> None:
    """Write an image message as PNG."""
    with atomic_path(path) as temporary:
        cv2.imwrite(str(temporary), images.to_bgr(message))


def save_cloud(path: Path, cloud: Cloud, colours: NDArray[np.uint8], base_from_camera: Array) -> None:
    """Draw a cloud in the camera's frame: from its own side, and from above.

    Args:
        path: PNG file.
        cloud: In the base frame, N points.
        colours: (N, 3) uint8 RGB of the spots.
        base_from_camera: (4, 4) camera pose.
    """
    points = 1e3 * transforms.apply(transforms.inverse(base_from_camera), cloud.points)
    shade = np.clip(colours / 255.0, 0.05, 0.95)
    figure = plt.figure(figsize=(12, 5.5), layout="constrained")
    front = figure.add_subplot(1, 2, 1)
    scatter = front.scatter(points[:, 0], points[:, 1], c=points[:, 2], s=6, cmap="viridis_r")
    front.set(xlabel="x right [mm]", ylabel="y down [mm]", aspect="equal", title="seen by the camera, colour: distance")
    front.invert_yaxis()
    figure.colorbar(scatter, ax=front, label="distance z [mm]", shrink=0.8)
    space = figure.add_subplot(1, 2, 2, projection="3d")
    space.scatter(points[:, 0], points[:, 2], -points[:, 1], c=shade, s=5, depthshade=False)
    space.set(xlabel="x [mm]", ylabel="z [mm]", zlabel="-y [mm]", title="in the colours of the spots")
    space.set_box_aspect(np.ptp(points[:, [0, 2, 1]], axis=0) + 1.0)
    space.view_init(elev=18, azim=-65)
    _save(figure, path)


def save_joints(
    path: Path,
    record: Record,
    kinematics: Kinematics,
    *,
    max_velocity: Array,
    max_acceleration: Array,
    period: float,
) -> None:
    """Draw the setpoints' positions, velocities and accelerations as shares of their limits.

    Args:
        path: PNG file.
        record: With the setpoints.
        kinematics: Names and position limits of the joints.
        max_velocity: (n,) of the driver [rad/s].
        max_acceleration: (n,) of the driver [rad/s^2].
        period: Of the setpoints [s].
    """
    streams = _streams(record.commands)
    figure, axes = plt.subplots(3, 1, figsize=(11, 10), sharex=True, layout="constrained")
    start = record.commands[0][0] if record.commands else 0
    middle, half = 0.5 * (kinematics.upper + kinematics.lower), 0.5 * (kinematics.upper - kinematics.lower)
    for times, q in streams:
        # setpoints are one control period apart, whatever their arrival
        t = (times[0] - start) * 1e-9 + period * np.arange(len(q))
        velocity = np.gradient(q, period, axis=0) if len(q) > 2 else np.zeros_like(q)
        acceleration = np.gradient(velocity, period, axis=0) if len(q) > 2 else np.zeros_like(q)
        for j in range(q.shape[1]):
            label = kinematics.joint_names[j] if times is streams[0][0] else None
            axes[0].plot(t, 100 * (q[:, j] - middle[j]) / half[j], color=f"C{j}", label=label)
            axes[1].plot(t, 100 * velocity[:, j] / max_velocity[j], color=f"C{j}")
            axes[2].plot(t, 100 * acceleration[:, j] / max_acceleration[j], color=f"C{j}")
    for axis, name in zip(axes, ("position, from the middle of its range", "velocity", "acceleration"), strict=True):
        for limit in (-100, 100):
            axis.axhline(limit, color="black", linestyle="--", linewidth=1)
        axis.set(ylabel="% of the limit", title=f"joint setpoints: {name}", ylim=(-110, 110))
        axis.grid(alpha=0.3)
    if streams:
        axes[0].legend(ncol=3, fontsize="small")
    axes[-1].set_xlabel("time since the first setpoint [s]")
    _save(figure, path)


def save_distance(
    path: Path, record: Record, kinematics: Kinematics, flange_from_camera: Array, motion: Motion
) -> None:
    """Draw the true distance and angle of the camera from its commanded end pose over time.

    Args:
        path: PNG file.
        record: With the joint states.
        kinematics: From base to flange.
        flange_from_camera: (4, 4) the true one.
        motion: The target and when the motion was ordered.
    """
    target = pose_from_message(motion.result.target)
    seconds, metres, radians = [], [], []
    for stamp, positions in record.joints[:: max(len(record.joints) // 2000, 1)]:
        if stamp < motion.begin - 1_000_000_000:
            continue
        q = kinematics.positions_from(record.joint_names, positions)
        delta = transforms.difference(kinematics.forward(q) @ flange_from_camera, target)
        seconds.append((stamp - motion.begin) * 1e-9)
        metres.append(np.linalg.norm(delta[:3]))
        radians.append(np.linalg.norm(delta[3:]))
    figure, (position, angle) = plt.subplots(2, 1, figsize=(10, 7), sharex=True, layout="constrained")
    position.semilogy(seconds, 1e3 * np.array(metres))
    position.axhline(2.0, color="black", linestyle="--", linewidth=1, label="limit at the end: 2 mm")
    position.set(ylabel="distance to target [mm]", title="true camera against its commanded end pose")
    angle.semilogy(seconds, np.degrees(radians))
    angle.axhline(0.5, color="black", linestyle="--", linewidth=1, label="limit at the end: 0.5 deg")
    angle.set(ylabel="angle to target [deg]", xlabel="time since the order [s]")
    for axis in (position, angle):
        axis.grid(alpha=0.3, which="both")
        axis.legend(loc="upper right")
    _save(figure, path)


def _streams(commands: list[tuple[int, Array]], pause: float = 0.5) -> list[tuple[Array, Array]]:
    """Split setpoints into streams (times [ns], positions (m, n)) where they pause."""
    if not commands:
        return []
    times = np.array([t for t, _ in commands])
    breaks = np.flatnonzero(np.diff(times) > pause * 1e9) + 1
    positions = np.array([q for _, q in commands])
    return list(zip(np.split(times, breaks), np.split(positions, breaks), strict=True))


def _save(figure: plt.Figure, path: Path) -> None:
    with atomic_path(path) as temporary:
        figure.savefig(temporary, dpi=110)
    plt.close(figure)

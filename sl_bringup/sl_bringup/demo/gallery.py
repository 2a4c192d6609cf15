"""Draws all pictures of a run into its output folder."""

from pathlib import Path

import numpy as np

from sl_bringup.demo import pictures
from sl_bringup.demo.acts import Motion
from sl_bringup.ros.observer import DECODER, Observer
from sl_common.ros import clouds
from sl_sim.cell import Cell


def draw(folder: Path, observer: Observer, cell: Cell, motion: Motion | None) -> None:
    """Write pattern.png, camera.png, decoded.png, cloud.png, joints.png and distance.png, those there are data for."""
    record, latest = observer.record, observer.latest
    for topic, name in (
        ("projector/image", "pattern.png"),
        ("camera/image_raw", "camera.png"),
        (f"{DECODER}/debug_image", "decoded.png"),
    ):
        if topic in latest:
            pictures.save_image(folder / name, latest[topic])
    if record.clouds and len(record.clouds[-1].points):
        cloud = record.clouds[-1]
        colours = clouds.unpack_rgb(clouds.from_message(latest["points"])["rgb"])
        pose = record.camera_poses[min(record.camera_poses, key=lambda t: abs(t - cloud.stamp))]
        pictures.save_cloud(folder / "cloud.png", cloud, colours, pose)
    if record.commands:
        pictures.save_joints(
            folder / "joints.png",
            record,
            cell.kinematics,
            max_velocity=np.asarray(cell.limits.velocity),
            max_acceleration=np.asarray(cell.limits.acceleration),
            period=1.0 / 125.0,
        )
    if motion is not None:
        pictures.save_distance(folder / "distance.png", record, cell.kinematics, cell.flange_from_camera, motion)

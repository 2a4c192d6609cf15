"""Synthetic cells for the tests of the self-calibration: a projector, a scene, a camera on a moving flange."""

from dataclasses import dataclass

import numpy as np

from sl_calibration.self_calibration.calibrate import SelfCalibrationOptions, self_calibrate
from sl_calibration.self_calibration.views import View
from sl_common import transforms
from sl_common.cameras import CameraModel

ROWS, COLS, PITCH = 44, 58, 17.0
SIZE = (1024, 768)
LENSES = {"none": (), "pers": (0.9,), "plumb_bob": (-0.28, 0.09, 1e-3, -8e-4, 0.0)}


def centers(rows=ROWS, cols=COLS, step=1):
    """Spot centres (rows, cols, 2); with a step, every so many rows and columns are where a smaller pattern has its."""
    row, col = np.meshgrid(np.arange(rows), np.arange(cols), indexing="ij")
    return np.stack([27.0 + PITCH * step * col, 18.0 + PITCH * step * row], axis=-1)


@dataclass
class Cell:
    camera: CameraModel
    projector: CameraModel
    flange_from_camera: np.ndarray
    base_from_projector: np.ndarray
    centers: np.ndarray
    points: np.ndarray
    base_from_flange: np.ndarray


def make_cell(
    seed=0,
    *,
    views=12,
    lens="none",
    relief=0.12,
    step=2,
    turn=30.0,
    projector_lens=(),
    motion="free",
    axis=(0.0, 0.0, 1.0),
):
    """A random cell: poses, intrinsics, a surface of the given relief [m] (0: a plane), and the motion of the flange.

    motion: free (turns by up to ``turn`` degrees about all axes), translation (none), axis (about one base axis only).
    """
    rng = np.random.default_rng(seed)
    camera = CameraModel(
        640,
        480,
        np.array([[rng.uniform(600, 900), 0, rng.normal(320, 8)], [0, 0, rng.normal(240, 8)], [0, 0, 1]])
        + np.diag([0, rng.uniform(600, 900), 0]),
        lens,
        LENSES[lens],
    )
    f = rng.uniform(1400, 2400)
    cx, fy, cy = rng.normal(511, 15), f * rng.uniform(0.995, 1.005), rng.uniform(380, 900)
    matrix = np.array([[f, 0, cx], [0, fy, cy], [0, 0, 1]])
    projector = CameraModel(*SIZE, matrix, "plumb_bob" if projector_lens else "none", projector_lens)
    base_from_scene = transforms.exp(np.concatenate([rng.uniform(-0.3, 0.3, 3) + [0.6, 0, 0.1], rng.normal(size=3)]))
    scene_from_projector = transforms.look_at(
        [rng.uniform(-0.4, 0.4), rng.uniform(-0.3, 0.3), rng.uniform(-1.7, -1.3)], [0, 0, 0], [0.05, 1, 0]
    )
    hand_eye = transforms.make(
        transforms.rotation_exp(rng.normal(scale=1.0, size=3)), rng.uniform(-0.08, 0.08, 3) + [0, 0, 0.08]
    )
    grid = centers(ROWS // step, COLS // step, step)
    points = hit_surface(projector, scene_from_projector, grid.reshape(-1, 2), relief, rng)
    poses = []
    for i in range(views):
        angles = np.radians(turn) * rng.uniform(-1, 1, 3)
        if motion == "translation":
            angles *= 0
        eye = transforms.rotation_exp(np.array([angles[0], angles[1], 0.0])) @ np.array([0, 0, -rng.uniform(0.6, 1.0)])
        scene_from_camera = transforms.look_at(eye, rng.normal(scale=0.03, size=3), [0.02, -1, 0.01])
        roll = transforms.rotation_exp(np.array([0, 0, angles[2] * (3.0 if motion == "free" else 0.0)]))
        scene_from_camera[:3, :3] = scene_from_camera[:3, :3] @ roll
        base_from_camera = base_from_scene @ scene_from_camera
        if motion == "translation":
            base_from_camera = base_from_scene @ transforms.look_at([0, 0, -0.9], [0, 0, 0], [0, -1, 0])
            base_from_camera[:3, 3] += rng.uniform(-0.1, 0.1, 3)
        if motion == "axis":
            start = base_from_scene @ transforms.look_at([0.1, 0, -0.9], [0, 0, 0], [0, -1, 0])
            centre = base_from_scene[:3, 3]
            spin = transforms.rotation_exp(np.radians(turn) * (2 * i / (views - 1) - 1) * np.array(axis))
            base_from_camera = transforms.make(spin @ start[:3, :3], spin @ (start[:3, 3] - centre) + centre)
            base_from_camera[:3, 3] += rng.uniform(-0.02, 0.02, 3)
        poses.append(base_from_camera @ transforms.inverse(hand_eye))
    return Cell(
        camera,
        projector,
        hand_eye,
        base_from_scene @ scene_from_projector,
        grid,
        transforms.apply(base_from_scene, points),
        np.array(poses),
    )


def hit_surface(projector, scene_from_projector, pixels, relief, rng):
    """Where the projector's rays meet z = relief * waves(x, y), by fixed-point iteration."""
    origin = scene_from_projector[:3, 3]
    rays = projector.rays(pixels) @ scene_from_projector[:3, :3].T
    phase = rng.uniform(0, 2 * np.pi, 4)
    depth = -origin[2] / rays[:, 2]
    for _ in range(30):
        p = origin + depth[:, None] * rays
        waves = np.sin(5 * p[:, 0] + phase[0]) * np.cos(4 * p[:, 1] + phase[1])
        z = relief * (waves + 0.5 * np.sin(9 * p[:, 1] + phase[2]))
        depth = 0.5 * depth + 0.5 * (z - origin[2]) / rays[:, 2]
    return origin + depth[:, None] * rays


ROTATION_SIGMA = np.radians(0.02)


def observe(
    cell, seed=0, *, pixel_sigma=0.1, position_sigma=1e-4, rotation_sigma=ROTATION_SIGMA, wrong=0.0, missing=0.1
):
    """Views of a cell with noise in pixels and reported poses, a share of wrong codes and one of missing dots."""
    rng = np.random.default_rng(seed + 10_000)
    rows, cols = cell.centers.shape[:2]
    row, col = (a.ravel() for a in np.meshgrid(np.arange(rows), np.arange(cols), indexing="ij"))
    views = []
    for i, pose in enumerate(cell.base_from_flange):
        camera_from_base = transforms.inverse(pose @ cell.flange_from_camera)
        pixels = cell.camera.project(transforms.apply(camera_from_base, cell.points))
        seen = np.isfinite(pixels).all(-1) & cell.camera.contains(pixels) & (rng.random(len(pixels)) > missing)
        pixels = np.clip(pixels[seen] + rng.normal(scale=pixel_sigma, size=(seen.sum(), 2)), 0, [639, 479])
        r, c = row[seen].copy(), col[seen].copy()
        bad = rng.random(len(r)) < wrong
        r[bad], c[bad] = rng.integers(0, rows, bad.sum()), rng.integers(0, cols, bad.sum())
        noise = np.concatenate([rng.normal(scale=position_sigma, size=3), rng.normal(scale=rotation_sigma, size=3)])
        views.append(View(f"view{i:02d}", r, c, pixels, transforms.perturb(pose, noise)))
    return views


QUICK = SelfCalibrationOptions(left_out=False, projector_distortion=False)


def calibrate(cell, views, options=QUICK):
    """Self-calibrate views of a cell."""
    return self_calibrate(views, cell.camera, cell.centers, SIZE, options)


def mahalanobis(delta, covariance):
    """Squared distance in standard deviations."""
    return float(delta @ np.linalg.solve(covariance, delta))

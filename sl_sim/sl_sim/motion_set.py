"""A motion for self-calibration: the arm shows one static scene to its camera from many poses."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from pattern_gen import Pattern
from sl_common import transforms
from sl_common.errors import ModelError
from sl_sim import sensor
from sl_sim.arm import ArmBody
from sl_sim.cell import Cell, inverse_kinematics
from sl_sim.dataset import NoViewError, intrinsics, spot_arrays
from sl_sim.effects import Effects
from sl_sim.exposure_integral import exposed_radiance
from sl_sim.projector import light_image
from sl_sim.renderer import Renderer
from sl_sim.spot_truth import SpotTruth, count_visible, spot_truth

LEAST_SPOTS = 300


@dataclass(frozen=True)
class MotionView:
    """One view: true joints (6,) and flange pose, the pose that the robot reports, the image and its truth arrays."""

    positions: np.ndarray
    base_from_flange: np.ndarray
    reported: np.ndarray
    image: np.ndarray
    arrays: dict[str, np.ndarray]


def random_positions(
    cell: Cell, rng: np.random.Generator, *, distance: tuple[float, float], oblique: float
) -> np.ndarray:
    """(6,) joint positions from which the camera looks at the object from a random side, distance [m], roll; within
    reach.

    Raises NoViewError when 200 draws are out of reach.
    """
    for _ in range(200):
        angle, about = np.radians(oblique) * np.sqrt(rng.uniform()), rng.uniform(0, 2 * np.pi)
        direction = np.array([np.sin(angle) * np.cos(about), np.sin(angle) * np.sin(about), np.cos(angle)])
        target = rng.uniform((-0.05, -0.05, -0.02), (0.05, 0.05, 0.05))
        position, target = transforms.apply(
            cell.base_from_object, np.array([target + rng.uniform(*distance) * direction, target])
        )
        view = transforms.look_at(position, target, np.array([0.02, 0.01, 1.0]))
        roll = transforms.rotation_exp(np.array([0.0, 0.0, rng.uniform(-np.pi, np.pi)]))
        pose = view @ transforms.make(roll, np.zeros(3)) @ transforms.inverse(cell.flange_from_camera)
        try:
            return inverse_kinematics(cell.kinematics, pose, cell.start_positions)
        except ModelError:
            continue
    raise NoViewError("no random view of the object is within the arm's reach: reduce the distance or the obliqueness")


def motion_views(
    cell: Cell,
    pattern: Pattern,
    effects: Effects,
    count: int,
    *,
    noise_mm: float = 0.1,
    noise_deg: float = 0.02,
    distance: tuple[float, float] = (0.4, 0.75),
    oblique: float = 40.0,
    seed: int = 0,
) -> Iterator[MotionView]:
    """Yield `count` MotionViews of a cell. noise_mm, noise_deg: standard deviation per axis of the reported flange
    poses.

    Raises NoViewError when the scene shows too few spots from anywhere.
    """
    rng = np.random.default_rng([seed, 11])
    renderer = Renderer(cell.caster, cell.camera, cell.light_source, effects.render_options)
    falloff = sensor.lens_falloff(cell.camera, effects.sensor.vignetting)
    light = light_image(np.ascontiguousarray(pattern.render()[..., ::-1]), effects.projector)
    body = ArmBody(cell.flange_from_camera)
    for _ in range(count):
        positions, truth = _good_view(cell, pattern, rng, distance, oblique)
        base_from_flange = cell.kinematics.forward(positions)
        base_from_camera = base_from_flange @ cell.flange_from_camera
        reach = float(np.linalg.norm(base_from_camera[:3, 3] - cell.base_from_object[:3, 3]))
        radiance = exposed_radiance(renderer, light, base_from_camera, effects, reach, occluders=body.at(positions))
        signal = sensor.filtered(radiance, falloff, effects.sensor)
        exposure = effects.sensor.exposure or sensor.automatic_exposure(signal, effects.sensor)
        noise = np.concatenate(
            [1e-3 * noise_mm * rng.standard_normal(3), np.radians(noise_deg) * rng.standard_normal(3)]
        )
        yield MotionView(
            positions,
            base_from_flange,
            transforms.perturb(base_from_flange, noise),
            sensor.expose(signal, exposure, effects.sensor, rng),
            spot_arrays(pattern, truth, cell.camera, effects, exposure),
        )


def _good_view(
    cell: Cell, pattern: Pattern, rng: np.random.Generator, distance: tuple[float, float], oblique: float
) -> tuple[np.ndarray, SpotTruth]:
    for _ in range(60):
        positions = random_positions(cell, rng, distance=distance, oblique=oblique)
        pose = cell.base_from_camera(positions)
        place = (cell.caster, cell.camera, pose, cell.projector, cell.base_from_projector, np.asarray(pattern.centers))
        enough = min(LEAST_SPOTS, 0.4 * pattern.symbols.size)
        if count_visible(*place) < enough:
            continue
        truth = spot_truth(*place, pattern.spot_diameter)
        good = truth.visible & ~truth.edge
        if good.sum() >= enough:
            return positions, truth
    raise NoViewError(f"scene '{cell.scene.name}' shows fewer than {LEAST_SPOTS} spots from 60 random poses")


def motion_file(
    cell: Cell, views: list[MotionView], names: list[str], noise_mm: float, noise_deg: float
) -> dict[str, Any]:
    """The content of motion.json: what a calibration may use, and under `truth` what it is judged by."""
    pers = cell.camera.distortion_model == "pers"
    return {
        "pixel_convention": "centre of the top-left pixel = (0, 0)",
        "units": "m, px",
        "camera": intrinsics(cell.camera),
        "distortion_model": "r_u = f sinh(r/f), f = pers_f px" if pers else "none",
        "robot_noise": {"mm": noise_mm, "deg": noise_deg},
        "views": [
            {"image": name, "base_from_flange": view.reported.tolist()} for name, view in zip(names, views, strict=True)
        ],
        "truth": {
            "flange_from_camera": cell.flange_from_camera.tolist(),
            "base_from_projector": cell.base_from_projector.tolist(),
            "projector": intrinsics(cell.projector),
            "base_from_flange": [view.base_from_flange.tolist() for view in views],
            "positions": [view.positions.tolist() for view in views],
            "scene": cell.scene.name,
            "seed": cell.settings.seed,
        },
    }

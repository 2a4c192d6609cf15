"""Random single-shot images with exact truth: scenes, views, rolls, distances, lenses, effects."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from pattern_gen import Pattern
from sl_common import transforms
from sl_common.cameras import CameraModel
from sl_common.errors import StructuredLightError
from sl_sim import scenes, sensor
from sl_sim.effects import EFFECTS, Effects
from sl_sim.exposure_integral import exposed_radiance
from sl_sim.light import LightSource, aimed_projector
from sl_sim.projector import channel_light, light_image
from sl_sim.raycast import RayCaster
from sl_sim.renderer import Renderer
from sl_sim.spot_truth import SpotTruth, count_visible, spot_truth

CAMERAS = ("vga", "vga_barrel", "hd", "hd_barrel")
LEAST_SPOTS = 120
"""A view with fewer visible spots away from edges is drawn again."""


class NoViewError(StructuredLightError):
    """No view shows enough spots."""


@dataclass(frozen=True)
class Shot:
    """One image with its truth.

    Attributes:
        name: SCENE__VIEW__CAMERA__EFFECTS. image: (H, W, 3) uint8 BGR. arrays: per-spot truth. meta: the rest, plain
            types.
    """

    name: str
    image: np.ndarray
    arrays: dict[str, np.ndarray]
    meta: dict[str, Any]


def random_camera(kind: str, rng: np.random.Generator) -> CameraModel:
    """A camera of a kind in CAMERAS with a principal point off the middle; barrel lenses follow Pers' model."""
    scale = 2.0 if kind.startswith("hd") else 1.0
    focal = scale * rng.uniform(760, 900)
    centre = scale * (np.array([319.5, 239.5]) + rng.uniform(-12, 12, 2))
    matrix = np.array([[focal, 0, centre[0]], [0, focal * rng.uniform(0.998, 1.002), centre[1]], [0, 0, 1.0]])
    size = int(640 * scale), int(480 * scale)
    if kind.endswith("barrel"):
        return CameraModel(*size, matrix, "pers", (rng.uniform(0.75, 1.3),))
    return CameraModel(*size, matrix)


def random_projector(width: int, height: int, rng: np.random.Generator) -> tuple[CameraModel, np.ndarray]:
    """A lens-shifted projector and base_from_projector, aimed at the object frame's origin from 0.85 to 1.25 m."""
    focal = width / 1024 * rng.uniform(1750, 2100)
    centre = np.array([0.5 * (width - 1) + rng.uniform(-12, 12), height * rng.uniform(0.85, 1.12)])
    model = CameraModel(width, height, np.array([[focal, 0, centre[0]], [0, focal, centre[1]], [0, 0, 1.0]]))
    direction = np.array([rng.uniform(-0.45, 0.45), rng.uniform(-0.35, 0.35), 1.0])
    position = rng.uniform(0.85, 1.25) * direction / np.linalg.norm(direction)
    return model, aimed_projector(
        model, position, np.zeros(3), roll=rng.uniform(-0.15, 0.15), up=np.array([0.0, 1.0, 0.0])
    )


def random_view(
    rng: np.random.Generator, *, distance: tuple[float, float] = (0.4, 0.95), oblique: float = 60.0
) -> np.ndarray:
    """base_from_camera that looks near the origin from a random side, distance [m] and roll; obliqueness [deg] from
    +z.
    """
    angle = np.radians(oblique) * np.sqrt(rng.uniform())
    about = rng.uniform(0, 2 * np.pi)
    direction = np.array([np.sin(angle) * np.cos(about), np.sin(angle) * np.sin(about), np.cos(angle)])
    target = rng.uniform((-0.07, -0.06, -0.02), (0.07, 0.06, 0.06))
    pose = transforms.look_at(target + rng.uniform(*distance) * direction, target, np.array([0.02, 1.0, 0.01]))
    return pose @ transforms.make(
        transforms.rotation_exp(np.array([0.0, 0.0, rng.uniform(-np.pi, np.pi)])), np.zeros(3)
    )


def random_effects(kind: str, rng: np.random.Generator) -> Effects:
    """The named effects with their sensor, light and motion varied by a few per cent to a few tens of per cent."""
    base = EFFECTS[kind]
    if kind == "clean":
        return base
    return replace(
        base,
        render=replace(base.render, ambient=base.render.ambient * rng.uniform(0.4, 1.6)),
        sensor=replace(
            base.sensor,
            exposure_bias=base.sensor.exposure_bias + rng.uniform(-0.35, 0.25),
            read_noise=base.sensor.read_noise * rng.uniform(0.7, 1.3),
        ),
        twist=tuple(np.asarray(base.twist) * rng.uniform(0.5, 1.2) * rng.choice([-1.0, 1.0], 6)),
        aperture=base.aperture * rng.uniform(0.7, 1.1),
    )


def spot_arrays(
    pattern: Pattern, truth: SpotTruth, camera: CameraModel, effects: Effects, exposure: float
) -> dict[str, np.ndarray]:
    """The truth of a view as the arrays of a truth file, with each spot's signal and its ratio to the sensor's
    noise.
    """
    rgb = np.array([letter.rgb for letter in pattern.letters], np.uint8)
    crosstalk = np.asarray(effects.sensor.crosstalk, float)
    response = (channel_light(rgb, effects.projector) @ crosstalk.T).max(-1)
    rays = camera.rays(np.nan_to_num(truth.xy).reshape(-1, 2))
    falloff = ((rays**2).sum(1) ** (-2.0 * effects.sensor.vignetting)).reshape(truth.visible.shape)
    peak = 1.0 - np.exp(-((0.5 * truth.axes_px[..., 0]) ** 2) / (2 * (effects.sensor.blur**2 + 0.2)))
    signal = np.clip(response[pattern.symbols] * truth.irradiance * falloff * peak * exposure, 0.0, 1.0)
    electrons = signal * effects.sensor.full_well
    noise = np.sqrt(electrons + effects.sensor.read_noise**2) if effects.sensor.noise else np.full(signal.shape, 1.0)
    lit = truth.visible | truth.partial
    return {
        "symbols": np.asarray(pattern.symbols),
        "centers": np.asarray(pattern.centers, float),
        "xyz": truth.xyz,
        "normal": truth.normal.astype(np.float32),
        "xy": truth.xy,
        "visible": truth.visible,
        "edge": truth.edge,
        "partial": truth.partial,
        "axes_px": truth.axes_px.astype(np.float32),
        "shift": truth.shift.astype(np.float32),
        "cos_proj": truth.cos_proj.astype(np.float32),
        "cos_cam": truth.cos_cam.astype(np.float32),
        "signal": np.where(lit, signal, 0.0).astype(np.float32),
        "snr": np.where(lit, electrons / noise, 0.0).astype(np.float32),
    }


def intrinsics(model: CameraModel) -> dict[str, Any]:
    """A model as plain numbers: fx fy cx cy width height, pers_f in px or None."""
    k = model.matrix
    pers = model.coefficients[0] * k[0, 0] if model.distortion_model == "pers" else None
    return {
        "fx": k[0, 0],
        "fy": k[1, 1],
        "cx": k[0, 2],
        "cy": k[1, 2],
        "width": model.width,
        "height": model.height,
        "pers_f": pers,
    }


def render_shot(
    pattern: Pattern,
    *,
    scene: str,
    camera: str,
    effects: str,
    seed: int,
    distance: tuple[float, float] = (0.4, 0.95),
    oblique: float = 60.0,
) -> Shot:
    """One random image of a scene; everything random follows from the seed.

    Raises NoViewError when 40 random views of the scene show too few spots.
    """
    rng = np.random.default_rng(seed)
    built = scenes.build(scene, int(rng.integers(1 << 30)))
    turned = transforms.make(transforms.rotation_exp(np.array([0.0, 0.0, 0.2 * rng.standard_normal()])), np.zeros(3))
    caster = RayCaster(built.bodies(turned))
    chosen = random_effects(effects, rng)
    for _ in range(40):
        camera_model = random_camera(camera, rng)
        projector, base_from_projector = random_projector(pattern.projector_width, pattern.projector_height, rng)
        base_from_camera = random_view(rng, distance=distance, oblique=oblique)
        place = (caster, camera_model, base_from_camera, projector, base_from_projector, np.asarray(pattern.centers))
        enough = min(LEAST_SPOTS, 0.4 * pattern.symbols.size)
        if count_visible(*place) < enough:
            continue
        truth = spot_truth(*place, pattern.spot_diameter)
        good = truth.visible & ~truth.edge & (truth.axes_px[..., 0] >= 2.0)
        if good.sum() >= enough:
            break
    else:
        raise NoViewError(f"no view of scene '{scene}' (seed {seed}) shows {LEAST_SPOTS} spots; use another seed")
    renderer = Renderer(caster, camera_model, LightSource(projector, base_from_projector), chosen.render_options)
    light = light_image(np.ascontiguousarray(pattern.render()[..., ::-1]), chosen.projector)
    reach = float(np.nanmedian(np.linalg.norm(truth.xyz[truth.visible] - base_from_camera[:3, 3], axis=1)))
    radiance = exposed_radiance(renderer, light, base_from_camera, chosen, reach)
    signal = sensor.filtered(radiance, sensor.lens_falloff(camera_model, chosen.sensor.vignetting), chosen.sensor)
    exposure = chosen.sensor.exposure or sensor.automatic_exposure(signal, chosen.sensor)
    image = sensor.expose(signal, exposure, chosen.sensor, rng)
    good = truth.visible & ~truth.edge
    angle = np.degrees(np.arccos(np.clip(np.nanmedian(truth.cos_cam[good]), -1, 1)))
    view = f"v{seed % 10000:04d}"
    hard = effects in ("dim", "budget", "noisy", "unbalanced", "motion", "defocus", "over") or angle > 45
    complex_scene = scene in ("boxes", "stairs", "clutter", "corner", "bust", "checker", "glossy", "freeform")
    meta: dict[str, Any] = {
        "name": f"{scene}__{view}__{camera}__{effects}",
        "scene": scene,
        "view": view,
        "camera": camera,
        "effects": effects,
        "seed": seed,
        "difficulty": ("easy", "medium", "hard")[int(hard) + int(complex_scene)],
        "description": built.description,
        "pixel_convention": "centre of top-left pixel = (0, 0)",
        "distortion_model": "none" if camera_model.distortion_model == "none" else "r_u = f sinh(r/f), f = pers_f px",
        "camera_K": intrinsics(camera_model),
        "projector_K": intrinsics(projector),
        "T_world_cam": base_from_camera.tolist(),
        "T_world_proj": base_from_projector.tolist(),
        "T_cam_proj": (transforms.inverse(base_from_camera) @ base_from_projector).tolist(),
        "obliqueness_deg": float(angle),
        "distance_m": reach,
        "exposure": float(exposure),
        "saturated_fraction": float((image == 255).any(-1).mean()),
        "n_visible": int(truth.visible.sum()),
        "n_visible_non_edge": int(good.sum()),
        "median_footprint_px": np.nanmedian(truth.axes_px[truth.visible], axis=0).tolist(),
    }
    return Shot(meta["name"], image, spot_arrays(pattern, truth, camera_model, chosen, exposure), meta)

"""The radiance of a whole exposure: mean over the camera's motion and the lens's pupil."""

import numpy as np

from sl_common import transforms
from sl_sim.effects import Effects
from sl_sim.light import Occluders
from sl_sim.renderer import Renderer


def lens_points(aperture: float, count: int) -> list[tuple[float, float]]:
    """Points (x, y) [m] that fill a round pupil evenly (a sunflower)."""
    if aperture <= 0:
        return [(0.0, 0.0)]
    k = np.arange(count)
    radius, angle = 0.5 * aperture * np.sqrt((k + 0.5) / count), k * np.pi * (3.0 - np.sqrt(5.0))
    return list(zip(radius * np.cos(angle), radius * np.sin(angle), strict=True))


def exposed_radiance(
    renderer: Renderer,
    light: np.ndarray,
    base_from_camera: np.ndarray,
    effects: Effects,
    distance: float,
    *,
    occluders: Occluders | None = None,
    pupil_samples: int = 12,
    motion_samples: int = 7,
) -> np.ndarray:
    """Mean radiance (H, W, 3) over the exposure and the pupil; base_from_camera holds at mid-exposure, distance [m]
    to the object.
    """
    twist = np.asarray(effects.twist, float)
    times = (np.arange(motion_samples) + 0.5) / motion_samples - 0.5 if twist.any() else np.zeros(1)
    points = lens_points(effects.aperture, pupil_samples)
    focus = effects.focus * distance if effects.aperture > 0 else 0.0
    total: np.ndarray | None = None
    for time in times:
        pose = base_from_camera @ transforms.exp(time * twist)
        for point in points:
            image = renderer.radiance(light, pose, occluders=occluders, lens_point=point, focus=focus)
            total = image if total is None else total + image
    assert total is not None
    return total / np.float32(len(times) * len(points))

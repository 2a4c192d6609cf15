"""Named sets of effects: what light, lens, sensor and transport do to an image."""

from dataclasses import dataclass, field, replace

import numpy as np

from sl_common import transforms
from sl_sim.projector import ProjectorOptions
from sl_sim.renderer import Occluders, Renderer, RenderOptions
from sl_sim.sensor import SensorOptions


@dataclass(frozen=True, kw_only=True)
class Effects:
    """Everything between a scene and an 8-bit image.

    Attributes:
        render, projector, sensor: see there; render.projector_vignetting is taken from the projector.
        twist: (6,) velocity of the camera in its own frame during the exposure, m and rad per exposure (v, w).
        aperture: diameter [m] of the entrance pupil for defocus, 0 = pinhole. focus: sharp distance over the distance to the
            object, 1 = sharp there.
    """

    render: RenderOptions = field(default_factory=RenderOptions)
    projector: ProjectorOptions = field(default_factory=ProjectorOptions)
    sensor: SensorOptions = field(default_factory=SensorOptions)
    twist: tuple[float, ...] = (0.0,) * 6
    aperture: float = 0.0
    focus: float = 1.0

    @property
    def render_options(self) -> RenderOptions:
        """`render` with the projector's vignetting."""
        return replace(self.render, projector_vignetting=self.projector.vignetting)


def _named() -> dict[str, Effects]:
    clean = SensorOptions(noise=False, bayer="", adc_bits=0, crosstalk=((1.0, 0, 0), (0, 1.0, 0), (0, 0, 1.0)), vignetting=0.0)
    pure = ProjectorOptions(crosstalk=((1.0, 0, 0), (0, 1.0, 0), (0, 0, 1.0)), black_level=0.0, vignetting=0.0)
    bounce = RenderOptions(interreflection=True)
    poor = ((0.74, 0.20, 0.06), (0.16, 0.68, 0.16), (0.05, 0.24, 0.71))
    return {
        "clean": Effects(render=RenderOptions(ambient=0.0), projector=pure, sensor=clean),
        "lab": Effects(render=bounce),
        "dim": Effects(render=bounce, sensor=SensorOptions(exposure_bias=-1.6, read_noise=12.0)),
        "over": Effects(render=bounce, sensor=SensorOptions(exposure_bias=1.0)),
        "ambient": Effects(render=RenderOptions(interreflection=True, ambient=0.12, ambient_colour=(1.0, 0.9, 0.75))),
        "noisy": Effects(render=bounce, sensor=SensorOptions(full_well=2500.0, read_noise=14.0)),
        "budget": Effects(
            render=RenderOptions(interreflection=True, ambient=0.05),
            projector=ProjectorOptions(gamma=(2.4, 2.2, 2.6), black_level=0.006, blur=0.8, vignetting=0.3,
                                       crosstalk=((1.0, 0.12, 0.02), (0.08, 1.0, 0.14), (0.02, 0.14, 1.0))),  # fmt: skip
            sensor=SensorOptions(full_well=4500.0, read_noise=12.0, crosstalk=poor, demosaic="bilinear", blur=0.6,
                                 vignetting=1.0, jpeg=88),  # fmt: skip
        ),
        "unbalanced": Effects(
            render=bounce, sensor=SensorOptions(white_balance=(0.55, 1.0, 1.25), gamma=1.8, bayer="grbg", crosstalk=poor)
        ),
        "linear": Effects(render=bounce, sensor=SensorOptions(gamma=1.0, adc_bits=12, bayer="bggr")),
        "jpeg": Effects(render=bounce, sensor=SensorOptions(jpeg=70)),
        "motion": Effects(render=bounce, twist=(0.0012, -0.0007, 0.0005, 0.0008, 0.0010, 0.002)),
        "defocus": Effects(render=bounce, aperture=0.004, focus=1.35),
    }


EFFECTS = _named()
"""Effects by name, from `clean` (nothing but optics) over `lab` (the default) to harsh ones."""


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
    """Mean radiance (H, W, 3) over the exposure and the pupil; base_from_camera holds at mid-exposure, distance [m] to the object."""
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

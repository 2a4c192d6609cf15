"""Named sets of effects: what light, lens, sensor and transport do to an image."""

from dataclasses import dataclass, field, replace

from sl_sim.projector import ProjectorOptions
from sl_sim.render_options import RenderOptions
from sl_sim.sensor import SensorOptions


@dataclass(frozen=True, kw_only=True)
class Effects:
    """Everything between a scene and an 8-bit image.

    Attributes:
        render, projector, sensor: see there; render.projector_vignetting is taken from the projector.
        twist: (6,) velocity of the camera in its own frame during the exposure, m and rad per exposure (v, w).
        aperture: diameter [m] of the entrance pupil for defocus, 0 = pinhole. focus: sharp distance over the
            distance to the
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
    clean = SensorOptions(
        noise=False, bayer="", adc_bits=0, crosstalk=((1.0, 0, 0), (0, 1.0, 0), (0, 0, 1.0)), vignetting=0.0
    )
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
            projector=ProjectorOptions(
                gamma=(2.4, 2.2, 2.6),
                black_level=0.006,
                blur=0.8,
                vignetting=0.3,
                crosstalk=((1.0, 0.12, 0.02), (0.08, 1.0, 0.14), (0.02, 0.14, 1.0)),
            ),
            sensor=SensorOptions(
                full_well=4500.0,
                read_noise=12.0,
                crosstalk=poor,
                demosaic="bilinear",
                blur=0.6,
                vignetting=1.0,
                jpeg=88,
            ),
        ),
        "unbalanced": Effects(
            render=bounce,
            sensor=SensorOptions(white_balance=(0.55, 1.0, 1.25), gamma=1.8, bayer="grbg", crosstalk=poor),
        ),
        "linear": Effects(render=bounce, sensor=SensorOptions(gamma=1.0, adc_bits=12, bayer="bggr")),
        "jpeg": Effects(render=bounce, sensor=SensorOptions(jpeg=70)),
        "motion": Effects(render=bounce, twist=(0.0012, -0.0007, 0.0005, 0.0008, 0.0010, 0.002)),
        "defocus": Effects(render=bounce, aperture=0.004, focus=1.35),
    }


EFFECTS = _named()
"""Effects by name, from `clean` (nothing but optics) over `lab` (the default) to harsh ones."""

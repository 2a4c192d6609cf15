"""Options of the renderer."""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class RenderOptions:
    """How light is simulated.

    Attributes:
        samples: sub-pixels per pixel and axis.
        lattice: distance of the nodes [px]; details smaller than that between even nodes may be missed.
        ambient: radiance of a white surface by ambient light, relative to projector white on it at 1 m.
        ambient_colour: (3,) RGB of the ambient light.
        projector_vignetting: the projector's loss at the far corner, see ProjectorOptions.
        interreflection: add one bounce of the projector's light between surfaces.
    """

    samples: int = 2
    lattice: int = 1
    ambient: float = 0.02
    ambient_colour: tuple[float, float, float] = (1.0, 0.95, 0.85)
    projector_vignetting: float = 0.15
    interreflection: bool = False

"""Where the light comes from and what stands in its way."""

from dataclasses import dataclass, field

import numpy as np

from sl_common import transforms
from sl_common.cameras import CameraModel


@dataclass(frozen=True)
class LightSource:
    """The projector: its intrinsics and pose."""

    model: CameraModel
    base_from_projector: np.ndarray


@dataclass(frozen=True)
class Occluders:
    """Capsules that keep light from the scene (the arm): ends (k, 2, 3) [m], radii (k,) [m], base frame."""

    ends: np.ndarray = field(default_factory=lambda: np.zeros((0, 2, 3)))
    radii: np.ndarray = field(default_factory=lambda: np.zeros(0))


def aimed_projector(
    model: CameraModel, position: np.ndarray, target: np.ndarray, *, roll: float = 0.0, up: np.ndarray | None = None
) -> np.ndarray:
    """base_from_projector at `position` with the panel's middle (not the optical axis) on `target`, rolled about the
    beam.
    """
    beam = transforms.look_at(position, target, np.array([0.0, 0.0, 1.0]) if up is None else up)
    beam = beam @ transforms.make(transforms.rotation_exp(np.array([0.0, 0.0, roll])), np.zeros(3))
    middle = model.rays(np.array([[0.5 * (model.width - 1), 0.5 * (model.height - 1)]]))[0]
    middle = middle / np.linalg.norm(middle)
    axis = np.cross(middle, [0.0, 0.0, 1.0])
    sine = np.linalg.norm(axis)
    turn = axis / max(sine, 1e-12) * np.arctan2(sine, middle[2])
    return beam @ transforms.make(transforms.rotation_exp(turn), np.zeros(3))

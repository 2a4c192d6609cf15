"""Compile the renderer's loops into the cache: `python -m sl_sim.warmup`, so that no first image waits for it."""

import sys
import time

import numpy as np

from sl_common import transforms
from sl_common.cameras import CameraModel
from sl_sim import meshes
from sl_sim.light import LightSource, Occluders
from sl_sim.projector import ProjectorOptions, light_image
from sl_sim.raycast import Body, RayCaster
from sl_sim.render_options import RenderOptions
from sl_sim.renderer import Renderer


def warm_up() -> np.ndarray:
    """Render a tiny scene with every kernel; returns its radiance (24, 32, 3)."""
    caster = RayCaster([Body(meshes.rectangle(2.0, 2.0), np.eye(4)), Body(meshes.box((0.2, 0.2, 0.2)), np.eye(4))])
    model = CameraModel(32, 24, np.array([[30.0, 0, 16], [0, 30.0, 12], [0, 0, 1.0]]))
    up = np.array([0.0, 1.0, 0.0])
    source = LightSource(model, transforms.look_at(np.array([0.3, 0.2, 1.0]), np.zeros(3), up))
    light = light_image(np.full((24, 32, 3), 200, np.uint8), ProjectorOptions())
    renderer = Renderer(caster, model, source, RenderOptions(interreflection=True))
    occluders = Occluders(np.array([[[5.0, 0, 0], [5.0, 1, 0]]]), np.array([0.1]))
    return renderer.radiance(
        light, transforms.look_at(np.array([-0.3, 0.2, 1.0]), np.zeros(3), up), occluders=occluders
    )


def main() -> int:
    """Entry point of `python -m sl_sim.warmup`."""
    start = time.perf_counter()
    mean = float(warm_up().mean())
    print(f"renderer compiled in {time.perf_counter() - start:.1f} s (mean radiance {mean:.2f})")
    return 0


if __name__ == "__main__":
    sys.exit(main())

"""How long the simulation takes: rows for the performance table, or `python -m sl_sim.benchmark`."""

import sys
import time
from dataclasses import replace

import numpy as np

from pattern_gen import default_pattern
from sl_sim import arm
from sl_sim.camera_simulation import CameraSimulation
from sl_sim.cell import Cell, CellSettings
from sl_sim.driver import ArmDriver
from sl_sim.effects import EFFECTS
from sl_sim.exposures import Exposure
from sl_sim.spot_truth import spot_truth

Row = tuple[str, float, str]


def _median(durations: list[float]) -> float:
    return float(np.median(durations))


def rows(repeats: int = 9, scene: str = "bust") -> list[Row]:
    """(what, value, unit) of the cell's camera at its default settings, of the truth, and of one control period.

    Times are medians of one thread; process time is given beside wall time because another load changes the latter.
    """
    cell = Cell(CellSettings(scene=scene))
    start = time.perf_counter()
    cell.caster.first_hits(np.zeros(3), np.ones((1, 3)))
    result: list[Row] = [(f"scene '{scene}' built", 1e3 * (time.perf_counter() - start), "ms")]
    effects = EFFECTS["lab"]
    effects = replace(effects, render=replace(effects.render, interreflection=False, lattice=2))
    camera = CameraSimulation(cell, effects)
    camera.show(np.ascontiguousarray(default_pattern().render()[..., ::-1]))
    for what, step in (("moving", 1e-4), ("at rest", 0.0)):
        wall, cpu = [], []
        for k in range(repeats + 1):
            q = np.tile(cell.start_positions + step * k, (7, 1))
            before = time.perf_counter(), time.process_time()
            camera.take(Exposure(0, q, cell.base_from_object))
            wall.append(time.perf_counter() - before[0])
            cpu.append(time.process_time() - before[1])
        size = f"{cell.camera.width}x{cell.camera.height}"
        result.append((f"image {size}, camera {what}", 1e3 * _median(wall[1:]), "ms"))
        result.append((f"image {size}, camera {what}, process time", 1e3 * _median(cpu[1:]), "ms"))
    pattern, pose = default_pattern(), cell.base_from_camera(cell.start_positions)
    durations = []
    for _ in range(3):
        begin = time.perf_counter()
        spot_truth(
            cell.caster,
            cell.camera,
            pose,
            cell.projector,
            cell.base_from_projector,
            pattern.centers,
            pattern.spot_diameter,
        )
        durations.append(time.perf_counter() - begin)
    result.append((f"truth of {pattern.rows * pattern.cols} spots", 1e3 * _median(durations), "ms"))
    driver = ArmDriver(arm.limits(), cell.start_positions)
    begin = time.perf_counter()
    for k in range(500):
        driver.receive(cell.start_positions + 1e-6 * k)
        driver.step()
    result.append(("one setpoint received, judged and followed", 1e6 * (time.perf_counter() - begin) / 500, "us"))
    return result


def main() -> int:
    """Entry point of `python -m sl_sim.benchmark`."""
    for what, value, unit in rows():
        print(f"{what:52s} {value:9.1f} {unit}")
    return 0


if __name__ == "__main__":
    sys.exit(main())

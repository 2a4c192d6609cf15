"""Orders to objects whose preferred place the simulated arm cannot go to: from an exact cloud to joint positions."""

import numpy as np
import pytest

from arm_positioner.choosing import first_possible
from arm_positioner.errors import UnreachableError
from arm_positioner.limits import from_urdf
from arm_positioner.planning import Planner
from arm_positioner.target import TargetOptions, find_target, other_targets
from arm_positioner.trajectory import MotionState, plan
from sl_bringup.demo.evaluation import pose_errors
from sl_common import transforms
from sl_sim import arm
from sl_sim.cell import Cell, CellSettings

STANDOFF = 0.4
PERIOD = 0.008


def cloud(cell, base_from_camera):
    """What a perfect decoder and calibration give of a pattern of 44 x 58 dots: points (N, 3), rows, columns."""
    row, col = (a.ravel() for a in np.mgrid[0:44, 0:58])
    pixels = np.stack([1024 / 58 * (col + 0.5) - 0.5, 768 / 44 * (row + 0.5) - 0.5], axis=1)
    spots, normals = cell.spots_in_base(pixels)
    lit = np.isfinite(spots).all(axis=1)
    spots, normals, row, col = spots[lit], normals[lit], row[lit], col[lit]
    rays = spots - base_from_camera[:3, 3]
    hits, _ = cell.surface_along_rays(base_from_camera[:3, 3], rays)
    seen = cell.camera.project(transforms.apply(transforms.inverse(base_from_camera), spots))
    ok = ((seen >= 0) & (seen < (cell.camera.width, cell.camera.height))).all(axis=1)
    ok &= np.linalg.norm(hits - spots, axis=1) < 1e-3
    ok &= -np.sum(rays * normals, axis=1) > 0.2 * np.linalg.norm(rays, axis=1)
    noise = 1.5e-4 * np.random.default_rng(0).normal(size=len(spots))
    points = spots + noise[:, None] * rays / np.linalg.norm(rays, axis=1)[:, None]
    return points[ok], row[ok], col[ok]


@pytest.mark.parametrize(("scene", "seed"), [("freeform", 1), ("boxes", 4)])
def test_an_object_whose_preferred_place_is_out_of_reach_is_seen_from_another(scene, seed):
    cell = Cell(CellSettings(scene=scene, seed=seed))
    start = np.array(cell.start_positions)
    here = cell.base_from_camera(start)
    chain = arm.kinematics()
    limits = from_urdf(
        chain.joint_names, chain.lower, chain.upper, chain.max_velocity, max_acceleration=[2.5], max_jerk=[25.0]
    )
    planner = Planner(chain, limits)
    points, row, col = cloud(cell, here)
    question = {"row": row, "col": col, "options": TargetOptions(standoff=STANDOFF)}

    def begin(target):
        def preview(goal):
            return plan(MotionState.at_rest(start), goal, limits, period=PERIOD)

        return planner.choose(target.base_from_camera, cell.flange_from_camera, start, preview, free_roll=True)

    preferred = find_target(points, here, **question)
    with pytest.raises(UnreachableError, match="out of reach"):
        begin(preferred)
    chosen, way, why = first_possible(
        preferred, lambda: other_targets(points, here, **question, previous=preferred.surface.point), begin
    )
    assert "beside the place preferred" in why
    there = cell.base_from_camera(way.positions)
    errors = pose_errors(cell, there, there, STANDOFF)
    assert abs(errors.standoff) < 1e-3
    assert np.degrees(errors.tilt) < 1.0
    assert np.degrees(chosen.surface.normal_sigma) < 0.7

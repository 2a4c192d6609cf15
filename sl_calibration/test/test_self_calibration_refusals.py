"""Self-calibration of bad input: each condition by its name, and what can be left out is left out."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))

from synthetic_views import QUICK, SIZE, calibrate, make_cell, observe

from sl_calibration.self_calibration.calibrate import self_calibrate
from sl_calibration.self_calibration.errors import (
    DegenerateMotionError,
    DegenerateSceneError,
    InconsistentPosesError,
    TooFewViewsError,
)
from sl_calibration.self_calibration.views import flatten
from sl_common import transforms
from sl_common.cameras import CameraModel
from sl_common.errors import InvalidInputError


def with_pose(view, pose):
    return replace(view, base_from_flange=pose)


def test_too_few_views():
    cell = make_cell(1, views=2)
    with pytest.raises(TooFewViewsError, match="2 usable views, at least 3"):
        calibrate(cell, observe(cell, 1))


def test_pure_translation():
    cell = make_cell(2, views=8, motion="translation")
    with pytest.raises(DegenerateMotionError, match=r"pure translation.*two different axes"):
        calibrate(cell, observe(cell, 2))


def test_rotation_about_one_axis_only():
    cell = make_cell(3, views=8, motion="axis")
    with pytest.raises(DegenerateMotionError, match=r"one axis of rotation.*across it"):
        calibrate(cell, observe(cell, 3, rotation_sigma=1e-5))


def test_flat_scene():
    cell = make_cell(4, views=6, relief=0.0, step=4)
    with pytest.raises(DegenerateSceneError, match=r"one plane.*different height"):
        calibrate(cell, observe(cell, 4))


def test_shuffled_poses():
    cell = make_cell(5, views=8)
    views = observe(cell, 5)
    order = [3, 6, 0, 7, 1, 2, 5, 4]
    with pytest.raises(InconsistentPosesError, match="shuffled"):
        calibrate(cell, [with_pose(v, views[i].base_from_flange) for v, i in zip(views, order, strict=True)])


def test_poses_shifted_by_one_image_are_recognised():
    cell = make_cell(5, views=8)
    views = observe(cell, 5)
    with pytest.raises(InconsistentPosesError, match="shifted by one image"):
        calibrate(cell, [with_pose(v, views[(i + 1) % 8].base_from_flange) for i, v in enumerate(views)])


def test_inverse_poses_are_recognised():
    cell = make_cell(5, views=8)
    views = [with_pose(v, transforms.inverse(v.base_from_flange)) for v in observe(cell, 5)]
    with pytest.raises(InconsistentPosesError, match="flange_from_base"):
        calibrate(cell, views)


def test_millimetres_in_some_or_all_poses_are_named():
    cell = make_cell(6, views=6)
    views = observe(cell, 6)

    def scaled(view):
        pose = view.base_from_flange.copy()
        pose[:3, 3] *= 1000
        return with_pose(view, pose)

    with pytest.raises(InvalidInputError, match=r"all views.*millimetres"):
        calibrate(cell, [scaled(v) for v in views])
    with pytest.raises(InvalidInputError, match=r"view02, view04.*millimetres"):
        calibrate(cell, [scaled(v) if i in (2, 4) else v for i, v in enumerate(views)])


def test_pose_that_is_not_rigid_is_named():
    cell = make_cell(6, views=6)
    views = observe(cell, 6)
    views[3].base_from_flange[0, 0] += 0.1
    with pytest.raises(InvalidInputError, match="view03: base_from_flange is not a rigid"):
        calibrate(cell, views)


@pytest.mark.parametrize("shift", [[0.0, 0.02, 0.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 0.0, 0.3, 0.0]])
def test_an_outlier_pose_is_left_out_and_named(shift):
    cell = make_cell(8, views=9)
    views = observe(cell, 8)
    views[4] = with_pose(views[4], transforms.perturb(views[4].base_from_flange, np.array(shift)))
    result = calibrate(cell, views)
    assert any("view04" in w and "does not fit" in w for w in result.warnings)
    assert "view04" not in result.names
    assert len(result.names) == 8
    delta = transforms.difference(result.flange_from_camera, cell.flange_from_camera)
    assert 1e3 * np.linalg.norm(delta[:3]) < 1.0


def test_two_swapped_images_are_named():
    cell = make_cell(9, views=10)
    views = observe(cell, 9)
    views[2], views[7] = (
        with_pose(views[2], views[7].base_from_flange),
        with_pose(views[7], views[2].base_from_flange),
    )
    result = calibrate(cell, views)
    assert any("view02 and view07 are swapped" in w for w in result.warnings)


def test_wrong_resolution_is_named():
    cell = make_cell(1, views=5)
    camera = CameraModel(320, 240, cell.camera.matrix)
    with pytest.raises(InvalidInputError, match=r"320x240.*another camera or resolution"):
        self_calibrate(observe(cell, 1), camera, cell.centers, SIZE, QUICK)


def test_dots_outside_the_pattern_are_named():
    cell = make_cell(1, views=5)
    with pytest.raises(InvalidInputError, match="outside the 10x10 pattern"):
        self_calibrate(observe(cell, 1), cell.camera, cell.centers[:10, :10], SIZE, QUICK)


def test_a_dot_claimed_twice_in_a_view_counts_not_at_all():
    cell = make_cell(1, views=3)
    views = observe(cell, 1)
    view = views[0]
    row, col = view.row.copy(), view.col.copy()
    row[5], col[5] = row[9], col[9]
    doubled = replace(view, row=row, col=col)
    assert (flatten([doubled], cell.centers).view == 0).sum() == len(view.row) - 2


def test_a_view_without_enough_usable_dots_is_left_out_and_named():
    cell = make_cell(1, views=7, step=3)
    views = observe(cell, 1)
    few = views[2]
    row, col = few.row[:14].copy(), few.col[:14].copy()
    row[1:4], col[1:4] = row[0], col[0]
    views[2] = replace(few, row=row, col=col, pixels=few.pixels[:14])
    result = calibrate(cell, views)
    assert "view02" not in result.names
    assert any("view02" in w for w in result.warnings)


def test_an_image_of_another_scene_is_left_out_and_named():
    cell = make_cell(1, views=8, step=3)
    views = observe(cell, 1)
    rng = np.random.default_rng(0)
    views[5] = replace(views[5], pixels=rng.uniform([0, 0], [639, 479], views[5].pixels.shape))
    result = calibrate(cell, views)
    assert "view05" not in result.names
    assert any("view05" in w for w in result.warnings)

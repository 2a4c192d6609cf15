"""The demo's judgement: a table that can fail, and errors measured right."""

import numpy as np
import pytest

from sl_bringup import nominal_calibration
from sl_bringup.demo.evaluation import pose_errors, surface_ahead
from sl_bringup.demo.report import Row, passed, table
from sl_bringup.demo.truth import parse
from sl_bringup.errors import DemoError
from sl_common import transforms
from sl_common.calibration_files import Calibration, PoseCalibration, load_calibration
from sl_sim.cell import Cell, CellSettings


@pytest.fixture(scope="module")
def cell():
    return Cell(CellSettings(scene="plane", seed=3))


@pytest.mark.parametrize(
    ("value", "limit", "least", "expected"),
    [
        (1.0, 2.0, False, True),
        (2.1, 2.0, False, False),
        (2.1, 2.0, True, True),
        (float("nan"), 2.0, False, False),
        (9.0, None, False, None),
    ],
)
def test_a_row_passes_within_its_limit_only(value, limit, least, expected):
    row = Row("x", value, "mm", limit, least)
    assert row.passed is expected
    assert passed([row]) is (expected is not False)
    assert ("FAILED" in table([row])) is (expected is False)


def test_a_nan_is_null_in_json():
    assert Row("x", float("nan"), "mm", 1.0).as_dict() == {
        "name": "x",
        "value": None,
        "unit": "mm",
        "limit": 1.0,
        "ok": False,
    }


def facing(cell, distance):
    """The pose at a distance before the plane where the start view's optical axis meets it, and the plane's normal."""
    start = cell.base_from_camera(np.asarray(cell.start_positions))
    _, normal = surface_ahead(cell, start)
    hit, _ = cell.surface_along_rays(start[:3, 3], start[None, :3, 2])
    position = hit[0] + distance * normal
    return transforms.look_at(position, hit[0]), normal


def test_a_perfect_pose_has_no_error(cell):
    pose, _ = facing(cell, 0.4)
    errors = pose_errors(cell, pose, pose, 0.4)
    assert abs(errors.standoff) < 1e-6
    assert errors.tilt < 1e-4
    assert errors.position == errors.orientation == 0


def test_errors_of_the_pose_are_measured_as_they_were_made(cell):
    pose, normal = facing(cell, 0.4)
    tilt = transforms.rotation_exp(np.array([0.02, 0.0, 0.0]))
    moved = transforms.make(pose[:3, :3] @ tilt, pose[:3, 3] + 0.003 * normal)
    errors = pose_errors(cell, pose, moved, 0.4)
    assert errors.position == pytest.approx(0.003, abs=1e-9)
    assert errors.orientation == pytest.approx(0.02, abs=1e-9)
    assert errors.tilt == pytest.approx(0.02, abs=1e-4)
    assert errors.standoff == pytest.approx(0.403 / np.cos(0.02) - 0.4, abs=1e-5)


def test_a_nominal_calibration_has_errors_of_the_size_asked_for_and_is_the_same_for_a_seed(cell, tmp_path):
    true = Calibration(
        cell.camera, cell.projector, PoseCalibration(cell.flange_from_camera), PoseCalibration(cell.base_from_projector)
    )
    deltas = []
    for seed in range(200):
        found = nominal_calibration.perturbed(true, seed)
        deltas.append(transforms.difference(true.flange_from_camera.transform, found.flange_from_camera.transform))
    sigma = np.std(deltas, axis=0)
    assert sigma[:3] == pytest.approx(0.25e-3, rel=0.2)
    assert sigma[3:] == pytest.approx(np.radians(0.01), rel=0.2)
    again = nominal_calibration.perturbed(true, 199)
    nominal_calibration.save(tmp_path, again, note="test", pattern_id="id")
    read = load_calibration(tmp_path)
    assert read.flange_from_camera.transform == pytest.approx(found.flange_from_camera.transform, abs=1e-12)
    assert read.projector.matrix == pytest.approx(found.projector.matrix, abs=1e-9)


def test_a_truth_that_lacks_something_is_refused_with_its_name():
    with pytest.raises(DemoError, match="camera"):
        parse("{}")

"""The command self_calibrate and its input files."""

import json
import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))

from synthetic_views import mahalanobis, make_cell, observe

from pattern_gen import default_pattern
from sl_calibration.commands.self_calibrate import main
from sl_calibration.self_calibration.inputs import load_motion, load_views
from sl_common import calibration_files, transforms
from sl_common.cameras import CameraModel
from sl_common.errors import InvalidInputError


def write_input(folder, cell, views):
    pattern = default_pattern()
    pattern.save(folder / "pattern.yaml")
    k = cell.camera.matrix
    motion = {
        "camera": {
            "fx": k[0, 0],
            "fy": k[1, 1],
            "cx": k[0, 2],
            "cy": k[1, 2],
            "width": 640,
            "height": 480,
            "pers_f": cell.camera.coefficients[0] * k[0, 0] if cell.camera.coefficients else None,
        },
        "distortion_model": cell.camera.distortion_model,
        "robot_noise": {"mm": 0.1, "deg": 0.02},
        "views": [{"image": f"images/{v.name}.png", "base_from_flange": v.base_from_flange.tolist()} for v in views],
    }
    (folder / "motion.json").write_text(json.dumps(motion))
    (folder / "dots").mkdir(exist_ok=True)
    for v in views:
        lines = [f"{r},{c},{x:.4f},{y:.4f},0.99" for r, c, (x, y) in zip(v.row, v.col, v.pixels, strict=True)]
        (folder / "dots" / f"{v.name}.csv").write_text("row,col,x,y,confidence\n" + "\n".join(lines) + "\n")
    return [
        "--motion",
        str(folder / "motion.json"),
        "--correspondences",
        str(folder / "dots"),
        "--pattern",
        str(folder / "pattern.yaml"),
        "--output",
        str(folder / "calibration"),
        "--no-left-out",
    ]


@pytest.fixture
def pers_cell():
    cell = make_cell(7, views=7, lens="pers", step=1)
    cell.centers = default_pattern().centers
    return cell


def test_command_writes_the_calibration_folder(tmp_path, capsys, pers_cell):
    rows, cols = pers_cell.centers.shape[:2]
    assert (rows, cols) == (44, 58)
    arguments = write_input(tmp_path, pers_cell, observe(pers_cell, 7, wrong=0.01, missing=0.6))
    assert main([*arguments, "--no-projector-distortion", "--no-centroids"]) == 0
    printed = capsys.readouterr().out
    assert "training error" in printed
    assert str(tmp_path / "calibration" / "hand_eye.yaml") in printed
    found = calibration_files.load_calibration(tmp_path / "calibration")
    assert found.camera.distortion_model == "pers"
    assert found.flange_from_camera.extra["samples"] == 7
    delta = transforms.difference(found.flange_from_camera.transform, pers_cell.flange_from_camera)
    assert mahalanobis(delta, found.flange_from_camera.covariance) < 22.5
    assert (tmp_path / "calibration" / "points.csv").read_text().count("\n") > 500


def test_command_fails_with_one_line_and_writes_nothing(tmp_path, capsys, pers_cell):
    views = observe(pers_cell, 7, missing=0.6)
    arguments = write_input(tmp_path, pers_cell, views[:2])
    assert main(arguments) == 1
    error = capsys.readouterr().err
    assert error.startswith("error: 2 usable views")
    assert error.count("\n") == 1
    assert not (tmp_path / "calibration").exists()


@pytest.mark.parametrize(
    ("edit", "message"),
    [
        (lambda m: m.pop("views"), "entry 'views' is missing"),
        (lambda m: m["camera"].pop("fx"), "entry 'fx' is missing"),
        (lambda m: m["views"][1].update(base_from_flange=[[1, 2], [3, 4]]), "view01.*finite 4x4"),
        (lambda m: m.update(distortion_model="fisheye"), "'fisheye' is unknown"),
        (lambda m: m["views"][1].update(image=m["views"][0]["image"]), "more than once"),
    ],
)
def test_motion_files_that_cannot_be_used_are_named(tmp_path, pers_cell, edit, message):
    cell = pers_cell
    cell.camera = CameraModel(640, 480, cell.camera.matrix)
    write_input(tmp_path, cell, observe(cell, 7, missing=0.8)[:3])
    path = tmp_path / "motion.json"
    motion = json.loads(path.read_text())
    edit(motion)
    path.write_text(json.dumps(motion))
    with pytest.raises(InvalidInputError, match=message):
        load_views(load_motion(path), tmp_path / "dots")


def test_csv_with_a_broken_line_is_named_with_the_line(tmp_path, pers_cell):
    write_input(tmp_path, pers_cell, observe(pers_cell, 7, missing=0.8)[:3])
    path = tmp_path / "dots" / "view01.csv"
    path.write_text(path.read_text() + "3,x,1,2,1\n")
    with pytest.raises(InvalidInputError, match=r"view01.csv: data line \d+"):
        load_views(load_motion(tmp_path / "motion.json"), tmp_path / "dots")

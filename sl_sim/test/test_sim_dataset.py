import json

import cv2
import numpy as np
import pytest

from pattern_gen import Pattern, default_pattern
from sl_common import transforms
from sl_common.cameras import CameraModel
from sl_sim.commands import render_dataset, render_motion
from sl_sim.dataset import render_shot

ARRAYS = {"symbols", "centers", "xyz", "normal", "xy", "visible", "edge", "partial", "axes_px", "shift", "cos_proj",
          "cos_cam", "signal", "snr"}  # fmt: skip


def camera_of(meta):
    k = meta["camera_K"]
    matrix = np.array([[k["fx"], 0, k["cx"]], [0, k["fy"], k["cy"]], [0, 0, 1]])
    lens = ("pers", (k["pers_f"] / k["fx"],)) if k["pers_f"] else ("none", ())
    return CameraModel(k["width"], k["height"], matrix, *lens)


def bright_at(image, xy):
    """Brightness at points over the brightness half a spot pitch away."""
    value = image.max(-1).astype(float)
    at = lambda p: cv2.remap(value, p[:, 0].astype(np.float32), p[:, 1].astype(np.float32), cv2.INTER_LINEAR)[:, 0]  # noqa: E731
    return at(xy)


def test_a_set_holds_what_its_readers_expect(tmp_path, capsys):
    folder = tmp_path / "set"
    code = render_dataset.main(
        [
            "--output",
            str(folder),
            "--count",
            "2",
            "--seed",
            "3",
            "--scenes",
            "sphere,boxes",
            "--effects",
            "lab",
            "--cameras",
            "vga_barrel",
            "--oblique",
            "25",
        ]
    )
    assert code == 0, capsys.readouterr().err
    assert Pattern.load(folder / "pattern.yaml").pattern_id == default_pattern().pattern_id
    names = sorted(p.stem for p in (folder / "images").glob("*.png"))
    assert [n.split("__")[0] for n in names] == ["boxes", "sphere"]
    assert sorted(p.name for p in (folder / "truth").iterdir()) == sorted(
        [n + e for n in names for e in (".json", ".npz")]
    )
    for name in names:
        image = cv2.imread(str(folder / "images" / f"{name}.png"))
        meta = json.loads((folder / "truth" / f"{name}.json").read_text())
        truth = dict(np.load(folder / "truth" / f"{name}.npz"))
        assert set(truth) == ARRAYS
        assert {"scene", "view", "camera", "effects", "difficulty", "projector_K"} <= set(meta)
        camera = camera_of(meta)
        exists = truth["visible"]
        base_from_camera = np.array(meta["T_world_cam"])
        projected = camera.project(transforms.apply(transforms.inverse(base_from_camera), truth["xyz"][exists]))
        np.testing.assert_allclose(projected, truth["xy"][exists], atol=1e-6)
        relative = transforms.inverse(base_from_camera) @ np.array(meta["T_world_proj"])
        np.testing.assert_allclose(relative, meta["T_cam_proj"], atol=1e-9)
        good = exists & ~truth["edge"] & (truth["snr"] > 10) & (truth["axes_px"][..., 0] > 3)
        assert good.sum() > 50
        # where truth says that a spot is, there is light; between four spots there is not
        between = 0.25 * sum(truth["xy"][a:, b:][:43, :57] for a in (0, 1) for b in (0, 1))
        whole = np.all([good[a:, b:][:43, :57] for a in (0, 1) for b in (0, 1)], axis=0)
        assert np.median(bright_at(image, truth["xy"][good])) > 2 * np.median(bright_at(image, between[whole]))
    assert render_dataset.main(["--output", str(folder), "--count", "1"]) == 1
    assert "already holds images" in capsys.readouterr().err


def test_a_shot_follows_its_seed():
    pattern = default_pattern()
    one, two = (render_shot(pattern, scene="plane", camera="vga", effects="clean", seed=4) for _ in range(2))
    np.testing.assert_array_equal(one.image, two.image)
    for key in ARRAYS:
        np.testing.assert_array_equal(one.arrays[key], two.arrays[key])
    other = render_shot(pattern, scene="plane", camera="vga", effects="clean", seed=5)
    assert np.abs(one.arrays["xyz"] - other.arrays["xyz"])[one.arrays["visible"]].max() > 1e-3


@pytest.mark.parametrize(
    ("arguments", "words"),
    [(["--scenes", "teapot"], "unknown scenes teapot"), (["--pattern", "/nowhere.yaml"], "nowhere")],
)
def test_bad_input_is_one_clear_line_and_exit_code_1(tmp_path, capsys, arguments, words):
    assert render_dataset.main(["--output", str(tmp_path / "x"), "--count", "1", *arguments]) == 1
    error = capsys.readouterr().err.strip()
    assert error.startswith("error: ")
    assert words in error
    assert len(error.splitlines()) == 1
    assert not (tmp_path / "x" / "images").exists()


@pytest.mark.parametrize("command", [render_dataset, render_motion])
def test_wrong_usage_is_exit_code_2_and_help_has_an_example(command, capsys):
    with pytest.raises(SystemExit) as stop:
        command.main(["--bogus"])
    assert stop.value.code == 2
    with pytest.raises(SystemExit) as stop:
        command.main(["--help"])
    assert stop.value.code == 0
    assert "example:\n  ros2 run sl_sim" in capsys.readouterr().out


def test_a_motion_has_noisy_reports_and_exact_truth(tmp_path, capsys):
    folder = tmp_path / "motion"
    assert render_motion.main(["--output", str(folder), "--views", "3", "--scene", "sphere", "--seed", "2"]) == 0
    motion = json.loads((folder / "motion.json").read_text())
    assert [view["image"] for view in motion["views"]] == [f"images/{k:03d}.png" for k in range(3)]
    truth, k = motion["truth"], motion["camera"]
    camera = camera_of({"camera_K": k})
    for index, view in enumerate(motion["views"]):
        assert cv2.imread(str(folder / view["image"])).shape == (k["height"], k["width"], 3)
        exact = np.array(truth["base_from_flange"][index])
        delta = transforms.difference(exact, np.array(view["base_from_flange"]))
        assert 0 < np.abs(delta[:3]).max() < 6e-4
        assert 0 < np.abs(delta[3:]).max() < np.radians(0.12)
        spots = np.load(folder / "truth" / f"{index:03d}.npz")
        camera_from_base = transforms.inverse(exact @ np.array(truth["flange_from_camera"]))
        visible = spots["visible"]
        assert visible.sum() > 300
        projected = camera.project(transforms.apply(camera_from_base, spots["xyz"][visible]))
        np.testing.assert_allclose(projected, spots["xy"][visible], atol=1e-6)
    p = truth["projector"]
    projector = CameraModel(
        p["width"], p["height"], np.array([[p["fx"], 0, p["cx"]], [0, p["fy"], p["cy"]], [0, 0, 1]])
    )
    hit = np.isfinite(spots["xyz"]).all(-1)
    back = projector.project(
        transforms.apply(transforms.inverse(np.array(truth["base_from_projector"])), spots["xyz"][hit])
    )
    np.testing.assert_allclose(back, spots["centers"][hit], atol=1e-2)
    assert render_motion.main(["--output", str(tmp_path / "y"), "--scene", "teapot"]) == 1
    assert "unknown scene" in capsys.readouterr().err

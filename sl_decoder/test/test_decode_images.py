"""decode_images: formats, CSV, overlays, exit codes."""

import csv

import cv2
import numpy as np
import pytest
from decoder_helpers import camera_image, default_pattern

from sl_decoder.commands.decode_images import main
from sl_decoder.image_files import read_image

PATTERN = default_pattern()


@pytest.fixture
def pattern_file(tmp_path):
    PATTERN.save(tmp_path / "pattern.yaml")
    return str(tmp_path / "pattern.yaml")


@pytest.mark.parametrize("suffix", [".png", ".tiff", ".jpg"])
@pytest.mark.parametrize("bits", [8, 16])
def test_formats(suffix: str, bits: int, tmp_path, pattern_file: str, capsys) -> None:
    if suffix == ".jpg" and bits == 16:
        pytest.skip("JPEG has eight bits")
    image = camera_image(PATTERN, 640, 480)
    path = tmp_path / f"view{suffix}"
    cv2.imwrite(str(path), image if bits == 8 else image.astype(np.uint16) * 40)
    assert (
        main(
            ["--pattern", pattern_file, "--output", str(tmp_path / "out"), "--debug", str(tmp_path / "dbg"), str(path)]
        )
        == 0
    )
    with open(tmp_path / "out" / "view.csv") as file:
        rows = list(csv.DictReader(file))
    assert list(rows[0]) == ["row", "col", "x", "y", "confidence"]
    assert len(rows) > 2400
    assert cv2.imread(str(tmp_path / "dbg" / "view.png")).shape[0] >= 960
    out = capsys.readouterr().out
    assert "view" in out
    assert "1 images" in out


def test_bayer_on_request(tmp_path, pattern_file: str) -> None:
    image = camera_image(PATTERN, 1280, 960)
    raw = np.zeros(image.shape[:2], np.uint8)
    raw[0::2, 0::2] = image[0::2, 0::2, 2]
    raw[0::2, 1::2] = image[0::2, 1::2, 1]
    raw[1::2, 0::2] = image[1::2, 0::2, 1]
    raw[1::2, 1::2] = image[1::2, 1::2, 0]
    cv2.imwrite(str(tmp_path / "raw.png"), raw)
    assert (
        main(["--pattern", pattern_file, "--output", str(tmp_path), "--bayer", "rggb", str(tmp_path / "raw.png")]) == 0
    )
    assert len((tmp_path / "raw.csv").read_text().splitlines()) > 2400
    assert abs(int(read_image(tmp_path / "raw.png", bayer="rggb")[400, 640, 0]) - int(image[400, 640, 0])) < 60


@pytest.mark.parametrize("kind", ["missing image", "no image", "missing pattern", "bad pattern", "twice"])
def test_failures_are_one_line_and_leave_nothing(kind: str, tmp_path, pattern_file: str, capsys) -> None:
    image = tmp_path / "a.png"
    cv2.imwrite(str(image), camera_image(PATTERN, 640, 480))
    arguments = {
        "missing image": ["--pattern", pattern_file, str(tmp_path / "none.png")],
        "no image": ["--pattern", pattern_file, pattern_file],
        "missing pattern": ["--pattern", str(tmp_path / "none.yaml"), str(image)],
        "bad pattern": ["--pattern", str(image), str(image)],
        "twice": ["--pattern", pattern_file, str(image), str(image)],
    }[kind]
    assert main([*arguments, "--output", str(tmp_path / "out")]) == 1
    error = capsys.readouterr().err.strip()
    assert error.startswith("error: ")
    assert len(error.splitlines()) == 1
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("arguments", [[], ["--pattern", "p.yaml", "--min-confidence", "3", "a.png"]])
def test_wrong_usage_exits_with_two(arguments: list[str], tmp_path) -> None:
    with pytest.raises(SystemExit) as stopped:
        main([*arguments, "--output", str(tmp_path / "x")])
    assert stopped.value.code == 2
    assert not (tmp_path / "x").exists()

"""The commands as a user runs them: output, exit codes, and nothing half-written."""

import subprocess
import sys

import cv2
import numpy as np
import pytest

from pattern_gen import default_pattern


def run(command, *arguments):
    return subprocess.run(
        [sys.executable, "-m", f"pattern_gen.commands.{command}", *map(str, arguments)],
        capture_output=True,
        text=True,
        timeout=120,
    )


@pytest.fixture
def pattern_file(tmp_path):
    path = tmp_path / "pattern.yaml"
    default_pattern().save(path)
    return path


@pytest.mark.parametrize(
    "options", [["--rows", 20, "--cols", 24], ["--grid", "hexagonal", "--aspect", "4:3", "--time-limit", 2]]
)
def test_generated_files_pass_verify(tmp_path, options):
    path = tmp_path / "new" / "pattern.yaml"
    result = run("generate", "--letters", 6, "--hamming", 3, *options, "--output", path)
    assert result.returncode == 0, result.stderr
    verified = run("verify", path)
    assert verified.returncode == 0, verified.stderr
    assert "minimum distance: 3" in verified.stdout
    assert "alphabet: 6" in verified.stdout


def test_verify_refuses_a_map_that_does_not_hold(pattern_file):
    result = run("verify", pattern_file, "--hamming", 5)
    assert result.returncode == 1
    assert result.stderr.startswith("error: ")
    assert result.stderr.count("\n") == 1
    assert "differ in 3 cells, not in 5" in result.stderr


def test_export_writes_image_and_arrays_that_agree(tmp_path, pattern_file):
    result = run("export", pattern_file, "--image", tmp_path / "p.png", "--npz", tmp_path / "p.npz")
    assert result.returncode == 0, result.stderr
    arrays = np.load(tmp_path / "p.npz")
    assert arrays["image"].shape == (768, 1024, 3)
    assert arrays["symbols"].shape == (44, 58)
    assert arrays["centers"].shape == (44, 58, 2)
    assert np.array_equal(cv2.imread(str(tmp_path / "p.png"))[..., ::-1], arrays["image"])
    pattern = default_pattern()
    assert np.array_equal(arrays["symbols"], pattern.symbols)
    assert np.array_equal(arrays["centers"], pattern.centers)


@pytest.mark.parametrize(
    ("command", "arguments", "code"),
    [
        ("generate", ["--letters", 6], 2),
        ("generate", ["--letters", "six", "--output", "x.yaml"], 2),
        (
            "generate",
            ["--letters", 2, "--hamming", 3, "--rows", 30, "--cols", 30, "--time-limit", 1, "--output", "x.yaml"],
            1,
        ),
        ("verify", ["missing.yaml"], 1),
        ("export", ["missing.yaml", "--npz", "x.npz"], 1),
    ],
)
def test_failures_say_why_in_one_line_and_write_nothing(tmp_path, monkeypatch, command, arguments, code):
    monkeypatch.chdir(tmp_path)
    result = run(command, *arguments)
    assert result.returncode == code
    assert "Traceback" not in result.stderr
    if code == 1:
        assert result.stderr.strip().splitlines()[-1].startswith("error: ")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("command", ["generate", "verify", "export"])
def test_help_has_an_example(command):
    result = run(command, "--help")
    assert result.returncode == 0
    assert "example" in result.stdout

import os
import pty
import re
import select
import signal
import subprocess
import sys
import time

import cv2
import numpy as np
import pytest

from pattern_gen import Pattern
from pattern_gen.catalogue import FOLDER

READY = FOLDER / "square_44x58_a6_h3.yaml"


def run(command, *arguments, **options):
    return subprocess.run(
        [sys.executable, "-m", f"pattern_gen.commands.{command}", *map(str, arguments)],
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
        **options,
    )


def test_generate_verify_export(tmp_path):
    path, image, arrays = tmp_path / "new" / "p.yaml", tmp_path / "p.png", tmp_path / "p.npz"
    done = run("generate", "--letters", 6, "--hamming", 3, "--rows", 20, "--cols", 26, "--output", path)
    assert done.returncode == 0, done.stderr
    assert "20x26" in done.stdout
    done = run("verify", path)
    assert done.returncode == 0, done.stderr
    assert "codes: 432" in done.stdout
    assert "alphabet: 6" in done.stdout
    assert "minimum distance: 3" in done.stdout
    done = run("export", path, "--image", image, "--npz", arrays)
    assert done.returncode == 0, done.stderr
    pattern = Pattern.load(path)
    data = np.load(arrays)
    assert set(data.files) == {"image", "symbols", "centers"}
    assert np.array_equal(data["symbols"], pattern.symbols)
    assert np.array_equal(data["centers"], pattern.centers)
    assert np.array_equal(data["image"], pattern.render())
    assert np.array_equal(cv2.imread(str(image))[..., ::-1], data["image"])


@pytest.mark.parametrize(
    "options",
    [
        ["--grid", "hexagonal", "--hamming", 1, "--rows", 12, "--cols", 16],
        ["--hamming", 3, "--aspect", "16:9", "--time-limit", 0.5],
        ["--hamming", 3, "--method", "paper", "--rows", 8, "--cols", 10, "--monochrome"],
    ],
)
def test_generate_options(tmp_path, options):
    path = tmp_path / "p.yaml"
    done = run("generate", "--letters", 5, *options, "--output", path)
    assert done.returncode == 0, done.stderr
    assert run("verify", path).returncode == 0
    if "16:9" in options:
        pattern = Pattern.load(path)
        assert pattern.cols / pattern.rows == pytest.approx(16 / 9, rel=0.15)


def test_generate_enlarges_a_file_with_its_letters(tmp_path):
    small, large = tmp_path / "small.yaml", tmp_path / "large.yaml"
    done = run("generate", "--letters", 6, "--hamming", 3, "--rows", 12, "--cols", 16, "--projector", "640x480",
               "--output", small)  # fmt: skip
    assert done.returncode == 0, done.stderr
    done = run("generate", "--enlarge", small, "--rows", 15, "--cols", 20, "--output", large)
    assert done.returncode == 0, done.stderr
    assert run("verify", large).returncode == 0
    before, after = Pattern.load(small), Pattern.load(large)
    assert after.symbols.shape == (15, 20)
    assert np.array_equal(after.symbols[:12, :16], before.symbols)
    assert after.letters == before.letters
    assert (after.projector_width, after.projector_height) == (640, 480)
    message = failed(run("generate", "--enlarge", small, "--rows", 9, "--cols", 20, "--output", large))
    assert "9x20 does not hold the map to enlarge, 12x16" in message


def test_generate_finds_a_map_once_and_says_so(tmp_path):
    size = ["--letters", 6, "--hamming", 3, "--rows", 13, "--cols", 17, "--output", tmp_path / "p.yaml"]
    first, again, anew = run("generate", *size), run("generate", *size), run("generate", "--no-cache", *size)
    assert "from the cache" not in first.stdout
    assert "from the cache" in again.stdout
    assert again.stdout.startswith(first.stdout.split(", found")[0])
    assert anew.stdout.split(", found")[0] == first.stdout.split(", found")[0]
    assert "from the cache" not in anew.stdout


def failed(done):
    assert done.returncode == 1
    assert done.stderr.startswith("error: ")
    assert done.stderr.count("\n") == 1
    assert "Traceback" not in done.stderr
    return done.stderr


def test_failed_search_writes_nothing(tmp_path):
    path = tmp_path / "p.yaml"
    path.write_text("precious")
    message = failed(run("generate", "--letters", 2, "--hamming", 3, "--rows", 30, "--cols", 30, "--output", path))
    assert "at most" in message
    assert path.read_text() == "precious"
    assert [file.name for file in tmp_path.iterdir()] == ["p.yaml"]


def test_unwritable_output_is_one_line(tmp_path):
    (tmp_path / "file").write_text("")
    failed(run("generate", "--letters", 5, "--rows", 5, "--cols", 5, "--output", tmp_path / "file" / "p.yaml"))
    assert [file.name for file in tmp_path.iterdir()] == ["file"]


def test_verify_names_both_places_and_the_wrong_symbol(tmp_path):
    text = READY.read_text()
    lines = text.splitlines()
    first = next(i for i, line in enumerate(lines) if line.startswith('- "'))
    for i in range(3):  # the first window once more, in the same rows
        row = lines[first + i]
        lines[first + i] = row[:33] + row[3:6] + row[36:]
    path = tmp_path / "copy.yaml"
    path.write_text("\n".join(lines))
    message = failed(run("verify", path))
    assert "row 1, column 1 " in message
    assert "row 1, column 31 " in message
    path.write_text(re.sub('- "\\d', '- "z', text, count=1))
    message = failed(run("verify", path))
    assert "row 0, column 0" in message
    assert "6 letters" in message
    assert f":{first + 1}:" in message


def test_export_failures_leave_nothing(tmp_path):
    failed(run("export", tmp_path / "missing.yaml", "--npz", tmp_path / "p.npz"))
    failed(run("export", READY, "--image", tmp_path / "p.jpg"))
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("command", "arguments"),
    [
        ("generate", []),
        ("generate", ["--output", "x"]),
        ("generate", ["--enlarge", READY, "--letters", 6, "--output", "x"]),
        ("generate", ["--letters", 6, "--rows", 4, "--output", "x"]),
        ("generate", ["--letters", 6, "--time-limit", -1, "--output", "x"]),
        ("export", [READY]),
        ("verify", []),
        ("tables", ["--table", "cubic", "--output", "x"]),
    ],
)
def test_wrong_usage_exits_with_2(command, arguments):
    assert run(command, *arguments).returncode == 2


@pytest.mark.parametrize("command", ["generate", "verify", "export", "tables"])
def test_help_has_an_example(command):
    done = run(command, "--help")
    assert done.returncode == 0
    assert "example" in done.stdout


def test_ctrl_c_keeps_the_best_so_far_and_progress_is_shown(tmp_path):
    path = tmp_path / "p.yaml"
    terminal, theirs = pty.openpty()
    process = subprocess.Popen(
        [sys.executable, "-m", "pattern_gen.commands.generate", "--letters", "6", "--hamming", "3",
         "--time-limit", "300", "--output", str(path)],
        stdout=subprocess.PIPE, stderr=theirs, text=True,
    )  # fmt: skip
    os.close(theirs)
    shown, end = "", time.monotonic() + 60
    while not re.search(r"best \d+x\d+", shown) and time.monotonic() < end:
        if select.select([terminal], [], [], 1.0)[0]:
            shown += os.read(terminal, 4096).decode(errors="replace")
    assert re.search(r"best \d+x\d+, trying \d+x\d+", shown)
    process.send_signal(signal.SIGINT)
    process.communicate(timeout=60)
    os.close(terminal)
    assert process.returncode == 0
    assert Pattern.load(path).min_hamming == 3
    assert run("verify", path).returncode == 0


def test_tables_verify_and_draw_what_they_list(tmp_path):
    done = run("tables", "--output", tmp_path, "--table", "square", "--hamming", 3, "--letters", 4, "--paper-time", 0.5)
    assert done.returncode == 0, done.stderr
    assert "18x24" in (tmp_path / "tables.md").read_text()
    assert (tmp_path / "tables.csv").read_text().startswith("table,a,h")
    assert cv2.imread(str(tmp_path / "square_a4_h3.png")) is not None
    assert run("verify", tmp_path / "square_a4_h3.yaml").returncode == 0

"""The demo by its command: exit code and figures, and no process left behind however it ends."""

import json
import os
import signal
import subprocess
import sys
import time

import pytest
from stack_testing.running import wait_for

pytestmark = pytest.mark.processes


def demo(output, *arguments):
    return [sys.executable, "-m", "sl_bringup.commands.demo", "--short", "--output", str(output), *arguments]


def processes_about(path):
    """Return the live processes that inherited the mark of a demo with this output."""
    found = []
    for entry in os.listdir("/proc"):
        if not entry.isdigit() or int(entry) == os.getpid():
            continue
        try:
            with open(f"/proc/{entry}/environ", "rb") as file:
                marked = f"SL_TEST_MARK={path}".encode() in file.read()
            with open(f"/proc/{entry}/stat") as file:
                alive = file.read().rpartition(")")[2].split()[0] not in "ZX"
        except (FileNotFoundError, ProcessLookupError, PermissionError):
            continue
        if marked and alive:
            found.append(int(entry))
    return found


def start(output, *arguments):
    """Start a demo whose processes, and theirs, all inherit a mark."""
    environment = dict(os.environ, SL_TEST_MARK=str(output))
    return subprocess.Popen(
        demo(output, *arguments),
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        start_new_session=True,
    )


def finish(process):
    text, _ = process.communicate(timeout=480)
    return text


@pytest.mark.timeout(500)
def test_the_arm_calibrates_itself_and_ends_where_it_should(tmp_path):
    output = tmp_path / "out"
    process = start(output, "--calibration", "self")
    try:
        text = finish(process)
        assert process.returncode == 0, text
        rows = {row["name"].strip(): row for row in json.loads((output / "report.json").read_text())}
        assert all(row["ok"] is not False for row in rows.values())
        assert rows["camera position against the commanded pose"]["value"] <= 2.0
        assert rows["camera orientation against the commanded pose"]["value"] <= 0.5
        assert rows["stand-off from the true surface, error"]["value"] <= 2.0
        assert rows["optical axis against the true surface normal"]["value"] <= 0.5
        assert rows["limit violations counted by the driver"]["value"] == 0
        assert rows["setpoints received by the driver"]["value"] > 400
        assert rows["dots decoded per image, median"]["value"] > 700
        assert rows["of these with a wrong row or column"]["value"] < 0.5
        assert 0 < rows["point error, median"]["value"] < 1.0
        assert rows["hand-eye transform, position error"]["value"] < 1.0
        assert rows["projector pose, position error"]["value"] < 1.5
        assert "point error, median" in text
        wait_for(lambda: not processes_about(output), 5, "end of all processes")
    finally:
        kill(process, output)


@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 130), (signal.SIGKILL, -9)])
def test_no_process_is_left_behind_when_the_demo_is_stopped(number, code, tmp_path):
    output = tmp_path / "out"
    process = start(output)
    try:
        wait_for(lambda: len(processes_about(output)) >= 6, 60, "start of the nodes")
        time.sleep(2.0)
        process.send_signal(number)
        text = finish(process)
        assert process.returncode == code, text
        assert "Traceback" not in text
        wait_for(lambda: not processes_about(output), 10, "end of all processes")
    finally:
        kill(process, output)


def test_a_dying_node_ends_the_demo_with_one_line_that_names_it(tmp_path):
    output = tmp_path / "out"
    process = start(output, "--scene", "moon")
    try:
        text = finish(process)
        assert process.returncode == 1
        errors = [line for line in text.splitlines() if line.startswith("error: ")]
        assert len(errors) == 1
        assert "cell ended" in errors[0]
        assert "moon" in errors[0]
        wait_for(lambda: not processes_about(output), 5, "end of all processes")
    finally:
        kill(process, output)


def test_a_folder_that_is_not_a_demos_output_is_left_alone(tmp_path):
    (tmp_path / "precious.txt").write_text("mine")
    done = subprocess.run(demo(tmp_path), capture_output=True, text=True, timeout=60)
    assert done.returncode == 1
    assert done.stderr.startswith("error: ")
    assert (tmp_path / "precious.txt").read_text() == "mine"


@pytest.mark.parametrize(
    "arguments", [["--standoff", "9"], ["--duration", "-1"], ["--calibration", "guess"], ["extra"]]
)
def test_wrong_usage_is_exit_code_2(arguments, tmp_path):
    done = subprocess.run(demo(tmp_path / "out", *arguments), capture_output=True, text=True, timeout=60)
    assert done.returncode == 2
    assert not (tmp_path / "out").exists()


def kill(process, output):
    """Whatever a failed test left."""
    for pid in processes_about(output):
        try:
            os.kill(pid, signal.SIGKILL)
        except ProcessLookupError:
            pass
    process.wait(10)

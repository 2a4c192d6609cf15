"""Every executable starts with `ros2 run`, says what it waits for, and stops cleanly."""

import os
import shutil
import signal
import subprocess
import time

import pytest
from stack_testing import packages
from stack_testing.running import START_UP, wait_for

from sl_bringup.isolation import environment, free_domain

EXECUTABLES = packages.executables()
COMMANDS = sorted(set(EXECUTABLES) - set(packages.NODES))
INPUTS = {
    "pattern_publisher": [],
    "decoder": [
        "/pattern (sl_msgs/msg/Pattern; reliable, transient local",
        "/camera/image_raw (sensor_msgs/msg/Image; best effort",
    ],
    "triangulator": [
        "/correspondences (sl_msgs/msg/Correspondences; best effort",
        "/joint_states (sensor_msgs/msg/JointState; best effort",
        "/robot_description (std_msgs/msg/String; reliable, transient local",
    ],
    "calibrator": ["/joint_states (sensor_msgs/msg/JointState; best effort", "/robot_description (std_msgs/msg/String"],
    "positioner": [
        "/points (sensor_msgs/msg/PointCloud2; best effort",
        "/joint_states (sensor_msgs/msg/JointState; best effort",
        "/robot_description (std_msgs/msg/String; reliable, transient local",
    ],
    "cell": ["/projector/image (sensor_msgs/msg/Image; reliable, transient local"],
}
"""What each node waits for when it starts alone."""


def ros2_run(*words):
    return ["bash", "-c", f'source {packages.ROOT}/env.sh && exec ros2 run "$@"', "ros2", *words]


def test_the_contracts_nodes_are_all_there():
    missing = {node for node, package in packages.NODES.items() if EXECUTABLES.get(node) != package}
    assert not missing


@pytest.mark.processes
@pytest.mark.parametrize("node", packages.NODES)
@pytest.mark.parametrize("number", [signal.SIGINT])
def test_a_node_says_what_it_waits_for_and_ends_with_0(node, number, tmp_path):
    log = tmp_path / "log"
    with free_domain() as domain, log.open("wb") as output:
        process = subprocess.Popen(
            ros2_run(packages.NODES[node], node),
            env=environment(domain),
            cwd=tmp_path,
            stdout=output,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )
        try:
            deadline = time.monotonic() + START_UP
            while time.monotonic() < deadline and process.poll() is None:
                text = log.read_text()
                if all(f"waiting for {words}" in text for words in INPUTS[node]) and f"[{node}]" in text:
                    break
                time.sleep(0.1)
            text = log.read_text()
            assert process.poll() is None, f"it ended on its own:\n{text}"
            for words in INPUTS[node]:
                assert f"waiting for {words}" in text
            assert "Traceback" not in text
            process.send_signal(number)
            assert process.wait(20) == 0, log.read_text()
            assert "Traceback" not in log.read_text()
            wait_for(lambda: not group_members(process.pid), 5, "end of the processes it had started")
        finally:
            try:
                os.killpg(process.pid, signal.SIGKILL)
            except ProcessLookupError:
                pass
            process.wait(10)


def group_members(group):
    """Return the live processes of a process group."""
    found = []
    for entry in os.listdir("/proc"):
        if entry.isdigit():
            try:
                with open(f"/proc/{entry}/stat") as file:
                    fields = file.read().rpartition(")")[2].split()
            except (FileNotFoundError, ProcessLookupError):
                continue
            if int(fields[2]) == group and fields[0] not in "ZX":
                found.append(int(entry))
    return found


@pytest.mark.parametrize("command", COMMANDS)
def test_a_command_explains_itself_with_an_example_and_refuses_nonsense(command):
    package = EXECUTABLES[command]
    shown = subprocess.run(ros2_run(package, command, "--help"), capture_output=True, text=True, timeout=90)
    assert shown.returncode == 0, shown.stderr
    assert f"ros2 run {package} {command}" in shown.stdout
    assert "example" in shown.stdout.lower()
    wrong = subprocess.run(ros2_run(package, command, "--no-such-option"), capture_output=True, text=True, timeout=90)
    assert wrong.returncode == 2
    assert "Traceback" not in wrong.stderr


def test_an_unknown_executable_or_package_is_one_line():
    for words, expected in ((["sl_decoder", "nothing"], "executable"), (["nothing", "decoder"], "not found")):
        done = subprocess.run(ros2_run(*words), capture_output=True, text=True, timeout=60)
        assert done.returncode != 0
        assert expected in (done.stdout + done.stderr).lower()


@pytest.mark.skipif(
    shutil.which("ros2") is not None and "workspace" not in str(shutil.which("ros2")), reason="real ros2cli"
)
def test_the_stand_in_for_ros2_says_that_it_knows_run_only():
    command = f"source {packages.ROOT}/env.sh && ros2 topic list"
    done = subprocess.run(["bash", "-c", command], capture_output=True, text=True, timeout=60)
    assert done.returncode == 2
    assert "ros2 run" in done.stderr


@pytest.mark.processes
@pytest.mark.parametrize(
    ("node", "parameter"), [("decoder", "min_confidence:=3.0"), ("positioner", "rate:=fast"), ("cell", "scene:=moon")]
)
def test_a_bad_parameter_is_one_line_and_exit_code_1(node, parameter, tmp_path):
    with free_domain() as domain:
        done = subprocess.run(
            ros2_run(packages.NODES[node], node, "--ros-args", "-p", parameter),
            env=environment(domain),
            capture_output=True,
            text=True,
            timeout=START_UP,
            cwd=tmp_path,
        )
    assert done.returncode == 1, done.stderr
    errors = [line for line in done.stderr.splitlines() if line.startswith("error: ")]
    assert len(errors) == 1
    assert parameter.split(":=")[0] in errors[0]
    assert "Traceback" not in done.stderr

"""The launch files: everything they name exists; run for real where launch is installed."""

import ast
import subprocess
import sys

import pytest
from stack_testing import packages

FOLDER = packages.ROOT / "sl_bringup"
FILES = sorted((FOLDER / "launch").glob("*.launch.py"))
OTHERS = {"rviz2": "rviz2"}
"""Nodes of other projects that a launch file may start."""


def strings(path):
    return {
        n.value
        for n in ast.walk(ast.parse(path.read_text()))
        if isinstance(n, ast.Constant) and isinstance(n.value, str)
    }


def nodes(path):
    """Return (package, executable) of the calls that start a node."""
    found = set()
    for call in ast.walk(ast.parse(path.read_text())):
        if not isinstance(call, ast.Call) or not isinstance(call.func, ast.Name):
            continue
        words = {k.arg: k.value.value for k in call.keywords if isinstance(k.value, ast.Constant)}
        if call.func.id == "Node" and {"package", "executable"} <= set(words):
            found.add((words["package"], words["executable"]))
        elif call.func.id == "node":
            found.add((call.args[0].value, call.args[1].value))
    return found


@pytest.mark.parametrize("path", FILES, ids=lambda p: p.name)
def test_a_launch_file_starts_what_exists(path):
    started = nodes(path)
    known = {(package, name) for name, package in packages.executables().items()} | set(OTHERS.items())
    assert started
    assert started <= known
    for name in strings(path):
        if (
            name.endswith((".yaml", ".rviz", ".launch.py"))
            and name[0] != "."
            and "/" not in name
            and " " not in name
            and "{" not in name
        ):
            assert list(FOLDER.rglob(name)), f"{name} does not exist"


def test_the_real_cells_launch_file_starts_the_whole_chain_and_no_simulation():
    started = {name for _, name in nodes(FOLDER / "launch/structured_light.launch.py")}
    assert set(packages.NODES) - {"cell"} <= started
    assert "cell" not in started


@pytest.mark.parametrize("path", FILES, ids=lambda p: p.name)
def test_launch_itself_accepts_the_file(path):
    pytest.importorskip("launch_ros", reason="launch comes with a full ROS 2 installation")
    code = (
        "import runpy, sys; from launch import LaunchContext, LaunchDescription;"
        "d = runpy.run_path(sys.argv[1])['generate_launch_description']();"
        "assert isinstance(d, LaunchDescription); print(len(d.describe_sub_entities() or d.entities))"
    )
    done = subprocess.run([sys.executable, "-c", code, str(path)], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr


def test_the_layouts_can_be_parsed():
    import json

    import yaml

    for path in (FOLDER / "rviz").glob("*.rviz"):
        assert "Visualization Manager" in yaml.safe_load(path.read_text())
    for path in (FOLDER / "foxglove").glob("*.json"):
        assert "layout" in json.loads(path.read_text())

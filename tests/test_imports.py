"""Algorithms never import rclpy or a message package, directly or through others; dependencies point one way."""

import ast

import pytest
from stack_testing import packages

ROS = {
    "rclpy",
    "sl_msgs",
    "action_msgs",
    "builtin_interfaces",
    "diagnostic_msgs",
    "geometry_msgs",
    "nav_msgs",
    "rcl_interfaces",
    "rosgraph_msgs",
    "sensor_msgs",
    "std_msgs",
    "std_srvs",
    "trajectory_msgs",
    "visualization_msgs",
    "launch",
    "launch_ros",
}
ROS_PARTS = {"ros", "nodes", "node", "messages", "ros_conversions", "node_parameters"}
"""Names of sub-packages and modules that may speak ROS, besides sl_bringup, which is about running nodes."""
ORDER = ["sl_common", "pattern_gen", "sl_decoder", "sl_calibration", "arm_positioner", "sl_sim", "sl_bringup"]


def imported(path, package):
    """Return the dotted names that a module imports, in functions too."""
    names = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            names |= {f"{node.module}.{alias.name}" for alias in node.names} | {node.module}
    return names


MODULES = {name: path for package in packages.PYTHON_PACKAGES for name, path in packages.modules(package).items()}
IMPORTS = {name: imported(path, name.split(".")[0]) for name, path in MODULES.items()}


def reaches_ros(name, trail=()):
    """Return the chain of imports by which a module reaches ROS, or None."""
    if name in trail:
        return None
    for other in sorted(IMPORTS[name]):
        if other.split(".")[0] in ROS:
            return (*trail, name, other)
        known = other if other in MODULES else None
        if known and known != name and (found := reaches_ros(known, (*trail, name))):
            return found
    return None


ALGORITHMS = [
    name
    for name in MODULES
    if name.split(".")[0] != "sl_bringup" and not ROS_PARTS & set(name.split(".")[1:]) and len(name.split(".")) > 1
]


def test_the_walk_finds_what_it_should():
    """The check itself: nodes are seen to reach ROS, and there are many algorithm modules."""
    assert reaches_ros("sl_decoder.node")
    assert reaches_ros("sl_calibration.nodes.triangulator")
    assert reaches_ros("sl_bringup.commands.demo")
    assert len(ALGORITHMS) > 60


@pytest.mark.parametrize("name", ALGORITHMS)
def test_an_algorithm_never_imports_ros(name):
    chain = reaches_ros(name)
    assert chain is None, " -> ".join(chain)


@pytest.mark.parametrize("name", MODULES)
def test_rclpy_stays_in_nodes_and_ros_folders(name):
    direct = any(other.split(".")[0] == "rclpy" for other in IMPORTS[name])
    assert not direct or {"ros", "nodes", "node", "decoder_node"} & set(name.split(".")), "imports rclpy"


@pytest.mark.parametrize("name", MODULES)
def test_dependencies_point_one_way(name):
    own = ORDER.index(name.split(".")[0])
    for other in IMPORTS[name]:
        package = other.split(".")[0]
        if package in ORDER:
            assert ORDER.index(package) <= own, f"{name} imports {other}"


@pytest.mark.parametrize("package", packages.PYTHON_PACKAGES)
def test_package_xml_declares_the_packages_it_imports(package):
    text = (packages.ROOT / package / "package.xml").read_text()
    used = {other.split(".")[0] for name in MODULES if name.split(".")[0] == package for other in IMPORTS[name]}
    for other in sorted(used & (ROS | set(ORDER))):
        if other != package:
            assert f"depend>{other}</" in text, f"{package}/package.xml does not declare {other}"


@pytest.mark.parametrize("name", MODULES)
def test_a_module_fits_on_a_few_screens(name):
    lines = len(MODULES[name].read_text().splitlines())
    limit = 300 if name.endswith((".node", ".triangulator", ".calibrator")) else 450
    assert lines <= limit, f"{lines} lines"

"""Every node, parameter, topic, service and executable is in README.md."""

import ast
import re

import pytest
from stack_testing import packages

README = packages.ROOT / "README.md"
IGNORED = {"/parameter_events", "/rosout", "/clock"}


def declared(path):
    """Return the parameter names of the `declare` calls in a module, those in a helper's first argument included."""
    tree = ast.parse(path.read_text())
    helpers = {
        node.name
        for node in ast.walk(tree)
        if isinstance(node, ast.FunctionDef)
        and not node.name.startswith("__")
        and any(isinstance(n, ast.Name) and n.id == "declare" for n in ast.walk(node))
    }
    names = set()
    for node in ast.walk(tree):
        if not isinstance(node, ast.Call) or not node.args:
            continue
        called = node.func.id if isinstance(node.func, ast.Name) else getattr(node.func, "attr", "")
        at = 1 if called == "declare" else 0
        if (called == "declare" or called in helpers) and len(node.args) > at:
            value = node.args[at]
            if isinstance(value, ast.Constant) and isinstance(value.value, str):
                names.add(value.value)
    return names


def parameters(package):
    return {n for path in packages.modules(package).values() if "commands" not in path.parts for n in declared(path)}


def interfaces(package):
    """Return the names given to publishers, subscriptions, services and actions of a package's nodes."""
    makers = {"create_publisher": 1, "create_subscription": 1, "create_service": 1, "_subscribe": 1}
    names = set()
    for path in packages.modules(package).values():
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Call):
                called = getattr(node.func, "attr", getattr(node.func, "id", ""))
                at = makers.get(called, 2 if called == "ActionServer" else None)
                if at is not None and len(node.args) > at and isinstance(node.args[at], ast.Constant):
                    names.add(node.args[at].value)
    return names - IGNORED


@pytest.fixture(scope="module")
def readme():
    assert README.exists(), "README.md is missing"
    return README.read_text()


NODE_PACKAGES = sorted(set(packages.NODES.values()))
PARAMETERS = [(p, name) for p in NODE_PACKAGES for name in sorted(parameters(p))]
INTERFACES = [(p, name) for p in NODE_PACKAGES for name in sorted(interfaces(p))]


def test_the_parsers_find_what_is_known_to_be_there():
    assert {"calibration_folder", "max_epipolar_distance", "joint_wait"} <= parameters("sl_calibration")
    assert {"scene", "camera_rate"} <= parameters("sl_sim")
    assert {"rate", "standoff", "cloud_timeout", "max_jerk"} <= parameters("arm_positioner")
    assert {"min_confidence", "tracking"} <= parameters("sl_decoder")
    assert {"~/status", "~/pause", "commands"} <= interfaces("arm_positioner")
    assert {"correspondences", "~/debug_image", "pattern"} <= interfaces("sl_decoder")
    assert len(PARAMETERS) > 70


@pytest.mark.parametrize(("package", "name"), PARAMETERS)
def test_a_parameter_is_documented(readme, package, name):
    assert f"`{name}`" in readme, f"parameter {name} of {package} is not in README.md"


@pytest.mark.parametrize(("package", "name"), INTERFACES)
def test_a_topic_service_or_action_is_documented(readme, package, name):
    assert f"`{name}`" in readme, f"{name} of {package} is not in README.md"


@pytest.mark.parametrize(("name", "package"), sorted(packages.executables().items()))
def test_an_executable_is_documented(readme, name, package):
    assert re.search(rf"ros2 run {package} {name}\b", readme), f"`ros2 run {package} {name}` is not in README.md"


@pytest.mark.parametrize("path", sorted((packages.ROOT / "sl_bringup/config").glob("*.yaml")), ids=lambda p: p.stem)
def test_the_default_parameter_files_name_real_parameters(path):
    import yaml

    node = path.stem
    if node not in packages.NODES:
        return
    known = parameters(packages.NODES[node])
    given = yaml.safe_load(path.read_text())[f"/**/{node}"]["ros__parameters"]
    assert set(given) <= known, f"unknown: {set(given) - known}"

"""What the workspace consists of, read from its files."""

import ast
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PYTHON_PACKAGES = ("sl_common", "pattern_gen", "sl_decoder", "sl_calibration", "arm_positioner", "sl_sim", "sl_bringup")
NODES = {
    "pattern_publisher": "pattern_gen",
    "decoder": "sl_decoder",
    "triangulator": "sl_calibration",
    "calibrator": "sl_calibration",
    "positioner": "arm_positioner",
    "cell": "sl_sim",
}
"""Nodes of the Contract and their packages."""


def executables() -> dict[str, str]:
    """Return package by executable, from the packages' setup.py."""
    out = {}
    for package in PYTHON_PACKAGES:
        for node in ast.walk(ast.parse((ROOT / package / "setup.py").read_text())):
            if isinstance(node, ast.Constant) and isinstance(node.value, str) and ":main" in node.value:
                out[node.value.split("=")[0].strip()] = package
    return out


def modules(package: str) -> dict[str, Path]:
    """Return the file of every module of a package by dotted name."""
    folder = ROOT / package / package
    out = {}
    for path in sorted(folder.rglob("*.py")):
        parts = path.relative_to(ROOT / package).with_suffix("").parts
        out[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return out

import subprocess
import sys
from pathlib import Path

import pytest

import arm_positioner
from arm_positioner.errors import Code


def test_codes_are_those_of_the_message():
    message = pytest.importorskip("sl_msgs.msg").PositionerStatus
    for code in Code:
        assert getattr(message, code.name) == code.value
    names = [n for n in dir(message) if n.isupper() and not n.startswith("_")]
    assert {n for n in names if isinstance(getattr(message, n), int)} == {c.name for c in Code}


def test_the_core_does_not_know_ros():
    folder = Path(arm_positioner.__file__).parent
    core = [p.stem for p in folder.glob("*.py") if p.stem not in ("__init__", "node")]
    assert len(core) > 15
    script = "import sys, importlib\n" + "".join(f"importlib.import_module('arm_positioner.{m}')\n" for m in core)
    script += "sys.exit('rclpy' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", script], check=False).returncode == 0

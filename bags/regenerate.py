"""Regenerate the bags of this folder: `source env.sh; python bags/regenerate.py`. The same come out each time."""

import shutil
import sys
from pathlib import Path

from sl_bringup.commands import record_bag

BAGS = {"wavy": ["--scene", "wavy", "--seed", "1", "--frames", "5"]}
"""Name of the folder and arguments of `ros2 run sl_bringup record_bag`."""


def main() -> int:
    """Replace every bag."""
    here = Path(__file__).resolve().parent
    for name, arguments in BAGS.items():
        shutil.rmtree(here / name, ignore_errors=True)
        code = record_bag.main([*arguments, "--output", str(here / name)])
        if code:
            return code
    return 0


if __name__ == "__main__":
    sys.exit(main())

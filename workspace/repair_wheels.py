"""Repair the ROS wheels' exported CMake files, which carry the paths of the machine that built them.

The files name the builder's Python and numpy include folders; they are pointed at this interpreter's. Run with the
venv's Python; running it again changes nothing.
"""

import re
import sys
import sysconfig
from pathlib import Path

import numpy as np

BUILDER = re.compile(
    r"/opt/python/cp\d+-cp\d+/(?P<rest>include/python[\d.]+|lib/python[\d.]+/site-packages/numpy/_core/include)"
)


def repair(prefix: Path) -> int:
    """Rewrite the files below ``prefix``/share; return how many were changed."""
    replacements = {"include": sysconfig.get_path("include"), "lib": np.get_include()}
    changed = 0
    for path in prefix.glob("share/**/*.cmake"):
        text = path.read_text()
        mended = BUILDER.sub(lambda match: replacements[match["rest"].split("/")[0]], text)
        if mended != text:
            path.write_text(mended)
            changed += 1
    return changed


if __name__ == "__main__":
    print(f"repaired {repair(Path(sys.prefix))} CMake files of the wheels")

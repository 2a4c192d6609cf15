import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
from positioner_scenes import cast, plane

from arm_positioner.errors import TargetError
from arm_positioner.target import TargetOptions, find_target, other_targets
from arm_positioner.target_process import TargetProcess
from sl_common import transforms

CAMERA = transforms.identity()


@pytest.fixture
def elsewhere():
    it = TargetProcess()
    yield it
    it.close()


def test_it_answers_as_find_target_does(elsewhere):
    points, row, col = cast(plane((0, 0, 1.0), (0.1, 0, -1.0)), noise=3e-4)
    kwargs = {"row": row, "col": col, "options": TargetOptions(standoff=0.2)}
    here, there = find_target(points, CAMERA, **kwargs), elsewhere.find(points, CAMERA, **kwargs)
    assert np.array_equal(here.base_from_camera, there.base_from_camera)
    here, there = other_targets(points, CAMERA, **kwargs), elsewhere.others(points, CAMERA, **kwargs)
    assert [t.surface.point.tolist() for t in here] == [t.surface.point.tolist() for t in there]
    with pytest.raises(TargetError, match="0 usable points of 0"):
        elsewhere.find(np.zeros((0, 3)), CAMERA)
    with pytest.raises(Exception, match="surface fit failed"):
        elsewhere.find("nonsense", CAMERA)


def test_it_survives_the_loss_of_the_process(elsewhere):
    points, _, _ = cast(plane((0, 0, 1.0), (0.1, 0, -1.0)), noise=3e-4)
    elsewhere._process.kill()
    elsewhere._process.wait()
    for _ in range(2):
        assert elsewhere.find(points, CAMERA).object_points > 1000


def test_it_does_not_outlive_a_killed_parent():
    script = (
        "import time\nfrom arm_positioner.target_process import TargetProcess\n"
        "print(TargetProcess()._process.pid, flush=True)\ntime.sleep(60)"
    )
    parent = subprocess.Popen([sys.executable, "-c", script], stdout=subprocess.PIPE, text=True)
    child = int(parent.stdout.readline())
    time.sleep(0.2)
    parent.send_signal(signal.SIGKILL)
    parent.wait()
    end = time.monotonic() + 15
    while time.monotonic() < end:
        try:
            os.kill(child, 0)
            with open(f"/proc/{child}/stat") as stat:
                if stat.read().split()[2] == "Z":
                    return
        except (ProcessLookupError, FileNotFoundError):
            return
        time.sleep(0.1)
    pytest.fail("the process is still there")

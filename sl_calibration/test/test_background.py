"""A node that is told to stop while a computation runs in its background."""

import os
import signal
import subprocess
import sys

import pytest

pytest.importorskip("rclpy")
pytestmark = pytest.mark.processes

NODE = """
import time
from rclpy.node import Node
from sl_calibration.nodes.background import Background, end_process
from sl_common.ros.run import run_node

class Busy(Node):
    def __init__(self):
        super().__init__("busy")
        self.background = Background(self)
        self.begin = self.create_timer(0.01, self.compute)

    async def compute(self):
        self.begin.cancel()
        await self.background.run(self.long)

    def long(self):
        print("computing", flush=True)
        time.sleep(600)

    def destroy_node(self):
        self.background.close()
        super().destroy_node()
        print("gone", flush=True)

raise SystemExit(end_process(run_node(Busy)))
"""


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_it_does_not_wait_for_the_computation(number):
    environment = os.environ | {"ROS_DOMAIN_ID": "39", "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    node = subprocess.Popen([sys.executable, "-c", NODE], stdout=subprocess.PIPE, text=True, env=environment)
    try:
        assert node.stdout.readline() == "computing\n"
        node.send_signal(number)
        output, _ = node.communicate(timeout=120)  # the computation takes five times that
        assert node.returncode == 0
        assert output.endswith("gone\n")
    finally:
        node.kill()
        node.wait()

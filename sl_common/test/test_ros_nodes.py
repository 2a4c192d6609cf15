"""Parameters, diagnostics and the running of nodes, on real nodes."""

import os
import signal
import subprocess
import sys
import textwrap
import threading
import time

import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node

from sl_common.errors import InvalidInputError
from sl_common.ros import diagnostics
from sl_common.ros.diagnostics import Diagnostics
from sl_common.ros.parameters import declare

DOMAIN = 1
ISOLATED = {"ROS_DOMAIN_ID": str(DOMAIN), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}


@pytest.fixture
def make_node(monkeypatch):
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    context = rclpy.Context()
    rclpy.init(context=context, domain_id=DOMAIN)
    nodes = []

    def make(*overrides):
        arguments = [word for override in overrides for word in ("-p", override)]
        nodes.append(Node("tested", context=context, cli_args=["--ros-args", *arguments] if arguments else None))
        return nodes[-1]

    yield make
    for node in nodes:
        node.destroy_node()
    rclpy.shutdown(context=context)


def test_parameters_take_the_type_of_their_default_and_floats_take_integers(make_node):
    node = make_node("rate:=100", "names:=[a, b]", "gains:=[1, 2]")
    assert declare(node, "rate", 125.0, "Control rate.", unit="Hz", minimum=1.0) == 100.0
    assert isinstance(node.get_parameter("rate").value, int | float)
    assert declare(node, "names", ["x"], "Joints.") == ["a", "b"]
    assert declare(node, "gains", [0.5], "Gains.") == [1.0, 2.0]
    assert declare(node, "untouched", True, "A switch.") is True


@pytest.mark.parametrize(
    ("override", "default", "options", "reason"),
    [
        ("p:=0", 125.0, {"minimum": 1.0, "unit": "Hz"}, "parameter p is 0, expected at least 1 Hz"),
        ("p:=7", 1, {"minimum": 0, "maximum": 5}, "parameter p is 7, expected at least 0 and at most 5"),
        ("p:=fast", 125.0, {}, "parameter p is 'fast' .str., expected float such as 125.0"),
        ("p:=red", "green", {"choices": ("green", "blue")}, "parameter p is 'red', expected one of green, blue"),
        ("p:=[1.0, -1.0]", [1.0], {"minimum": 0.0}, "parameter p is -1, expected at least 0"),
        ("p:=.nan", 1.0, {"minimum": 0.0}, "parameter p is nan"),
    ],
)
def test_unusable_parameters_are_refused_with_the_value_and_the_range(make_node, override, default, options, reason):
    with pytest.raises(InvalidInputError, match=reason):
        declare(make_node(override), "p", default, "Tested.", **options)


def test_diagnostics_survive_ticks_from_other_threads_while_they_publish(make_node):
    node = make_node()
    reports = Diagnostics(node, "cell")
    received = []
    node.create_subscription(DiagnosticArray, "/diagnostics", received.append, 10)
    running = True

    def tick():
        while running:
            reports.tick("images")
            reports.set("temperature", 21.5)

    threads = [threading.Thread(target=tick) for _ in range(3)]
    for thread in threads:
        thread.start()
    try:
        for _ in range(300):
            reports.publish()
    finally:
        running = False
        for thread in threads:
            thread.join()
    reports.level(diagnostics.WARN, "too dark")
    executor = rclpy.executors.SingleThreadedExecutor(context=node.context)
    executor.add_node(node)
    reports.publish()
    for _ in range(100):
        executor.spin_once(timeout_sec=0.1)
        if received and received[-1].status[0].message == "too dark":
            break
    status = received[-1].status[0]
    assert (status.level, status.message, status.hardware_id) == (diagnostics.WARN, "too dark", "cell")
    values = {v.key: v.value for v in status.values}
    assert values["temperature"] == "21.5"
    assert int(values["images total"]) > 0


PROGRAM = """
    import sys
    import time

    from rclpy.node import Node
    from sl_common.errors import InvalidInputError
    from sl_common.ros.run import run_node

    class Tested(Node):
        def __init__(self):
            super().__init__("tested")
            if "fail" in sys.argv:
                raise InvalidInputError("the lens cap is on: remove it")
            self.create_timer(0.05, self._work)

        def _work(self):
            print("spinning", flush=True)
            if "slow" in sys.argv:
                time.sleep(3.0)
                print("done", flush=True)

        def destroy_node(self):
            assert self.context.ok(), "a node must be able to publish while it is destroyed"
            print("destroyed", flush=True)
            super().destroy_node()

    sys.exit(run_node(Tested))
"""


def start(*arguments):
    return subprocess.Popen(
        [sys.executable, "-c", textwrap.dedent(PROGRAM), *arguments],
        env=os.environ | ISOLATED,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


@pytest.mark.parametrize("stop", [signal.SIGINT, signal.SIGTERM])
def test_a_node_stops_cleanly_on_a_signal(stop):
    process = start()
    assert process.stdout.readline() == "spinning\n"
    process.send_signal(stop)
    out, err = process.communicate(timeout=30)
    assert process.returncode == 0, err
    assert out.endswith("destroyed\n")
    assert "Traceback" not in err


@pytest.mark.parametrize(("pauses", "finished"), [([], True), ([0.1], True), ([0.1, 1.5], False)])
def test_a_signal_lets_a_callback_finish_unless_another_comes_later(pauses, finished):
    process = start("slow")
    assert process.stdout.readline() == "spinning\n"
    process.send_signal(signal.SIGINT)
    for pause in pauses:
        time.sleep(pause)
        process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=30)
    assert process.returncode == 0, err
    assert out == ("done\n" if finished else "") + "destroyed\n"


def test_a_node_that_cannot_start_says_why_in_one_line():
    result = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(PROGRAM), "fail"],
        env=os.environ | ISOLATED,
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert result.returncode == 1
    assert result.stderr == "error: the lens cap is on: remove it\n"

"""The decoder as a node: rate, latency and drops over DDS at a camera's rate."""

import threading
import time
from pathlib import Path

import numpy as np
import rclpy
from numpy.typing import NDArray
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from sensor_msgs.msg import Image
from std_msgs.msg import Header

from pattern_gen import Pattern, default_pattern
from pattern_gen.ros_conversions import pattern_to_message
from sl_bringup.demo.report import Row
from sl_bringup.errors import DemoError
from sl_bringup.isolation import environment
from sl_bringup.processes import Executable, Process, ProcessGroup
from sl_common.ros import images
from sl_common.ros.qos import LATCHED, STREAM_PUBLISH, STREAM_SUBSCRIBE
from sl_common.ros.stamps import from_ns, to_ns
from sl_decoder.benchmark import camera_image
from sl_msgs.msg import Correspondences
from sl_msgs.msg import Pattern as PatternMessage

SIZES = ((640, 480, 30), (640, 480, 60), (1280, 960, 30))
"""Width, height, images per second."""
MAX_MEMORY = 250.0
"""Of the decoder node [MB]."""
_WARM_UP = 1.0


class _Camera(Node):
    """Publishes images at a rate and notes when their correspondences come back."""

    def __init__(self) -> None:
        super().__init__("benchmark_camera")
        self._pattern_publisher = self.create_publisher(PatternMessage, "pattern", LATCHED)
        self._images = self.create_publisher(Image, "camera/image_raw", STREAM_PUBLISH)
        self.create_subscription(Correspondences, "correspondences", self._on_correspondences, STREAM_SUBSCRIBE)
        self.arrivals: dict[int, tuple[float, int]] = {}

    def show(self, pattern: Pattern) -> None:
        """Publish the pattern, latched."""
        header = Header(frame_id="projector_optical_frame")
        self._pattern_publisher.publish(pattern_to_message(pattern, header))

    def stream(self, frames: list[NDArray[np.uint8]], rate: float, seconds: float) -> dict[int, float]:
        """Publish ``frames`` in turn, back and forth, at ``rate`` [1/s]; returns times of sending by stamp."""
        messages = [images.to_message(f, Header(frame_id="camera_optical_frame")) for f in frames]
        order = [*range(len(messages)), *range(len(messages) - 2, 0, -1)]
        sent: dict[int, float] = {}
        begin = time.monotonic()
        for k in range(round(rate * seconds)):
            delay = begin + k / rate - time.monotonic()
            if delay > 0:
                time.sleep(delay)
            message = messages[order[k % len(order)]]
            stamp = self.get_clock().now().nanoseconds
            message.header.stamp = from_ns(stamp)
            sent[stamp] = time.monotonic()
            self._images.publish(message)
        return sent

    @property
    def listeners(self) -> int:
        """Subscribers of the images."""
        return int(self._images.get_subscription_count())

    def _on_correspondences(self, message: Correspondences) -> None:
        self.arrivals[to_ns(message.header.stamp)] = (time.monotonic(), len(message.row))


def decoder_node_rows(domain: int, log_folder: Path, seconds: float = 5.0) -> list[Row]:
    """Run the decoder node and measure it at each of :data:`SIZES`; raises DemoError when it does not answer."""
    pattern = default_pattern()
    with ProcessGroup(environment(domain), log_folder) as processes:
        decoder = processes.start(Executable("sl_decoder", "decoder"))
        context_free = not rclpy.ok()
        if context_free:
            rclpy.init(args=[], domain_id=domain)
        camera = _Camera()
        executor = SingleThreadedExecutor()
        executor.add_node(camera)
        thread = threading.Thread(target=_spin, args=(executor,), daemon=True)
        thread.start()
        try:
            camera.show(pattern)
            rows = []
            for width, height, rate in SIZES:
                frames = [camera_image(pattern, width, height, shift=0.5 * k, seed=k) for k in range(8)]
                _wait_for_answer(camera, frames, processes)
                rows += _measure(camera, frames, rate, seconds, f"decoder node, {width}x{height} at {rate}/s")
            rows.append(Row("decoder node: resident memory", _resident(decoder), "MB", MAX_MEMORY, digits=0))
            return rows
        finally:
            executor.shutdown(timeout_sec=2.0)
            thread.join(timeout=2.0)
            camera.destroy_node()
            if context_free:
                rclpy.try_shutdown()


def _measure(camera: _Camera, frames: list[NDArray[np.uint8]], rate: int, seconds: float, name: str) -> list[Row]:
    camera.stream(frames, rate, _WARM_UP)
    time.sleep(0.3)
    camera.arrivals.clear()
    sent = camera.stream(frames, rate, seconds)
    time.sleep(0.5)
    answered = {stamp: camera.arrivals[stamp] for stamp in sent if stamp in camera.arrivals}
    latency = 1e3 * np.array([answered[s][0] - sent[s] for s in answered] or [np.nan])
    dots = np.array([float(n) for _, n in answered.values()] or [np.nan])
    return [
        Row(f"{name}: answers", len(answered) / seconds, "1/s", digits=1),
        Row(f"{name}: images not answered", 100.0 * (1 - len(answered) / len(sent)), "%", digits=1),
        Row(f"{name}: latency, median", float(np.median(latency)), "ms", digits=1),
        Row(f"{name}: latency, 99th percentile", float(np.percentile(latency, 99)), "ms", digits=1),
        Row(f"{name}: dots decoded, median", float(np.median(dots)), "", digits=0),
    ]


def _wait_for_answer(camera: _Camera, frames: list[NDArray[np.uint8]], processes: ProcessGroup) -> None:
    """Send images now and then until one is answered: the decoder has started and knows the pattern."""
    deadline = time.monotonic() + 180.0
    camera.arrivals.clear()
    while not camera.arrivals:
        processes.check()
        if time.monotonic() > deadline:
            raise DemoError("the decoder answered no image within 180 s; see its log")
        if camera.listeners:
            camera.stream(frames, 10.0, 0.5)
        time.sleep(0.2)


def _resident(process: Process) -> float:
    """Return the resident memory of a process [MB]."""
    for line in Path(f"/proc/{process.pid}/status").read_text(encoding="ascii").splitlines():
        if line.startswith("VmRSS:"):
            return int(line.split()[1]) / 1024
    return float("nan")


def _spin(executor: SingleThreadedExecutor) -> None:
    try:
        executor.spin()
    except ExternalShutdownException:
        pass

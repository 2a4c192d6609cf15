"""The node `decoder`: camera images to correspondences."""

from __future__ import annotations

import sys
import time

import cv2
from rclpy.node import Node
from sensor_msgs.msg import Image

from pattern_gen import Pattern
from pattern_gen.ros_conversions import pattern_from_message
from sl_common.errors import StructuredLightError
from sl_common.ros import images
from sl_common.ros.diagnostics import ERROR, OK, WARN, Diagnostics
from sl_common.ros.parameters import declare
from sl_common.ros.qos import LATCHED, STREAM_PUBLISH, STREAM_SUBSCRIBE
from sl_common.ros.run import run_node
from sl_common.ros.stamps import to_ns
from sl_common.ros.waiting import InputWatch
from sl_decoder.colours import load_colours
from sl_decoder.debug import draw
from sl_decoder.decoded import Decoded
from sl_decoder.decoder import Decoder, DecoderOptions
from sl_decoder.messages import to_message
from sl_decoder.tracking import Tracker
from sl_decoder.warmup import prepare, warm_up
from sl_msgs.msg import Correspondences
from sl_msgs.msg import Pattern as PatternMessage

REFUSAL_PERIOD = 5.0  # least time between two lines about refused messages of one kind [s]


class DecoderNode(Node):
    """Reads parameters, converts messages, calls the decoder, publishes."""

    def __init__(self) -> None:
        super().__init__("decoder")
        min_confidence = declare(
            self,
            "min_confidence",
            0.5,
            "dots whose probability of being right is less are left out",
            minimum=0.0,
            maximum=1.0,
        )
        self._tracking = declare(
            self, "tracking", True, "follow dots from image to image (track_id) and decode around the prediction"
        )
        colours_file = declare(
            self, "colours_file", "", "colours.yaml of a colour calibration; empty: colours are learnt from each image"
        )
        threads = declare(self, "threads", 1, "threads of the image filters", minimum=1, maximum=64)
        self._options = DecoderOptions(min_confidence=min_confidence)
        self._colours = load_colours(colours_file) if colours_file else None
        cv2.setNumThreads(threads)
        start = time.monotonic()
        prepare()
        elapsed = time.monotonic() - start
        self.get_logger().info(f"ready after {elapsed:.1f} s of preparation")

        self._last_refusal: dict[str, float] = {}
        self._pattern: Pattern | None = None
        self._decoder: Decoder | None = None
        self._tracker: Tracker | None = None
        self._diagnostics = Diagnostics(self, "sl_decoder")
        self._diagnostics.level(WARN, "waiting for pattern and images")
        self._publisher = self.create_publisher(Correspondences, "correspondences", STREAM_PUBLISH)
        self._debug = self.create_publisher(Image, "~/debug_image", STREAM_PUBLISH)
        self._watch = InputWatch(self)
        self._watch.expect("pattern", PatternMessage, LATCHED)
        self._watch.expect("camera/image_raw", Image, STREAM_SUBSCRIBE)
        self.create_subscription(PatternMessage, "pattern", self._on_pattern, LATCHED)
        self.create_subscription(Image, "camera/image_raw", self._on_image, STREAM_SUBSCRIBE)

    def _on_pattern(self, message: PatternMessage) -> None:
        try:
            pattern = pattern_from_message(message)
            if self._pattern is not None and pattern.pattern_id == self._pattern.pattern_id:
                same_places = pattern.origin == self._pattern.origin and pattern.pitch == self._pattern.pitch
                if same_places and pattern.spot_diameter == self._pattern.spot_diameter:
                    return
            decoder = Decoder(pattern, options=self._options, colours=self._colours)
        except StructuredLightError as error:
            self._refuse("pattern", error)
            return
        warm_up(pattern)  # this pattern's own path through the code, before the first image
        self._watch.seen("pattern")
        self._pattern, self._decoder, self._tracker = pattern, decoder, Tracker(decoder)
        self.get_logger().info(
            f"pattern {pattern.pattern_id}: {pattern.rows}x{pattern.cols} {pattern.grid.value}, "
            f"{pattern.alphabet} letters, minimum Hamming distance {pattern.min_hamming}"
        )

    def _on_image(self, message: Image) -> None:
        self._diagnostics.tick("images")
        if self._decoder is None or self._tracker is None or self._pattern is None:
            self._watch.seen("camera/image_raw")
            return
        try:
            bgr = images.to_bgr(message)
            if self._tracking:
                decoded = self._tracker.track(bgr, to_ns(message.header.stamp))
            else:
                decoded = self._decoder.decode(bgr)
        except StructuredLightError as error:
            self._refuse("image", error)
            return
        self._watch.seen("camera/image_raw")
        self._publisher.publish(to_message(decoded, message.header, self._pattern.pattern_id))
        self._diagnostics.tick("correspondences")
        self._report(decoded)
        if self._debug.get_subscription_count() > 0:
            overlay = draw(bgr, decoded, self._pattern)
            self._debug.publish(images.to_message(overlay, message.header))

    def _refuse(self, what: str, error: StructuredLightError) -> None:
        now = time.monotonic()
        if now - self._last_refusal.get(what, -REFUSAL_PERIOD) >= REFUSAL_PERIOD:
            self._last_refusal[what] = now
            self.get_logger().error(f"{what} refused: {error}")
        self._diagnostics.level(ERROR, f"{what} refused: {error}")
        self._diagnostics.tick(f"refused {what}s")

    def _report(self, decoded: Decoded) -> None:
        self._diagnostics.set("dots", len(decoded))
        self._diagnostics.set("blobs", decoded.blobs)
        self._diagnostics.set("decode time [ms]", 1e3 * decoded.decode_time)
        self._diagnostics.set("tracked", decoded.tracked)
        for reason, number in decoded.inspection.counts().items():
            self._diagnostics.set(f"blobs {reason}", number)
        if decoded.mirrored:
            self._diagnostics.level(WARN, "the pattern is seen in a mirror: refused")
        elif len(decoded) == 0:
            why = ", ".join(f"{n} {r}" for r, n in decoded.inspection.counts().items()) or "no blobs"
            self._diagnostics.level(WARN, f"nothing decoded: {why}")
        else:
            self._diagnostics.level(OK, f"{len(decoded)} dots")


def main() -> int:
    """Entry point of the executable `decoder`."""
    return run_node(DecoderNode)


if __name__ == "__main__":
    sys.exit(main())

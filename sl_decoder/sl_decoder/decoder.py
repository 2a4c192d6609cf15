"""The decoder: a camera image to camera-projector correspondences."""

from __future__ import annotations

import time
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from pattern_gen import Pattern
from sl_common.errors import StructuredLightError
from sl_decoder import centres, rescaling, segmentation
from sl_decoder.alphabet import read_alphabet
from sl_decoder.codebook import build_codebook
from sl_decoder.colours import Colours
from sl_decoder.decoded import Decoded, Inspection, Reason, nothing
from sl_decoder.interpretation import Interpretation
from sl_decoder.lattice import to_axial
from sl_decoder.listing import correspondences
from sl_decoder.memory import keep_freed_memory
from sl_decoder.reasons import explain

SMALLEST_IMAGE = 16  # side [px]
LEAST_BELIEF = 2.0  # log-odds below which a dot is never given
LEAST_KERNEL = 12  # side of the background filter [px]
KERNEL_SHARE = 1 / 36  # of the image's width: a pattern of some sixty columns that fills the image has this pitch
SMALLER = (2, 4)  # times smaller are the images that are read for dots seen from near
MOSTLY_EXPLAINED = 0.85  # share of the blobs that are decoded from which no second opinion on the links is asked
WELL_EXPLAINED = 0.4  # share of the blobs that are decoded from which no smaller image is tried
SMALL_CORE = 15.0  # pixels of the median blob's core up to which dots may be blurred into each other
NEARLY_EXPLAINED = 0.9  # share of the blobs that are decoded from which small dots are not read again
FEW_GAPS = 0.04  # share of the dots amid decoded ones that segmentation may miss before that
OTHER_SCALE_GAIN = 1.05  # times as many dots that an image of another size must give: its centres are noisier
SHARPER_GAIN = 1.12  # and that the sharpened one must give to come first: long dots fall apart in it
BLURS = (0.3, 0.0, 0.6, None)  # metrics in which what is left is linked once more [px^2]
MANY_RECOVERED = 0.03  # share of the decoded dots that was recovered, from which all is read once more with them
RECOVERIES = 3  # rounds of recovery at most


@dataclass(frozen=True, kw_only=True)
class DecoderOptions:
    """Options of the decoder; the defaults work.

    min_confidence: dots less certain are left out. max_false_alarms: expected number of wrongly accepted patterns per
    image without any; it sets the evidence that the first placement of an image needs. kernel: side of the background
    filter [px], 0: found from the image.
    """

    min_confidence: float = 0.5
    max_false_alarms: float = 1e-6
    kernel: int = 0


class Decoder:
    """Decodes images of one pattern; keeps no state between images.

    pattern: what is projected. colours: a colour calibration, or None to learn the letters from each image.
    Raises StructuredLightError for a pattern that it cannot read, or colours that do not fit the pattern.
    """

    def __init__(
        self, pattern: Pattern, *, options: DecoderOptions | None = None, colours: Colours | None = None
    ) -> None:
        keep_freed_memory()
        self.pattern = pattern
        self.options = options or DecoderOptions()
        self.codebook = build_codebook(pattern)
        self.alphabet = read_alphabet(pattern)
        if colours is not None and len(colours.rgb) != pattern.alphabet:
            raise StructuredLightError(
                f"colours.yaml has {len(colours.rgb)} letters, the pattern {pattern.alphabet}: "
                "calibrate with this pattern"
            )
        self._calibrated = None if colours is None else colours.rgb[:, ::-1].copy()
        self._projector = np.ascontiguousarray(pattern.centers, np.float32)
        confidence = min(self.options.min_confidence, 1.0 - 1e-6)
        self.limit = max(float(np.log(max(confidence, 1e-6) / (1.0 - confidence))), LEAST_BELIEF)

    def decode(self, bgr: NDArray[np.uint8]) -> Decoded:
        """Correspondences of a BGR image (H, W, 3) uint8. Raises StructuredLightError for anything else."""
        start = time.perf_counter()
        check_image(bgr)
        reading = self.interpret(bgr)
        return self.report(reading, start)

    def interpret(self, bgr: NDArray[np.uint8]) -> Interpretation:
        """All that was found out about an image.

        The background filter must be wider than the dots, and noise must not make several blobs of one: where the
        usual width explains little of what is seen, the image is read at half its size, and at a quarter. Dots of a few
        pixels, which lens, mosaic and compression blur into each other, are read again from the sharpened image,
        and what either reading finds is joined."""
        usual = self.options.kernel or max(LEAST_KERNEL, round(bgr.shape[1] * KERNEL_SHARE))
        best = self._interpret_with(bgr, usual)
        for scale in SMALLER:
            if self.options.kernel or best.explained() >= WELL_EXPLAINED or min(bgr.shape[:2]) < 2 * scale * usual:
                break
            image = cv2.resize(bgr, None, fx=1 / scale, fy=1 / scale, interpolation=cv2.INTER_AREA)
            smaller = self._interpret_with(image, usual, pixel=1 / scale)
            if smaller.decoded() > OTHER_SCALE_GAIN * best.decoded():
                rescaling.enlarge(smaller, scale)
                best = smaller
        if best.is_small(SMALL_CORE) and (best.explained() < NEARLY_EXPLAINED or best.gaps() > FEW_GAPS):
            sharper = self._interpret_with(rescaling.doubled_and_sharpened(bgr), 2 * usual, pixel=2.0)
            better = sharper.found() > SHARPER_GAIN * best.found()
            rescaling.enlarge(sharper, 0.5)
            if better:
                best, sharper = sharper, best
            rescaling.adopt(best, sharper, self.limit)
        return best

    def _interpret_with(self, bgr: NDArray[np.uint8], kernel: int, pixel: float = 1.0) -> Interpretation:
        segments = segmentation.segment(bgr, kernel)
        return self.read(
            centres.measure(segments, shapes=len(self.alphabet.profiles) > 1), segments.smooth, pixel=pixel
        )

    def read(
        self, dots: centres.Dots, smooth: NDArray[np.uint8] | None = None, *, pixel: float = 1.0
    ) -> Interpretation:
        """Interpretation of measured dots; smooth (3, H, W): the image, to recover dots that were not segmented.

        pixel: size of the camera's pixels in those of the image."""
        reading = Interpretation(self.codebook, self.alphabet, dots, pixel=pixel)
        if reading.n < len(self.codebook.lattice.window):
            return reading
        reading.build_graph()
        reading.read_letters(self._calibrated)
        trials = np.log(len(self.codebook.codes) * max(1.0, reading.lattices))
        evidence = trials - np.log(self.options.max_false_alarms)
        placed = reading.place(evidence)
        if not placed:
            reading.correct_letters()
            placed = reading.place(evidence)
        if not reading.is_complete() and reading.refuse_mirrored():
            placed = reading.place(evidence)
        if placed:
            reading.grow(self.limit)
            if not reading.is_complete():
                reading.refit()
                reading.place(evidence)
                reading.grow(self.limit)
                self._place_rest(reading)
            if smooth is not None:
                self._recover(reading, smooth)
            reading.finish(self.limit)
        return reading

    def _place_rest(self, reading: Interpretation) -> None:
        """Place and grow what is left without a place, linked in several metrics."""
        for blur in BLURS:
            if reading.is_complete() or (blur is None and reading.explained() > MOSTLY_EXPLAINED):
                break
            if reading.place_rest(blur):
                reading.grow(self.limit)

    def _recover(self, reading: Interpretation, smooth: NDArray[np.uint8]) -> None:
        """Recover dots; where that gives many, they tell the letters, and what is next to them, better than before."""
        for _ in range(RECOVERIES):
            before = reading.n
            reading.recover(smooth, self.limit)
            if reading.n - before <= MANY_RECOVERED * reading.decoded():
                break
            reading.include_recovered()
            reading.refit()
            reading.grow(self.limit)
            self._place_rest(reading)

    def elements(self, row: NDArray[np.int32], col: NDArray[np.int32]) -> tuple[NDArray, NDArray]:
        """Indices (v, u) of pattern elements in arrays of the map's axial layout."""
        u, v = to_axial(row, col, hexagonal=self.codebook.hexagonal)
        return v + self.codebook.v_offset, u

    def report(self, reading: Interpretation, start: float) -> Decoded:
        """The correspondences of an interpretation; start: time.perf_counter() at its begin."""
        book = self.codebook
        m = reading.segmented
        if reading.n < len(book.lattice.window):
            return nothing(blobs=m, rejected=m, decode_time=time.perf_counter() - start)
        reason = explain(reading)
        number = np.bincount(reason, minlength=len(Reason))
        row, col, camera, projector, confidence, corrected = correspondences(
            reading.claim,
            reading.belief,
            reading.centre,
            reading.letter,
            book.letters,
            book.v_offset,
            book.hexagonal,
            self._projector,
        )
        links = reading.links
        if reading.n > m:
            links = np.full((reading.n, book.lattice.directions), -1, np.int32)
            links[:m] = reading.links
        return Decoded(
            row=row,
            col=col,
            camera=camera,
            projector=projector,
            confidence=confidence,
            corrected=corrected,
            track_id=np.full(len(row), -1, np.int32),
            blobs=m,
            labelled=int(np.count_nonzero(reading.at >= 0)),
            inconsistent=int(number[Reason.INCONSISTENT]),
            rejected=int(len(reason) - number[Reason.DECODED] - number[Reason.INCONSISTENT]),
            decode_time=time.perf_counter() - start,
            mirrored=reading.mirrored,
            inspection=Inspection(reading.centre[: reading.n], reading.letter[: reading.n], links, reason),
        )


def check_image(bgr: NDArray[np.uint8]) -> None:
    """Raise StructuredLightError unless an image is (H, W, 3) uint8 and large enough."""
    if not isinstance(bgr, np.ndarray) or bgr.ndim != 3 or bgr.shape[2] != 3 or bgr.dtype != np.uint8:
        what = f"{bgr.dtype} array of shape {bgr.shape}" if isinstance(bgr, np.ndarray) else type(bgr).__name__
        raise StructuredLightError(f"the decoder reads BGR images (H, W, 3) uint8, not {what}")
    if min(bgr.shape[:2]) < SMALLEST_IMAGE:
        raise StructuredLightError(f"image of {bgr.shape[1]}x{bgr.shape[0]} px is too small to hold a pattern")

"""Rows for the performance table: name, value, unit, limit (None: none is set)."""

from __future__ import annotations

import gc
import resource
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from functools import partial
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from pattern_gen import Pattern, default_pattern
from sl_decoder.decoder import Decoder
from sl_decoder.reliability import robustness
from sl_decoder.synthetic import view
from sl_decoder.tracking import Tracker
from sl_decoder.warmup import warm_up

FIRST_FRAME = "--first-frame"
"""Argument: print the time of the first image after the warm-up over the median of those that follow."""


TURNS = 5  # in which the functions of a comparison are timed


class Row(NamedTuple):
    """One line of the table; limit is the most that value may be."""

    name: str
    value: float
    unit: str
    limit: float | None = None


def camera_image(pattern: Pattern, width: int, height: int, *, shift: float = 0.0, seed: int = 0) -> NDArray[np.uint8]:
    """A synthetic camera image (H, W, 3) uint8 BGR of the whole pattern: rolled view, blur, ambient light, noise."""
    scale = width / 640.0
    affine = view(pattern, angle=0.1, scale=0.56, seed=1) * scale
    affine[:, 2] += np.array([shift, 0.5 * shift])
    image = cv2.warpAffine(pattern.render()[:, :, ::-1], affine, (width, height), flags=cv2.INTER_AREA)
    image = cv2.GaussianBlur(image, (0, 0), 0.6 * scale).astype(np.float32) * 1.2 + 22.0
    noise = np.random.default_rng(seed).normal(0.0, 2.5, image.shape)
    return np.clip(image + noise, 0, 255).astype(np.uint8)


def _medians(functions: Sequence[Callable[[], object]], repeats: int) -> list[float]:
    """Median milliseconds of each function, in turns of some calls: a clock that varies then varies for all of them."""
    times: list[list[float]] = [[] for _ in functions]
    for _ in range(TURNS):
        for function, of_function in zip(functions, times, strict=True):
            function()  # what the others pushed out of the caches comes back
            for _ in range(-(-repeats // TURNS)):
                start = time.perf_counter()
                function()
                of_function.append(time.perf_counter() - start)
    return [1e3 * float(np.median(of_function)) for of_function in times]


def floor(image: NDArray[np.uint8]) -> None:
    """Channel maximum, threshold and connected components: what any decoder pays at least."""
    blue, green, red = cv2.split(image)
    value = cv2.max(cv2.max(blue, green), red)
    _, binary = cv2.threshold(value, 60, 255, cv2.THRESH_BINARY)
    cv2.connectedComponentsWithStats(binary)


def blob_detectors() -> tuple[cv2.SimpleBlobDetector, cv2.SimpleBlobDetector]:
    """cv2.SimpleBlobDetector with its default parameters, and with parameters that find the dots."""
    parameters = cv2.SimpleBlobDetector.Params()
    parameters.blobColor = 255
    parameters.minThreshold = 10
    parameters.minArea = 4
    parameters.filterByCircularity = parameters.filterByConvexity = parameters.filterByInertia = False
    parameters.minDistBetweenBlobs = 3
    return cv2.SimpleBlobDetector.create(), cv2.SimpleBlobDetector.create(parameters)


def tracking_time(tracker: Tracker, images: list[NDArray[np.uint8]], repeats: int = 60) -> tuple[float, float]:
    """Median milliseconds of the tracked images of a moving view, and the share of images that were tracked."""
    times, tracked = [], 0
    for k in range(repeats):
        phase = k % (2 * len(images) - 2)
        image = images[phase if phase < len(images) else 2 * len(images) - 2 - phase]
        start = time.perf_counter()
        decoded = tracker.track(image, 1 + k * 33_000_000)
        elapsed = 1e3 * (time.perf_counter() - start)
        if decoded.tracked:
            tracked += 1
            times.append(elapsed)
    return float(np.median(times)) if times else float("nan"), tracked / repeats


def timing_rows(repeats: int = 30) -> list[Row]:
    """Decoding times on one thread, whole pattern in view."""
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        pattern = default_pattern()
        decoder = Decoder(pattern)
        rows: list[Row] = []
        for name, width, height, limit in (("VGA", 640, 480, 5.0), ("1280x960", 1280, 960, 12.0)):
            image = camera_image(pattern, width, height)
            found = len(decoder.decode(image))
            calls: list[Callable[[], object]] = [partial(decoder.decode, image), partial(floor, image)]
            if name == "VGA":
                calls += [partial(detector.detect, image) for detector in blob_detectors()]
            decode, least, *blobs = _medians(calls, repeats)
            rows.append(Row(f"decode {name}, {found} dots", decode, "ms", limit))
            moving = [camera_image(pattern, width, height, shift=1.5 * k, seed=k) for k in range(8)]
            track, share = tracking_time(Tracker(decoder), moving, 2 * repeats)
            rows.append(Row(f"track {name}, {100 * share:.0f} % of the images", track, "ms", limit / 2))
            rows.append(Row(f"floor {name}: maximum, threshold, components", least, "ms"))
            rows.append(Row(f"decode {name} over the floor", decode / least, ""))
            if blobs:
                usual, fitting = blobs
                rows.append(Row("decode VGA over SimpleBlobDetector (set to find the dots)", decode / fitting, "", 0.3))
                rows.append(Row("decode VGA over SimpleBlobDetector (its defaults, finds nothing)", decode / usual, ""))
        return rows
    finally:
        cv2.setNumThreads(threads)


def robustness_rows(runs: int = 10) -> list[Row]:
    """Wrong letters and missing dots on the shipped map."""
    pattern = default_pattern()
    rows = []
    for name, values in (("flipped", (0.01, 0.02, 0.05, 0.10)), ("missing", (0.05, 0.10, 0.20))):
        for value in values:
            right, wrong, undecoded = robustness(pattern, runs=runs, **{name: value})
            what = f"{100 * value:.0f} % of {'letters flipped' if name == 'flipped' else 'dots missing'}"
            limit = 0.1 if (name, value) == ("flipped", 0.05) else None
            rows.append(Row(f"{what}: right", 100 * right, "%"))
            rows.append(Row(f"{what}: wrong", 100 * wrong, "%", limit))
            rows.append(Row(f"{what}: undecoded", 100 * undecoded, "%"))
    return rows


def memory_row() -> Row:
    """Peak resident memory of this process."""
    return Row("peak resident memory of this process", resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024, "MB")


def resident() -> float:
    """Resident memory of this process [MB]."""
    with open("/proc/self/statm", encoding="ascii") as file:
        return int(file.read().split()[1]) * resource.getpagesize() / 2**20


def memory_growth(frames: int) -> tuple[float, int]:
    """Growth of the resident memory [MB] and of the number of Python's live allocations over `frames` small images.

    Decoded and tracked in turn, parts of the pattern moving through the view. Growth in the first half does not count:
    allocators and caches settle. Both ends are at the same image, with nothing left for the garbage collector.
    """
    pattern = default_pattern()
    decoder = Decoder(pattern)
    tracker = Tracker(decoder)
    parts = [
        np.ascontiguousarray(camera_image(pattern, 640, 480, shift=1.5 * k, seed=k)[180:300, 240:400]) for k in range(8)
    ]
    period = 2 * (len(parts) - 1)
    first = frames // 2 // period * period
    before = (0.0, 0)
    for k in range(frames // period * period + 1):
        image = parts[min(k % period, period - k % period)]
        if k % 2:
            decoder.decode(image)
        else:
            tracker.track(image, 1 + k * 16_000_000)
        if k == first:
            before = _held()
    after = _held()
    return after[0] - before[0], after[1] - before[1]


def _held() -> tuple[float, int]:
    gc.collect()
    return resident(), sys.getallocatedblocks()


def growth_rows(frames: int = 10_000) -> list[Row]:
    """Memory after many images."""
    megabytes, blocks = memory_growth(frames)
    return [
        Row(f"growth of the resident memory over {frames} images", megabytes, "MB", 2.0),
        Row(f"growth of Python's live allocations over {frames} images", blocks, "", 500.0),
    ]


def first_frame() -> float:
    """Time of the first image after the warm-up over the median of those that follow, in this process."""
    pattern = default_pattern()
    warm_up(pattern)
    decoder = Decoder(pattern)
    image = camera_image(pattern, 640, 480)
    times = []
    for _ in range(20):
        start = time.perf_counter()
        decoder.decode(image)
        times.append(time.perf_counter() - start)
    return times[0] / float(np.median(times[1:]))


def first_frame_row() -> Row:
    """`first_frame` of a new process."""
    command = [sys.executable, "-m", "sl_decoder.benchmark", FIRST_FRAME]
    answer = subprocess.run(command, capture_output=True, text=True, check=True)
    return Row("first image after start over the median", float(answer.stdout), "", 1.5)


def rows() -> list[Row]:
    """All rows."""
    return [*timing_rows(), first_frame_row(), *robustness_rows(), memory_row(), *growth_rows()]


def main() -> None:
    """Print the table."""
    if FIRST_FRAME in sys.argv:
        print(first_frame())
        return
    for row in rows():
        limit = "" if row.limit is None else f"<= {row.limit:g}"
        print(f"{row.name:70s} {row.value:9.3f} {row.unit:3s} {limit}")


if __name__ == "__main__":
    main()

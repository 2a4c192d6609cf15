"""Compile everything before the first image: `python -m sl_decoder.warmup` at build time, `warm_up()` at start-up."""

from __future__ import annotations

import subprocess
import sys
import time
from dataclasses import replace

import numpy as np

from pattern_gen import Letter, Pattern, default_pattern
from sl_decoder import native
from sl_decoder.compiled import kernels
from sl_decoder.decoder import Decoder
from sl_decoder.tracking import Tracker

CACHE_ONLY = "--cache-only"
"""Argument: compile what numba's cache lacks, without the native library."""


def warm_up(pattern: Pattern | None = None) -> int:
    """Decode a rendering of a pattern (default: the shipped one) a few times; returns how many dots were found."""
    pattern = pattern or default_pattern()
    image = np.ascontiguousarray(pattern.render()[:, :, ::-1])
    decoder = Decoder(pattern)
    tracker = Tracker(decoder)
    found = 0
    for stamp in range(3):
        found = len(tracker.track(image, 1 + stamp * 33_000_000))
        decoder.decode(image)
    # the paths that a clean image does not take: another pattern beside it, a mirror, nothing of ours at all
    rng = np.random.default_rng(0)
    symbols = rng.integers(0, pattern.alphabet, pattern.symbols.shape).astype(np.uint8)
    other = np.ascontiguousarray(replace(pattern, symbols=symbols).render()[:, :, ::-1])
    half = image.shape[1] // 2
    decoder.decode(np.hstack([image[:, :half], other[:, half:]]))
    decoder.decode(np.ascontiguousarray(image[:, ::-1]))
    decoder.decode(other)
    tracker.track(other, 1 + 4 * 33_000_000)
    return found


def _of_shapes() -> Pattern:
    """A pattern whose letters differ in shape and intensity: kernels that colours have no need of."""
    pattern = default_pattern()
    letters = tuple(Letter((drive,) * 3, shape) for shape in ("disc", "ring") for drive in (255, 140))
    return replace(pattern, letters=letters, symbols=(pattern.symbols % len(letters)).astype(np.uint8))


def build() -> int:
    """Compile all kernels, into the native library where this machine can; returns how many dots were found."""
    for stale in native.FOLDER.glob("*.nb?"):  # numba does not notice that a kernel called by another has changed
        stale.unlink(missing_ok=True)
    for kernel in kernels:
        kernel.calls = {}
    found = warm_up()
    warm_up(_of_shapes())
    try:
        native.build(kernels)
    except Exception as error:  # whatever kept it from being built, the kernels still run, compiled by numba
        print(f"decoder: no native library ({error}); compiled for numba's cache instead, which takes more memory")
    return found


def prepare() -> None:
    """Make everything ready in this process, compiling in another where that is due.

    The compiler takes 150 MB that a process never gives back; what is already compiled only has to be loaded.
    """
    if not native.available():
        command = [sys.executable, "-m", "sl_decoder.warmup", CACHE_ONLY]
        subprocess.run(command, stdout=subprocess.DEVNULL, check=False)
    warm_up()


def main() -> int:
    """Compile and say how long it took."""
    start = time.monotonic()
    found = warm_up() if native.available() or CACHE_ONLY in sys.argv else build()
    print(f"decoder compiled in {time.monotonic() - start:.1f} s ({found} dots decoded)")
    return 0 if found else 1


if __name__ == "__main__":
    sys.exit(main())

"""How far the decoder can be trusted: right, wrong and undecoded dots under errors, and confidences against the truth.

    python -m sl_decoder.reliability                        # wrong letters and missing dots on the shipped map
    python -m sl_decoder.reliability --rendered DIR...      # images with truth, as `render_dataset` writes them

prints the tables of docs/decoding.md.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from pattern_gen import Pattern, default_pattern
from sl_common.errors import StructuredLightError
from sl_decoder.decoder import Decoder
from sl_decoder.image_files import read_image
from sl_decoder.synthetic import synthetic_dots

EDGES = (0.0, 0.9, 0.95, 0.98, 0.99, 0.995, 0.998, 0.999, 0.9995, 1.0)
CORRUPTIONS = (
    {"flipped": 0.01},
    {"flipped": 0.02},
    {"flipped": 0.05},
    {"flipped": 0.10},
    {"missing": 0.05},
    {"missing": 0.10},
    {"missing": 0.20},
    {"flipped": 0.05, "missing": 0.10},
)
TOLERANCE = 1.5  # distance from the true centre up to which a dot of an image is right [px]
EDGE_TOLERANCE = 4.0  # between both, dots at edges are not judged: where they are is uncertain


@dataclass(frozen=True)
class Outcome:
    """N decoded dots: confidence (N,) and right (N,) bool; present: dots that there were to decode."""

    confidence: NDArray[np.float64]
    right: NDArray[np.bool_]
    present: int

    def shares(self) -> tuple[float, float, float]:
        """Right, wrong and undecoded dots, as shares of those present."""
        right, wrong = int(self.right.sum()), int((~self.right).sum())
        return right / self.present, wrong / self.present, (self.present - right - wrong) / self.present


def pooled(outcomes: Sequence[Outcome]) -> Outcome:
    """All dots of several outcomes."""
    return Outcome(
        np.concatenate([o.confidence for o in outcomes]),
        np.concatenate([o.right for o in outcomes]),
        sum(o.present for o in outcomes),
    )


def corrupted(pattern: Pattern, *, flipped: float = 0.0, missing: float = 0.0, runs: int = 10) -> Outcome:
    """Decode `runs` random views of which shares of the letters are wrong and of the dots are missing (seeded)."""
    decoder = Decoder(pattern)
    outcomes = []
    for seed in range(runs):
        dots, index = synthetic_dots(
            pattern, flipped=flipped, missing=missing, angle=2 * np.pi * seed / runs, seed=seed
        )
        reading = decoder.read(dots)
        decoded = decoder.report(reading, 0.0)
        map_v, map_u = decoder.elements(decoded.row, decoded.col)
        right = index[reading.claim[map_v, map_u]] == decoded.row * pattern.cols + decoded.col
        outcomes.append(Outcome(decoded.confidence.astype(np.float64), right, len(dots)))
    return pooled(outcomes)


def robustness(
    pattern: Pattern, *, flipped: float = 0.0, missing: float = 0.0, runs: int = 10
) -> tuple[float, float, float]:
    """Shares of the dots present that come out right, wrong and undecoded, over `runs` random views."""
    return corrupted(pattern, flipped=flipped, missing=missing, runs=runs).shares()


def rendered(folder: Path) -> Outcome:
    """Decode a folder of images with truth. Raises StructuredLightError when there are none."""
    paths = sorted((folder / "images").glob("*.png"))
    if not paths:
        raise StructuredLightError(f"no images in {folder / 'images'}: give a folder that render_dataset has written")
    decoder = Decoder(Pattern.load(folder / "pattern.yaml"))
    outcomes = []
    for path in paths:
        truth = np.load(folder / "truth" / f"{path.stem}.npz")
        scored = truth["visible"] & ~truth["edge"]
        decoded = decoder.decode(read_image(path))
        distance = np.linalg.norm(decoded.camera - truth["xy"][decoded.row, decoded.col], axis=1)
        right = distance <= TOLERANCE
        judged = right | scored[decoded.row, decoded.col] | ~(distance <= EDGE_TOLERANCE)
        outcomes.append(Outcome(decoded.confidence[judged].astype(np.float64), right[judged], int(scored.sum())))
    return pooled(outcomes)


def reliability(outcome: Outcome) -> list[tuple[float, float, int, float, float]]:
    """Per bin of confidence that holds any: its edges, number of dots, mean confidence, share that is right."""
    bins = []
    for low, high in pairwise(EDGES):
        inside = (outcome.confidence >= low) & ((outcome.confidence < high) | (high == EDGES[-1]))
        if inside.any():
            mean, right = float(outcome.confidence[inside].mean()), float(outcome.right[inside].mean())
            bins.append((low, high, int(inside.sum()), mean, right))
    return bins


def _print_reliability(outcome: Outcome) -> None:
    print("| confidence | dots | mean confidence | right |\n|---|---|---|---|")
    for low, high, number, mean, right in reliability(outcome):
        print(f"| {low:g} to {high:g} | {number} | {mean:.4f} | {right:.4f} |")


def _print_corruptions(runs: int) -> None:
    pattern = default_pattern()
    outcomes = []
    print("| letters flipped | dots missing | right | wrong | undecoded |\n|---|---|---|---|---|")
    for corruption in CORRUPTIONS:
        outcomes.append(corrupted(pattern, runs=runs, **corruption))
        right, wrong, undecoded = (100 * share for share in outcomes[-1].shares())
        flipped, missing = (100 * corruption.get(kind, 0.0) for kind in ("flipped", "missing"))
        print(f"| {flipped:.0f} % | {missing:.0f} % | {right:.2f} % | {wrong:.3f} % | {undecoded:.2f} % |")
    print()
    _print_reliability(pooled(outcomes))


def main(argv: Sequence[str] | None = None) -> int:
    """Print the tables; exit code 0 done, 1 failed with one line, 2 wrong usage."""
    parser = argparse.ArgumentParser(
        prog="python -m sl_decoder.reliability", description=(__doc__ or "").split("\n")[0]
    )
    parser.add_argument("--rendered", nargs="+", type=Path, metavar="DIR", help="folders of images with truth")
    parser.add_argument("--runs", type=int, default=10, help="random views per row (default %(default)s)")
    arguments = parser.parse_args(argv)
    cv2.setNumThreads(1)
    try:
        if arguments.rendered:
            _print_reliability(pooled([rendered(folder) for folder in arguments.rendered]))
        else:
            _print_corruptions(arguments.runs)
    except (StructuredLightError, OSError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())

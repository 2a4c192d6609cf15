"""Command colours: the letters' drive values that the camera tells apart best, from photographs of the colour
charts."""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from pattern_gen import Pattern
from sl_calibration.colour_calibration import ColourCalibration, calibrate_colours, save_colours
from sl_calibration.colour_charts import colour_chart_samples
from sl_calibration.colour_letters import LetterOptions
from sl_calibration.commands.shared import images_in, read_image
from sl_common.commands import make_parser, progress, run_command
from sl_common.errors import InvalidInputError

EXAMPLE = """\
  ros2 run sl_calibration colours --pattern pattern.yaml --chart photos/chart --intensity photos/intensity \\
      --output calibration/colours.yaml
Project the frames with pattern_publisher's set_projection (COLOUR_CHART steps 0 to 27; INTENSITY_CHART steps 0 to 17 of
red, then green, then blue) and take one photo of each, exposure and white balance fixed, nothing moving. The intensity
chart is optional. Give the file to pattern_publisher and decoder (parameter colours_file) or decode_images
--colours."""


def _parser() -> argparse.ArgumentParser:
    """Return the command's argument parser."""
    p = make_parser("sl_calibration colours", __doc__ or "", EXAMPLE)
    p.add_argument("--pattern", required=True, type=Path, metavar="FILE.yaml", help="pattern whose letters to choose")
    p.add_argument("--chart", required=True, type=Path, metavar="DIR", help="photos of the colour chart, by name order")
    p.add_argument("--intensity", type=Path, metavar="DIR", help="photos of the intensity chart, by name order")
    p.add_argument("--output", required=True, type=Path, metavar="FILE.yaml", help="colours.yaml to write")
    p.add_argument(
        "--adapt-to-scene",
        action="store_true",
        help="choose for all coloured surfaces of the scene, not the typical one",
    )
    p.add_argument(
        "--ceiling", type=float, default=235.0, metavar="V", help="largest camera value above black (default: 235)"
    )
    return p


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; returns its exit code."""
    return run_command(_parser(), _run, arguments)


def _run(args: argparse.Namespace) -> None:
    pattern = Pattern.load(args.pattern)
    chart = _frames(args.chart)
    intensity = _frames(args.intensity) if args.intensity else None
    if intensity is not None and intensity.shape[1:] != chart.shape[1:]:
        raise InvalidInputError(f"{args.intensity}: images of another size than those of {args.chart}")
    samples = colour_chart_samples(chart, intensity)
    options = LetterOptions(ceiling=args.ceiling)
    result = calibrate_colours(samples, pattern, options, adapt_to_scene=args.adapt_to_scene)
    print(summary(result, samples.places))
    save_colours(args.output, result)
    print(f"wrote {args.output}")


def _frames(folder: Path) -> np.ndarray:
    frames: list[np.ndarray] = []
    for path in progress(images_in(folder), "reading"):
        image = read_image(path)
        if image.ndim != 3 or image.shape[-1] != 3:
            raise InvalidInputError(f"{path}: not a colour image; a monochrome camera needs no colour calibration")
        if frames and image.shape != frames[0].shape:
            raise InvalidInputError(
                f"{path}: {image.shape[1]}x{image.shape[0]}, the images before it have another size"
            )
        frames.append(image)
    return np.stack(frames)


def summary(result: ColourCalibration, places: int) -> str:
    """Return the result in lines for people."""
    lines = [
        f"{result.samples} patches at {places} places; the response fits to {result.model.rms:.2f} grey levels RMS",
        "mixing (camera R G B by projector R G B): "
        + "; ".join(" ".join(f"{value:.3f}" for value in row) for row in result.model.mixing),
    ]
    for number, (drives, shape, camera) in enumerate(zip(result.drives, result.shapes, result.camera, strict=True)):
        seen = ", ".join(f"{value:.0f}" for value in camera)
        lines.append(f"letter {number}: drive {', '.join(str(v) for v in drives)} ({shape}), camera {seen}")
    lines.append(
        f"least distance of two letters: {result.least_before:.1f} before, {result.least_after:.1f} after"
        f" ({result.least_after / max(result.least_before, 1e-9):.2f} times)"
    )
    return "\n".join(lines)


if __name__ == "__main__":
    sys.exit(main())

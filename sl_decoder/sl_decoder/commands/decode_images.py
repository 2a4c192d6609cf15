"""`decode_images`: image files to CSV files of correspondences."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from pattern_gen import Pattern
from sl_common.commands import UsageError, make_parser, progress, run_command
from sl_common.errors import StructuredLightError
from sl_common.files import atomic_path, write_text
from sl_decoder.debug import draw
from sl_decoder.decoded import Decoded
from sl_decoder.decoder import Decoder, DecoderOptions
from sl_decoder.image_files import BAYER, read_image

EXAMPLE = "  ros2 run sl_decoder decode_images --pattern pattern.yaml --output decoded --debug overlays images/*.png"


def parser() -> argparse.ArgumentParser:
    """The command line."""
    result = make_parser(
        "sl_decoder decode_images",
        "Decode images of the projected pattern. Writes OUTPUT/<image name>.csv with the header "
        "row,col,x,y,confidence; x and y in raw pixels, the centre of the top-left pixel is (0, 0).",
        EXAMPLE,
    )
    result.add_argument("images", nargs="+", metavar="IMAGE", help="PNG, JPEG or TIFF, 8 or 16 bit")
    result.add_argument("--pattern", required=True, metavar="FILE", help="pattern file (YAML) of the projected pattern")
    result.add_argument("--colours", metavar="FILE", help="colours.yaml of a colour calibration")
    result.add_argument("--output", required=True, metavar="DIR", help="folder of the CSV files")
    result.add_argument("--debug", metavar="DIR", help="also write overlays <image name>.png into this folder")
    result.add_argument("--bayer", choices=sorted(BAYER), help="images are raw mosaics with this pattern")
    result.add_argument(
        "--min-confidence", type=float, default=0.5, help="leave less certain dots out (default %(default)s)"
    )
    return result


def to_csv(decoded: Decoded) -> str:
    """The CSV text of a decoded image."""
    columns = zip(
        decoded.row.tolist(), decoded.col.tolist(), decoded.camera.tolist(), decoded.confidence.tolist(), strict=True
    )
    return "row,col,x,y,confidence\n" + "".join(f"{r},{c},{p[0]:.4f},{p[1]:.4f},{q:.5f}\n" for r, c, p, q in columns)


def _summary_line(name: str, decoded: Decoded) -> str:
    reasons = {k: v for k, v in decoded.inspection.counts().items() if k != "decoded"}
    why = ", ".join(f"{v} {k}" for k, v in reasons.items())
    figures = f"{decoded.blobs:7d} {len(decoded):8d} {int(decoded.corrected.sum()):9d} {1e3 * decoded.decode_time:8.1f}"
    return f"{name[:40]:40s} {figures}  {why}"


def run(arguments: argparse.Namespace) -> None:
    """Decode all images; raises StructuredLightError on the first that cannot be read."""
    if not 0.0 <= arguments.min_confidence <= 1.0:
        raise UsageError(f"--min-confidence is {arguments.min_confidence}, expected 0 to 1")
    names = [Path(image).stem for image in arguments.images]
    doubles = sorted({name for name in names if names.count(name) > 1})
    if doubles:
        raise StructuredLightError(
            f"{len(doubles)} image names occur twice, e.g. '{doubles[0]}': their CSV files would collide"
        )
    pattern = Pattern.load(arguments.pattern)
    colours = None
    if arguments.colours:
        from sl_decoder.colours import load_colours

        colours = load_colours(arguments.colours)
    decoder = Decoder(pattern, options=DecoderOptions(min_confidence=arguments.min_confidence), colours=colours)
    lines = []
    total = 0
    for path in progress(arguments.images, "images"):
        bgr = read_image(path, bayer=arguments.bayer)
        decoded = decoder.decode(bgr)
        name = Path(path).stem
        write_text(Path(arguments.output) / f"{name}.csv", to_csv(decoded))
        if arguments.debug:
            with atomic_path(Path(arguments.debug) / f"{name}.png") as target:
                cv2.imwrite(str(target), draw(bgr, decoded, pattern))
        lines.append(_summary_line(name, decoded))
        total += len(decoded)
    print(f"{'image':40s} {'blobs':>7s} {'decoded':>8s} {'corrected':>9s} {'ms':>8s}  not decoded")
    print("\n".join(lines))
    print(f"{len(lines)} images, {total} dots, {total / max(len(lines), 1):.0f} per image")


def main(argv: Sequence[str] | None = None) -> int:
    """Entry point: exit code 0 done, 1 failed with one line on stderr, 2 wrong usage."""
    np.seterr(all="ignore")
    return run_command(parser(), run, argv)


if __name__ == "__main__":
    sys.exit(main())

"""Every reason for not decoding a blob occurs where it should, is counted, and is drawn in its own colour."""

import cv2
import numpy as np
import pytest
from decoder_helpers import camera_image, default_pattern

from sl_decoder import Decoder, Reason
from sl_decoder.debug import _REASON_COLOUR, draw
from sl_decoder.decoded import REASON_TEXT, Decoded

PATTERN = default_pattern()
DECODER = Decoder(PATTERN)


def near(decoded: Decoded, x: float, y: float, radius: float) -> np.ndarray:
    """Reasons of the blobs within a radius [px] of a place."""
    inspection = decoded.inspection
    return inspection.reason[np.hypot(*(inspection.centre - [x, y]).T) < radius]


def clean() -> np.ndarray:
    return camera_image(PATTERN, 1280, 960)


def saturated() -> tuple[np.ndarray, Reason]:
    image = clean().astype(float)
    y, x = np.mgrid[:960, :1280]
    flash = np.exp(-((x - 640) ** 2 + (y - 480) ** 2) / (2 * 90**2))[..., None]
    washed_out = image + 60 * flash * np.maximum(image - 25, 0)
    return np.clip(washed_out, 0, 255).astype(np.uint8), Reason.SATURATED


def too_small() -> tuple[np.ndarray, Reason]:
    image = clean()
    image[420:540, 580:700] = 22
    for x, y in np.random.default_rng(0).integers([590, 430], [690, 530], (25, 2)):
        image[y, x] = (40, 255, 40)
    return image, Reason.TOO_SMALL


def no_neighbours() -> tuple[np.ndarray, Reason]:
    image = clean()
    image[380:580, 540:740] = 22
    cv2.circle(image, (640, 480), 4, (0, 180, 0), -1, cv2.LINE_AA)
    return image, Reason.NO_NEIGHBOURS


def inconsistent() -> tuple[np.ndarray, Reason]:
    image = clean()
    image[380:580, 540:740] = 22
    for k, angle in enumerate(np.linspace(0, 4 * np.pi, 60)):  # a spiral of dots has no lattice coordinates
        centre = (640 + (20 + 1.2 * k) * np.cos(angle), 480 + (20 + 1.2 * k) * np.sin(angle))
        cv2.circle(image, tuple(int(c) for c in centre), 3, (200, 90, 30), -1, cv2.LINE_AA)
    return image, Reason.INCONSISTENT


def unknown_code() -> tuple[np.ndarray, Reason]:
    image = clean()
    patch = image[400:560, 560:720]
    image[400:560, 560:720] = patch[:, :, [1, 2, 0]]  # other letters on the same lattice
    return image, Reason.UNKNOWN_CODE


def improbable() -> tuple[np.ndarray, Reason]:
    image = clean()
    decoded = DECODER.decode(image)
    for x, y in decoded.camera[np.hypot(*(decoded.camera - [640, 480]).T) < 80][::7].astype(int):
        dot = image[y - 7 : y + 8, x - 7 : x + 8].copy()
        image[y - 7 : y + 8, x - 7 : x + 8] = 22
        image[y - 7 : y + 8, x - 2 : x + 13] = np.maximum(
            dot, image[y - 7 : y + 8, x - 2 : x + 13]
        )  # a quarter pitch on
    return image, Reason.IMPROBABLE


def mirrored() -> tuple[np.ndarray, Reason]:
    return np.ascontiguousarray(clean()[:, ::-1]), Reason.MIRRORED


CASES = [saturated, too_small, no_neighbours, inconsistent, unknown_code, improbable, mirrored]


@pytest.mark.parametrize("case", CASES, ids=[case.__name__ for case in CASES])
def test_a_reason_occurs_is_counted_and_drawn(case) -> None:
    image, reason = case()
    decoded = DECODER.decode(image)
    found = near(decoded, 640, 480, 90.0)
    assert (found == reason).any(), np.unique(decoded.inspection.reason, return_counts=True)
    assert decoded.inspection.counts()[REASON_TEXT[reason]] >= (found == reason).sum()
    overlay = draw(image, decoded, PATTERN)
    centre = decoded.inspection.centre[decoded.inspection.reason == reason][0]
    x, y = np.round((centre + 0.5) * 2 - 0.5).astype(int)
    assert (overlay[y - 2 : y + 3, x - 2 : x + 3] == _REASON_COLOUR[reason]).all(-1).any()
    assert overlay[2 * image.shape[0] :].any()  # the legend
    if reason is not Reason.MIRRORED:
        assert len(decoded) > 1500


def test_every_reason_has_a_text_and_a_colour_of_its_own() -> None:
    assert set(REASON_TEXT) == set(Reason)
    assert set(_REASON_COLOUR) == set(Reason) - {Reason.DECODED}
    assert len(set(_REASON_COLOUR.values())) == len(_REASON_COLOUR)

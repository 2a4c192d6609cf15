"""The decoder on the development data; SL_TEST_DATA names its folder. The bars are the project's own."""

import os
from pathlib import Path

import cv2
import numpy as np
import pytest

from pattern_gen import Grid, Pattern, generate
from sl_decoder import Decoder

DATA = Path(os.environ.get("SL_TEST_DATA", "/nonexistent"))
pytestmark = pytest.mark.skipif(not DATA.is_dir(), reason="SL_TEST_DATA does not name the data folder")


def masks(truth) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Scored, resolvable and inner dots, as the data's README defines them."""
    scored = truth["visible"] & ~truth["edge"]
    minor, major = truth["axes_px"][..., 0], truth["axes_px"][..., 1]
    resolvable = scored & (minor >= 2.0) & (major <= 4 * minor) & (np.linalg.norm(truth["shift"], axis=-1) <= 0.75)
    if "snr" in truth:
        resolvable &= truth["snr"] >= 4.0
    whole = np.lib.stride_tricks.sliding_window_view(np.pad(resolvable, 1), (3, 3)).all((2, 3))
    return scored, resolvable, whole


@pytest.mark.parametrize("name", ["rendered", "rendered_motion"])
def test_rendered_sets(name: str) -> None:
    decoder = Decoder(Pattern.load(DATA / "rendered" / "pattern.yaml"))
    total = np.zeros(6)
    error = []
    for path in sorted((DATA / name / "images").glob("*.png")):
        truth = dict(np.load(DATA / name / "truth" / f"{path.stem}.npz"))
        scored, resolvable, inner = masks(truth)
        decoded = decoder.decode(cv2.imread(str(path)))
        distance = np.linalg.norm(decoded.camera - truth["xy"][decoded.row, decoded.col], axis=1)
        good = distance <= 1.5
        ignored = ~good & (distance <= 4.0) & ~scored[decoded.row, decoded.col]
        got = np.zeros(scored.shape, bool)
        got[decoded.row[good], decoded.col[good]] = True
        assert (got & inner).sum() >= 0.97 * inner.sum(), path.name
        error.append(distance[good & scored[decoded.row, decoded.col]])
        total += [
            (got & inner).sum(),
            inner.sum(),
            (got & resolvable).sum(),
            resolvable.sum(),
            good.sum(),
            (~ignored).sum(),
        ]
    assert total[0] / total[1] >= 0.995
    assert total[2] / total[3] >= 0.97
    assert total[4] / total[5] >= 0.9995
    assert np.median(np.concatenate(error)) <= 0.08


def gray_map(folder: Path) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Raw projector column and row of each pixel, white and black frame."""
    frames = [
        cv2.imread(str(folder / f"graycode_{i:02d}.png"), cv2.IMREAD_GRAYSCALE).astype(np.int32) for i in range(42)
    ]

    def axis(first: int) -> np.ndarray:
        value = np.zeros_like(frames[0])
        bit = np.zeros_like(frames[0])
        for k in range(10):
            bit = bit ^ (frames[first + 2 * k] > frames[first + 2 * k + 1])
            value = 2 * value + bit
        return value

    return axis(0), axis(20), frames[40], frames[41]


@pytest.fixture(scope="module")
def relighting_pattern() -> Pattern:
    """A pitch of 8 projector px puts about five dots across a square of the board (some 40 projector px)."""
    drawn = generate(6, 1, rows=90, cols=120, seed=1)
    return Pattern(
        grid=Grid.SQUARE,
        symbols=drawn.symbols,
        letters=drawn.letters,
        pitch=8.0,
        origin=(30.0, 25.0),
        spot_diameter=4.0,
    )


@pytest.mark.parametrize("capture", range(4))
def test_real_geometry_and_albedo(capture: int, relighting_pattern: Pattern) -> None:
    pattern = relighting_pattern
    x, y, white, black = gray_map(DATA / "kamino_procam" / f"capture_{capture}")
    inside = (x < pattern.projector_width) & (y < pattern.projector_height)
    light = np.zeros((*x.shape, 3))
    light[inside] = pattern.render()[y[inside], x[inside], ::-1] / 255.0
    frame = black[..., None] + (white - black).clip(0)[..., None] * light
    decoded = Decoder(pattern).decode(np.clip(frame + 0.5, 0, 255).astype(np.uint8))
    # right: the raw map around the decoded place is the dot's own
    corner = np.round(decoded.camera).astype(int)
    right = np.zeros(len(decoded), bool)
    for i, (cx, cy) in enumerate(corner):
        patch = np.s_[max(0, cy - 3) : cy + 4, max(0, cx - 3) : cx + 4]
        seen = np.array([np.median(x[patch]), np.median(y[patch])])
        right[i] = np.linalg.norm(seen - decoded.projector[i]) < 0.4 * pattern.pitch
    assert (~right).sum() < 0.005 * len(decoded)
    # of the dots whose whole window lies on bright surface
    bright = (white - black) > 0.2 * (white - black).max()
    col = np.round((x - pattern.origin[0]) / pattern.pitch).astype(int)
    row = np.round((y - pattern.origin[1]) / pattern.pitch).astype(int)
    near = np.maximum(abs(x - pattern.origin[0] - 8 * col), abs(y - pattern.origin[1] - 8 * row)) < 1.5
    near &= (col >= 0) & (col < pattern.cols) & (row >= 0) & (row < pattern.rows) & (white - black > 10)
    index = row[near] * pattern.cols + col[near]
    count = np.bincount(index, minlength=pattern.symbols.size).reshape(pattern.symbols.shape)
    lit = np.bincount(index, weights=bright[near], minlength=pattern.symbols.size).reshape(pattern.symbols.shape)
    on_bright = (count >= 4) & (lit >= 0.9 * count)
    wanted = np.zeros_like(on_bright)
    wanted[1:-1, 1:-1] = np.lib.stride_tricks.sliding_window_view(on_bright, (3, 3)).all((2, 3))
    got = np.zeros_like(on_bright)
    got[decoded.row[right], decoded.col[right]] = True
    assert wanted.sum() > 1500
    assert (got & wanted).sum() >= 0.9 * wanted.sum()


def test_photographs_of_other_things_give_nothing() -> None:
    decoder = Decoder(Pattern.load(DATA / "rendered" / "pattern.yaml"))
    paths = sorted(DATA.glob("gopro_wide/*/*.jpg")) + sorted(DATA.glob("kamino_procam/*/graycode_*.png"))[::5]
    assert len(paths) > 60
    for path in paths:
        image = cv2.imread(str(path))
        assert len(decoder.decode(cv2.resize(image, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA))) == 0, (
            path.name
        )

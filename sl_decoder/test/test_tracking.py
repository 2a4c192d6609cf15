"""Tracking: identities persist, verification decides, nothing stale survives."""

import numpy as np
from decoder_helpers import camera_image, default_pattern

from sl_decoder import Decoder, Tracker
from sl_decoder.benchmark import view

PATTERN = default_pattern()
DECODER = Decoder(PATTERN)
MS = 1_000_000


def true_place(decoded, shift: float) -> np.ndarray:
    affine = view(PATTERN, angle=0.1, scale=0.56, seed=1)
    affine[:, 2] += np.array([shift, 0.5 * shift])
    return decoded.projector @ affine[:, :2].T + affine[:, 2]


def test_dots_keep_their_identity_while_they_move() -> None:
    tracker = Tracker(DECODER)
    seen: dict[tuple[int, int], int] = {}
    tracked = 0
    for k in range(12):
        decoded = tracker.track(camera_image(PATTERN, 640, 480, shift=3.0 * k, seed=k), 1 + 33 * k * MS)
        assert np.linalg.norm(decoded.camera - true_place(decoded, 3.0 * k), axis=1).max() < 0.7
        assert len(decoded) > 2300
        assert len(np.unique(decoded.track_id)) == len(decoded)
        tracked += decoded.tracked
        now = dict(
            zip(zip(decoded.row.tolist(), decoded.col.tolist(), strict=True), decoded.track_id.tolist(), strict=True)
        )
        assert all(seen[key] == value for key, value in now.items() if key in seen)
        seen = now
    assert tracked >= 9


def test_a_jump_by_whole_dots_is_noticed() -> None:
    tracker = Tracker(DECODER)
    pitch = PATTERN.pitch * 0.56
    for k, shift in enumerate([0.0, 0.0, pitch, pitch, 0.0, 3 * pitch]):
        decoded = tracker.track(camera_image(PATTERN, 640, 480, shift=shift, seed=k), 1 + 33 * k * MS)
        assert np.linalg.norm(decoded.camera - true_place(decoded, shift), axis=1).max() < 0.7
        assert len(decoded) > 2300


def test_an_object_that_starts_to_move_is_not_lost() -> None:
    tracker = Tracker(DECODER)
    still = camera_image(PATTERN, 640, 480)
    y, x = np.mgrid[:480, :640]
    middle, radius, shares = np.array([300.0, 240.0]), 70.0, []
    for k in range(10):
        shift = np.array([4.0, 2.0]) * max(0, k - 2)  # three images at rest first
        moved = np.roll(still, shift.astype(int)[::-1], (0, 1))
        image = still.copy()
        image[np.hypot(*(np.stack([x, y], -1) - middle).transpose(2, 0, 1)) < radius] = 22
        there = np.hypot(*(np.stack([x, y], -1) - middle - shift).transpose(2, 0, 1)) < radius
        image[there] = moved[there]
        decoded = tracker.track(image, 1 + 33 * k * MS)
        place = true_place(decoded, 0.0)
        on = np.linalg.norm(place - middle, axis=1) < radius - 10
        assert np.linalg.norm(decoded.camera - place - shift, axis=1)[on].max() < 0.7
        shares.append(on.sum())
    assert min(shares) > 0.9 * shares[0]


def test_what_a_rim_covers_is_let_go() -> None:
    tracker = Tracker(DECODER)
    still = camera_image(PATTERN, 1280, 960)
    tracked = 0
    for k in range(10):
        image = still.copy()
        image[:, : 500 + 2 * k] = 22
        decoded = tracker.track(image, 1 + 33 * k * MS)
        place = 2 * true_place(decoded, 0.0)
        seen = place[:, 0] > 510 + 2 * k
        error = np.linalg.norm(decoded.camera - place, axis=1)
        assert seen.sum() > 1500
        assert error[seen].max() < 0.5
        assert error.max() < 2.5  # half a dot's width: not what the rim keeps pushing on
        assert (error > 1.0).sum() <= 8  # without letting go 11, up to 4.5 px off
        tracked += decoded.tracked
    assert tracked >= 8


def test_a_camera_that_turns_round_is_tracked() -> None:
    tracker = Tracker(DECODER)
    kinds = []
    for k, shift in enumerate([0.0, 1.5, 3.0, 4.5, 3.0, 1.5, 0.0, 1.5]):
        decoded = tracker.track(camera_image(PATTERN, 640, 480, shift=shift, seed=k), 1 + 33 * k * MS)
        assert np.linalg.norm(decoded.camera - true_place(decoded, shift), axis=1).max() < 0.7
        kinds.append(decoded.tracked)
    assert all(kinds[1:])


def test_a_switched_pattern_leaves_nothing() -> None:
    tracker = Tracker(DECODER)
    for k in range(3):
        tracker.track(camera_image(PATTERN, 640, 480, seed=k), 1 + 33 * k * MS)
    other = type(PATTERN)(
        grid=PATTERN.grid,
        symbols=np.random.default_rng(1).integers(0, 6, PATTERN.symbols.shape),
        letters=PATTERN.letters,
    )
    assert len(tracker.track(camera_image(other, 640, 480), 1 + 100 * MS)) == 0
    assert len(tracker.track(np.zeros((480, 640, 3), np.uint8), 1 + 133 * MS)) == 0


def test_gaps_older_stamps_and_other_sizes_start_anew() -> None:
    tracker = Tracker(DECODER)
    first = tracker.track(camera_image(PATTERN, 640, 480), 10_000 * MS)
    late = tracker.track(camera_image(PATTERN, 640, 480), 20_000 * MS)
    assert not late.tracked
    assert not np.intersect1d(first.track_id, late.track_id).size
    older = tracker.track(camera_image(PATTERN, 640, 480), 15_000 * MS)
    assert not older.tracked
    larger = tracker.track(camera_image(PATTERN, 1280, 960), 15_033 * MS)
    assert not larger.tracked
    assert len(larger) > 2300
    assert not np.intersect1d(older.track_id, larger.track_id).size

"""The time offset between two streams of poses of one rigid body, from the angles that they turn by.

Between the same two instants hand and camera turn by the same angle, whatever the transform between them. Where the
motion is smooth and the streams are not synchronised, the offset is the shift that makes the angles agree.
"""

import numpy as np
from numpy.typing import NDArray

from sl_calibration.pose_stream import PoseStream
from sl_common import transforms

Array = NDArray[np.float64]

_INTERVALS = (0.15, 0.4, 1.0)
_COARSE = 0.02
_FINE = 0.002
_MAX_SAMPLES = 400


def angle_mismatch(hand: PoseStream, eye: PoseStream, offset: float) -> float:
    """Median difference [rad] of the angles that hand and eye turn by, the hand read ``offset`` seconds later."""
    step = max(1, len(eye) // _MAX_SAMPLES)
    times, poses = eye.times[::step], eye.poses[::step]
    inside = (times + offset >= hand.times[0]) & (times + offset <= hand.times[-1])
    if inside.sum() < 5:
        return float("inf")
    differences = []
    # A slow eye is read at its own samples: between them it may have turned anyhow.
    intervals = _INTERVALS if eye.period < _INTERVALS[0] else tuple(k * eye.period for k in (1, 2, 4))
    for interval in intervals:
        later = times + interval
        usable = inside & (later <= eye.times[-1]) & (later + offset <= hand.times[-1])
        if usable.sum() < 5:
            continue
        of_eye = _turn(poses[usable], eye.at(later[usable]))
        of_hand = _turn(hand.at(times[usable] + offset), hand.at(later[usable] + offset))
        differences.append(float(np.median(np.abs(of_eye - of_hand))))
    return float(np.mean(differences)) if differences else float("inf")


def estimate_offset(hand: PoseStream, eye: PoseStream, largest: float) -> float:
    """Return the offset [s] with ``hand.at(t + offset)`` belonging to ``eye`` at t, within +- ``largest``."""
    best = 0.0
    for around, reach, step in ((0.0, largest, _COARSE), (None, 2 * _COARSE, _FINE)):
        centre = best if around is None else around
        grid = centre + step * np.arange(-round(reach / step), round(reach / step) + 1)
        scores = np.array([angle_mismatch(hand, eye, float(offset)) for offset in grid])
        if not np.isfinite(scores).any():
            return 0.0
        least = np.nanmin(scores)
        ties = grid[scores <= least + 1e-9]  # a body at rest says nothing: the offset nearest to zero
        best = float(ties[np.argmin(np.abs(ties))])
    return best


def _turn(a: Array, b: Array) -> Array:
    return transforms.rotation_angle(np.swapaxes(a[..., :3, :3], -1, -2) @ b[..., :3, :3])

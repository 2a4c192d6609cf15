"""Hand-eye calibration from poses of the hand in the base and of a target in the camera.

The hand's poses are read at the stamps of the eye's, shifted by a time offset that is estimated. Closed forms start a
joint refinement of the hand-eye transform, the target's pose and the offset, with residuals where the noise is: in the
target's pose in the camera, positions and rotations weighted by their spread, under a robust loss.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from sl_calibration.hand_eye_closed_forms import (
    MotionPairs,
    length_ratio,
    motion_pairs,
    solve_daniilidis,
    solve_park,
    solve_tsai,
)
from sl_calibration.pose_stream import PoseStream
from sl_calibration.time_offset import estimate_offset
from sl_common import transforms
from sl_common.errors import InvalidInputError

Array = NDArray[np.float64]

_STREAM_PERIOD = 0.12
_SLOWEST_EYE = 1.0
_MAX_GAP = 0.1
_LEAST_SECOND_AXIS = float(np.radians(1.0))
_CLOSED_FORM_POSES = 150
_FOLDS = 8
_REFINE_SAMPLES = 600
_SIGMA_FLOOR = np.array([1e-5] * 3 + [1e-5] * 3)


@dataclass(frozen=True)
class HandEyeOptions:
    """How to calibrate.

    Attributes:
        least_angle: Pairs of poses that turn less than this are not used for the start [rad].
        min_poses: Fewest samples accepted.
        max_offset: Largest time offset looked for [s]; 0: the streams are synchronised.
        outlier: A sample this many times farther off than the typical one is an outlier.
        reject_outliers: Leave outliers out instead of refusing the data.
    """

    least_angle: float = float(np.radians(8))
    min_poses: int = 5
    max_offset: float = 0.5
    outlier: float = 12.0
    reject_outliers: bool = False


@dataclass(frozen=True, eq=False)
class HandEye:
    """Result of a hand-eye calibration.

    Attributes:
        flange_from_camera: (4, 4) [m].
        covariance: (6, 6) of x y z rx ry rz in the flange's frame [m, rad].
        base_from_target: (4, 4) the target's pose [m].
        time_offset: The eye's pose at t belongs to the hand's at t + time_offset [s].
        offset_estimated: Whether the offset was estimated (streams) or taken as zero (single poses).
        eye_inverted: Whether the eye's poses turned out to be those of the camera in the target.
        rows: (N,) lines of the eye's file that were used.
        position_error: (N,) distance of the target from its pose [m], all samples in the fit.
        rotation_error: (N,) angle likewise [rad].
        left_out_position: (N,) distance of the target, placed by a fit without the sample's block, from the mean of all
            such placements [m].
        left_out_rotation: (N,) likewise [rad].
        closed_forms: For each closed form: mean position and rotation error [m, rad] over all samples.
        rejected_rows: Lines left out as outliers.
    """

    flange_from_camera: Array
    covariance: Array
    base_from_target: Array
    time_offset: float
    offset_estimated: bool
    eye_inverted: bool
    rows: NDArray[np.int64]
    position_error: Array
    rotation_error: Array
    left_out_position: Array
    left_out_rotation: Array
    closed_forms: dict[str, tuple[float, float]]
    rejected_rows: NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class _Samples:
    """What a fit sees: the hand's stream, stamps and rows (N,), the eye's camera_from_target (N, 4, 4)."""

    hand: PoseStream
    times: Array
    eye: Array
    rows: NDArray[np.int64]
    moving: bool

    def of(self, chosen: NDArray[np.bool_]) -> "_Samples":
        return _Samples(self.hand, self.times[chosen], self.eye[chosen], self.rows[chosen], self.moving)

    def thinned(self, number: int) -> "_Samples":
        chosen = np.zeros(len(self.times), dtype=bool)
        chosen[np.unique(np.linspace(0, len(chosen) - 1, number).round().astype(int))] = True
        return self.of(chosen)


@dataclass(frozen=True, eq=False)
class _Fit:
    """flange_from_camera, base_from_target, offset, the residuals' spread (6,) and the covariance (6, 6) of the
    first."""

    hand_eye: Array
    target: Array
    offset: float
    sigma: Array
    covariance: Array


def calibrate_hand_eye(
    hand: PoseStream, eye: PoseStream, options: HandEyeOptions | None = None, *, eye_inverted: bool | None = None
) -> HandEye:
    """Calibrate.

    Args:
        hand: base_from_hand.
        eye: camera_from_target, or its inverse.
        options: See HandEyeOptions.
        eye_inverted: Whether ``eye`` is target_from_camera; None: find out, the wrong way fits far worse.

    Raises:
        InvalidInputError: too few poses, streams that do not overlap, poses that do not belong together, mixed units, a
            motion that does not determine the transform, or an outlier; the message says which.
    """
    options = options or HandEyeOptions()
    _check_overlap(hand, eye, options)
    epoch = hand.times[0]  # seconds since 1970 leave too few digits for derivatives by time
    hand, eye = (PoseStream(s.times - epoch, s.poses, s.rows) for s in (hand, eye))
    best: tuple[float, bool, _Samples, MotionPairs, dict[str, Array]] | None = None
    failure: InvalidInputError | None = None
    # A hand sampled densely is interpolated, whatever the eye's rate; an eye that looks now and then tells no offset.
    streams = hand.period < _STREAM_PERIOD
    estimate = streams and eye.period < _SLOWEST_EYE and options.max_offset > 0
    for inverted in (False, True) if eye_inverted is None else (eye_inverted,):
        turned = PoseStream(eye.times, transforms.inverse(eye.poses) if inverted else eye.poses, eye.rows)
        offset = estimate_offset(hand, turned, options.max_offset) if estimate else 0.0
        try:
            samples = _pair(hand, turned, offset, options, streams)
            pairs = _checked_pairs(samples, offset, options)
        except InvalidInputError as error:
            failure = failure or error
            continue
        starts = _closed_forms(pairs)
        score = min(_typical(*_errors(samples, start, None, offset)) for start in starts.values())
        if best is None or score < best[0]:
            best = (score, inverted, samples, pairs, starts)
            first_offset = offset
    if best is None:
        assert failure is not None
        raise failure
    _, inverted, samples, pairs, starts = best
    _check_units(pairs, starts["Park"])
    closed = {}
    for name, start in starts.items():
        position, rotation = _errors(samples, start, None, first_offset)
        closed[name] = (float(position.mean()), float(rotation.mean()))
    start = min(starts.values(), key=lambda x: _typical(*_errors(samples, x, None, first_offset)))
    fit = _refine(samples, start, first_offset, estimate)
    samples, rejected = _without_outliers(samples, fit, options)
    if len(rejected):
        fit = _refine(samples, fit.hand_eye, fit.offset, estimate)
    _check_belongs(samples, fit)
    left_position, left_rotation, replicates = _leave_out(samples, fit, estimate)
    position, rotation = _errors(samples, fit.hand_eye, fit.target, fit.offset)
    return HandEye(
        fit.hand_eye,
        _honest_covariance(fit, replicates),
        fit.target,
        fit.offset,
        estimate,
        inverted,
        samples.rows,
        position,
        rotation,
        left_position,
        left_rotation,
        closed,
        rejected,
    )


def _check_overlap(hand: PoseStream, eye: PoseStream, options: HandEyeOptions) -> None:
    reach = options.max_offset
    if hand.times[0] - reach > eye.times[-1] or eye.times[0] - reach > hand.times[-1]:
        raise InvalidInputError(
            f"hand and eye do not overlap in time: {hand.times[0]:.3f} to {hand.times[-1]:.3f} s against"
            f" {eye.times[0]:.3f} to {eye.times[-1]:.3f} s; are both stamped by one clock?"
        )


def _pair(hand: PoseStream, eye: PoseStream, offset: float, options: HandEyeOptions, streams: bool) -> _Samples:
    limit = max(_MAX_GAP, 3 * hand.period) if streams else 1e-3
    if not streams and len(hand) == len(eye) and np.abs(hand.times - eye.times).max() < 0.5:
        eye = PoseStream(hand.times, eye.poses, eye.rows)  # single poses: the stamps only say which belong together
    margin = 0.1 if streams else 0.0
    times = eye.times + offset
    usable = (hand.gap(times) <= limit) & (times >= hand.times[0] + margin) & (times <= hand.times[-1] - margin)
    if usable.sum() < options.min_poses:
        raise InvalidInputError(
            f"too few poses: {usable.sum()} of {len(eye)} eye poses have a hand pose at their time, at least"
            f" {options.min_poses} are needed, better 15"
        )
    return _Samples(hand, eye.times[usable], eye.poses[usable], eye.rows[usable], streams)


def _checked_pairs(samples: _Samples, offset: float, options: HandEyeOptions) -> MotionPairs:
    chosen = samples.thinned(_CLOSED_FORM_POSES)
    hand = samples.hand.at(chosen.times + offset)
    tolerance = float(np.radians(3.0))
    pairs = motion_pairs(hand, chosen.eye, least_angle=options.least_angle, angle_tolerance=tolerance)
    degrees = np.degrees(pairs.largest_angle)
    if pairs.largest_angle < options.least_angle:
        raise InvalidInputError(
            f"degenerate motion: the hand turns by {degrees:.1f} deg at most, a translation says nothing about the"
            f" rotation; turn it by 30 deg and more about two axes"
        )
    if pairs.agreement < 0.5:
        raise InvalidInputError(
            f"hand and eye do not belong together: they turn by the same angle in {100 * pairs.agreement:.0f} % of the"
            " pairs of poses only; shuffled poses, files of two recordings, or clocks that differ by more than"
            f" {options.max_offset:g} s"
        )
    if pairs.second_axis < _LEAST_SECOND_AXIS:
        axis = np.linalg.svd(pairs.hand_vectors, full_matrices=False)[2][0]
        raise InvalidInputError(
            f"degenerate motion: all rotations are about one axis of the hand ({axis[0]:.2f}, {axis[1]:.2f},"
            f" {axis[2]:.2f}), {np.degrees(pairs.second_axis):.1f} deg about any other; add poses that turn about"
            f" another axis by 30 deg and more"
        )
    return pairs


def _check_units(pairs: MotionPairs, start: Array) -> None:
    ratio = length_ratio(pairs, start[:3, :3])
    if not 0.5 < ratio < 2:
        raise InvalidInputError(
            f"mixed units: lengths of the eye must be multiplied by {ratio:.3g} to fit the hand's; give both in metres"
        )


def _closed_forms(pairs: MotionPairs) -> dict[str, Array]:
    forms = {"Tsai": solve_tsai(pairs), "Park": solve_park(pairs)}
    daniilidis = solve_daniilidis(pairs)
    if daniilidis is not None and np.isfinite(daniilidis).all():
        forms["Daniilidis"] = daniilidis
    return forms


def _targets(samples: _Samples, hand_eye: Array, offset: float) -> Array:
    return samples.hand.at(samples.times + offset) @ hand_eye @ samples.eye


def _errors(samples: _Samples, hand_eye: Array, target: Array | None, offset: float) -> tuple[Array, Array]:
    """Distance [m] and angle [rad] (N,) of each sample's base_from_target from ``target``, None: from their median."""
    found = _targets(samples, hand_eye, offset)
    target = _median_pose(found) if target is None else target
    delta = transforms.difference(target, found)
    return np.linalg.norm(delta[:, :3], axis=-1), np.linalg.norm(delta[:, 3:], axis=-1)


def _typical(position: Array, rotation: Array) -> float:
    """One number for position and rotation errors: medians in mm plus tenths of a degree."""
    return float(1e3 * np.median(position) + np.degrees(np.median(rotation)) * 10)


def _median_pose(poses: Array) -> Array:
    """Pose (4, 4) in the middle of poses (N, 4, 4), outliers ignored."""
    start = poses[np.argmin(np.linalg.norm(poses[:, :3, 3] - np.median(poses[:, :3, 3], axis=0), axis=-1))]
    for _ in range(5):
        start = transforms.perturb(start, np.median(transforms.difference(start, poses), axis=0))
    return start


def _refine(
    samples: _Samples, start: Array, offset: float, estimate_offset_too: bool, known: Array | None = None
) -> _Fit:
    """Joint robust least squares; the spreads of positions and rotations are learned from the residuals, or known."""
    target = _median_pose(_targets(samples, start, offset))
    sigma = np.array([2e-3] * 3 + [5e-3] * 3) if known is None else known
    used = samples.thinned(_REFINE_SAMPLES)
    parameters = np.zeros(13 if estimate_offset_too else 12)

    def residuals(p: Array) -> Array:
        hand = used.hand.at(used.times + offset + (p[12] if len(p) > 12 else 0.0))
        predicted = transforms.inverse(hand @ transforms.perturb(start, p[:6])) @ transforms.perturb(target, p[6:12])
        return (transforms.difference(used.eye, predicted) / sigma).ravel()

    solution = None
    for _ in range(4 if known is None else 1):
        solution = least_squares(
            residuals, parameters, loss="cauchy", f_scale=3.0, x_scale=np.array([0.01] * len(parameters)), max_nfev=60
        )
        parameters = solution.x
        raw = np.abs(residuals(parameters).reshape(-1, 6) * sigma)
        spread = 1.4826 * np.repeat([np.median(raw[:, :3]), np.median(raw[:, 3:])], 3)
        sigma = np.maximum(spread, _SIGMA_FLOOR)
    assert solution is not None
    scaled = residuals(parameters)
    weight = 1 / np.sqrt(1 + (scaled / 3) ** 2)
    jacobian = solution.jac
    normal = jacobian.T @ jacobian
    scale = float(((weight * scaled) ** 2).sum() / max(len(scaled) - len(parameters), 1))
    # of the samples used in the fit; the others add nothing new, neighbours in a stream being alike
    covariance = np.linalg.pinv(normal) * max(scale, 0.25)
    return _Fit(
        transforms.perturb(start, parameters[:6]),
        transforms.perturb(target, parameters[6:12]),
        offset + (float(parameters[12]) if estimate_offset_too else 0.0),
        sigma,
        covariance[:6, :6],
    )


def _without_outliers(samples: _Samples, fit: _Fit, options: HandEyeOptions) -> tuple[_Samples, NDArray[np.int64]]:
    position, rotation = _errors(samples, fit.hand_eye, fit.target, fit.offset)
    far = position > options.outlier * max(float(np.median(position)), 1e-4)
    turned = rotation > options.outlier * max(float(np.median(rotation)), 2e-4)
    bad = far | turned
    if not bad.any():
        return samples, np.zeros(0, dtype=np.int64)
    if bad.sum() > 0.2 * len(bad):
        return samples, np.zeros(0, dtype=np.int64)  # no outliers but a bad fit, told by the next check
    worst = int(np.argmax(np.where(bad, position / max(np.median(position), 1e-4), 0)))
    if not options.reject_outliers:
        others = f" and {bad.sum() - 1} more" if bad.sum() > 1 else ""
        raise InvalidInputError(
            f"outlier pose: line {samples.rows[worst]} of the eye's file{others} is"
            f" {1e3 * position[worst]:.1f} mm and {np.degrees(rotation[worst]):.2f} deg off, the typical pose"
            f" {1e3 * np.median(position):.2f} mm and {np.degrees(np.median(rotation)):.3f} deg; remove it, or let"
            " outliers be rejected"
        )
    return samples.of(~bad), samples.rows[bad]


def _check_belongs(samples: _Samples, fit: _Fit) -> None:
    position, rotation = _errors(samples, fit.hand_eye, fit.target, fit.offset)
    hand = samples.hand.at(samples.times)
    travelled = float(np.linalg.norm(np.ptp(hand[:, :3, 3], axis=0)))
    reach = max(travelled, float(np.median(np.linalg.norm(samples.eye[:, :3, 3], axis=-1))))
    if np.median(position) > 0.1 * reach or np.median(rotation) > np.radians(5):
        raise InvalidInputError(
            f"hand and eye do not belong together: the target strays by {1e3 * np.median(position):.0f} mm and"
            f" {np.degrees(np.median(rotation)):.1f} deg in the median; shuffled poses, a target that moved, or"
            f" poses of"
            " another frame"
        )


def _leave_out(samples: _Samples, fit: _Fit, estimate: bool) -> tuple[Array, Array, Array]:
    """Fit without each of eight blocks (single poses when there are few) and place its samples by the rest's result.

    Returns the distance [m] and angle [rad] (N,) of each left-out sample's base_from_target from the mean of them
    all, and the changes (K, 6) of the hand-eye transform.
    """
    number = len(samples.times)
    folds = np.arange(number) * _FOLDS // number if samples.moving else np.arange(number) % min(number, _FOLDS)
    found = np.empty((number, 4, 4))
    replicates = []
    for fold in range(int(folds.max()) + 1):
        test = folds == fold
        trained = _refine(samples.of(~test), fit.hand_eye, fit.offset, estimate, fit.sigma)
        found[test] = _targets(samples.of(test), trained.hand_eye, trained.offset)
        replicates.append(transforms.difference(fit.hand_eye, trained.hand_eye))
    delta = transforms.difference(_median_pose(found), found)
    delta -= delta.mean(0)
    return np.linalg.norm(delta[:, :3], axis=-1), np.linalg.norm(delta[:, 3:], axis=-1), np.array(replicates)


def _honest_covariance(fit: _Fit, replicates: Array) -> Array:
    """Widen the posterior to the delete-a-block jackknife: neighbouring samples of a stream share their errors."""
    groups = len(replicates)
    spread = np.sqrt((groups - 1) / groups * ((replicates - replicates.mean(0)) ** 2).sum(0))
    posterior = np.sqrt(np.diag(fit.covariance))
    factor = np.maximum(1.0, spread / np.maximum(posterior, 1e-12))
    return fit.covariance * np.outer(factor, factor)

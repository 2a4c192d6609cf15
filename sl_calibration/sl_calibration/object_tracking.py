"""Rigid motion of the object of interest between consecutive clouds (paper section III.B, "future work").

Dots lie on the projector's rays, not on the object: when it moves, each dot slides over its surface, so that dots of
the same row and column are different points of the object. Surface is registered to surface instead: the new points
against the tangent planes of the reference surface (point to plane), which leaves free what the surface itself leaves
free - a ball may spin, a plane may slide - and such directions are reported, not guessed.
"""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from sl_common import transforms
from sl_common.errors import StructuredLightError

Array = NDArray[np.float64]
BoolArray = NDArray[np.bool_]


class TrackingLostError(StructuredLightError):
    """The object could not be followed into the new cloud."""


@dataclass(frozen=True, kw_only=True)
class TrackingOptions:
    """How to track.

    Attributes:
        least_points: Fewest points of the object.
        reach: Largest distance that a surface moves between two clouds [m].
        jump: Neighbouring dots farther apart in depth than this share of their median distance along the surface belong
            to different objects.
        position_sigma: Noise of a point along the surface normal, at least [m].
        degenerate: Directions of motion known worse than this [m, at the object's rim] are reported as not observed.
    """

    least_points: int = 40
    reach: float = 0.05
    jump: float = 3.0
    position_sigma: float = 1e-4
    degenerate: float = 5e-3


@dataclass(frozen=True, eq=False)
class Surface:
    """Points with normals, N each: points (N, 3) [m], normals (N, 3) unit, row and col (N,)."""

    points: Array
    normals: Array
    row: NDArray[np.int64]
    col: NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class ObjectMotion:
    """Motion of the object against the reference cloud.

    Attributes:
        reference_from_now: (4, 4) [m], moves the present points onto the reference; its inverse is the object's motion.
        covariance: (6, 6) of x y z rx ry rz of the motion about the object's middle [m, rad]; directions that the
            surface does not show carry the standard deviation UNOBSERVED.
        observed: Number of directions of motion that the surface shows, of 6.
        rms: Distance of the points from the reference surface [m].
        overlap: Share of the present points that met the reference.
        centre: (3,) middle of the present points [m].
    """

    reference_from_now: Array
    covariance: Array
    observed: int
    rms: float
    overlap: float
    centre: Array


UNOBSERVED = 1.0
"""Standard deviation given to directions that are not observed [m at the rim]."""


def _grid(row: NDArray[np.int64], col: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return a table of indices with a border, -1 where no dot is."""
    table = np.full((row.max() + 3, col.max() + 3), -1, dtype=np.int64)
    table[row + 1, col + 1] = np.arange(len(row))
    return table


def build_surface(points: Array, row: NDArray[np.int64], col: NDArray[np.int64], eye: Array) -> Surface:
    """Return the points with normals from their neighbours in the pattern; those without enough neighbours are dropped.

    Args:
        points: (N, 3) [m].
        row: (N,) of the dots.
        col: (N,) of the dots.
        eye: (3,) place from where they were seen; normals point towards it.
    """
    if len(points) == 0:
        return Surface(points, points.copy(), row, col)
    table = _grid(row, col)
    near = np.stack([table[row + i, col + j] for i in (0, 1, 2) for j in (0, 1, 2)], axis=1)
    there = near >= 0
    around = np.where(there[:, :, None], points[near], 0.0)
    count = there.sum(1)
    mean = around.sum(1) / np.maximum(count, 1)[:, None]
    offset = np.where(there[:, :, None], around - mean[:, None, :], 0.0)
    values, vectors = np.linalg.eigh(np.swapaxes(offset, -1, -2) @ offset)
    normals = vectors[:, :, 0]
    # Flat neighbourhoods only: at an edge the plane through both sides is no surface.
    good = (count >= 5) & (values[:, 0] < 0.05 * np.maximum(values[:, 1], 1e-300))
    towards = ((eye - points) * normals).sum(-1)
    normals = normals * np.where(towards < 0, -1.0, 1.0)[:, None]
    return Surface(points[good], normals[good], row[good], col[good])


def segment(
    points: Array,
    row: NDArray[np.int64],
    col: NDArray[np.int64],
    eye: Array,
    options: TrackingOptions | None = None,
    known: BoolArray | None = None,
) -> BoolArray:
    """Return which points (N,) belong to the object of interest: the connected surface nearest to the eye.

    Neighbours in the pattern are connected where their distance is not much larger than usual. Patches of fewer than
    ``least_points`` do not count; of the others, that with the smallest median distance is chosen. Where some points
    are ``known`` (N,) to lie on the object, the patch with most of them is: seen from elsewhere, another may be
    nearer. Raises TrackingLostError where there is none.
    """
    o = options or TrackingOptions()
    count = len(points)
    if count < o.least_points:
        raise TrackingLostError(f"{count} points, at least {o.least_points} are needed to follow an object")
    table = _grid(row, col)
    links = []
    for i, j in ((1, 2), (2, 1)):
        other = table[row + i, col + j]
        mine = np.flatnonzero(other >= 0)
        links.append(np.stack([mine, other[mine]]))
    a, b = np.concatenate(links, axis=1)
    distance = np.linalg.norm(points[a] - points[b], axis=-1)
    close = distance < o.jump * np.median(distance) if len(distance) else np.zeros(0, dtype=bool)
    graph = coo_matrix((np.ones(close.sum()), (a[close], b[close])), shape=(count, count))
    _, label = connected_components(graph, directed=False)
    size = np.bincount(label)
    range_ = np.linalg.norm(points - eye, axis=-1)
    large = np.flatnonzero(size >= o.least_points)
    if len(large) == 0:
        raise TrackingLostError(f"no connected surface of {o.least_points} points; the largest has {size.max()}")
    if known is not None and known.any():
        best = max(large, key=lambda k: int(known[label == k].sum()))
    else:
        best = min(large, key=lambda k: float(np.median(range_[label == k])))
    return np.asarray(label == best)


def register(
    reference: Surface, points: Array, start: Array | None = None, options: TrackingOptions | None = None
) -> ObjectMotion:
    """Find the rigid motion of points (N, 3) onto a reference surface by point-to-plane ICP with a robust loss.

    Done twice from the start: the first pass finds the noise, which tells in the second what the surface shows.
    Raises TrackingLostError for too few points or too little overlap.
    """
    o = options or TrackingOptions()
    if len(points) < o.least_points or len(reference.points) < o.least_points:
        raise TrackingLostError(
            f"{len(points)} points against {len(reference.points)} of the reference; {o.least_points} are needed"
        )
    start = transforms.identity() if start is None else np.asarray(start, dtype=np.float64)
    first = _Registration(reference, points, start, o, o.position_sigma)
    return _Registration(reference, points, start, o, first.sigma).motion()


class _Registration:
    """One pass of the registration; ``noise`` [m] decides which directions count as observed."""

    def __init__(self, reference: Surface, points: Array, start: Array, options: TrackingOptions, noise: float) -> None:
        self._reference, self._points, self._options, self._noise = reference, points, options, noise
        self._tree = cKDTree(reference.points)
        self._spacing = float(np.median(self._tree.query(reference.points, k=2)[0][:, 1]))
        self._centre = points.mean(0)
        rim = max(float(np.sqrt(((points - self._centre) ** 2).sum(-1).mean())), 1e-6)
        # Rotations in metres at the object's rim: all six directions in the same unit.
        self._scale = np.array([1.0, 1.0, 1.0, 1 / rim, 1 / rim, 1 / rim])
        self._pose = start
        reach = max(options.reach, 2 * self._spacing)
        for iteration in range(40):
            step = self._step(reach)
            reach = max(0.8 * reach, 3 * self._spacing)
            if iteration > 5 and np.abs(step).max() < 1e-7:
                break

    def _step(self, reach: float) -> Array:
        """Match, solve and move once; returns the step (6,) [m]."""
        moved = transforms.apply(self._pose, self._points)
        pivot = transforms.apply(self._pose, self._centre[None])[0]
        distance, index = self._tree.query(moved)
        plane, surface = self._reference.normals[index], self._reference.points[index]
        self._error = ((moved - surface) * plane).sum(-1)
        across = np.linalg.norm((moved - surface) - self._error[:, None] * plane, axis=-1)
        self._near = (distance < reach) & (across < 1.2 * self._spacing)
        if self._near.sum() < self._options.least_points:
            raise TrackingLostError(f"{int(self._near.sum())} of {len(moved)} points meet the reference surface")
        self.sigma = max(1.4826 * float(np.median(np.abs(self._error[self._near]))), self._options.position_sigma)
        weight = np.where(self._near, 1 / (1 + (self._error / (3 * self.sigma)) ** 2), 0.0)
        jacobian = np.hstack([plane, np.cross(moved - pivot, plane)]) * self._scale
        self._values, self._vectors = np.linalg.eigh((jacobian * weight[:, None]).T @ jacobian)
        self._seen = self._values > self._least_information(float(weight.sum()))
        inverse = np.where(self._seen, 1 / np.maximum(self._values, 1e-300), 0.0)
        step = -(self._vectors * inverse) @ (self._vectors.T @ (jacobian.T @ (weight * self._error)))
        move = step * self._scale
        turn = transforms.rotation_exp(move[3:])
        self._pose = transforms.make(turn, pivot + move[:3] - turn @ pivot) @ self._pose
        return step

    def _least_information(self, count: float) -> float:
        """Return the eigenvalue of the normal matrix [1] above which a direction counts as observed.

        Normals from noisy neighbours scatter, and the scatter alone looks like information about sliding and spinning.
        """
        scatter = self._noise**2 / (6 * self._spacing**2)
        return max((self._noise / self._options.degenerate) ** 2, 25 * count * scatter)

    def motion(self) -> ObjectMotion:
        """Return the result."""
        variance = np.where(self._seen, self.sigma**2 / np.maximum(self._values, 1e-300), UNOBSERVED**2)
        covariance = (self._vectors * variance) @ self._vectors.T * np.outer(self._scale, self._scale)
        return ObjectMotion(
            reference_from_now=self._pose,
            covariance=covariance,
            observed=int(self._seen.sum()),
            rms=float(np.sqrt(np.mean(self._error[self._near] ** 2))),
            overlap=float(self._near.mean()),
            centre=self._centre,
        )


@dataclass
class ObjectTracker:
    """Follows the object of interest from cloud to cloud, against the first one seen.

    Attributes:
        options: How to track.
    """

    options: TrackingOptions = field(default_factory=TrackingOptions)
    _reference: Surface | None = None
    _pose: Array = field(default_factory=transforms.identity)

    def reset(self) -> None:
        """Forget the object; the next cloud is the reference."""
        self._reference, self._pose = None, transforms.identity()

    def update(self, points: Array, row: NDArray[np.int64], col: NDArray[np.int64], eye: Array) -> ObjectMotion:
        """Register a cloud; returns the motion since the reference.

        Directions that the surface does not show keep their value. Raises TrackingLostError; the reference stays.

        Args:
            points: (N, 3) in the base frame [m].
            row: (N,) of the dots.
            col: (N,) of the dots.
            eye: (3,) position of the camera in the base frame [m].
        """
        known = None
        if self._reference is not None and len(points):
            distance = cKDTree(self._reference.points).query(transforms.apply(self._pose, points))[0]
            known = distance < self.options.reach / 2
        chosen = segment(points, row, col, eye, self.options, known)
        points, row, col = points[chosen], row[chosen], col[chosen]
        if self._reference is None:
            surface = build_surface(points, row, col, eye)
            if len(surface.points) < self.options.least_points:
                raise TrackingLostError(
                    f"{len(surface.points)} points with a normal, {self.options.least_points} are needed"
                )
            self._reference = surface
        motion = register(self._reference, points, self._pose, self.options)
        self._pose = motion.reference_from_now
        return motion

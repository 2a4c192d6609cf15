"""What a self-calibration is computed from: views of one static scene, flattened into arrays of observations."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sl_common import transforms
from sl_common.errors import InvalidInputError

Array = NDArray[np.float64]
IntArray = NDArray[np.int64]

LEAST_DOTS = 12
"""A view with fewer dots than this cannot be placed and is refused."""

MILLIMETRE_EXTENT = 20.0
"""Flange positions farther from the base than this [m] belong to no arm: they are in millimetres."""


@dataclass(frozen=True, eq=False)
class View:
    """The dots of one image and the pose of the flange when it was taken.

    Attributes:
        name: Of the image, used in messages.
        row: (N,) int64, row of each dot in the pattern.
        col: (N,) int64, its column.
        pixels: (N, 2) float64, raw camera pixels.
        base_from_flange: (4, 4) as the robot reports it [m].
        stamp: Of the image [ns]; 0: unknown.
    """

    name: str
    row: IntArray
    col: IntArray
    pixels: Array
    base_from_flange: Array
    stamp: int = 0

    def __post_init__(self) -> None:
        row, col = np.asarray(self.row, dtype=np.int64), np.asarray(self.col, dtype=np.int64)
        pixels = np.asarray(self.pixels, dtype=np.float64).reshape(-1, 2)
        if not len(row) == len(col) == len(pixels):
            raise InvalidInputError(
                f"{self.name}: {len(row)} rows, {len(col)} columns and {len(pixels)} pixels of dots"
            )
        for name, value in (("row", row), ("col", col), ("pixels", pixels)):
            object.__setattr__(self, name, value)
        object.__setattr__(self, "base_from_flange", np.array(self.base_from_flange, dtype=np.float64))

    def usable(self) -> "View":
        """Return the view without dots that it claims twice, as one of the two must be wrong, and without NaN."""
        _, where, count = np.unique(np.stack([self.row, self.col]), axis=1, return_inverse=True, return_counts=True)
        keep = (count[where.reshape(-1)] == 1) & np.isfinite(self.pixels).all(-1)
        return replace(self, row=self.row[keep], col=self.col[keep], pixels=self.pixels[keep])


@dataclass(frozen=True, eq=False)
class Observations:
    """All views as flat arrays. M observations of K dots in V views.

    Attributes:
        names: V names of the views.
        base_from_flange: (V, 4, 4) as reported [m].
        view: (M,) index of the view of each observation.
        point: (M,) index of its dot.
        pixels: (M, 2) raw camera pixels.
        dots: (K, 2) row and column of each dot.
        projector_pixels: (K, 2) where the projector shows it.
    """

    names: tuple[str, ...]
    base_from_flange: Array
    view: IntArray
    point: IntArray
    pixels: Array
    dots: IntArray
    projector_pixels: Array

    def select(self, keep: NDArray[np.bool_]) -> "Observations":
        """Keep the observations where ``keep`` (M,) is true; views and dots stay as they are."""
        return Observations(
            self.names,
            self.base_from_flange,
            self.view[keep],
            self.point[keep],
            self.pixels[keep],
            self.dots,
            self.projector_pixels,
        )


def flatten(views: Sequence[View], centers: Array) -> Observations:
    """Flatten views into observations; ``centers`` (rows, cols, 2) are the pattern's spot centres [projector px].

    Only usable dots count, see :meth:`View.usable`. Raises InvalidInputError naming the view for dots outside the
    pattern or too few dots.
    """
    rows, cols = centers.shape[:2]
    view_index, dot_index, pixels = [], [], []
    for i, view in enumerate(views):
        outside = (view.row < 0) | (view.row >= rows) | (view.col < 0) | (view.col >= cols)
        if outside.any():
            bad = int(np.flatnonzero(outside)[0])
            raise InvalidInputError(
                f"{view.name}: dot at row {view.row[bad]}, column {view.col[bad]} is outside the {rows}x{cols} pattern:"
                " give the pattern file that was projected"
            )
        kept = view.usable()
        if len(kept.row) < LEAST_DOTS:
            raise InvalidInputError(
                f"{view.name}: {len(kept.row)} usable dots, at least {LEAST_DOTS} are needed: retake or leave out this"
                " view"
            )
        view_index.append(np.full(len(kept.row), i))
        dot_index.append(kept.row * cols + kept.col)
        pixels.append(kept.pixels)
    dots, point = np.unique(np.concatenate(dot_index), return_inverse=True)
    row_col = np.stack([dots // cols, dots % cols], axis=-1)
    return Observations(
        names=tuple(view.name for view in views),
        base_from_flange=np.stack([view.base_from_flange for view in views]),
        view=np.concatenate(view_index),
        point=point.reshape(-1).astype(np.int64),
        pixels=np.concatenate(pixels),
        dots=row_col,
        projector_pixels=np.asarray(centers, dtype=np.float64)[row_col[:, 0], row_col[:, 1]],
    )


def check_poses(names: Sequence[str], poses: Array) -> None:
    """Raise InvalidInputError naming the views whose flange pose is not rigid, in millimetres or repeated for all."""
    for name, pose in zip(names, poses, strict=True):
        if not transforms.is_rigid(pose, 1e-3):
            raise InvalidInputError(
                f"{name}: base_from_flange is not a rigid 4x4 transform: rotation part orthonormal, last row 0 0 0 1"
            )
    distance = np.linalg.norm(poses[:, :3, 3], axis=-1)
    far = distance > MILLIMETRE_EXTENT
    if far.any():
        which = "all views" if far.all() else ", ".join(name for name, f in zip(names, far, strict=True) if f)
        raise InvalidInputError(
            f"flange positions {distance[far].min():.0f} to {distance[far].max():.0f} m from the base in {which}:"
            " these look like millimetres, give metres"
        )

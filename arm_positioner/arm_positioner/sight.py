"""The object as the clouds show it over time: a target per cloud, smoothed while it is followed."""

import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from arm_positioner.errors import ObjectGoneError
from arm_positioner.following import TargetFilter
from arm_positioner.target import Target, TargetOptions, find_target, other_targets
from sl_common import transforms

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Sighting:
    """A cloud in the base frame.

    Attributes:
        time: When its image was taken [s].
        points: (N, 3) in the base frame [m].
        base_from_camera: (4, 4) camera pose at that time [m].
        confidence: (N,) or None.
        row: (N,) or None.
        col: (N,) or None.
        projector: (3,) its position [m], or None.
    """

    time: float
    points: Array
    base_from_camera: Array
    confidence: NDArray | None = None
    row: NDArray | None = None
    col: NDArray | None = None
    projector: Array | None = None


class Sight:
    """Finds the target in each cloud and keeps to the same object."""

    def __init__(
        self,
        smoothing: TargetFilter | None = None,
        find: Callable[..., Target] = find_target,
        find_others: Callable[..., list[Target]] = other_targets,
    ) -> None:
        """Smooth followed targets by ``smoothing``; the functions are those of :mod:`.target`, or the same in another
        process.
        """
        self._find, self._find_others = find, find_others
        self._filter = smoothing or TargetFilter()
        self._lock = threading.Lock()
        self._latest: Target | None = None
        self._offset: Array | None = None

    def reset(self) -> None:
        """Forget the object: the next target is the nearest one again."""
        with self._lock:
            self._filter.reset()
            self._latest = self._offset = None

    def choose_anew(self) -> None:
        """Keep the object but not the place on it: the next target is where the normal is clear."""
        with self._lock:
            self._filter.reset()
            self._offset = None

    @property
    def latest(self) -> Target | None:
        """The target of the last cloud, unsmoothed."""
        return self._latest

    def look(self, sighting: Sighting, options: TargetOptions, *, anchor: Array | None = None) -> Target:
        """Return the target in a cloud, as it is; see :func:`.target.find_target` for ``anchor`` and errors.

        The place on the object, chosen in the first cloud, stays where it is against the object's middle. Where the
        object of an earlier goal is gone, a new goal takes the nearest one.
        """
        with self._lock:
            previous, offset = self._latest, self._offset
        try:
            target = self._find_in(
                sighting, options, None if previous is None else previous.surface.point, anchor, offset
            )
        except ObjectGoneError:
            if offset is not None or anchor is not None:
                raise
            target = self._find_in(sighting, options, None, None, None)
        with self._lock:
            self._latest = target
            if offset is None or anchor is not None:
                self._offset = target.surface.point - target.middle
            self._filter.update(sighting.time, target.base_from_camera)
        return target

    def others(self, sighting: Sighting, options: TargetOptions) -> list[Target]:
        """Return targets before other places of the object last looked at; see :func:`.target.other_targets`."""
        latest = self._latest
        previous = None if latest is None else latest.surface.point
        return self._find_others(sighting.points, sighting.base_from_camera, **_details(sighting, options, previous))

    def take(self, target: Target) -> None:
        """Keep to the place of ``target`` from now on."""
        with self._lock:
            self._filter.reset()
            self._latest, self._offset = target, target.surface.point - target.middle

    def _find_in(
        self,
        sighting: Sighting,
        options: TargetOptions,
        previous: Array | None,
        anchor: Array | None,
        offset: Array | None,
    ) -> Target:
        return self._find(
            sighting.points,
            sighting.base_from_camera,
            anchor=anchor,
            offset=offset,
            **_details(sighting, options, previous),
        )

    def expected(self, time: float) -> Array:
        """Return the smoothed target pose (4, 4) expected at ``time`` [s]."""
        with self._lock:
            return self._filter.at(time)


def _details(sighting: Sighting, options: TargetOptions, previous: Array | None) -> dict[str, Any]:
    """Return what finding targets is told beside the points and the camera's pose."""
    names = ("confidence", "row", "col", "projector")
    return {name: getattr(sighting, name) for name in names} | {"options": options, "previous": previous}


def nearly_equal(a: Array, b: Array, *, distance: float = 3e-4, angle: float = 2e-3) -> bool:
    """Whether two poses (4, 4) differ by less than ``distance`` [m] and ``angle`` [rad]: not worth a motion."""
    delta = transforms.difference(a, b)
    return bool(np.linalg.norm(delta[:3]) < distance and np.linalg.norm(delta[3:]) < angle)

"""Which letter of a map gets which representation: likely confusions should rarely lead towards another window's code.

Windows at the least distance h from each other are told apart by h cells. If the two letters in such a cell look
alike to the camera, one error there leaves h - 1. So the pairs of letters that separate the closest windows most
often get the representations that the camera separates best: a quadratic assignment, over the (a, a) counts of such
separations and the (a, a) probabilities of confusion. It is solved exactly up to 8 letters, by exchanges above.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import permutations
from math import erfc, sqrt

import numpy as np
from numpy.typing import NDArray

from pattern_gen.letters import PROJECTOR_GAMMA
from pattern_gen.pattern import Letter
from pattern_gen.search_request import Request
from pattern_gen.shapes import SHAPES
from pattern_gen.verification import window_codes

CHROMATICITY_NOISE = 0.10  # standard deviation in the camera: unknown albedo, mixing of channels, noise of dim spots
LOG_LIGHT_NOISE = 0.30  # of the logarithm of the light: albedo, distance and slope vary from spot to spot
SHAPE_NOISE = 0.20  # of the part of the enclosing circle in which two shapes differ: blur, few pixels
EXACT_UP_TO = 8
_COMPARED = 4_000_000  # codes compared with each other at most; from more windows, an even choice is taken
_SHAPE_LINES = 201


def separations(symbols: NDArray[np.uint8], request: Request) -> NDArray[np.float64]:
    """How often each pair of letters separates two windows at the least distance of any two.

    Args:
        symbols: (rows, cols) map.
        request: grid, window, alphabet and whether rotations count.

    Returns:
        (a, a) symmetric counts with a zero diagonal. Large maps: counted from an even choice of windows.
    """
    codes = window_codes(symbols, request.grid, request.window, request.invariant)
    windows = codes.shape[2]
    cells = codes.reshape(len(codes), -1)
    total = cells.shape[1]
    chosen = np.unique(np.linspace(0, windows - 1, min(windows, max(1, _COMPARED // total))).astype(np.int64))
    counts = np.zeros((request.alphabet, request.alphabet))
    least = len(cells)
    for window in chosen:
        gaps = np.zeros(total, np.uint8)
        for cell in cells:
            gaps += cell != cell[window]
        gaps[window::windows] = 255  # the window itself in any orientation
        if gaps.min() < least:
            least = int(gaps.min())
            counts[:] = 0.0
        near = cells[:, gaps == least]
        here = np.broadcast_to(cells[:, window, None], near.shape)
        differ = near != here
        np.add.at(counts, (here[differ], near[differ]), 1.0)
    return counts + counts.T


def confusion(letters: Sequence[Letter]) -> NDArray[np.float64]:
    """Probability of taking one representation for another in a camera-like space: (a, a), zero diagonal.

    The space is the chromaticity, the logarithm of the light and the shape, each in units of its noise; two points at
    distance d are confused with the probability that normal noise carries one beyond their middle.
    """
    light = np.array([[(value / 255.0) ** PROJECTOR_GAMMA for value in letter.rgb] for letter in letters])
    total = light.sum(axis=1)
    chromaticity = light / total[:, None] / CHROMATICITY_NOISE
    brightness = np.log(total) / LOG_LIGHT_NOISE
    gap = ((chromaticity[:, None] - chromaticity[None]) ** 2).sum(axis=2) + (brightness[:, None] - brightness) ** 2
    names = sorted({letter.shape for letter in letters})
    masks = {name: _mask(name) for name in names}
    for i, first in enumerate(letters):
        for j, second in enumerate(letters):
            gap[i, j] += (np.mean(masks[first.shape] != masks[second.shape]) / SHAPE_NOISE) ** 2
    probability = np.array([[0.5 * erfc(sqrt(value) / (2.0 * sqrt(2.0))) for value in row] for row in gap])
    np.fill_diagonal(probability, 0.0)
    return probability


def _mask(shape: str) -> NDArray[np.bool_]:
    """A shape of diameter one, sampled on its enclosing circle."""
    at = (np.arange(_SHAPE_LINES) + 0.5) / _SHAPE_LINES - 0.5
    chords = SHAPES[shape].chords(at)
    inside = np.zeros((_SHAPE_LINES, _SHAPE_LINES), np.bool_)
    for interval in range(chords.shape[1]):
        inside |= (at >= chords[:, interval, :1]) & (at < chords[:, interval, 1:])
    circle: NDArray[np.bool_] = np.hypot(at[:, None], at) < 0.5
    return inside[circle]


def best_assignment(counts: NDArray[np.float64], probability: NDArray[np.float64]) -> tuple[int, ...]:
    """The representation of each letter that minimises the sum of counts times probabilities of confusion.

    Args:
        counts, probability: (a, a) symmetric.

    Returns:
        A permutation of 0..a-1; the first in lexicographic order of equally good ones (found exactly for small a).
    """
    a = len(counts)

    def cost(order: NDArray[np.int64]) -> NDArray[np.float64]:
        return (probability[order[..., :, None], order[..., None, :]] * counts).sum(axis=(-2, -1))

    identity = np.arange(a)
    if a <= EXACT_UP_TO:
        orders = np.array(list(permutations(range(a))))
        costs = np.concatenate([cost(part) for part in np.array_split(orders, max(1, len(orders) // 5000))])
        return tuple(orders[int(np.flatnonzero(costs <= costs.min() * (1 + 1e-12))[0])].tolist())
    random = np.random.default_rng(0)
    best = _exchange(identity, cost)
    for _ in range(8):
        other = _exchange(random.permutation(a), cost)
        if cost(other) < cost(best) * (1 - 1e-12):
            best = other
    return tuple(best.tolist())


def _exchange(order: NDArray[np.int64], cost: Callable[[NDArray[np.int64]], NDArray[np.float64]]) -> NDArray[np.int64]:
    """Exchange the best pair until none improves the cost."""
    first, second = np.triu_indices(len(order), 1)
    while True:
        trials = np.repeat(order[None], len(first), axis=0)
        rows = np.arange(len(first))
        trials[rows, first], trials[rows, second] = order[second], order[first]
        costs = cost(trials)
        if costs.min() >= cost(order) * (1 - 1e-12):
            return order
        order = trials[int(costs.argmin())]


def assign_letters(symbols: NDArray[np.uint8], letters: Sequence[Letter], request: Request) -> tuple[Letter, ...]:
    """The same representations, arranged for a map: see the module."""
    order = best_assignment(separations(symbols, request), confusion(letters))
    return tuple(letters[i] for i in order)

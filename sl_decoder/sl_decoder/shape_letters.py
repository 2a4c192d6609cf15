"""First reading of letters that differ in shape: all of a hue told apart by intensity and radial profile together.

How bright and how peaked a shape's image is depends on the blur as much as on the letter: a blurred ring is darker than
a disc and may be as dark as a disc of the next intensity. So the letters are a mixture of as many normal distributions
in (log signal over its surroundings, radial profile), with the map's shares. It is begun at the places where the
letters' images lie under several blurs, fitted by expectation maximisation, and the likeliest is taken.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sl_decoder.alphabet import Alphabet
from sl_decoder.letter_model import LetterModel

Array = NDArray[np.float64]

FIRST_SPREAD = np.array([0.15, 0.05])  # of log signal and profile, before anything is known
LEAST_SPREAD = np.array([0.03, 0.01])  # that noise leaves
OUTLIERS = 0.05  # share of dots that are no letter's
RANGE = 4.0  # of log signal times that of the profile, over which those are spread
SAMPLE = 300  # dots from which the blur is told
FIRST_ROUNDS = 6  # of expectation maximisation under each blur
FIELD_ROUNDS = 3  # in which the surroundings are freed of their letters' levels
ROUNDS = 3  # of expectation maximisation in each of those
TIED = 20.0  # dots' worth of a spread that all letters have in common


class Mixture(NamedTuple):
    """Letters as normal distributions: mean and spread (A, 2) of log signal over the field and of the profile."""

    mean: Array
    spread: Array


def features(x: Array) -> Array:
    """What mixtures are weighed and fitted with (N, 6): squares, values, presence of measures x (N, 2), nan: none."""
    known = ~np.isnan(x)
    value = np.where(known, x, 0.0)
    return np.hstack([value * value, value, known])


def weigh(mixture: Mixture, share: Array, of: Array) -> tuple[Array, float]:
    """Probability (N, A) of each letter for dots of `features` (N, 6), and the mean logarithm of their density.

    share (N, A): before measuring. A measure that is nan tells nothing.
    """
    precision = mixture.spread**-2.0
    constant = precision * mixture.mean**2 - np.log(precision)
    exponent = of @ np.hstack([precision, -2.0 * precision * mixture.mean, constant]).T
    density = share * np.exp(-0.5 * exponent) / (2.0 * np.pi)
    total = density.sum(1) + OUTLIERS / RANGE
    return density / total[:, None], float(np.log(total).mean())


def fit(mixture: Mixture, share: Array, of: Array, rounds: int) -> tuple[Mixture, float]:
    """Expectation maximisation; returns the mixture and the mean log density it gave before the last round."""
    density = -np.inf
    for _ in range(rounds):
        probability, density = weigh(mixture, share, of)
        square, value, weight = np.split(probability.T @ of, 3, axis=1)  # each (A, 2)
        mean = (value + mixture.mean) / (weight + 1.0)
        square = np.maximum(square + mean * (mean * weight - 2.0 * value), 0.0)  # of the deviations
        common = square.sum(0) / np.maximum(weight.sum(0), 1.0)
        spread = np.sqrt((square + TIED * common) / (weight + TIED))
        mixture = Mixture(mean, np.maximum(spread, LEAST_SPREAD))
    return mixture, density


def read_shapes(
    alphabet: Alphabet, hue: NDArray, signal: NDArray, profile: NDArray, near: NDArray, use: NDArray
) -> tuple[NDArray[np.int32], Mixture]:
    """Letters (N,) int32 of dots with their mixture.

    hue (N,) of each dot; signal (N,) its log signal; profile (N,), nan where not measured; near (N, K) neighbours or
    -1; use (N,) bool: dots that look like part of a lattice.
    """
    share = np.where(hue[:, None] == alphabet.hue, alphabet.share, 0.0)
    share *= (1.0 - OUTLIERS) / np.maximum(share.sum(1, keepdims=True), 1e-9)
    counted = (near >= 0) & use[near]
    number = np.maximum(counted.sum(1), 1)

    def surroundings(value: Array) -> Array:
        return np.where(counted, value[near], 0.0).sum(1) / number

    relative = signal.astype(np.float64)
    for h in range(int(alphabet.hue.max()) + 1):
        of_hue = use & (hue == h)
        if of_hue.any():
            relative[hue == h] -= np.median(relative[of_hue])
    x = np.stack([relative - surroundings(relative), profile], 1)
    chosen = np.flatnonzero(use)
    few = chosen[:: max(1, len(chosen) // SAMPLE)]
    best, highest = None, -np.inf
    for appearance in alphabet.appearances:  # (A, 2)
        expected = appearance.copy()
        for h in range(int(alphabet.hue.max()) + 1):
            letters = alphabet.hue == h
            expected[letters, 0] -= np.average(appearance[letters, 0], weights=alphabet.share[letters])
        begun = Mixture(expected, np.tile(FIRST_SPREAD, (len(expected), 1)))
        mixture, density = fit(begun, share[few], features(x[few]), FIRST_ROUNDS)
        if density > highest:
            best, highest = mixture, density
    assert best is not None
    for _ in range(FIELD_ROUNDS):
        probability, _ = weigh(best, share, features(x))
        level = probability @ best.mean[:, 0]
        x[:, 0] = relative - surroundings(relative - level)
        best, _ = fit(best, share[few], features(x[few]), ROUNDS)
    probability, _ = weigh(best, share, features(x))
    return np.argmax(probability, axis=1).astype(np.int32), best


def with_shapes(model: LetterModel, mixture: Mixture, alphabet: Alphabet) -> LetterModel:
    """A model with the levels and profiles of a mixture: letters that overlap are as uncertain as they are."""
    profile, spread = model.profile.copy(), model.profile_spread.copy()
    for g in np.unique(alphabet.group):
        letters = alphabet.group == g
        weights = alphabet.share[letters]
        mean = np.average(mixture.mean[letters, 1], weights=weights)
        square = np.average(mixture.spread[letters, 1] ** 2 + (mixture.mean[letters, 1] - mean) ** 2, weights=weights)
        profile[g], spread[g] = mean, np.sqrt(square)
    level, level_spread = mixture.mean[:, 0].astype(np.float32), mixture.spread[:, 0].astype(np.float32)
    return model._replace(profile=profile, profile_spread=spread, level=level, level_spread=level_spread)

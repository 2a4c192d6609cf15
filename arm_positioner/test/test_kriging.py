"""The normal at the scale of the dots: on surfaces in closed form, with noise, outliers and changing curvature."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from arm_positioner.kriging import fit_height

SPACING = 0.01


def grid(rng, half=6, jitter=0.15):
    x, y = np.meshgrid(np.arange(-half, half + 1.0), np.arange(-half, half + 1.0))
    places = SPACING * (np.stack([x.ravel(), y.ravel()], axis=1) + jitter * rng.normal(size=(x.size, 2)))
    return places[np.argsort(np.linalg.norm(places, axis=1))][:120]


def fit(places, heights, inliers=None):
    ones = np.ones(len(places))
    return fit_height(places, heights, ones, np.ones(len(places), bool) if inliers is None else inliers, SPACING)


def waves(rng, length, height):
    """A sum of waves no shorter than ``length``, and its mean slopes over a dot's neighbourhood at the origin."""
    wave = 2 * np.pi / (length * rng.uniform(1, 2, 6))
    angle, phase, size = rng.uniform(0, np.pi, 6), rng.uniform(0, 2 * np.pi, 6), rng.uniform(0.5, 1, 6)
    vector = wave[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    size *= height / size.sum()
    mean = np.exp(-0.5 * (wave * 0.75 * SPACING) ** 2)  # a Gaussian mean of a wave
    return lambda p: np.sin(p @ vector.T + phase) @ size, (size * mean * np.cos(phase)) @ vector


def degrees(fitted, true):
    return np.degrees(np.linalg.norm(fitted.estimate[1:] - true))


@settings(max_examples=30)
@given(st.lists(st.floats(-1, 1), min_size=6, max_size=6), st.integers(0, 1000))
def test_a_quadric_is_met_exactly(c, seed):
    places = grid(np.random.default_rng(seed))
    x, y = places.T
    fitted = fit(places, 0.01 * c[0] + c[1] * x + c[2] * y + 5 * (c[3] * x * x + c[4] * x * y + c[5] * y * y))
    assert fitted.estimate == pytest.approx([0.01 * c[0], c[1], c[2]], abs=1e-6)
    assert fitted.bending == pytest.approx(5 * np.array([[2 * c[3], c[4]], [c[4], 2 * c[5]]]), abs=1e-3)


def test_curvature_that_changes_from_dot_to_dot_does_not_bias_the_normal():
    errors = []
    for seed in range(20):
        rng = np.random.default_rng(seed)
        surface, slopes = waves(rng, 10 * SPACING, 0.01)
        places = grid(rng)
        errors.append(degrees(fit(places, surface(places)), slopes))
    assert np.median(errors) < 0.1
    assert max(errors) < 0.5


@pytest.mark.parametrize("noise", [1e-4, 3e-4])
def test_the_uncertainty_stated_is_that_of_the_errors(noise):
    errors, noises = [], []
    for seed in range(60):
        rng = np.random.default_rng(seed)
        surface, slopes = waves(rng, rng.uniform(15, 40) * SPACING, 0.01)
        places = grid(rng)
        fitted = fit(places, surface(places) + noise * rng.normal(size=len(places)))
        errors += list((fitted.estimate[1:] - slopes) / np.sqrt(np.diag(fitted.covariance)[1:]))
        noises.append(fitted.noise)
    assert 0.6 < np.std(errors) < 1.4
    assert np.mean(np.abs(errors) > 3) < 0.03
    assert 0.8 * noise < np.median(noises) < 1.2 * noise


def test_a_flat_face_averages_the_whole_neighbourhood():
    sigma = []
    for seed in range(20):
        rng = np.random.default_rng(seed)
        places = grid(rng)
        sigma.append(degrees(fit(places, 3e-4 * rng.normal(size=len(places))), 0.0))
    best = np.degrees(3e-4 / np.sqrt((grid(np.random.default_rng(0))[:, 0] ** 2).sum()))
    assert np.sqrt(np.mean(np.square(sigma)) / 2) < 2.0 * best


@pytest.mark.parametrize("share", [0.03, 0.1, 0.2])
def test_wrong_points_are_left_out(share):
    for seed in range(10):
        rng = np.random.default_rng(seed)
        surface, slopes = waves(rng, 25 * SPACING, 0.01)
        places = grid(rng)
        wrong = rng.random(len(places)) < share
        heights = surface(places) + 1e-4 * rng.normal(size=len(places))
        heights[wrong] += rng.choice([-1, 1], wrong.sum()) * rng.uniform(0.01, 0.1, wrong.sum())
        fitted = fit(places, heights)
        assert not (fitted.inliers & wrong).any()
        assert degrees(fitted, slopes) < 1.0


def test_details_as_fine_as_the_dots_are_no_wrong_points():
    rng = np.random.default_rng(0)
    surface, _ = waves(rng, 30 * SPACING, 0.01)
    places = grid(rng)
    dent = 3e-4 * np.exp(-0.5 * ((places - places[5]) ** 2).sum(axis=1) / SPACING**2)
    assert fit(places, surface(places) - dent).inliers.all()

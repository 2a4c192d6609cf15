"""The projector's pose in the base from a calibrated pair and the arm's pose."""

import numpy as np

from sl_calibration.projector_placement import place_projector
from sl_common import transforms
from sl_common.calibration_files import PoseCalibration

RNG = np.random.default_rng(5)


def random_pose(distance):
    return transforms.make(transforms.rotation_exp(RNG.uniform(-1.5, 1.5, 3)), RNG.uniform(-distance, distance, 3))


def random_covariance():
    root = RNG.normal(size=(6, 6)) * np.repeat([2e-3, 4e-3], 3)[:, None]
    return root @ root.T


def test_the_frames_are_chained():
    flange, hand_eye, pair = random_pose(1.0), random_pose(0.1), random_pose(0.8)
    placed = place_projector(flange, PoseCalibration(hand_eye), PoseCalibration(pair))
    np.testing.assert_allclose(placed.transform, flange @ hand_eye @ pair, atol=1e-12)
    np.testing.assert_array_equal(placed.covariance, 0)


def test_the_covariance_is_that_of_perturbed_transforms():
    flange = random_pose(1.0)
    hand_eye = PoseCalibration(random_pose(0.1), random_covariance())
    pair = PoseCalibration(random_pose(0.8), random_covariance())
    placed = place_projector(flange, hand_eye, pair)
    one, two = (
        transforms.perturb(pose.transform, RNG.multivariate_normal(np.zeros(6), pose.covariance, size=8000))
        for pose in (hand_eye, pair)
    )
    sampled = np.cov(transforms.difference(placed.transform, flange @ one @ two).T)
    scale = np.sqrt(np.diag(placed.covariance))
    np.testing.assert_allclose(sampled / np.outer(scale, scale), placed.covariance / np.outer(scale, scale), atol=0.06)

import numpy as np
import pytest

from sl_calibration.object_tracking import ObjectTracker, TrackingLostError, TrackingOptions, build_surface, segment
from sl_common import transforms

EYE = np.array([0.0, 0.0, 0.0])
ROW, COL = (a.ravel() for a in np.meshgrid(np.arange(30), np.arange(36), indexing="ij"))
RAYS = np.column_stack([(COL - 17.5) * 0.011, (ROW - 14.5) * 0.011, np.ones(len(ROW))])


def wavy(x, y):
    return 0.03 * np.sin(22 * x + 0.4) * np.cos(17 * y) + 0.02 * np.sin(31 * y + 11 * x)


def ball(x, y):
    return -np.sqrt(np.maximum(0.3**2 - x**2 - y**2, 0.0)) + 0.3


def plane(x, y):
    return 0.1 * x - 0.2 * y


def scan(height, world_from_object, sigma=0.0, seed=0):
    """Where fixed projector rays meet a moved surface z = height(x, y) of the object's frame."""
    depth = np.full(len(RAYS), world_from_object[2, 3])
    for _ in range(60):
        p = transforms.apply(transforms.inverse(world_from_object), RAYS * depth[:, None])
        q = transforms.apply(transforms.inverse(world_from_object), RAYS * (depth + 1e-6)[:, None])
        f = p[:, 2] - height(p[:, 0], p[:, 1])
        slope = (q[:, 2] - height(q[:, 0], q[:, 1]) - f) / 1e-6
        depth = depth - np.clip(f / slope, -0.02, 0.02)
    noise = np.random.default_rng(seed).normal(scale=sigma, size=len(RAYS))
    return RAYS * (depth + noise)[:, None]


START = transforms.make(np.eye(3), [0.0, 0.0, 1.0])


def moved(k, step):
    return transforms.perturb(START, k * np.array(step))


def test_a_moving_surface_is_followed_in_all_directions():
    tracker = ObjectTracker()
    step = [0.004, -0.003, 0.005, 0.008, 0.01, -0.012]
    for k in range(8):
        now = moved(k, step)
        motion = tracker.update(scan(wavy, now, 1e-4, k), ROW, COL, EYE)
        assert motion.observed == 6
        reference_from_now = START @ transforms.inverse(now)
        error = transforms.difference(reference_from_now, motion.reference_from_now)
        middle = transforms.apply(motion.reference_from_now, motion.centre[None])
        truth = transforms.apply(reference_from_now, motion.centre[None])
        assert np.linalg.norm(middle - truth) < 1e-3
        assert np.degrees(np.linalg.norm(error[3:])) < 0.35


def test_a_dot_is_not_a_point_of_the_object():
    """Sideways motion: dots of the same row and column would tell of depth only."""
    tracker = ObjectTracker()
    tracker.update(scan(wavy, START), ROW, COL, EYE)
    sideways = scan(wavy, moved(1, [0.01, 0, 0, 0, 0, 0]))
    assert np.abs((sideways - scan(wavy, START))[:, 0]).mean() < 1e-3  # what the dots themselves do
    motion = tracker.update(sideways, ROW, COL, EYE)
    shift = transforms.apply(motion.reference_from_now, motion.centre[None])[0] - motion.centre
    np.testing.assert_allclose(shift, [-0.01, 0, 0], atol=1.5e-3)


@pytest.mark.parametrize(("height", "observed"), [(plane, 3), (ball, 3)])
def test_directions_that_the_surface_does_not_show_are_reported_and_left_alone(height, observed):
    tracker = ObjectTracker()
    tracker.update(scan(height, START, 1e-4, 1), ROW, COL, EYE)
    motion = tracker.update(scan(height, moved(1, [0, 0, 0.01, 0, 0, 0]), 1e-4, 2), ROW, COL, EYE)
    assert motion.observed == observed
    assert np.linalg.eigvalsh(motion.covariance).max() > 0.5
    shift = transforms.apply(motion.reference_from_now, motion.centre[None])[0] - motion.centre
    assert shift[2] == pytest.approx(-0.01, abs=1e-3)
    # Spin or slide is not invented: the whole motion stays as small as what was seen.
    assert transforms.rotation_angle(motion.reference_from_now) < np.radians(1.0)


def test_the_nearest_connected_surface_is_the_object():
    points = scan(plane, START)
    near = (ROW > 8) & (ROW < 20) & (COL > 8) & (COL < 22)
    points[near] *= 0.8
    assert (segment(points, ROW, COL, EYE) == near).all()


def test_small_patches_are_not_objects():
    points = scan(plane, START)
    speck = (ROW < 3) & (COL < 3)
    points[speck] *= 0.5
    assert not segment(points, ROW, COL, EYE)[speck].any()


def test_normals_point_to_the_eye_and_edges_have_none():
    points = scan(plane, START)
    points[COL >= 18] *= 1.3
    surface = build_surface(points, ROW, COL, EYE)
    assert ((EYE - surface.points) * surface.normals).sum(-1).min() > 0
    assert not np.isin(surface.col, (17, 18)).any()
    direction = np.array([0.1, -0.2, -1.0]) / np.linalg.norm([0.1, -0.2, -1.0])
    np.testing.assert_allclose(
        surface.normals[surface.col < 17], np.tile(direction, ((surface.col < 17).sum(), 1)), atol=1e-6
    )


def test_loss_is_said_and_does_not_end_the_tracking():
    tracker = ObjectTracker()
    tracker.update(scan(wavy, START), ROW, COL, EYE)
    with pytest.raises(TrackingLostError, match="points"):
        tracker.update(scan(wavy, START)[:20], ROW[:20], COL[:20], EYE)
    with pytest.raises(TrackingLostError, match="meet the reference"):
        tracker.update(scan(wavy, moved(1, [0, 0, 0.4, 0, 0, 0])), ROW, COL, EYE)
    assert tracker.update(scan(wavy, START), ROW, COL, EYE).rms < 1e-4


def test_options_decide_what_is_enough():
    with pytest.raises(TrackingLostError, match="at least 2000"):
        segment(scan(plane, START), ROW, COL, EYE, TrackingOptions(least_points=2000))


def test_the_object_is_kept_when_another_one_comes_nearer():
    """The eye moves over: the neighbour is nearer to it then, but the object followed is the first one's."""
    left = COL < 15
    depth = np.where(left, 1.0 + wavy(RAYS[:, 0], RAYS[:, 1]), 1.15 + wavy(RAYS[:, 1], RAYS[:, 0]))
    points = RAYS * depth[:, None]
    tracker = ObjectTracker()
    tracker.update(points, ROW, COL, EYE)
    motion = tracker.update(points, ROW, COL, np.array([0.6, 0.0, 0.9]))
    assert motion.centre[0] < 0
    assert np.linalg.norm(transforms.log(motion.reference_from_now)) < 5e-4

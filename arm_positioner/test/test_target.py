import numpy as np
import pytest
from positioner_scenes import box, cast, nearest, plane, sphere

from arm_positioner.errors import InvalidGoalError, ObjectGoneError, TargetError
from arm_positioner.surface import FitOptions
from arm_positioner.target import TargetOptions, facing_pose, find_target, other_targets
from sl_common import transforms

CAMERA = transforms.look_at((0.1, -0.05, 0.0), (0.0, 0.0, 1.0), (0, -1, 0))
WALL = plane((0, 0, 1.3), (0, 0, -1.0))


def angle(a, b):
    return np.arccos(np.clip(a @ b, -1, 1))


def spoil(points, rng, share, scale=0.1):
    wrong = rng.random(len(points)) < share
    points = points.copy()
    points[wrong] += rng.normal(scale=scale, size=(wrong.sum(), 3))
    return points


@pytest.mark.parametrize("tilt", [0.0, 0.4, 0.9])
@pytest.mark.parametrize("outliers", [0.0, 0.1])
def test_plane(tilt, outliers):
    rng = np.random.default_rng(1)
    normal = np.array([np.sin(tilt), 0, -np.cos(tilt)])
    points, row, col = cast(plane((0, 0, 1.0), normal), noise=5e-4, rng=rng)
    points = spoil(points, rng, outliers)
    target = find_target(points, CAMERA, row=row, col=col, options=TargetOptions(standoff=0.25))
    patch = target.surface
    assert abs((patch.point - (0, 0, 1.0)) @ normal) < 4e-4
    assert angle(patch.normal, normal) < np.radians(0.3)
    pose = target.base_from_camera
    assert np.allclose(pose[:3, 3] - patch.point, 0.25 * patch.normal)
    assert np.allclose(pose[:3, 2], -patch.normal)
    assert patch.rms < 1.2e-3


@pytest.mark.parametrize("with_map", [True, False])
def test_sphere_before_a_wall(with_map):
    rng = np.random.default_rng(2)
    centre, radius = np.array([0.02, 0.03, 1.0]), 0.12
    points, row, col = cast(nearest(sphere(centre, radius), WALL), noise=5e-4, rng=rng)
    points = spoil(points, rng, 0.03)
    extra = {"row": row, "col": col} if with_map else {}
    patch = find_target(points, CAMERA, **extra).surface
    assert abs(np.linalg.norm(patch.point - centre) - radius) < 6e-4
    assert angle(patch.normal, (patch.point - centre) / radius) < np.radians(1.0)
    assert patch.normal @ (CAMERA[:3, 3] - patch.point) > 0


def test_the_front_of_the_nearest_box():
    boxes = [box((x - 0.08, -0.1, z), (x + 0.08, 0.1, z + 0.2)) for x, z in ((-0.15, 1.0), (0.08, 0.85))]
    points, row, col = cast(nearest(*boxes, WALL), noise=5e-4)
    patch = find_target(points, CAMERA, row=row, col=col).surface
    assert abs(patch.point[2] - 0.85) < 5e-4
    assert angle(patch.normal, np.array([0, 0, -1.0])) < np.radians(0.4)


def test_the_stated_uncertainty_covers_the_error():
    normal = np.array([np.sin(0.3), 0, -np.cos(0.3)])
    distances, tilts = [], []
    for seed in range(60):
        points, row, col = cast(
            plane((0, 0, 1.0), normal), noise=1e-3, rng=np.random.default_rng(seed), rows=14, cols=14
        )
        patch = find_target(points, CAMERA, row=row, col=col).surface
        sigma = np.sqrt(np.diag(patch.covariance))
        distances.append((patch.point - (0, 0, 1.0)) @ normal / sigma[0])
        tilts += list((patch.tangents @ normal) / sigma[1:])
    # standardised errors: about one, neither a boast nor an excuse
    assert 0.6 < np.std(distances) < 1.6
    assert 0.6 < np.std(tilts) < 1.6


def test_an_anchor_holds_the_surface_point():
    points, row, col = cast(plane((0, 0, 1.0), (0, 0, -1.0)), noise=3e-4)
    anchor = np.array([0.1, 0.08, 1.0])
    patch = find_target(points, CAMERA, row=row, col=col, anchor=anchor).surface
    assert np.linalg.norm(patch.point - anchor) < 0.02


def test_an_anchor_in_a_shadow_is_not_replaced_by_a_place_beside_it():
    points, row, col = cast(plane((0, 0, 1.0), (0, 0, -1.0)), noise=3e-4)
    anchor = np.array([0.1, 0.08, 1.0])
    lit = np.linalg.norm(points - anchor, axis=1) > 0.06
    with pytest.raises(TargetError, match=r"not seen: the nearest dot of the object is 6\d mm from it, limit 3\d mm"):
        find_target(points[lit], CAMERA, row=row[lit], col=col[lit], anchor=anchor)


def test_confidence_counts_and_nonfinite_points_do_not():
    points, row, col = cast(plane((0, 0, 1.0), (0, 0, -1.0)), noise=3e-4)
    points[::7] = np.nan
    confidence = np.ones(len(points))
    low = np.arange(len(points)) % 5 == 0
    points[low, 2] -= 0.05
    confidence[low] = 0.1
    patch = find_target(
        points, CAMERA, row=row, col=col, confidence=confidence, options=TargetOptions(min_confidence=0.5)
    ).surface
    assert abs(patch.point[2] - 1.0) < 4e-4


@pytest.mark.parametrize(
    ("points", "said"),
    [
        (np.zeros((0, 3)), "0 usable points of 0"),
        (np.full((50, 3), np.nan), "0 usable points of 50"),
        (np.random.default_rng(0).uniform((-1, -1, 1), (1, 1, 3), (400, 3)), "refused|points|object"),
        (np.stack([np.linspace(0, 1, 60), np.zeros(60), np.ones(60)], axis=1), "line|normal|points"),
    ],
)
def test_what_is_no_surface_is_refused_with_numbers(points, said):
    with pytest.raises(TargetError, match=said):
        find_target(points, CAMERA)


def test_a_rough_surface_is_refused_with_its_rms():
    points, row, col = cast(plane((0, 0, 1.0), (0, 0, -1.0)), noise=4e-3)
    with pytest.raises(TargetError, match=r"RMS .* mm over"):
        find_target(points, CAMERA, row=row, col=col, options=TargetOptions(fit=FitOptions(max_rms=2e-3)))


def test_a_surface_seen_edge_on_is_refused():
    points, row, col = cast(plane((0, 0, 1.0), (np.sin(1.2), 0, -np.cos(1.2))), noise=1e-4)
    with pytest.raises(TargetError, match="deg from its normal"):
        find_target(points, CAMERA, row=row, col=col, options=TargetOptions(fit=FitOptions(max_tilt=0.8)))


def test_least_rotation_is_least():
    rng = np.random.default_rng(0)
    for _ in range(20):
        camera = transforms.make(transforms.rotation_exp(rng.normal(size=3)), rng.normal(size=3))
        normal = rng.normal(size=3)
        normal /= np.linalg.norm(normal)
        pose = facing_pose(np.zeros(3), normal, camera, 0.3)
        turned = transforms.rotation_angle(camera[:3, :3].T @ pose[:3, :3])
        for roll in np.linspace(-np.pi, np.pi, 50):
            spun = pose[:3, :3] @ transforms.rotation_exp((0, 0, roll))
            assert turned <= transforms.rotation_angle(camera[:3, :3].T @ spun) + 1e-9


@pytest.mark.parametrize("normal", [(0, 0, 1.0), (0, 0, -1.0), (1.0, 0, 0)])
def test_opposite_and_vertical_normals_give_proper_poses(normal):
    camera = transforms.make(np.eye(3), np.zeros(3))
    for roll in (None, 0.0, 0.7):
        pose = facing_pose((0.1, 0.2, 0.3), normal, camera, 0.3, roll)
        assert transforms.is_rigid(pose)
        assert np.allclose(pose[:3, 2], -np.array(normal))


def test_fixed_roll_is_upright():
    pose = facing_pose((1.0, 0, 0), (-1.0, 0, 0), transforms.identity(), 0.3, 0.0)
    assert np.allclose(pose[:3, 1], (0, 0, -1))  # the image's down is the base's down


@pytest.mark.parametrize("standoff", [0.0, -0.1, float("nan")])
def test_a_standoff_that_is_not_positive_is_refused(standoff):
    with pytest.raises(InvalidGoalError, match="standoff"):
        facing_pose(np.zeros(3), (0, 0, 1.0), transforms.identity(), standoff)


def roof(angle, centre=(0.02, 0.02, 1.0)):
    """Two planes that meet in an edge through ``centre``, tilted by ``angle`` to either side."""
    sides = [plane(centre, (s * np.sin(angle), 0.0, -np.cos(angle))) for s in (-1, 1)]
    return lambda origin, directions: np.max([side(origin, directions) for side in sides], axis=0)


def test_the_place_is_chosen_off_a_crease():
    points, row, col = cast(roof(0.35), noise=1e-4)
    target = find_target(points, CAMERA, row=row, col=col)
    patch = target.surface
    assert abs(patch.point[0] - 0.02) > 0.02
    side = np.copysign(np.sin(0.35), patch.point[0] - 0.02)
    assert angle(patch.normal, np.array([side, 0, -np.cos(0.35)])) < 0.02  # the edge itself bends by 0.7
    assert np.linalg.norm(patch.point - target.middle) < 0.2


def test_the_same_place_is_taken_again_by_its_offset():
    points, row, col = cast(roof(0.35), noise=1e-4)
    first = find_target(points, CAMERA, row=row, col=col)
    moved = np.array([0.03, -0.02, 0.01])
    again = find_target(
        points + moved,
        CAMERA,
        row=row,
        col=col,
        previous=first.surface.point,
        offset=first.surface.point - first.middle,
    )
    assert np.allclose(again.surface.point - first.surface.point, moved, atol=2e-3)
    assert angle(again.surface.normal, first.surface.normal) < 2e-3


def test_an_object_that_is_gone_is_not_mistaken_for_the_wall_behind():
    ball = sphere((0.0, 0.0, 0.9), 0.1)
    points, row, col = cast(nearest(ball, WALL), noise=2e-4)
    seen = find_target(points, CAMERA, row=row, col=col).surface.point
    points, row, col = cast(WALL, noise=2e-4)
    with pytest.raises(ObjectGoneError, match=r"nearest patch is \d{3} mm .* limit 100 mm"):
        find_target(points, CAMERA, row=row, col=col, previous=seen)


def test_the_uncertainty_includes_that_of_the_place_on_a_curved_surface():
    points, row, col = cast(nearest(sphere((0.02, 0.03, 1.0), 0.05), WALL), pitch=0.005, noise=1e-5)
    patch = find_target(
        points, CAMERA, row=row, col=col, options=TargetOptions(fit=FitOptions(place_sigma=1e-3))
    ).surface
    assert patch.normal_sigma == pytest.approx(1e-3 / 0.05, rel=0.25)


def test_other_places_lie_all_over_the_object_the_one_with_the_shortest_way_first():
    ball = sphere((0.02, 0.03, 1.0), 0.15)
    points, row, col = cast(nearest(ball, WALL), pitch=0.006, noise=2e-4)
    here = find_target(points, CAMERA, row=row, col=col)
    others = other_targets(points, CAMERA, row=row, col=col, previous=here.surface.point)
    assert len(others) > 5
    places = np.array([t.surface.point for t in others])
    assert np.ptp(places, axis=0)[:2].min() > 0.08
    apart = np.linalg.norm(places[:, None] - places, axis=-1)[np.triu_indices(len(places), 1)]
    assert apart.min() > 0.015
    for t in others:
        assert abs(np.linalg.norm(t.surface.point - (0.02, 0.03, 1.0)) - 0.15) < 1e-3
        assert angle(t.base_from_camera[:3, 2], -t.surface.normal) < 1e-6
    ways = [np.linalg.norm(t.base_from_camera[:3, 3] - CAMERA[:3, 3]) for t in others]
    assert ways[0] == min(ways)


def test_other_places_keep_off_a_crease_while_there_are_any():
    points, row, col = cast(roof(0.35), noise=1e-4)
    others = other_targets(points, CAMERA, row=row, col=col)
    patch = others[0].surface
    assert abs(patch.point[0] - 0.02) > 0.02
    side = np.copysign(np.sin(0.35), patch.point[0] - 0.02)
    assert angle(patch.normal, np.array([side, 0, -np.cos(0.35)])) < 0.02


def test_the_uncertainty_includes_that_of_rays_that_meet_at_a_small_angle():
    points, row, col = cast(plane((0, 0, 1.0), (0, 0, -1.0)), noise=3e-4)
    without, wide, narrow = (
        find_target(points, CAMERA, row=row, col=col, projector=projector).surface
        for projector in (None, np.array([-0.8, 0.2, 0.0]), np.array([0.02, 0.1, -0.3]))
    )
    assert without.normal_sigma < wide.normal_sigma < 1.1 * without.normal_sigma + 1.5e-3
    assert narrow.normal_sigma > 5 * wide.normal_sigma
    assert np.array_equal(narrow.normal, wide.normal)

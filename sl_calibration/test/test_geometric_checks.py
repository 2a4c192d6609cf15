import numpy as np
import pytest

from sl_calibration.geometric_checks import (
    CheckOptions,
    Mark,
    PreviousCloud,
    displacements,
    epipolar_gate,
    jumped_alone,
    keys,
    refuse_off_line,
    remember,
)
from sl_calibration.triangulation import Rejection, triangulate
from sl_common import transforms
from sl_common.cameras import CameraModel

CAMERA = CameraModel(640, 480, np.array([[820.0, 0, 325.3], [0, 815, 236.8], [0, 0, 1]]), "pers", (1.1,))
PROJECTOR = CameraModel(1024, 768, np.array([[2000.0, 0, 514.5], [0, 2000, 698.9], [0, 0, 1]]))
BASE_FROM_PROJECTOR = transforms.look_at([0.35, 0.1, 0.0], [0.0, 0.0, 1.2], [0.0, 1.0, 0.0])
ROW, COL = (a.ravel() for a in np.mgrid[:20, :30])
KEY = keys(ROW, COL)
PIXELS = np.column_stack([200.0 + 20 * COL, 300.0 + 18 * ROW])
SECOND = 1_000_000_000


def surface(raised: float = 0.0) -> np.ndarray:
    """Points (600, 3) in the base frame: a wavy wall, columns 10 to 19 raised towards the camera by an object [m]."""
    rays = PROJECTOR.rays(PIXELS)
    depth = 1.2 + 0.02 * np.sin(PIXELS[:, 0] / 60) - np.where((COL >= 10) & (COL < 20), raised, 0.0)
    return transforms.apply(BASE_FROM_PROJECTOR, rays * depth[:, None])


def camera_pose(step: float) -> np.ndarray:
    """base_from_camera as the arm moves."""
    return transforms.look_at([-0.1 + step, 0.02 * step, 0.1], [0.0, 0.0, 1.2], [0.0, 1.0, 0.0])


def seen(points: np.ndarray, pose: np.ndarray, seed: int) -> np.ndarray:
    exact = CAMERA.project(transforms.apply(transforms.inverse(pose), points))
    return exact + np.random.default_rng(seed).normal(0, 0.06, exact.shape)


def checked(previous: PreviousCloud, pixels: np.ndarray, pose: np.ndarray, stamp: int):
    """Triangulation, marks and the cloud to hand on, as the node chains them."""
    result = triangulate(CAMERA, PROJECTOR, transforms.inverse(pose) @ BASE_FROM_PROJECTOR, pixels, PIXELS)
    result = refuse_off_line(result, epipolar_gate(result.epipolar_distance, 2.0))
    moved = displacements(previous, CAMERA, pose, KEY, pixels)
    moved[~result.valid] = np.nan
    jumped, _ = jumped_alone(KEY, moved)
    in_base = transforms.apply(pose, result.points[result.valid])
    mark = np.where(jumped, Mark.JUMPED, result.rejection)
    return result, mark, remember(previous, KEY[result.valid], in_base, stamp)


def along_the_line(points: np.ndarray, dot: int, depth: float) -> np.ndarray:
    """The points with one dot moved along its own projector ray: a wrong dot that its epipolar line cannot tell."""
    wrong = points.copy()
    origin = BASE_FROM_PROJECTOR[:3, 3]
    wrong[dot] = origin + (wrong[dot] - origin) * (1 + depth / np.linalg.norm(wrong[dot] - origin))
    return wrong


@pytest.mark.parametrize("seed", range(5))
def test_a_planted_wrong_dot_is_marked_and_no_other(seed: int) -> None:
    rng = np.random.default_rng(seed)
    _, mark, previous = checked(PreviousCloud(), seen(surface(), camera_pose(0.0), seed), camera_pose(0.0), SECOND)
    assert (mark == Mark.NONE).all()
    off, along = rng.choice(len(KEY), 2, replace=False)
    pose = camera_pose(0.01)
    pixels = seen(along_the_line(surface(), along, 0.03), pose, 100 + seed)
    extrinsics = transforms.inverse(pose) @ BASE_FROM_PROJECTOR
    line = pixels[off] - CAMERA.project(transforms.apply(extrinsics, 2 * PROJECTOR.rays(PIXELS[[off]]))[:1])[0]
    pixels[off] += 1.2 * np.array([-line[1], line[0]]) / np.linalg.norm(line)  # less than the fixed limit of 2 px
    result, mark, _ = checked(previous, pixels, pose, SECOND + 33_000_000)
    assert mark[off] == Mark.EPIPOLAR
    assert np.isnan(result.points[off]).all()
    assert mark[along] == Mark.JUMPED
    assert np.isfinite(result.points[along]).all()  # marked, not dropped
    assert (np.delete(mark, [off, along]) == Mark.NONE).all()


def test_a_moving_object_is_not_lost() -> None:
    previous, marked = PreviousCloud(), []
    for k in range(8):
        pose = camera_pose(0.003 * k)
        result, mark, previous = checked(
            previous, seen(surface(0.006 * k), pose, k), pose, SECOND + 33_000_000 * k
        )  # 18 cm/s towards the camera
        assert result.valid.all()
        marked.append((mark != Mark.NONE).mean())
    assert max(marked) < 0.005


def test_a_dot_that_stays_where_it_jumped_to_is_marked_once() -> None:
    _, _, previous = checked(PreviousCloud(), seen(surface(), camera_pose(0.0), 0), camera_pose(0.0), SECOND)
    wrong = along_the_line(surface(), 333, -0.05)
    marks = []
    for k in (1, 2):
        _, mark, previous = checked(previous, seen(wrong, camera_pose(0.0), k), camera_pose(0.0), SECOND + k)
        marks.append(mark[333])
    assert marks == [Mark.JUMPED, Mark.NONE]


def test_the_gate_follows_the_noise_and_stays_below_the_limit() -> None:
    rng = np.random.default_rng(0)
    assert epipolar_gate(np.abs(rng.normal(0, 0.01, 500)), 2.0) == CheckOptions().least_gate
    assert epipolar_gate(np.abs(rng.normal(0, 0.2, 5000)), 2.0) == pytest.approx(1.2, rel=0.05)
    assert epipolar_gate(np.abs(rng.normal(0, 3.0, 500)), 2.0) == 2.0
    assert epipolar_gate(np.array([np.nan]), 2.0) == 2.0


def test_old_points_and_points_of_the_future_predict_nothing() -> None:
    points = surface()[:5]
    cloud = remember(PreviousCloud(), KEY[:5], points, 10 * SECOND)
    assert len(remember(cloud, KEY[5:6], points[:1], 10 * SECOND + SECOND // 2).key) == 6
    assert len(remember(cloud, KEY[5:6], points[:1], 12 * SECOND).key) == 1
    assert len(remember(cloud, KEY[5:6], points[:1], 9 * SECOND).key) == 1
    again = remember(cloud, KEY[[2, 1]], points[[4, 3]], 10 * SECOND + 1)
    assert (np.diff(again.key) > 0).all()
    np.testing.assert_array_equal(again.points, points[[0, 3, 4, 3, 4]])


def test_nothing_known_marks_nothing() -> None:
    jumped, distance = jumped_alone(KEY, np.full((len(KEY), 2), np.nan))
    assert not jumped.any()
    assert np.isnan(distance).all()
    assert int(Mark.EPIPOLAR) == int(Rejection.EPIPOLAR)

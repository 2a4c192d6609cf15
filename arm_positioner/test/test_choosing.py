"""Which target is driven to where not all can be, and when a second look corrects the first."""

import numpy as np
import pytest

from arm_positioner.choosing import camera_sigma, first_possible, tells_more
from arm_positioner.common_error import common_covariance
from arm_positioner.errors import InvalidGoalError, JointLimitError, SingularityError, TargetError, UnreachableError
from arm_positioner.surface import SurfacePatch
from arm_positioner.target import Target, facing_pose
from sl_common import transforms

UP = np.array([0.0, 0.0, 1.0])
TANGENTS = np.eye(3)[:2]


def target(x, normal=UP, height=0.0, sigmas=(5e-4, 4e-3)):
    """A target at (x, 0, height), known to a height [m] and a tilt [rad]."""
    covariance = np.diag([sigmas[0], sigmas[1], sigmas[1]]) ** 2
    surface = SurfacePatch(np.array([x, 0.0, height]), np.array(normal), covariance, TANGENTS, 0.05, 100, 1.0, 1e-4)
    return Target(facing_pose(surface.point, surface.normal, np.eye(4), 0.4), surface, 300, np.zeros(3))


class Arm:
    """Refuses targets at some places, each for its reason."""

    def __init__(self, **refusals):
        self.refusals, self.asked = refusals, []

    def begin(self, wanted):
        x = f"x{round(100 * wanted.surface.point[0])}"
        self.asked.append(x)
        if x in self.refusals:
            raise self.refusals[x]
        return x


def unasked():
    pytest.fail("others were looked for without need")


def test_the_place_wanted_is_taken_where_it_can_be():
    wanted = target(0.01)
    assert first_possible(wanted, unasked, Arm().begin) == (wanted, "x1", "")


def test_the_first_place_that_can_be_reached_is_taken_and_said():
    arm = Arm(
        x1=UnreachableError("out of reach by 36 mm"), x4=JointLimitError("joint limit"), x5=SingularityError("singular")
    )
    others = [target(0.04), target(0.05), target(0.06), target(0.07)]
    chosen, begun, why = first_possible(target(0.01), lambda: others, arm.begin)
    assert chosen is others[2]
    assert begun == "x6"
    assert why == "50 mm beside the place preferred, for which: out of reach by 36 mm"
    assert arm.asked == ["x1", "x4", "x5", "x6"]


@pytest.mark.parametrize("count", [0, 3, 20])
def test_where_no_place_can_be_reached_the_first_reason_is_given(count):
    others = [target(0.02 + 0.01 * k) for k in range(count)]
    arm = Arm(
        **{f"x{k}": SingularityError("other") for k in range(2, 30)}, x1=UnreachableError("out of reach by 36 mm")
    )
    with pytest.raises(UnreachableError, match=r"by 36 mm; \d other places on the object are no better"):
        first_possible(target(0.01), lambda: others, arm.begin)
    assert len(arm.asked) <= 10  # however many places there are, the refusal comes soon


def test_what_no_other_place_helps_against_is_raised_as_it_is():
    arm = Arm(x1=InvalidGoalError("standoff"))
    with pytest.raises(InvalidGoalError, match=r"^standoff$"):
        first_possible(target(0.01), unasked, arm.begin)

    def lost():
        raise TargetError("the point cloud is 2 s old")

    with pytest.raises(UnreachableError, match="36 mm; nor is another place known: the point cloud is 2 s old"):
        first_possible(target(0.01), lost, Arm(x1=UnreachableError("36 mm")).begin)


def test_a_less_certain_second_look_does_not_correct_the_first_unless_it_contradicts_it():
    first = target(0.0, sigmas=(5e-4, 4e-3))
    assert tells_more(first, target(0.0, sigmas=(5e-4, 3e-3)))
    worse = (2e-3, 0.02)
    tilted = transforms.rotation_exp((0.03, 0.0, 0.0)) @ UP
    assert not tells_more(first, target(0.0, tilted, sigmas=worse))
    assert not tells_more(first, target(0.0, UP, 4e-3, sigmas=worse))
    assert tells_more(first, target(0.0, transforms.rotation_exp((0.1, 0.0, 0.0)) @ UP, sigmas=worse))
    assert tells_more(first, target(0.0, UP, 0.02, sigmas=worse))
    assert camera_sigma(first) == pytest.approx(np.hypot(5e-4, 0.4 * 4e-3))


def meeting_points(camera, projector, spots, shift):
    """Where the rays to spots (N, 3) meet, those of the projector turned about it so that they pass by ``shift`` [m]
    in the plane of both.
    """
    out = []
    for spot in spots:
        sight, light = spot - camera, spot - projector
        across = np.cross(light, np.cross(sight, light))
        moved = spot + shift * across / np.linalg.norm(across) - projector
        # the two rays lie in one plane: least squares of camera + s sight = projector + t moved
        s, _ = np.linalg.lstsq(np.stack([sight, -moved], axis=1), projector - camera, rcond=None)[0]
        out.append(camera + s * sight)
    return np.array(out)


@pytest.mark.parametrize("angle", [8.0, 15.0, 45.0])
def test_the_error_of_a_calibration_tilts_what_is_seen_along_the_light(angle):
    camera = np.array([0.0, 0.0, 0.4])
    projector = 1.1 * np.array([np.sin(np.radians(angle)), 0.0, np.cos(np.radians(angle))])
    grid = 0.01 * np.stack(np.meshgrid([-1, 0, 1], [-1, 0, 1]), axis=-1).reshape(-1, 2)
    spots = np.column_stack([grid, np.zeros(9)])
    sigma = 2e-4
    seen = meeting_points(camera, projector, spots, sigma)
    design = np.column_stack([np.ones(9), seen[:, :2]])
    height, *slopes = np.linalg.lstsq(design, seen[:, 2], rcond=None)[0]
    covariance = common_covariance(np.zeros(3), UP, TANGENTS, camera, projector, sigma)
    assert np.sqrt(covariance[0, 0]) == pytest.approx(abs(height), rel=0.1)
    tilt, stated = np.linalg.norm(slopes), np.sqrt(np.linalg.eigvalsh(covariance[1:, 1:])[-1])
    assert tilt <= 1.05 * stated
    assert stated <= 2.0 * tilt

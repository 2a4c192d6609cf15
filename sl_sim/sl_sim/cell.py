"""The simulated cell as a whole: arm, eye-in-hand camera, fixed projector and object, and the truth about them.

Everything follows from CellSettings, so that a report can rebuild the very cell that a node has simulated.
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields
from functools import cached_property

import numpy as np

from sl_common import transforms
from sl_common.cameras import CameraModel
from sl_common.errors import InvalidInputError, ModelError
from sl_common.kinematics import Kinematics
from sl_sim import arm, scenes
from sl_sim.light import LightSource, aimed_projector
from sl_sim.raycast import RayCaster
from sl_sim.spot_truth import Lit, light_up

_TOWARDS_ARM = np.array([[0.0, 0.0, -1.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
"""Object axes (x right, y up, z towards the arm) in the base frame."""
_READY = np.array([0.2, -1.9, 2.2, -0.3, 1.4, 0.3])
"""A folded, wrist-forward configuration from which the start pose is found [rad]."""


@dataclass(frozen=True, kw_only=True)
class CellSettings:
    """What a cell is made of; lengths in m, angles in deg, base frame unless said otherwise.

    Attributes:
        scene: name in sl_sim.scenes.NAMES. seed: varies the scene, the mounting of camera and projector, and the noise.
        camera_width, camera_height: px. focal_length: px. pers: Pers coefficient in focal lengths, 0 = no distortion.
        projector_width, projector_height, projector_focal_length: px. projector_shift: principal point's row as a
            share of
            the panel's height (above 1: below the panel).
        object_position: the object frame's origin. projector_position. start_offset: the camera at the start from the
            object's origin, in the object frame (x right, y up, z towards the arm). start_roll: about the optical axis.
        sway: amplitude of the object's motion along base x, y, z. swing: its amplitude about the vertical.
            sway_period [s].
    """

    scene: str = "bust"
    seed: int = 0
    camera_width: int = 640
    camera_height: int = 480
    focal_length: float = 820.0
    pers: float = 1.1
    projector_width: int = 1024
    projector_height: int = 768
    projector_focal_length: float = 1890.0
    projector_shift: float = 1.06
    object_position: Sequence[float] = (1.02, 0.0, 0.42)
    projector_position: Sequence[float] = (0.16, 0.46, 0.72)
    start_offset: Sequence[float] = (0.07, 0.05, 0.62)
    start_roll: float = 25.0
    sway: Sequence[float] = (0.0, 0.0, 0.0)
    swing: float = 0.0
    sway_period: float = 8.0

    def __post_init__(self) -> None:
        for field_ in fields(self):
            value = getattr(self, field_.name)
            if isinstance(value, list | tuple):
                value = tuple(float(x) for x in value)
                if len(value) != 3 or not np.isfinite(value).all():
                    raise InvalidInputError(f"{field_.name} must be three finite numbers, got {list(value)}")
                object.__setattr__(self, field_.name, value)
        if self.sway_period <= 0:
            raise InvalidInputError(f"sway_period must be positive, got {self.sway_period}")

    @property
    def moves(self) -> bool:
        """The object moves."""
        return any(self.sway) or self.swing != 0


class Cell:
    """A cell and its truth.

    Attributes:
        settings. scene: the bodies. caster: rays against them.
        camera, projector: true intrinsics. flange_from_camera, base_from_projector, base_from_object: true poses.
        kinematics: base_link to tool0. limits: of the joints. start_positions: (6,) at rest, the camera sees the
            object.
    """

    def __init__(self, settings: CellSettings) -> None:
        self.settings = settings
        rng = np.random.default_rng([settings.seed, 2007])
        scenes.check(settings.scene)
        self.base_from_object = transforms.make(_TOWARDS_ARM, np.asarray(settings.object_position))
        self.camera = _camera(settings, rng)
        self.projector = _projector(settings, rng)
        self.base_from_projector = aimed_projector(
            self.projector,
            np.asarray(settings.projector_position) + rng.uniform(-0.01, 0.01, 3),
            self.base_from_object[:3, 3] + rng.uniform(-0.005, 0.005, 3),
            roll=rng.uniform(-0.03, 0.03),
        )
        mount = transforms.rotation_exp(np.array([0.0, 0.0, -0.12]))
        mount = mount @ transforms.rotation_exp(np.array([0.05, -0.08, 0.0]) + rng.uniform(-0.01, 0.01, 3))
        self.flange_from_camera = transforms.make(
            mount, np.array([0.018, -0.066, 0.052]) + rng.uniform(-0.003, 0.003, 3)
        )
        self.kinematics = arm.kinematics()
        self.limits = arm.limits()
        self.start_positions = self._start()

    def _start(self) -> np.ndarray:
        position = transforms.apply(self.base_from_object, np.asarray(self.settings.start_offset)[None])[0]
        view = transforms.look_at(position, self.base_from_object[:3, 3], np.array([0.0, 0.0, 1.0]))
        roll = transforms.make(
            transforms.rotation_exp(np.array([0.0, 0.0, np.radians(self.settings.start_roll)])), np.zeros(3)
        )
        return inverse_kinematics(self.kinematics, view @ roll @ transforms.inverse(self.flange_from_camera), _READY)

    @cached_property
    def scene(self) -> scenes.Scene:
        """The bodies, built when first asked for."""
        return scenes.build(self.settings.scene, self.settings.seed)

    @cached_property
    def caster(self) -> RayCaster:
        """Rays against the scene, built when first asked for."""
        return RayCaster(self.scene.bodies(self.base_from_object, moving=self.settings.moves))

    @property
    def light_source(self) -> LightSource:
        """The projector."""
        return LightSource(self.projector, self.base_from_projector)

    def base_from_camera(self, q: np.ndarray) -> np.ndarray:
        """True pose (4, 4) of the optical frame at joint positions q (6,)."""
        return self.kinematics.forward(q) @ self.flange_from_camera

    def base_from_object_at(self, time: float) -> np.ndarray:
        """Pose of the object `time` [s] after it began to move: a sine that starts gently; time <= 0: at rest."""
        s = self.settings
        if time <= 0 or not s.moves:
            return self.base_from_object
        ramp = min(time / s.sway_period, 1.0)
        wave = ramp**3 * (10 - 15 * ramp + 6 * ramp**2) * np.sin(2 * np.pi * time / s.sway_period)
        swing = np.array([0.0, 0.0, np.radians(s.swing) * wave])
        return transforms.perturb(self.base_from_object, np.concatenate([np.asarray(s.sway) * wave, swing]))

    def place_object(self, base_from_object: np.ndarray | None) -> None:
        """Put the moving part of the scene at a pose; None: where it starts. Raises InvalidInputError for a fixed
        object.
        """
        pose = self.base_from_object if base_from_object is None else np.asarray(base_from_object, float)
        moving = [k for k, body in enumerate(self.caster.bodies) if body.moving]
        if moving:
            self.caster.move(moving[0], pose)
        elif not np.allclose(pose, self.base_from_object, atol=1e-9):
            raise InvalidInputError("this cell's object does not move: set sway or swing")

    def surface_along(
        self, base_from_camera: np.ndarray, pixels: np.ndarray, *, base_from_object: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """True surface points and unit normals (n, 3) [m], base frame, that a camera at this pose sees in pixels (n,
        2); NaN: none.
        """
        self.place_object(base_from_object)
        directions = self.camera.rays(np.asarray(pixels, float)) @ base_from_camera[:3, :3].T
        hits = self.caster.first_hits(base_from_camera[:3, 3], directions)
        return self.caster.points(base_from_camera[:3, 3], directions, hits), self.caster.normals_at(hits)

    def surface_along_rays(
        self, origins: np.ndarray, directions: np.ndarray, *, base_from_object: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """As surface_along, for rays of the base frame: origins (3,) or (n, 3), directions (n, 3)."""
        self.place_object(base_from_object)
        hits = self.caster.first_hits(origins, directions)
        return self.caster.points(origins, directions, hits), self.caster.normals_at(hits)

    def spots_in_base(
        self, pixels: np.ndarray, *, base_from_object: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """True points and unit normals (n, 3) [m], base frame, that light of projector pixels (n, 2) falls on; NaN:
        none.
        """
        self.place_object(base_from_object)
        lit: Lit = light_up(self.caster, self.projector, self.base_from_projector, np.asarray(pixels, float))
        return lit.xyz, lit.normal

    def truth(self) -> dict[str, object]:
        """All that a report needs to judge results, as plain types."""
        return {
            "scene": self.settings.scene,
            "description": scenes.describe(self.settings.scene),
            "seed": self.settings.seed,
            "cell": asdict(self.settings),
            "flange_from_camera": self.flange_from_camera.tolist(),
            "base_from_projector": self.base_from_projector.tolist(),
            "base_from_object": self.base_from_object.tolist(),
            "camera": _plain(self.camera),
            "projector": _plain(self.projector),
            "start_positions": self.start_positions.tolist(),
            "joints": list(self.kinematics.joint_names),
        }


def _camera(settings: CellSettings, rng: np.random.Generator) -> CameraModel:
    centre = 0.5 * np.array([settings.camera_width - 1, settings.camera_height - 1]) + rng.uniform(-6, 6, 2)
    matrix = np.array(
        [[settings.focal_length, 0, centre[0]], [0, settings.focal_length * 1.0008, centre[1]], [0, 0, 1.0]]
    )
    model = ("pers", (settings.pers,)) if settings.pers > 0 else ("none", ())
    return CameraModel(settings.camera_width, settings.camera_height, matrix, *model)


def _projector(settings: CellSettings, rng: np.random.Generator) -> CameraModel:
    width, height, focal = settings.projector_width, settings.projector_height, settings.projector_focal_length
    centre = 0.5 * (width - 1) + rng.uniform(-8, 8), settings.projector_shift * height - 0.5
    return CameraModel(width, height, np.array([[focal, 0, centre[0]], [0, focal, centre[1]], [0, 0, 1.0]]))


def _plain(model: CameraModel) -> dict[str, object]:
    return {
        "width": model.width,
        "height": model.height,
        "matrix": np.asarray(model.matrix).tolist(),
        "distortion_model": model.distortion_model,
        "coefficients": list(model.coefficients),
    }


def inverse_kinematics(chain: Kinematics, base_from_tip: np.ndarray, start: np.ndarray) -> np.ndarray:
    """Joint positions (n,) near `start` that reach a pose, by damped least squares. Raises ModelError when there are
    none.
    """
    q = np.array(start, float)
    for _ in range(300):
        error = transforms.difference(chain.forward(q), base_from_tip)
        if np.abs(error).max() < 1e-10:
            break
        jacobian = chain.jacobian(q)
        damping = 1e-6 + 1e-2 * min(1.0, float(error @ error))
        step = jacobian.T @ np.linalg.solve(jacobian @ jacobian.T + damping * np.eye(6), error)
        q = q + step * min(1.0, 0.3 / max(np.abs(step).max(), 1e-12))
    else:
        raise ModelError(f"the start pose at {np.round(base_from_tip[:3, 3], 3).tolist()} m is out of the arm's reach")
    if (q < chain.lower).any() or (q > chain.upper).any():
        raise ModelError(f"the start pose needs joint positions {np.round(q, 2).tolist()} rad, outside the limits")
    return q

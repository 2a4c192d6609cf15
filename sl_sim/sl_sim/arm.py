"""The simulated arm: its description, its limits, its body as capsules, and how its joints follow a reference."""

from dataclasses import dataclass
from importlib.resources import files

import numpy as np
import yaml

from sl_common import transforms
from sl_common.kinematics import Kinematics
from sl_sim.light import Occluders

BASE_FRAME, FLANGE = "base_link", "tool0"

_CAPSULES = (  # link frame, ends in that frame [m], radius [m]
    ("base_link", (0, 0, 0), (0, 0, 0.1625), 0.075),
    ("upper_arm_link", (0, 0, 0), (0, 0, 0.138), 0.060),
    ("upper_arm_link", (0, 0, 0.138), (-0.425, 0, 0.138), 0.055),
    ("forearm_link", (0, 0, 0.138), (0, 0, 0.007), 0.055),
    ("forearm_link", (0, 0, 0.007), (-0.3922, 0, 0.007), 0.048),
    ("wrist_1_link", (0, 0, -0.1263), (0, 0, 0), 0.042),
    ("wrist_2_link", (0, 0, -0.0997), (0, 0, 0), 0.042),
    ("wrist_3_link", (0, 0, -0.0996), (0, 0, 0), 0.042),
)


@dataclass(frozen=True)
class JointLimits:
    """Limits of n joints: names, and (n,) arrays of positions [rad], velocity, acceleration and jerk [rad/s, /s^2,
    /s^3].
    """

    names: tuple[str, ...]
    lower: np.ndarray
    upper: np.ndarray
    velocity: np.ndarray
    acceleration: np.ndarray
    jerk: np.ndarray


def urdf() -> str:
    """The arm's URDF."""
    return (files("sl_sim") / "description" / "ur5e.urdf").read_text(encoding="utf-8")


def kinematics() -> Kinematics:
    """Kinematics from base_link to tool0."""
    return Kinematics(urdf(), BASE_FRAME, FLANGE)


def limits() -> JointLimits:
    """Positions and velocities of the URDF, accelerations and jerks of the YAML beside it."""
    chain = kinematics()
    further = yaml.safe_load((files("sl_sim") / "description" / "ur5e_limits.yaml").read_text(encoding="utf-8"))
    acceleration, jerk = (
        np.array([float(further[n][k]) for n in chain.joint_names]) for k in ("max_acceleration", "max_jerk")
    )
    return JointLimits(chain.joint_names, chain.lower, chain.upper, chain.max_velocity, acceleration, jerk)


class ArmBody:
    """Where the arm's links are, as capsules that keep projector light from the scene."""

    def __init__(self, flange_from_camera: np.ndarray) -> None:
        text = urdf()
        links = [name for name, *_ in _CAPSULES if name != BASE_FRAME]
        self._chains = {name: Kinematics(text, BASE_FRAME, name) for name in [*links, FLANGE]}
        self._camera = flange_from_camera[:3, 3]

    def at(self, q: np.ndarray) -> Occluders:
        """The capsules, the camera's included, at joint positions q (6,)."""
        pose = {name: chain.forward(q[: chain.size]) for name, chain in self._chains.items()}
        pose[BASE_FRAME] = np.eye(4)
        ends = [transforms.apply(pose[link], np.array([a, b], float)) for link, a, b, _ in _CAPSULES]
        ends.append(transforms.apply(pose[FLANGE], np.array([np.zeros(3), self._camera - [0, 0, 0.02]])))
        return Occluders(np.array(ends), np.array([*(radius for *_, radius in _CAPSULES), 0.03]))


class Servo:
    """Joints that follow a reference like a critically damped second-order system.

    Attributes:
        positions, velocities: (n,) [rad, rad/s].
    """

    def __init__(self, positions: np.ndarray, bandwidth: float = 80.0, steps: int = 4) -> None:
        """bandwidth [rad/s]: the lag behind a ramp is 2 / bandwidth [s]; steps: subdivisions of a control period."""
        self._omega, self._steps = bandwidth, steps
        self.reset(positions)

    def reset(self, positions: np.ndarray) -> None:
        """At rest at positions (n,)."""
        self.positions = np.array(positions, float)
        self.velocities = np.zeros_like(self.positions)
        self._reference = self.positions.copy()

    def follow(self, reference: np.ndarray, period: float) -> None:
        """Move on by one period [s] while the reference goes to `reference` (n,) in a straight line."""
        dt, omega, start = period / self._steps, self._omega, self._reference
        decay = np.exp(-omega * dt)
        for k in range(self._steps):
            target = start + (k + 1) / self._steps * (reference - start)
            error = self.positions - target
            slope = self.velocities + omega * error
            self.positions = target + (error + slope * dt) * decay
            self.velocities = (self.velocities - omega * slope * dt) * decay
        self._reference = np.array(reference, float)
        if np.abs(self.positions - reference).max() < 1e-9 and np.abs(self.velocities).max() < 1e-8:
            self.positions, self.velocities = self._reference.copy(), np.zeros_like(self.velocities)

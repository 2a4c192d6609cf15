"""Arms for the tests: a six-axis arm without a spherical wrist, a seven-axis arm, a gantry with a wrist."""

from math import pi

import numpy as np

from sl_common.kinematics import Kinematics


def _urdf(name: str, joints: list[tuple]) -> str:
    """Joints: (name, type, xyz, rpy, axis, lower, upper, velocity); links between them, tool0 at the end."""
    text = [f'<robot name="{name}"><link name="base_link"/>']
    parent = "base_link"
    for joint, kind, xyz, rpy, axis, lower, upper, velocity in joints:
        child = "tool0" if joint == "tool" else f"{joint}_link"
        text.append(
            f'<link name="{child}"/><joint name="{joint}" type="{kind}"><parent link="{parent}"/>'
            f'<child link="{child}"/><origin xyz="{xyz[0]} {xyz[1]} {xyz[2]}" rpy="{rpy[0]} {rpy[1]} {rpy[2]}"/>'
        )
        if kind != "fixed":
            text.append(
                f'<axis xyz="{axis}"/><limit lower="{lower}" upper="{upper}" velocity="{velocity}" effort="100"/>'
            )
        text.append("</joint>")
        parent = child
    return "".join([*text, "</robot>"])


def six_axis_urdf() -> str:
    """The proportions of a common collaborative arm: three parallel axes, offset wrist."""
    z, zero = "0 0 1", (0, 0, 0)
    return _urdf(
        "six",
        [
            ("pan", "revolute", (0, 0, 0.16), zero, z, -2 * pi, 2 * pi, 3.0),
            ("lift", "revolute", zero, (pi / 2, 0, 0), z, -2 * pi, 2 * pi, 3.0),
            ("elbow", "revolute", (-0.42, 0, 0), zero, z, -pi, pi, 3.0),
            ("wrist_a", "revolute", (-0.39, 0, 0.13), zero, z, -2 * pi, 2 * pi, 3.2),
            ("wrist_b", "revolute", (0, -0.1, 0), (pi / 2, 0, 0), z, -2 * pi, 2 * pi, 3.2),
            ("wrist_c", "revolute", (0, 0.1, 0), (pi / 2, pi, pi), z, -2 * pi, 2 * pi, 3.2),
            ("tool", "fixed", (0, 0, 0.05), zero, "", 0, 0, 0),
        ],
    )


def seven_axis_urdf() -> str:
    """A redundant arm with narrow, unsymmetric joint ranges."""
    z = "0 0 1"
    h = pi / 2
    return _urdf(
        "seven",
        [
            ("a1", "revolute", (0, 0, 0.333), (0, 0, 0), z, -2.89, 2.89, 2.1),
            ("a2", "revolute", (0, 0, 0), (-h, 0, 0), z, -1.76, 1.76, 2.1),
            ("a3", "revolute", (0, -0.316, 0), (h, 0, 0), z, -2.89, 2.89, 2.1),
            ("a4", "revolute", (0.0825, 0, 0), (h, 0, 0), z, -3.07, -0.07, 2.1),
            ("a5", "revolute", (-0.0825, 0.384, 0), (-h, 0, 0), z, -2.89, 2.89, 2.6),
            ("a6", "revolute", (0, 0, 0), (h, 0, 0), z, -0.01, 3.75, 2.6),
            ("a7", "revolute", (0.088, 0, 0), (h, 0, 0), z, -2.89, 2.89, 2.6),
            ("tool", "fixed", (0, 0, 0.107), (0, 0, 0), "", 0, 0, 0),
        ],
    )


def gantry_urdf() -> str:
    """Three prismatic axes and a roll-pitch-yaw wrist whose first joint turns without end."""
    zero = (0, 0, 0)
    return _urdf(
        "gantry",
        [
            ("x", "prismatic", (0, 0, 1.0), zero, "1 0 0", -0.6, 0.6, 0.5),
            ("y", "prismatic", zero, zero, "0 1 0", -0.6, 0.6, 0.5),
            ("z", "prismatic", zero, zero, "0 0 1", -0.4, 0.4, 0.5),
            ("yaw", "continuous", zero, zero, "0 0 1", 0, 0, 2.0),
            ("pitch", "revolute", zero, zero, "0 1 0", -1.9, 1.9, 2.0),
            ("roll", "revolute", zero, zero, "1 0 0", -1.9, 1.9, 2.0),
            ("tool", "fixed", (0, 0, 0.1), zero, "", 0, 0, 0),
        ],
    )


URDFS = {"six": six_axis_urdf, "seven": seven_axis_urdf, "gantry": gantry_urdf}

HOME = {
    "six": np.array([0.2, -1.3, 1.7, -1.9, -1.5, 0.3]),
    "seven": np.array([0.1, -0.5, 0.2, -2.0, 0.1, 1.6, 0.6]),
    "gantry": np.array([0.1, -0.1, 0.0, 0.3, 0.4, 0.2]),
}


def kinematics(name: str) -> Kinematics:
    """Return the kinematics from base_link to tool0."""
    return Kinematics(URDFS[name](), "base_link", "tool0")

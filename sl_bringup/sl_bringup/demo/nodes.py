"""Which executables make up the demo, and with which parameters."""

from pathlib import Path
from typing import Any

from sl_bringup.processes import Executable, share_folder


def parameter_file(node: str) -> Path:
    """Return the default parameter file of a node."""
    return share_folder("sl_bringup") / "config" / f"{node}.yaml"


def executable(package: str, node: str, *, niceness: int = 0, **parameters: Any) -> Executable:
    """Return a node of the stack with its default parameter file and ``parameters`` over it."""
    files = [parameter_file(node)]
    return Executable(package, node, parameters=parameters, parameter_files=files, niceness=niceness)


def calibrator(calibration_folder: Path, session_folder: Path) -> Executable:
    """Return the calibrator, which keeps its samples in ``session_folder``."""
    return executable(
        "sl_calibration",
        "calibrator",
        niceness=5,
        calibration_folder=calibration_folder,
        session_folder=session_folder,
        sample_timeout=30.0,  # an image may take seconds to render on a busy machine
    )


def chain(calibration_folder: Path) -> list[Executable]:
    """Return the nodes that a real cell runs too: projector to setpoints.

    Two limits of the positioner are those of a simulation on a busy machine, not of a real cell: an image may take a
    second to render, and the simulated driver may lag. Those on the motion are the defaults.
    """
    return [
        executable("pattern_gen", "pattern_publisher"),
        executable("sl_decoder", "decoder", niceness=5),
        executable("sl_calibration", "triangulator", niceness=5, calibration_folder=calibration_folder),
        executable(
            "arm_positioner",
            "positioner",
            calibration_folder=calibration_folder,
            cloud_timeout=4.0,
            lost_timeout=15.0,
            driver_lag=1.0,
            joint_timeout=0.5,  # the ray caster takes the cores: joint states come late
        ),
    ]


def simulated_cell(scene: str, seed: int, **parameters: Any) -> Executable:
    """Return the cell: arm, camera and projector light."""
    return executable("sl_sim", "cell", scene=scene, seed=seed, **parameters)

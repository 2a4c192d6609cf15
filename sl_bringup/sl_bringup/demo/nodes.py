"""Which executables make up the demo, and with which parameters."""

from pathlib import Path

from sl_bringup.processes import Executable, share_folder


def parameter_file(node: str) -> Path:
    """Return the default parameter file of a node."""
    return share_folder("sl_bringup") / "config" / f"{node}.yaml"


def executable(package: str, node: str, **parameters: object) -> Executable:
    """Return a node of the stack with its default parameter file and ``parameters`` over it."""
    return Executable(package, node, parameters=parameters, parameter_files=[parameter_file(node)])


def chain(calibration_folder: Path) -> list[Executable]:
    """Return the nodes that a real cell runs too: projector to setpoints.

    The positioner waits longer for a cloud than in front of a real camera: on a busy machine an image is rendered in a second.
    """
    return [
        executable("pattern_gen", "pattern_publisher"),
        executable("sl_decoder", "decoder"),
        executable("sl_calibration", "triangulator", calibration_folder=calibration_folder),
        executable("arm_positioner", "positioner", calibration_folder=calibration_folder, cloud_timeout=4.0),
    ]


def simulated_cell(scene: str, seed: int, **parameters: object) -> Executable:
    """Return the cell: arm, camera and projector light."""
    return executable("sl_sim", "cell", scene=scene, seed=seed, **parameters)

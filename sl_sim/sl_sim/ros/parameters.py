"""The cell node's parameters, declared with description, unit and range."""

from dataclasses import dataclass, replace

from rclpy.node import Node

from sl_common.ros.parameters import declare
from sl_sim import scenes
from sl_sim.cell import CellSettings
from sl_sim.effects import EFFECTS, Effects


@dataclass(frozen=True)
class CellParameters:
    """Values of all parameters; units as in their descriptions."""

    settings: CellSettings
    effects: Effects
    joints: list[str]
    control_rate: float
    joint_state_rate: float
    camera_rate: float
    exposure_time: float
    command_buffer: float
    stream_timeout: float
    first_setpoint_jump: float
    encoder_noise: float
    encoder_step: float
    servo_bandwidth: float
    self_shadow: bool
    object_moves: bool

    @property
    def driver_options(self) -> dict[str, float]:
        """Keyword arguments of the ArmDriver."""
        return {
            "period": 1.0 / self.control_rate,
            "buffer": self.command_buffer,
            "timeout": self.stream_timeout,
            "jump": self.first_setpoint_jump,
            "bandwidth": self.servo_bandwidth,
        }


def declare_all(node: Node, joints: list[str]) -> CellParameters:
    """Declare every parameter on the node and return the values. Raises InvalidInputError for a bad one."""
    d = CellSettings()
    settings = CellSettings(
        scene=declare(node, "scene", d.scene, "the scene in front of the arm", choices=scenes.NAMES),
        seed=declare(node, "seed", d.seed, "varies the scene, the mounting and the noise", minimum=0),
        camera_width=declare(node, "camera_width", d.camera_width, "image width", unit="px", minimum=64, maximum=4096),
        camera_height=declare(
            node, "camera_height", d.camera_height, "image height", unit="px", minimum=48, maximum=4096
        ),
        focal_length=declare(
            node, "focal_length", d.focal_length, "true focal length of the camera", unit="px", minimum=50.0
        ),
        pers=declare(
            node, "pers", d.pers, "Pers coefficient of the lens in focal lengths, 0 = no distortion", minimum=0.0
        ),
        projector_width=declare(node, "projector_width", d.projector_width, "panel width", unit="px", minimum=64),
        projector_height=declare(node, "projector_height", d.projector_height, "panel height", unit="px", minimum=48),
        projector_focal_length=declare(
            node,
            "projector_focal_length",
            d.projector_focal_length,
            "true focal length of the projector",
            unit="px",
            minimum=50.0,
        ),
        projector_shift=declare(
            node, "projector_shift", d.projector_shift, "row of the principal point over the panel height (lens shift)"
        ),
        object_position=declare(
            node, "object_position", list(d.object_position), "origin of the object in base_link", unit="m"
        ),
        projector_position=declare(
            node, "projector_position", list(d.projector_position), "projector in base_link", unit="m"
        ),
        start_offset=declare(
            node,
            "start_offset",
            list(d.start_offset),
            "camera at the start: right, up, towards the arm from the object",
            unit="m",
        ),
        start_roll=declare(node, "start_roll", d.start_roll, "roll of the camera at the start", unit="deg"),
        sway=declare(
            node, "object_sway", list(d.sway), "amplitude of the object's motion along base x, y, z", unit="m"
        ),
        swing=declare(
            node, "object_swing", d.swing, "amplitude of the object's rotation about the vertical", unit="deg"
        ),
        sway_period=declare(
            node, "object_period", d.sway_period, "period of the object's motion", unit="s", minimum=0.5
        ),
    )
    effects = EFFECTS[declare(node, "effects", "lab", "light, projector and sensor effects", choices=tuple(EFFECTS))]
    bounce = declare(node, "interreflection", False, "add one bounce of the projector's light (slower)")
    lattice = declare(
        node, "lattice", 2, "distance of traced rays where the surface is smooth", unit="px", minimum=1, maximum=4
    )
    samples = declare(node, "samples", 2, "sub-pixels per pixel and axis", minimum=1, maximum=5)
    ambient = declare(
        node,
        "ambient",
        effects.render.ambient,
        "ambient light on white over projector white at 1 m",
        minimum=0.0,
        maximum=10.0,
    )
    exposure = declare(node, "exposure", effects.sensor.exposure, "exposure gain, 0 = automatic", minimum=0.0)
    noise = declare(node, "noise", effects.sensor.read_noise, "read noise of the sensor", unit="electrons", minimum=0.0)
    jpeg = declare(node, "jpeg", effects.sensor.jpeg, "JPEG quality of the transport, 0 = none", minimum=0, maximum=100)
    effects = replace(
        effects,
        render=replace(effects.render, interreflection=bounce, samples=samples, lattice=lattice, ambient=ambient),
        sensor=replace(effects.sensor, exposure=exposure, read_noise=noise, jpeg=jpeg),
    )
    return CellParameters(
        settings=settings,
        effects=effects,
        joints=declare(node, "joints", joints, "order of the values in a Float64MultiArray setpoint"),
        control_rate=declare(
            node, "control_rate", 125.0, "setpoints consumed", unit="Hz", minimum=10.0, maximum=1000.0
        ),
        joint_state_rate=declare(
            node, "joint_state_rate", 125.0, "joint_states published", unit="Hz", minimum=1.0, maximum=1000.0
        ),
        camera_rate=declare(
            node, "camera_rate", 5.0, "images taken, fewer when rendering cannot follow", unit="Hz", minimum=0.05
        ),
        exposure_time=declare(
            node, "exposure_time", 0.008, "exposure, for motion blur", unit="s", minimum=0.0, maximum=0.2
        ),
        command_buffer=declare(
            node,
            "command_buffer",
            0.04,
            "time that a stream of setpoints waits in the queue",
            unit="s",
            minimum=0.0,
            maximum=1.0,
        ),
        stream_timeout=declare(
            node, "stream_timeout", 0.3, "pause that ends a stream of setpoints", unit="s", minimum=0.02
        ),
        first_setpoint_jump=declare(
            node,
            "first_setpoint_jump",
            0.002,
            "distance from the joints at which a stream's start counts as a jump",
            unit="rad",
            minimum=0.0,
        ),
        encoder_noise=declare(
            node, "encoder_noise", 1.5e-5, "standard deviation of joint_states", unit="rad", minimum=0.0
        ),
        encoder_step=declare(node, "encoder_step", 6e-6, "quantisation of joint_states", unit="rad", minimum=0.0),
        servo_bandwidth=declare(
            node, "servo_bandwidth", 80.0, "the arm lags a ramp by 2 / bandwidth", unit="rad/s", minimum=5.0
        ),
        self_shadow=declare(node, "self_shadow", True, "the arm may stand in the projector's light"),
        object_moves=declare(
            node, "object_moves", False, "the object moves from the start; else when ~/move_object says so"
        ),
    )

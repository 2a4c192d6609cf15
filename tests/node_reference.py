"""The reference of every node in README.md: topics, services, actions and parameters, read from the running nodes.

    python tests/node_reference.py        # rewrite the tables in README.md

Each node is started as a process and asked over ROS for what it offers; what a topic is for stands here, the rest comes
from the node itself. A test compares README.md with the running nodes, so that it cannot fall behind.
"""

import re
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from rcl_interfaces.srv import DescribeParameters, GetParameters, ListParameters
from rclpy.parameter import parameter_value_to_python
from rclpy.topic_endpoint_info import TopicEndpointTypeEnum
from stack_testing.running import Stack, running_stack, wait_for
from std_msgs.msg import String

from sl_bringup.processes import share_folder
from sl_common.ros.qos import LATCHED, describe

README = Path(__file__).resolve().parents[1] / "README.md"

NODES = {
    "pattern_publisher": "pattern_gen",
    "decoder": "sl_decoder",
    "triangulator": "sl_calibration",
    "calibrator": "sl_calibration",
    "positioner": "arm_positioner",
    "cell": "sl_sim",
}
"""Every node and its package, in the order of the data flow."""

MEANING = {
    "projector/image": "what the projector shows; put it on the projector full screen, without scaling",
    "projector/camera_info": "intrinsics of the projector",
    "pattern": "the pattern: map, letters, spot centres and size",
    "camera/image_raw": "camera image: bgr8, rgb8, bgra8, rgba8, mono8, mono16, rgb16, bgr16 or Bayer",
    "camera/camera_info": "intrinsics of the camera (plumb_bob)",
    "correspondences": "dots of one image with their place in the pattern; the image's stamp",
    "joint_states": "measured joint positions, mapped by name",
    "robot_description": "URDF of the arm",
    "points": "point cloud x y z rgb confidence row col; the image's stamp",
    "commands": "setpoint of all joints, in the order of `joints` (forward_command_controller)",
    "joint_trajectory": "setpoints that end at rest (joint_trajectory_controller)",
    "/diagnostics": "rates, figures and the reason when something is wrong, at 1 Hz",
    "~/debug_image": "dots, graph, letters, rows and columns drawn on the image; made only while subscribed",
    "~/marked": "dots that the checks mark: x y z camera_u camera_v row col mark distance; mark as in docs/decoding.md",
    "~/object": "pose, motion and covariance of the tracked object",
    "~/reset_object": "forget the tracked object and begin anew with the next cloud",
    "~/status": "code and one sentence with the numbers, at 10 Hz and on change",
    "~/target": "camera pose that the arm heads for",
    "~/target_pose": "camera pose to servo to; refused when older than 0.1 s",
    "~/markers": "target, surface patch and path for RViz",
    "~/progress": "where the calibration stands and what to do next",
    "~/truth": "the true cell as JSON, for reports only",
    "~/truth/camera_pose": "true camera pose at each image's stamp, for reports only",
    "~/truth/object_pose": "true object pose at each image's stamp, for reports only",
    "~/set_projection": "show the pattern, a Gray code bit, white, black or a chart; answers when it is shown",
    "~/reload": "read the calibration folder again",
    "~/move_object": "start or stop the object's motion",
    "~/reset": "arm at rest at its start pose, counters at zero",
    "~/pause": "true: come to rest and stay; false: ready again",
    "~/stop": "come to rest and forget the target",
    "~/position_arm": "bring the camera in front of the object or to a pose, and follow it",
    "~/take_sample": "add the present view to the session",
    "~/remove_sample": "remove a view",
    "~/list_samples": "the views, with residuals",
    "~/compute": "compute the calibration, with residuals and uncertainty",
    "~/save": "write the calibration folder, all files or none",
    "~/load": "load a calibration folder or resume a session",
    "~/run_motion": "move the arm through the calibration motion, taking a view at each stop",
    "/clock": "simulated time",
}

_PLUMBING = ("/rosout", "/parameter_events")
_PARAMETER_SERVICES = re.compile(r"/(describe|get|list|set)_parameter(s|_types|s_atomically)$|/get_type_description$")
_ACTION_PARTS = re.compile(r"/_action/\w+$")
_PARAMETERS_OF_RCLPY = ("use_sim_time", "start_type_description_service", "qos_overrides")


class NodeReference:
    """What a running node offers, as Markdown."""

    def __init__(self, stack: Stack, name: str) -> None:
        self._stack, self._name, self._node = stack, name, stack.peer.node
        wait_for(lambda: name in self._node.get_node_names(), 90.0, f"node {name}")
        self._wait_until_complete()
        self._parameters = self._describe_parameters()

    def topics(self) -> dict[tuple[str, str], tuple[str, str]]:
        """Map ("publishes" or "subscribes", relative name) to (type, QoS)."""
        out = {}
        for way, verb in (("publisher", "publishes"), ("subscription", "subscribes")):
            for topic, types in sorted(self._endpoints(way)):
                out[verb, self._relative(topic)] = (types[0].replace("/msg/", "/"), self._qos(topic, way))
        return out

    def services(self) -> dict[str, str]:
        """Map the relative names of services and actions to their types."""
        out = {}
        for name, types in self._node.get_service_names_and_types_by_node(self._name, "/"):
            if name.endswith("/_action/send_goal"):
                out[self._relative(_ACTION_PARTS.sub("", name))] = types[0].removesuffix("_SendGoal")
            elif not _PARAMETER_SERVICES.search(name) and not _ACTION_PARTS.search(name):
                out[self._relative(name)] = types[0].replace("/srv/", "/")
        return out

    def parameters(self) -> dict[str, tuple[Any, str, str]]:
        """Map names to (default, description with unit, allowed values)."""
        return self._parameters

    def markdown(self) -> str:
        """Return the tables."""
        lines = ["| | topic | type | QoS | |", "|---|---|---|---|---|"]
        lines += [
            f"| {verb} | `{topic}` | {kind} | {qos} | {_meaning(topic)} |"
            for (verb, topic), (kind, qos) in self.topics().items()
        ]
        if services := self.services():
            lines += ["", "| service or action | type | |", "|---|---|---|"]
            lines += [
                f"| `{name}` | {kind.replace('/action/', '/')} | {_meaning(name)} |" for name, kind in services.items()
            ]
        lines += ["", "| parameter | default | |", "|---|---|---|"]
        for name, (default, text, allowed) in self.parameters().items():
            text = text[:1].lower() + text[1:] if text[1:2].islower() else text
            lines.append(f"| `{name}` | {_shown(default)} | {text}{f'; {allowed}' if allowed else ''} |")
        return "\n".join(lines)

    def _wait_until_complete(self) -> None:
        """Give the node a robot, on which some of its topics depend, and wait until no topic or service is added."""
        arm = share_folder("sl_sim") / "description" / "ur5e.urdf"
        wait_for(lambda: self._endpoints("publisher"), 120.0, "topics of the node")
        if "robot_description" in {self._relative(t) for t, _ in self._endpoints("subscription")}:
            self._stack.peer.publish("robot_description", String(data=arm.read_text()), LATCHED)
        seen: tuple[Any, ...] = ()
        while seen != (seen := (self.topics(), self.services())):
            time.sleep(2.0)

    def _endpoints(self, way: str) -> list[tuple[str, list[str]]]:
        query = getattr(
            self._node, f"get_{'publisher' if way == 'publisher' else 'subscriber'}_names_and_types_by_node"
        )
        return [(t, k) for t, k in query(self._name, "/") if t not in _PLUMBING and not _ACTION_PARTS.search(t)]

    def _qos(self, topic: str, way: str) -> str:
        info = (
            self._node.get_publishers_info_by_topic
            if way == "publisher"
            else self._node.get_subscriptions_info_by_topic
        )
        wanted = TopicEndpointTypeEnum.PUBLISHER if way == "publisher" else TopicEndpointTypeEnum.SUBSCRIPTION
        profile = next(i.qos_profile for i in info(topic) if i.node_name == self._name and i.endpoint_type == wanted)
        return re.sub(r", depth \d+", "", describe(profile))  # DDS does not tell others the depth

    def _relative(self, name: str) -> str:
        if name.startswith(f"/{self._name}/"):
            return "~" + name.removeprefix(f"/{self._name}")
        return name if name in ("/diagnostics", "/clock") else name.removeprefix("/")

    def _describe_parameters(self) -> dict[str, tuple[Any, str, str]]:
        call = self._stack.peer.call
        found = call(ListParameters, f"/{self._name}/list_parameters", ListParameters.Request()).result.names
        names = [n for n in found if not n.startswith(_PARAMETERS_OF_RCLPY)]
        descriptors = call(
            DescribeParameters, f"/{self._name}/describe_parameters", DescribeParameters.Request(names=names)
        ).descriptors
        values = call(GetParameters, f"/{self._name}/get_parameters", GetParameters.Request(names=names)).values
        return {
            name: (parameter_value_to_python(value), d.description, d.additional_constraints)
            for name, d, value in zip(names, descriptors, values, strict=True)
        }


def _meaning(name: str) -> str:
    if name not in MEANING:
        raise KeyError(f"say in MEANING of {Path(__file__).name} what '{name}' is for")
    return MEANING[name]


def _shown(value: Any) -> str:
    if value == "" or value == [""]:
        return "empty"
    return str(value).lower() if isinstance(value, bool) else str(value).replace("'", "")


def section(text: str, node: str) -> str:
    """Return the generated part of README's text for a node; raises ValueError when it has none."""
    match = re.search(_markers(node), text, re.DOTALL)
    if match is None:
        raise ValueError(f"README.md has no markers '<!-- reference of {node} -->' and '<!-- end -->'")
    return match[1].strip()


def _markers(node: str) -> str:
    return rf"<!-- reference of {node} -->\n(.*?)<!-- end -->"


def describe_node(name: str, folder: Path) -> str:
    """Start a node in a domain of its own and return its tables as Markdown."""
    with running_stack(folder) as stack:
        stack.start(NODES[name], name)
        return NodeReference(stack, name).markdown()


def main() -> None:
    """Rewrite README.md."""
    for name in sys.argv[1:] or NODES:
        section(README.read_text(), name)
        with tempfile.TemporaryDirectory() as folder:
            block = f"<!-- reference of {name} -->\n\n{describe_node(name, Path(folder))}\n\n<!-- end -->"
        text = README.read_text()
        README.write_text(re.sub(_markers(name), lambda _, block=block: block, text, flags=re.DOTALL))
        print(f"{name}: done")


if __name__ == "__main__":
    main()

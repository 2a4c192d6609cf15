"""Between rclpy's messages and the message types of rosbags.

Bytes that rclpy serialised hold uninitialised padding, and some are refused by rosbags: a bag is therefore written with
rosbags' own serialisation, the same for the same content, and read back with rclpy's deserialisation.
"""

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from sl_bringup.processes import share_folder

_NO_TIME = QosTime(0, 0)


@cache
def typestore() -> Typestore:
    """Return the message types of Jazzy and of sl_msgs."""
    store = get_typestore(Stores.ROS2_JAZZY)
    definitions: dict[str, Any] = {}
    folder: Path = share_folder("sl_msgs") / "msg"
    for path in sorted(folder.glob("*.msg")):
        definitions.update(get_types_from_msg(path.read_text(encoding="utf-8"), f"sl_msgs/msg/{path.stem}"))
    store.register(definitions)
    return store


def type_name(message_type: type) -> str:
    """Return the ROS name of a message class, such as sensor_msgs/msg/Image."""
    module = message_type.__module__.split(".")
    return f"{module[0]}/{module[1]}/{message_type.__name__}"


def serialise(message: Any) -> bytes:
    """Return an rclpy message as CDR bytes, equal for equal content."""
    return bytes(typestore().serialize_cdr(_convert(message), type_name(type(message))))


def qos(*, latched: bool) -> Qos:
    """Return the offered QoS kept with a topic: reliable, depth 1, transient local where latched."""
    return Qos(
        history=QosHistory.KEEP_LAST,
        depth=1,
        reliability=QosReliability.RELIABLE,
        durability=QosDurability.TRANSIENT_LOCAL if latched else QosDurability.VOLATILE,
        deadline=_NO_TIME,
        lifespan=_NO_TIME,
        liveliness=QosLiveliness.AUTOMATIC,
        liveliness_lease_duration=_NO_TIME,
        avoid_ros_namespace_conventions=False,
    )


def _convert(message: Any) -> Any:
    """Return the rosbags counterpart of an rclpy message."""
    fields = message.get_fields_and_field_types()
    values = {name: _value(getattr(message, name), kind) for name, kind in fields.items()}
    return typestore().types[type_name(type(message))](**values)


_DTYPES = {
    "boolean": np.bool_,
    "octet": np.uint8,
    "byte": np.uint8,
    "char": np.uint8,
    "int8": np.int8,
    "uint8": np.uint8,
    "int16": np.int16,
    "uint16": np.uint16,
    "int32": np.int32,
    "uint32": np.uint32,
    "int64": np.int64,
    "uint64": np.uint64,
    "float": np.float32,
    "double": np.float64,
}


def _value(value: Any, kind: str) -> Any:
    """Convert a field by its type in IDL words, such as sequence<float> or double[9]."""
    element = kind.removeprefix("sequence<").split(",")[0].removesuffix(">") if kind.startswith("sequence<") else ""
    if not element and kind.endswith("]"):
        element = kind[: kind.rindex("[")]
    if element:
        if element in _DTYPES:
            return np.array(value, dtype=_DTYPES[element])
        return [_value(v, element) for v in value]
    if hasattr(value, "get_fields_and_field_types"):
        return _convert(value)
    if kind == "octet" and isinstance(value, bytes):
        return value[0]
    return value

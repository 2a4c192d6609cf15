"""sensor_msgs/PointCloud2 to and from named arrays (sensor_msgs_py is not among the wheels)."""

import array
import sys
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from sensor_msgs.msg import PointCloud2, PointField
from std_msgs.msg import Header

from sl_common.errors import InvalidInputError

_DATATYPES: dict[np.dtype, int] = {
    np.dtype(np.int8): PointField.INT8,
    np.dtype(np.uint8): PointField.UINT8,
    np.dtype(np.int16): PointField.INT16,
    np.dtype(np.uint16): PointField.UINT16,
    np.dtype(np.int32): PointField.INT32,
    np.dtype(np.uint32): PointField.UINT32,
    np.dtype(np.float32): PointField.FLOAT32,
    np.dtype(np.float64): PointField.FLOAT64,
}
_DTYPES: dict[int, np.dtype] = {code: dtype for dtype, code in _DATATYPES.items()}


def pack_rgb(rgb: ArrayLike) -> NDArray[np.float32]:
    """Pack colours (N, 3) uint8 into the float32 (N,) that RViz and PCL read from a field named rgb."""
    c = np.asarray(rgb, dtype=np.uint32)
    return (c[:, 0] << 16 | c[:, 1] << 8 | c[:, 2]).astype(np.uint32).view(np.float32)


def unpack_rgb(packed: ArrayLike) -> NDArray[np.uint8]:
    """Return the colours (N, 3) uint8 of a packed rgb field (N,) float32."""
    c = np.ascontiguousarray(packed, dtype=np.float32).view(np.uint32)
    return np.stack([c >> 16 & 255, c >> 8 & 255, c & 255], axis=-1).astype(np.uint8)


def to_message(header: Header, **fields: ArrayLike) -> PointCloud2:
    """Build an unordered cloud from arrays (N,) of equal length, fields in the order given, x y z among them.

    Fields are packed without gaps, the layout that most readers expect.
    """
    arrays = {name: np.asarray(values) for name, values in fields.items()}
    lengths = {name: len(values) for name, values in arrays.items()}
    if len(set(lengths.values())) > 1:
        raise InvalidInputError(f"fields of a cloud must have equal length, got {lengths}")
    dtype = np.dtype([(name, values.dtype) for name, values in arrays.items()])
    count = next(iter(lengths.values()), 0)
    points = np.empty(count, dtype=dtype)
    for name, values in arrays.items():
        points[name] = values
    data = array.array("B")
    data.frombytes(points.tobytes())
    message_fields = [
        PointField(name=name, offset=dtype.fields[name][1], datatype=_DATATYPES[values.dtype], count=1)  # type: ignore[index]
        for name, values in arrays.items()
    ]
    xyz = [arrays[k] for k in ("x", "y", "z") if k in arrays]
    return PointCloud2(
        header=header,
        height=1,
        width=count,
        fields=message_fields,
        is_bigendian=sys.byteorder == "big",
        point_step=dtype.itemsize,
        row_step=dtype.itemsize * count,
        data=data,
        is_dense=bool(all(np.isfinite(v).all() for v in xyz)),
    )


def from_message(message: PointCloud2) -> dict[str, NDArray]:
    """Return a cloud's fields as arrays (N,) in native byte order, N = width * height; extra padding is honoured.

    Raises InvalidInputError when x, y or z is missing or the data do not fit the declared size.
    """
    names = {f.name for f in message.fields}
    if not {"x", "y", "z"} <= names:
        raise InvalidInputError(f"point cloud lacks x, y or z; it has: {', '.join(sorted(names)) or 'no fields'}")
    order: Literal[">", "<"] = ">" if message.is_bigendian else "<"
    formats: list[np.dtype] = []
    offsets: list[int] = []
    for f in message.fields:
        if f.datatype not in _DTYPES:
            raise InvalidInputError(f"field '{f.name}' has unknown datatype {f.datatype}")
        dtype = _DTYPES[f.datatype].newbyteorder(order)
        formats.append(dtype)
        offsets.append(f.offset)
        if f.offset + dtype.itemsize > message.point_step:
            raise InvalidInputError(f"field '{f.name}' does not fit the point step of {message.point_step} bytes")
    needed = message.row_step * (message.height - 1) + message.point_step * message.width if message.height else 0
    if message.row_step < message.point_step * message.width or len(message.data) < needed:
        raise InvalidInputError(
            f"point cloud of {message.width}x{message.height} points takes {needed} bytes, got {len(message.data)}"
        )
    layout = np.dtype(
        {
            "names": [f.name for f in message.fields],
            "formats": formats,
            "offsets": offsets,
            "itemsize": message.point_step,
        }
    )
    raw = np.frombuffer(message.data, dtype=np.uint8)
    rows = [
        raw[r * message.row_step : r * message.row_step + message.point_step * message.width].view(layout)
        for r in range(message.height)
    ]
    points = np.concatenate(rows) if rows else np.empty(0, dtype=layout)
    return {name: points[name].astype(points[name].dtype.newbyteorder("=")) for name in points.dtype.names or ()}

"""Messages of ROS 2 in CDR, as bags have them, with the text of their definitions."""

from __future__ import annotations

import struct
from collections.abc import Sequence

_HEADER = "std_msgs/Header header\n"
_TIME = "int32 sec\nuint32 nanosec\n"
_VECTOR = "float64 x\nfloat64 y\nfloat64 z\n"
_QUATERNION = "float64 x 0\nfloat64 y 0\nfloat64 z 0\nfloat64 w 1\n"
_PARTS = {
    "std_msgs/Header": "builtin_interfaces/Time stamp\nstring frame_id\n",
    "builtin_interfaces/Time": _TIME,
    "geometry_msgs/Point": _VECTOR,
    "geometry_msgs/Vector3": _VECTOR,
    "geometry_msgs/Quaternion": _QUATERNION,
    "geometry_msgs/Pose": "Point position\nQuaternion orientation\n",
    "geometry_msgs/Wrench": "Vector3 force\nVector3 torque\n",
    "geometry_msgs/Transform": "Vector3 translation\nQuaternion rotation\n",
    "geometry_msgs/TransformStamped": f"{_HEADER}string child_frame_id\nTransform transform\n",
}
_WITH_HEADER = ("std_msgs/Header", "builtin_interfaces/Time")
_TYPES = {
    "sensor_msgs/msg/JointState": (
        f"{_HEADER}string[] name\nfloat64[] position\nfloat64[] velocity\nfloat64[] effort\n",
        _WITH_HEADER,
    ),
    "geometry_msgs/msg/PoseStamped": (
        f"{_HEADER}Pose pose\n",
        (*_WITH_HEADER, "geometry_msgs/Pose", "geometry_msgs/Point", "geometry_msgs/Quaternion"),
    ),
    "geometry_msgs/msg/PointStamped": (
        f"{_HEADER}Point point\n", (*_WITH_HEADER, "geometry_msgs/Point"),
    ),
    "geometry_msgs/msg/WrenchStamped": (
        f"{_HEADER}Wrench wrench\n",
        (*_WITH_HEADER, "geometry_msgs/Wrench", "geometry_msgs/Vector3"),
    ),
    "tf2_msgs/msg/TFMessage": (
        "geometry_msgs/TransformStamped[] transforms\n",
        ("geometry_msgs/TransformStamped", *_WITH_HEADER, "geometry_msgs/Transform",
         "geometry_msgs/Vector3", "geometry_msgs/Quaternion"),
    ),
    "std_msgs/msg/Float64": ("float64 data\n", ()),
    "std_msgs/msg/String": ("string data\n", ()),
    "std_msgs/msg/Bool": ("bool data\n", ()),
}  # fmt: skip
TYPES = {
    name: text + "".join(f"{'=' * 80}\nMSG: {part}\n{_PARTS[part]}" for part in parts)
    for name, (text, parts) in _TYPES.items()
}
"""The definition of each type, followed by those of what it has."""


class Cdr:
    """Writes one message in CDR, little-endian; each value is aligned to its size."""

    def __init__(self) -> None:
        self._body = bytearray()

    def bytes(self) -> bytes:
        """The message with its encapsulation header."""
        return b"\x00\x01\x00\x00" + bytes(self._body)

    def u32(self, value: int) -> Cdr:
        """An unsigned or signed number of four bytes."""
        self._align(4)
        self._body += struct.pack("<I", value & 0xFFFFFFFF)
        return self

    def f64(self, *values: float) -> Cdr:
        """Numbers one after the other."""
        self._align(8)
        self._body += struct.pack(f"<{len(values)}d", *values)
        return self

    def flag(self, value: bool) -> Cdr:
        """A boolean."""
        self._body.append(value)
        return self

    def text(self, value: str) -> Cdr:
        """A string."""
        data = value.encode() + b"\0"
        self.u32(len(data))
        self._body += data
        return self

    def list_f64(self, values: Sequence[float]) -> Cdr:
        """A sequence of numbers."""
        self.u32(len(values))
        return self.f64(*values) if len(values) else self

    def header(self, seconds: float, frame: str) -> Cdr:
        """A stamp and the name of a frame."""
        nanoseconds = round(seconds * 1e9)
        self.u32(nanoseconds // 1_000_000_000)
        return self.u32(nanoseconds % 1_000_000_000).text(frame)

    def _align(self, size: int) -> None:
        self._body += bytes(-len(self._body) % size)

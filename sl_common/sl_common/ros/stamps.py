"""Stamps as integer nanoseconds."""

from builtin_interfaces.msg import Time


def to_ns(stamp: Time) -> int:
    """Return a message's stamp in nanoseconds."""
    return int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)


def from_ns(nanoseconds: int) -> Time:
    """Return a message's stamp of integer nanoseconds."""
    sec, nanosec = divmod(int(nanoseconds), 1_000_000_000)
    return Time(sec=sec, nanosec=nanosec)

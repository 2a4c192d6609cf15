"""A ROS domain of one's own: on this machine only, and used by nobody else."""

import fcntl
import os
import socket
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from sl_bringup.errors import ProcessError

DOMAINS = range(60, 100)
"""Domains to choose from; higher ones reach into Linux' ephemeral ports."""


@contextmanager
def free_domain(wanted: int | None = None) -> Iterator[int]:
    """Yield a ROS domain id that nobody uses, and keep it from other callers on this machine until the block ends.

    Args:
        wanted: This very one, whether it is in use or not; None: the first of :data:`DOMAINS` that is free.

    Raises ProcessError when all are taken.
    """
    if wanted is not None:
        yield wanted
        return
    for domain in DOMAINS:
        handle = _lock(domain)
        if handle is None:
            continue
        try:
            yield domain
        finally:
            os.close(handle)
        return
    raise ProcessError(f"all ROS domains {DOMAINS.start} to {DOMAINS.stop - 1} are in use; give one with --domain-id")


def environment(domain: int) -> dict[str, str]:
    """Return this process's environment with the domain, discovery on this machine only, and unbuffered output."""
    out = dict(os.environ)
    out["ROS_DOMAIN_ID"] = str(domain)
    out["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    out.pop("ROS_LOCALHOST_ONLY", None)
    out["PYTHONUNBUFFERED"] = "1"
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        out.setdefault(name, "1")  # the matrices are small: threads of a library only take cores from other nodes
    return out


def _lock(domain: int) -> int | None:
    """Return the handle that holds the domain's lock, or None where somebody has or uses the domain."""
    path = Path(tempfile.gettempdir()) / f"structured_light_domain_{domain}.lock"
    try:
        handle = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
    except OSError:
        return None  # another user's
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        os.close(handle)
        return None
    if _unused(domain):
        return handle
    os.close(handle)
    return None


def _unused(domain: int) -> bool:
    """Tell whether no DDS participant listens on the domain's discovery port (DDS-RTPS 9.6.1: 7400 + 250 domain)."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.bind(("", 7400 + 250 * domain))
        except OSError:
            return False
    return True

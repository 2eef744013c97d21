"""Whether anybody on this machine can be on a ROS domain, told by the UDP ports of DDS."""

from __future__ import annotations

import psutil
from rclpy.utilities import get_rmw_implementation_identifier

_BASE, _PER_DOMAIN, _PER_PARTICIPANT, _UNICAST = 7400, 250, 2, 10
"""PB, DG, PG and d1 of DDSI-RTPS 2.2, section 9.6.1.1: where a participant listens for others."""


def nobody_here(domain: int) -> bool:
    """Whether there surely is no participant on a domain on this machine.

    Args:
        domain: a ROS domain id, 0 to 232.

    Returns:
        False also where that cannot be told from ports: with another middleware than Fast DDS, or
        on a system that does not tell which are in use.
    """
    if not get_rmw_implementation_identifier().startswith('rmw_fastrtps'):
        return False
    try:
        used = {socket.laddr.port for socket in psutil.net_connections('udp') if socket.laddr}
    except (psutil.Error, OSError):
        return False
    first = _BASE + _PER_DOMAIN * domain + _UNICAST
    theirs = range(first, first + _PER_DOMAIN - _UNICAST, _PER_PARTICIPANT)
    return used.isdisjoint(theirs)

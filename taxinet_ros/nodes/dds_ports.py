"""Whether anybody on this machine is on a ROS domain, told by the UDP ports of DDS."""

from __future__ import annotations

import psutil
from rclpy.utilities import get_rmw_implementation_identifier

_BASE, _PER_DOMAIN = 7400, 250
"""PB and DG of DDSI-RTPS 2.2, section 9.6.1.1: where the ports of a domain begin, and how many
there are: of those who listen to all, and of each participant."""


def anybody_here(domain: int) -> bool | None:
    """Whether there is a participant on a domain on this machine, whoever started it.

    Args:
        domain: a ROS domain id, 0 to 232.

    Returns:
        True also where another program has one of the ports. None where that cannot be told from
        ports: with another middleware than Fast DDS, or on a system that does not tell which are
        in use.
    """
    if not get_rmw_implementation_identifier().startswith('rmw_fastrtps'):
        return None
    try:
        used = {socket.laddr.port for socket in psutil.net_connections('udp') if socket.laddr}
    except (psutil.Error, OSError):
        return None
    first = _BASE + _PER_DOMAIN * domain
    return not used.isdisjoint(range(first, first + _PER_DOMAIN))

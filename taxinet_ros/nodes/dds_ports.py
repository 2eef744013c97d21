"""Whether anybody on this machine can be on a ROS domain, told by the UDP ports of DDS."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from rclpy.utilities import get_rmw_implementation_identifier

_BASE, _PER_DOMAIN, _PER_PARTICIPANT, _UNICAST = 7400, 250, 2, 10
"""PB, DG, PG and d1 of DDSI-RTPS 2.2, section 9.6.1.1: where a participant listens for others."""

_TABLES = (Path('/proc/net/udp'), Path('/proc/net/udp6'))


def nobody_here(domain: int) -> bool:
    """Whether there surely is no participant on a domain on this machine.

    Args:
        domain: a ROS domain id, 0 to 232.

    Returns:
        False also where that cannot be told from ports: with another middleware than Fast DDS, or
        on a system other than Linux.
    """
    if not get_rmw_implementation_identifier().startswith('rmw_fastrtps'):
        return False
    tables = [table for table in _TABLES if table.exists()]
    used = {port for table in tables for port in _ports(table)}
    first = _BASE + _PER_DOMAIN * domain + _UNICAST
    theirs = range(first, first + _PER_DOMAIN - _UNICAST, _PER_PARTICIPANT)
    return bool(tables) and used.isdisjoint(theirs)


def _ports(table: Path) -> Iterator[int]:
    """Local ports in a table of sockets (proc(5)): the second column, in hexadecimal."""
    for line in table.read_text().splitlines()[1:]:
        yield int(line.split()[1].rpartition(':')[2], 16)

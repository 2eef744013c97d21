"""Reserve a private ROS domain for a graph, and refuse to join another graph's."""

from __future__ import annotations

import contextlib
import itertools
import os
import socket
import time
from collections.abc import Iterator

import rclpy
from domain_coordinator import domain_id
from domain_coordinator.impl import PORT_BASE
from rclpy.context import Context
from rclpy.node import Node

from taxinet_ros.errors import UsageError
from taxinet_ros.nodes import interface
from taxinet_ros.nodes.running.leave import leave_graph

HIGHEST = 232
"""The highest domain id whose ports exist (DDSI-RTPS 2.2, section 9.6.1.1)."""
BY_HAND = 'TAXINET_DOMAIN_ID'
"""Environment variable that overrides the automatic choice of a domain."""
DISCOVERY_RANGE, LOCALHOST = 'ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST'
"""ROS 2 environment variable of the discovery range, and its narrowest value."""
_PEERS = 'ROS_STATIC_PEERS'
"""ROS 2 environment variable of static discovery peers."""
_RESERVED = 'TAXINET_RESERVED_DOMAIN'
"""Environment variable that tells a child which domain its parent has reserved."""
# Participants announce themselves and their endpoints every 3 s: what was missed at first on a busy
# machine is found after one period (3.4 s was observed) or two.
_LOOK_S = 7.0
_LOOK_PERIOD_S = 0.05
_NAMELESS = '_NODE_NAME_UNKNOWN_'
_CHOICE = 100
"""Number of domains to choose from: Linux assigns the ports of higher ones dynamically."""
# Each graph starts its search after the previous one's domain, to avoid remains of its predecessor.
_domains = itertools.cycle([*range(1 + os.getpid() % 100, 101), *range(1, 1 + os.getpid() % 100)])
# DDSI-RTPS 2.2, section 9.6.1.1: first port of domain 0, number of ports per domain, offset of the
# unicast ports. Each participant of a machine takes the next two.
_BASE, _PER_DOMAIN, _OF_NODES, _MOST_NODES = 7400, 250, 10, 20
_made_sure_of: set[tuple[int, str]] = set()


@contextlib.contextmanager
def own_domain(wanted: int | None = None, namespace: str = '/') -> Iterator[int]:
    """Reserve a ROS domain id that no node of this machine uses.

    Discovery is limited to this machine unless the user has set another range. Of the domains from
    1 to 100, reserved ones and those in use are skipped. ``TAXINET_DOMAIN_ID`` sets the domain by
    hand, to inspect the graph with other tools; such a domain is observed for some seconds first,
    unless it is unused.

    Args:
        wanted: the domain; default ``TAXINET_DOMAIN_ID``, else a free one.
        namespace: absolute namespace of the graph; graphs with different namespaces may share a
            domain set by the user.

    Raises:
        UsageError: a domain set by hand is invalid or belongs to another graph, or none is free.
    """
    if wanted is None:
        wanted = domain_by_hand()
    with _localhost(), _free() if wanted is None else _reserved(wanted) as (domain, alone):
        if wanted is not None:
            refuse_neighbours(domain, namespace)
        if not alone and namespace == '/':
            raise UsageError(
                f'ROS domain {domain} is taken: another graph on this machine has reserved it (TCP '
                f'port {PORT_BASE + domain}); choose another one'
            )
        with _set(_RESERVED, str(domain)):
            yield domain


def domain_by_hand() -> int | None:
    """The domain set by ``TAXINET_DOMAIN_ID``, if any.

    Raises:
        UsageError: it is invalid, or belongs to another graph.
    """
    text = os.environ.get(BY_HAND)
    if not text:
        return None
    domain = domain_number(text, BY_HAND)
    with _localhost():
        refuse_neighbours(domain)
    return domain


def check_workers(workers: int) -> None:
    """Check that each worker can get a domain, before anything is started.

    Raises:
        UsageError: a domain is set by hand, and there is more than one worker; or it is invalid, or
            belongs to another graph.
    """
    text = os.environ.get(BY_HAND)
    if text and workers > 1:
        raise UsageError(
            f'{BY_HAND} {text}: a single domain, but {workers} workers need one each; use '
            f'--workers 1, or unset {BY_HAND}'
        )
    domain_by_hand()


def domain_number(text: str, where: str) -> int:
    """Read a ROS domain id.

    Raises:
        UsageError: it is not a domain id.
    """
    if not (text.isascii() and text.isdecimal() and int(text) <= HIGHEST):
        raise UsageError(f'{where} {text!r}: a ROS domain is an integer from 0 to {HIGHEST}')
    return int(text)


def refuse_neighbours(domain: int, namespace: str = '/') -> None:
    """Check that no other graph is on a domain; once per process, some seconds if it is in use.

    Raises:
        UsageError: there is another graph; the message names its node.
    """
    clock = f'{namespace.rstrip("/")}{interface.CLOCK.name}'
    if (domain, clock) in _made_sure_of:
        return  # Remaining endpoints belong to a previous graph of this process.
    far = os.environ.get(DISCOVERY_RANGE) != LOCALHOST or os.environ.get(_PEERS)
    if not (far or in_use(domain)):
        return
    if found := _clocks_on(domain, clock):
        verb = 'publishes' if len(found) == 1 else 'publish'
        raise UsageError(
            f'another graph is on ROS domain {domain}: {" and ".join(found)} {verb} {clock}; end '
            'it (a killed one disappears after about 20 s), or set another ROS_DOMAIN_ID'
        )
    _made_sure_of.add((domain, clock))


def in_use(domain: int) -> bool:
    """Whether a program of this machine uses a domain, by the UDP ports of its first nodes."""
    first = _BASE + _PER_DOMAIN * domain
    for port in (first, *range(first + _OF_NODES, first + _OF_NODES + _MOST_NODES)):
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            try:
                probe.bind(('', port))
            except OSError:
                return True
    return False


def _clocks_on(domain: int, clock: str) -> list[str]:
    """Names of the nodes that publish a clock on a domain."""
    context = Context()
    rclpy.init(context=context, domain_id=domain)
    try:
        probe = Node(
            f'taxinet_probe_{os.getpid()}', context=context, enable_rosout=False,
            start_parameter_services=False,
        )
        found: list[str] = []
        deadline = time.monotonic() + _LOOK_S
        while not found and time.monotonic() < deadline:
            time.sleep(_LOOK_PERIOD_S)
            found = sorted(
                f'{end.node_namespace.rstrip("/")}/{end.node_name}'
                for end in probe.get_publishers_info_by_topic(clock)
                # A publisher may be discovered shortly before its node.
                if end.node_name != _NAMELESS
            )
        leave_graph(probe)
    finally:
        rclpy.try_shutdown(context=context)
    return found


def require_discovery() -> None:
    """Check that a node in a process of its own can find others.

    Raises:
        UsageError: discovery is switched off.
    """
    if os.environ.get(DISCOVERY_RANGE) == 'OFF':
        raise UsageError(
            f'{DISCOVERY_RANGE}=OFF: nodes in processes of their own do not find each other; '
            f'unset it, or set it to {LOCALHOST}'
        )


def require_free_domain() -> None:
    """Check that a simulator started by hand is the only one.

    Raises:
        UsageError: another graph is on the domain of this process.
    """
    domain = domain_number(os.environ.get('ROS_DOMAIN_ID') or '0', 'ROS_DOMAIN_ID')
    if os.environ.get(_RESERVED) != str(domain):
        refuse_neighbours(domain)


@contextlib.contextmanager
def _free() -> Iterator[tuple[int, bool]]:
    """Choose and reserve a domain, then check that it is free."""
    for _ in range(_CHOICE):
        with contextlib.ExitStack() as stack:
            domain, reserved = stack.enter_context(_reserved(next(_domains)))
            if reserved and not in_use(domain):
                yield domain, True
                return
    raise UsageError('all ROS domains from 1 to 100 are in use; end a graph')


@contextlib.contextmanager
def _reserved(domain: int) -> Iterator[tuple[int, bool]]:
    """Reserve a domain; yields whether it succeeded."""
    # Entered and left explicitly: the library's context manager swallows an OSError of its body.
    reservation = domain_id(lambda: domain)
    try:
        reservation.__enter__()
    except RuntimeError:
        yield domain, False
        return
    try:
        yield domain, True
    finally:
        reservation.__exit__(None, None, None)


@contextlib.contextmanager
def _localhost() -> Iterator[None]:
    """Limit discovery to this machine, unless the user has set a range."""
    with _set(DISCOVERY_RANGE, os.environ.get(DISCOVERY_RANGE) or LOCALHOST):
        yield


@contextlib.contextmanager
def _set(name: str, value: str) -> Iterator[None]:
    """Context in which an environment variable is set."""
    before = os.environ.get(name)
    os.environ[name] = value
    try:
        yield
    finally:
        if before is None:
            del os.environ[name]
        else:
            os.environ[name] = before

"""Who is on a graph's ROS domain: a domain of its own, no other graph, each publisher once.

A graph gets a domain that no program of this machine uses, limited to this machine; one set by hand
is refused if another graph is on it. Before the first step of a run each topic must have exactly
the publishers of the table, matched with every node that needs their messages, and again before its
verdict: rclpy does not report who sent a message. A publisher that comes and leaves in between is
noticed by the subscriptions of its topic.
"""

from __future__ import annotations

import contextlib
import itertools
import os
import socket
import time
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Sequence
from typing import Any

import rclpy
from domain_coordinator import domain_id
from domain_coordinator.impl import PORT_BASE
from rclpy.context import Context
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSCompatibility, QoSProfile, qos_check_compatible
from rclpy.subscription import Subscription

from taxinet_ros.errors import InfraKind, UsageError
from taxinet_ros.nodes import interface
from taxinet_ros.nodes.interface import PERCEPTION, RECORDER, SIMULATOR, Topic
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
NAMELESS = '_NODE_NAME_UNKNOWN_'
"""Node name that rmw returns for an endpoint whose name is not known yet."""
_NAME_WAIT_S, _NAME_PERIOD_S = 0.5, 0.02
_CHOICE = 100
"""Number of domains to choose from: Linux assigns the ports of higher ones dynamically."""
# Each graph starts its search after the previous one's domain, to avoid remains of its predecessor,
# and each process, forked ones too, elsewhere.
_graphs = itertools.count()
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
            f'one worker, or unset {BY_HAND}'
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
                if end.node_name != NAMELESS
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
            number = 1 + (os.getpid() + next(_graphs)) % _CHOICE
            domain, reserved = stack.enter_context(_reserved(number))
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


# Publishers and subscriptions ------------------------------------------------------------------

End = tuple[int, ...]
"""Unique identifier (GID) of a publisher or subscription, never reused."""
# A perception or a recorder chooses its inputs at start-up, and hears a second camera only in runs
# that have one.
_CHOSEN = {
    interface.IMAGE.name: {PERCEPTION, RECORDER}, interface.TRUTH.name: {PERCEPTION},
    interface.CAMERA2.name: {RECORDER},
}


class Endpoints:
    """The publishers and subscriptions of one lockstep node on topics of the table.

    Attributes:
        speakers: its publishers by topic name.
        listeners: its subscriptions by topic name.
    """

    def __init__(self, node: Node, on_second: Callable[[Topic], None]) -> None:
        """``on_second`` is called with a topic on which a second publisher was matched."""
        self._node, self._on_second = node, on_second
        self.speakers: dict[str, Publisher] = {}
        self.listeners: dict[str, Subscription] = {}

    def speak(self, topic: Topic) -> Publisher:
        """Publish on a topic."""
        publisher = self._node.create_publisher(topic.type, topic.name, topic.end_qos)
        self.speakers[topic.name] = publisher
        return publisher

    def listen(
        self, topic: Topic, callback: Callable[[Any], None], *, raw: bool,
        qos: QoSProfile | None = None,
    ) -> None:
        """Subscribe to a topic, by default with its own quality of service."""
        self.listeners[topic.name] = self._node.create_subscription(
            topic.type, topic.name, callback, qos or topic.end_qos, raw=raw,
            event_callbacks=self._second_publisher_events(topic),
        )

    def unlisten(self, topic: Topic) -> None:
        """Hear a topic no more."""
        self._node.destroy_subscription(self.listeners.pop(topic.name))

    def unmatched(
        self, participants: Sequence[str], needed: Callable[[Topic], Collection[str]]
    ) -> Iterator[str]:
        """Yield topics on which this node has not found all others of a run, or one too many.

        Counting is not enough: an earlier ``ros2 topic echo`` would be counted as a node of the
        run, and that node would miss the run's first messages.

        Args:
            participants: nodes of the run.
            needed: names of the nodes that must hear a topic.
        """
        for topic in interface.TOPICS:
            speaker, listener = self.speakers.get(topic.name), self.listeners.get(topic.name)
            if (speaker and not heard_by(self._node, speaker, needed(topic))) or (
                listener and not hears(self._node, listener, topic, participants)
            ):
                yield topic.name

    def _second_publisher_events(self, topic: Topic) -> SubscriptionEventCallbacks:
        present = 0

        def matched(now: Any) -> None:
            nonlocal present
            before, present = present, now.current_count
            # A publisher that was lost on a busy machine comes back where there is none.
            if before and now.total_count_change:
                self._on_second(topic)

        # Of several publishers, another one is no news.
        return SubscriptionEventCallbacks(matched=matched if len(topic.publishers) == 1 else None)


def heard_by(node: Node, publisher: Publisher, names: Collection[str]) -> bool:
    """Whether a publisher is matched with all of the given nodes."""
    matched = publisher.get_subscription_count()
    if matched < len(names):  # Much cheaper than the check below, and called often.
        return False
    ends = node.get_subscriptions_info_by_topic(publisher.topic_name)
    fitting = sum(fits(publisher.qos_profile, end.qos_profile) for end in ends)
    return set(names) <= {end.node_name for end in ends} and matched >= fitting


def hears(
    node: Node, subscription: Subscription, topic: Topic, participants: Sequence[str]
) -> bool:
    """Whether a subscription is matched with each publisher of a run, and there is no other."""
    matched = subscription.get_publisher_count()
    if matched < len(_wanted(topic, participants)):  # as above
        return False
    if not has_its_publishers(node, topic, participants):
        return False
    ends = node.get_publishers_info_by_topic(topic.name)
    return bool(matched >= sum(fits(end.qos_profile, subscription.qos_profile) for end in ends))


def has_its_publishers(node: Node, topic: Topic, participants: Sequence[str]) -> bool:
    """Whether each publisher of a run is there exactly once, and no other.

    The endpoint of a killed node remains until DDS drops it after about 20 s; until then it cannot
    be distinguished from a live one.
    """
    names = [end.node_name for end in node.get_publishers_info_by_topic(topic.name)]
    wanted = _wanted(topic, participants)
    return not _extra(names, topic, wanted) and all(names.count(name) == 1 for name in wanted)


def intruder(
    node: Node, participants: Sequence[str], topics: Sequence[Topic] = interface.TOPICS
) -> tuple[str, str] | None:
    """A publisher too many on topics of a run: its node, and a line on it."""
    for topic in topics:
        wanted = _wanted(topic, participants)
        names = publisher_names(node, topic)
        if others := _extra(names, topic, wanted):
            words = f'publishes {topic.name}, which is for {" and ".join(sorted(wanted))}'
            return min(others), words
        counts = Counter(name for name in names if name in wanted)
        for name in sorted(name for name, count in counts.items() if count > 1):
            return name, f'a second node of this name publishes {topic.name}'
    return None


def brief_intruder(node: Node, topic: Topic, participants: Sequence[str]) -> tuple[str, str]:
    """As :func:`intruder`, of a topic on which a second publisher was just matched."""
    left = f'a second publisher of {topic.name} came and left'
    return intruder(node, participants, [topic]) or (min(_wanted(topic, participants)), left)


def publisher_names(node: Node, topic: Topic) -> list[str]:
    """Node of each publisher of a topic; a name may become known only shortly after its end."""
    deadline = time.monotonic() + _NAME_WAIT_S
    while True:
        names = [str(end.node_name) for end in node.get_publishers_info_by_topic(topic.name)]
        if NAMELESS not in names or time.monotonic() > deadline:
            return names
        time.sleep(_NAME_PERIOD_S)  # The middleware's threads discover the name meanwhile.


def simulators(node: Node) -> dict[End, str]:
    """Names of the nodes that give out scenarios, one for each publisher."""
    ends = node.get_publishers_info_by_topic(interface.SCENARIO.name)
    return {tuple(end.endpoint_gid): str(end.node_name) for end in ends}


def nodes_present(node: Node) -> list[str]:
    """Names of all nodes in the namespace of a node, itself included; a second one counts twice."""
    nodes = node.get_node_names_and_namespaces()
    return [name for name, namespace in nodes if namespace == node.get_namespace()]


def fits(offered: Any, asked: Any) -> bool:
    """Whether these QoS profiles of a publisher and a subscription are compatible."""
    return bool(qos_check_compatible(offered, asked)[0] != QoSCompatibility.ERROR)


def missing_nodes(node: Node, names: Sequence[str]) -> dict[str, str]:
    """Nodes that are missing or incomplete, each with the reason."""
    why: dict[str, str] = {}
    for topic in interface.TOPICS:
        speakers, listeners = _ends(node, topic)
        expected = (
            ('publish', speakers, topic.speakers(names)),
            ('subscribe to', listeners, topic.listeners(names) - _CHOSEN.get(topic.name, set())),
        )
        for verb, ends, wanted in expected:
            for name in wanted & set(names) - {end.node_name for end in ends}:
                why.setdefault(name, f'does not {verb} {topic.name}')
        for name in _misfits(speakers, listeners, set(names)):
            why.setdefault(name, f'incompatible quality of service on {topic.name}')
    return why


def why_silent(node: Node, name: str, participants: Sequence[str]) -> str:
    """Reason why a node of a run is silent, or '': a missing topic or incompatible endpoint."""
    if why := missing_nodes(node, participants).get(name):
        return why
    inputs = [topic for topic in interface.TOPICS if name in _CHOSEN.get(topic.name, ())]
    heard = any(name == end.node_name for topic in inputs for end in _ends(node, topic)[1])
    if heard or name != PERCEPTION:
        return ''
    return f'does not subscribe to {" or ".join(topic.name for topic in inputs)}'


def why_not_ready(
    node: Node, participants: Sequence[str], silent: Sequence[str], unmatched: Sequence[str]
) -> tuple[str, str, str]:
    """Kind, names and reason of what keeps a run from starting; of nodes, those others wait for.

    Args:
        node: the simulator.
        participants: nodes of the run.
        silent: those that have not said that they are ready.
        unmatched: topics on which the simulator has not found all of them.
    """
    if (found := intruder(node, participants)) is not None:
        return InfraKind.INTRUDER, *found
    if absent := missing_nodes(node, participants):
        names = sorted(absent)
        return InfraKind.NOT_READY, ', '.join(names), absent[names[0]]
    if silent:
        why = why_silent(node, silent[0], participants) or 'does not say that it is ready'
        return InfraKind.NOT_READY, ', '.join(silent), why
    return InfraKind.NOT_READY, SIMULATOR, f'not all ends are found on {", ".join(unmatched)}'


def _ends(node: Node, topic: Topic) -> tuple[list[Any], list[Any]]:
    return (
        node.get_publishers_info_by_topic(topic.name),
        node.get_subscriptions_info_by_topic(topic.name),
    )


def _misfits(speakers: list[Any], listeners: list[Any], names: set[str]) -> Iterator[str]:
    """Nodes with a subscription incompatible with a publisher of the graph."""
    for speaker in speakers:
        for listener in listeners:
            ours = {speaker.node_name, listener.node_name} <= names
            if ours and not fits(speaker.qos_profile, listener.qos_profile):
                yield str(listener.node_name)


def _wanted(topic: Topic, participants: Sequence[str]) -> set[str]:
    """Nodes of a run that publish on a topic, with one publisher each.

    If none of them takes part, the node acting as simulator replaces them, as in a replay.
    """
    return topic.speakers(participants) or {SIMULATOR}


def _extra(names: Collection[str], topic: Topic, wanted: set[str]) -> set[str]:
    """Foreign nodes; those of the graph that take no part in the run publish nothing in it."""
    return set(names) - wanted - set(topic.publishers)

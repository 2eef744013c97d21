"""Publishers and subscribers of a graph's topics: matched, missing and foreign ones.

A publisher must be matched with every node that needs its messages. Counting is not enough: an
earlier ``ros2 topic echo`` would be counted as a node of the run, and that node would miss the
run's first messages.

The publishers of a run's topics are pinned at READY; no others are allowed after that. DDS reports
each matched publisher to a subscription before its first message arrives, and counts them, so a
publisher that joins, publishes once and leaves is noticed too. rclpy does not report who sent a
message; so a run into which another node has published, or could have, has no verdict.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSCompatibility, QoSProfile, qos_check_compatible

from taxinet_ros.errors import InfraError, InfraKind
from taxinet_ros.nodes import interface
from taxinet_ros.nodes.interface import SIMULATOR, Topic
from taxinet_ros.nodes.running.remaps import elsewhere


def heard_by(node: Node, publisher: Publisher, names: Collection[str]) -> bool:
    """Whether a publisher is matched with all of the given nodes.

    Args:
        node: node of the publisher.
        publisher: the publisher.
        names: names of the nodes that must be matched.
    """
    matched = publisher.get_subscription_count()
    if matched < len(names):  # Much cheaper than the check below, and called often.
        return False
    ends = node.get_subscriptions_info_by_topic(publisher.topic_name)
    fitting = sum(fits(publisher.qos_profile, end.qos_profile) for end in ends)
    return set(names) <= {end.node_name for end in ends} and matched >= fitting


def fits(offered: Any, asked: Any) -> bool:
    """Whether these QoS profiles of a publisher and a subscription are compatible."""
    return bool(qos_check_compatible(offered, asked)[0] != QoSCompatibility.ERROR)


End = tuple[int, ...]
"""Unique identifier (GID) of a publisher or subscription, never reused."""
# A perception or a recorder chooses its inputs at start-up.
_CHOSEN = {
    interface.IMAGE.name: {interface.PERCEPTION, interface.RECORDER},
    interface.TRUTH.name: {interface.PERCEPTION},
}


def missing_nodes(node: Node, names: Sequence[str], gone: Collection[End] = ()) -> dict[str, str]:
    """Nodes that are missing or incomplete, each with the reason as text.

    Args:
        node: the observing node.
        names: names of the nodes of the graph.
        gone: endpoints known to belong to dead processes.
    """
    why: dict[str, str] = {}
    for topic in interface.TOPICS:
        speakers, listeners = (
            [end for end in ends if tuple(end.endpoint_gid) not in gone]
            for ends in _ends(node, topic)
        )
        expected = (
            ('publish', speakers, topic.speakers(names)),
            ('subscribe to', listeners, topic.listeners(names) - _CHOSEN.get(topic.name, set())),
        )
        for verb, ends, wanted in expected:
            for name in wanted & set(names) - {end.node_name for end in ends} - why.keys():
                others = elsewhere(node, topic, {name}, publish=ends is speakers)
                but = f' but {"to " if ends is listeners else ""}{others[0][1]}' if others else ''
                why[name] = f'does not {verb} {topic.name}{but}'
        for name in _misfits(speakers, listeners, set(names)):
            why.setdefault(name, f'incompatible quality of service on {topic.name}')
    return why


def why_silent(node: Node, name: str, names: Sequence[str]) -> str:
    """Reason why a node of a graph is silent, or '': a missing topic or incompatible endpoint.

    Args:
        node: the observing node.
        name: name of the silent node.
        names: names of the nodes of the graph.
    """
    if why := missing_nodes(node, names).get(name):
        return why
    inputs = [topic for topic in interface.TOPICS if name in _CHOSEN.get(topic.name, ())]
    if any(name == end.node_name for topic in inputs for end in _ends(node, topic)[1]):
        return ''
    others = [end for topic in inputs for end in elsewhere(node, topic, {name}, publish=False)]
    if not others and name != interface.PERCEPTION:
        return ''
    but = f' but to {others[0][1]}' if others else ''
    return f'does not subscribe to {" or ".join(topic.name for topic in inputs)}{but}'


def ends_of(node: Node, name: str) -> set[End]:
    """All known endpoints of a node of a graph."""
    return {
        tuple(end.endpoint_gid)
        for topic in interface.TOPICS for ends in _ends(node, topic) for end in ends
        if end.node_name == name
    }


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


UNKNOWN = 'unknown'
"""Name of a node that left before its name was known."""
NAMELESS = '_NODE_NAME_UNKNOWN_'
"""Node name that rmw returns for an endpoint whose name is not known yet."""
_MATCHED = rclpy_implementation.rcl_subscription_event_type_t.RCL_SUBSCRIPTION_MATCHED
_NAME_WAIT_S, _NAME_PERIOD_S = 0.5, 0.02
Gid = tuple[int, ...]


@dataclass(frozen=True, kw_only=True)
class Stranger:
    """A foreign publisher on a topic of a run.

    Attributes:
        name: name of the node; :data:`UNKNOWN` if it left before its name was known.
        topic: topic it publishes on.
        speakers: names of the nodes allowed to publish there.
    """

    name: str
    topic: Topic
    speakers: tuple[str, ...]

    @property
    def detail(self) -> str:
        """Description in one line."""
        if self.name == UNKNOWN:
            return f'somebody who is gone again published on {self.topic.name}'
        if self.name in self.speakers:
            return f'a second node of this name publishes {self.topic.name}'
        return f'publishes {self.topic.name}, which is for {" and ".join(self.speakers)}'

    def error(self, step: int) -> InfraError:
        """Error of a run at a control step."""
        return InfraError(InfraKind.INTRUDER, self.name, step, self.detail)


class Speakers:
    """Publishers of one topic known to a node, and those that belong to a run."""

    def __init__(self, node: Node, topic: Topic, name: str = '') -> None:
        """No publisher is pinned before :meth:`pin`.

        Args:
            node: the observing node.
            topic: the topic.
            name: full name in this graph with namespace and remapping, if known.
        """
        self.topic = topic
        self._node, self._name = node, name or topic.name
        self._pinned = False
        self._known: set[Gid] = set()
        self._named: tuple[str, ...] = ()
        self._besides: set[str] = set()

    def wanted(self, participants: Collection[str]) -> set[str]:
        """Publishing nodes required, one endpoint each, before a run of these participants starts.

        If none of them takes part, the node acting as simulator replaces them, as in a replay.
        """
        return self.topic.speakers(tuple(participants)) or {SIMULATOR}

    def settled(self, participants: Collection[str]) -> bool:
        """Whether each publisher of a run is present exactly once, and no other.

        The endpoint of a killed node remains until DDS drops it after about 20 s; until then it
        cannot be distinguished from a live one.
        """
        names = [end.node_name for end in self._ends()]
        wanted = self.wanted(participants)
        others = [name for name in names if name not in wanted]
        return (
            all(names.count(name) == 1 for name in wanted)
            and set(others) <= self._tolerated(wanted)
            and len(others) == len(set(others))
        )

    def absent(self, participants: Collection[str]) -> set[str]:
        """Publishers of a run that are missing."""
        return self.wanted(participants) - {end.node_name for end in self._ends()}

    def pin(self, participants: Collection[str]) -> None:
        """Pin the current publishers to the run; later ones are foreign."""
        wanted = self.wanted(participants)
        self._named, self._besides = tuple(sorted(wanted)), self._tolerated(wanted)
        self._known = {_gid(end) for end in self._ends()}
        self._pinned = True

    def release(self) -> None:
        """Unpin after the run."""
        self._pinned = False

    def early_stranger(self, participants: Collection[str]) -> Stranger | None:
        """A foreign publisher present before the run has started."""
        wanted = self.wanted(participants)
        tolerated = self._tolerated(wanted)
        seen: set[str] = set()
        for end in self._named_ends(set()):
            name = end.node_name
            if name == NAMELESS:
                continue  # It may belong to the run; its name will be known shortly.
            if name in seen or name not in wanted | tolerated:
                return Stranger(name=name, topic=self.topic, speakers=tuple(sorted(wanted)))
            seen.add(name)
        return None

    def stranger(self) -> Stranger | None:
        """A foreign publisher that joined during the run, as far as the graph knows."""
        return self._newcomer() if self._pinned else None

    def may_have_changed(self) -> bool:
        """Quick check for a possible foreign publisher, a few microseconds."""
        return self._pinned and self._node.count_publishers(self._name) != len(self._known)

    def _newcomer(self) -> Stranger | None:
        """A publisher that joined since the run started; harmless ones are accepted."""
        new = self._named_ends(self._known)
        for end in new:
            if end.node_name not in self._besides:
                return self._named_stranger(end.node_name)
        self._known |= {_gid(end) for end in new}
        return None

    def _named_stranger(self, name: str) -> Stranger:
        return Stranger(name=_word(name), topic=self.topic, speakers=self._named)

    def _named_ends(self, known: set[Gid]) -> list[Any]:
        """Endpoints other than the known ones, with names if they become known shortly."""
        deadline = time.monotonic() + _NAME_WAIT_S
        while True:
            new = [end for end in self._ends() if _gid(end) not in known]
            nameless = any(end.node_name == NAMELESS for end in new)
            if not nameless or time.monotonic() > deadline:
                return new
            # The middleware's threads discover the name meanwhile.
            time.sleep(_NAME_PERIOD_S)

    def _tolerated(self, wanted: Collection[str]) -> set[str]:
        """Nodes of the graph that take no part in the run and publish nothing in it."""
        return set(self.topic.publishers) - set(wanted)

    def _ends(self) -> list[Any]:
        return list(self._node.get_publishers_info_by_topic(self._name))


class HeardSpeakers(Speakers):
    """Publishers of a subscribed topic; those that join and leave are counted too."""

    def __init__(
        self, node: Node, topic: Topic, callback: Callable[[Any], None], *, raw: bool,
        on_match: Callable[[], object], qos: QoSProfile | None = None,
    ) -> None:
        """Subscribe.

        Args:
            node: the subscribing node.
            topic: the topic.
            callback: called with messages, or their bytes if ``raw``.
            raw: whether to pass raw bytes.
            on_match: called after a publisher was matched or lost.
            qos: QoS of the subscription, if not the topic's.
        """
        def matched(_: object) -> None:
            on_match()

        self.subscription = node.create_subscription(
            topic.type, topic.name, callback, qos or topic.end_qos, raw=raw,
            event_callbacks=SubscriptionEventCallbacks(matched=matched),
        )
        super().__init__(node, topic, self.subscription.topic_name)
        # A separate count: the event's is read only when the executor gets to it.
        self._matched = rclpy_implementation.EventHandle(self.subscription.handle, _MATCHED)
        self._ever = 0

    def close(self) -> None:
        """Release the subscription; called before its node is destroyed."""
        self._matched.destroy_when_not_in_use()

    def settled(self, participants: Collection[str]) -> bool:
        """See :class:`Speakers`; also requires that all of them are matched."""
        # Much cheaper than the check below, and called often.
        matched = self.subscription.get_publisher_count()
        if matched < len(self.wanted(participants)) or not super().settled(participants):
            return False
        return bool(matched >= sum(
            fits(end.qos_profile, self.subscription.qos_profile) for end in self._ends()
        ))

    def pin(self, participants: Collection[str]) -> None:
        """See :class:`Speakers`."""
        self._ever = self._matched_ever()
        super().pin(participants)

    def stranger(self) -> Stranger | None:
        """See :class:`Speakers`; queries the middleware directly, ahead of pending callbacks."""
        ever = self._matched_ever()
        if not self._pinned or ever == self._ever:
            return super().stranger()
        known = len(self._known)
        found = self._newcomer()
        if found is None and ever - self._ever > len(self._known) - known:
            found = self._named_stranger(UNKNOWN)
        if found is None:
            self._ever = ever
        return found

    def may_have_changed(self) -> bool:
        """See :class:`Speakers`."""
        return self._pinned and self._matched_ever() != self._ever

    def _matched_ever(self) -> int:
        """Number of publishers ever matched with the subscription."""
        with self._matched:
            return int(self._matched.take_event().total_count)


def first_stranger(topics: Iterable[Speakers], thorough: bool = False) -> Stranger | None:
    """The first foreign publisher on any of the topics, named ones first.

    Args:
        topics: topics to check.
        thorough: check every endpoint, even without changes.
    """
    found = [
        stranger for topic in topics
        if (thorough or topic.may_have_changed()) and (stranger := topic.stranger()) is not None
    ]
    found.sort(key=lambda stranger: stranger.name == UNKNOWN)
    return found[0] if found else None


def _gid(end: Any) -> Gid:
    return tuple(end.endpoint_gid)


def _word(name: str) -> str:
    return UNKNOWN if name == NAMELESS else name

"""Publishers and subscribers of a graph's topics: who is matched, missing, or a stranger.

A publisher has to be matched with every node that must hear it. Counting is not enough: an
``ros2 topic echo`` that was there first would be counted as a node of the run, and the run's
first messages would pass that node by.

Who publishes on the topics of a run is known by the ends at its READY, and nobody else may
after that. DDS tells a subscription of each publisher that it is matched with before that
publisher's first message comes through, and counts them, so somebody who comes, publishes once
and leaves is noticed too. rclpy does not tell who sent a message; so a run into which somebody
else has published, or could have, has no verdict.
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
    """Whether whatever a publisher says now reaches all of some nodes.

    Args:
        node: that the publisher belongs to.
        publisher: the speaking end.
        names: of the nodes that must hear it.
    """
    matched = publisher.get_subscription_count()
    if matched < len(names):  # Far cheaper than what follows, and asked many times.
        return False
    ends = node.get_subscriptions_info_by_topic(publisher.topic_name)
    fitting = sum(fits(publisher.qos_profile, end.qos_profile) for end in ends)
    return set(names) <= {end.node_name for end in ends} and matched >= fitting


def fits(offered: Any, asked: Any) -> bool:
    """Whether quality of service lets a publisher and a subscription of these profiles connect."""
    return bool(qos_check_compatible(offered, asked)[0] != QoSCompatibility.ERROR)


End = tuple[int, ...]
"""The identifier of one publisher or subscription, which is never used again."""
# Which of its possible inputs a perception or a recorder takes, it decides when it starts.
_CHOSEN = {
    interface.IMAGE.name: {interface.PERCEPTION, interface.RECORDER},
    interface.TRUTH.name: {interface.PERCEPTION},
}


def missing_nodes(node: Node, names: Sequence[str], gone: Collection[End] = ()) -> dict[str, str]:
    """What keeps a graph from being whole: for each node that is not all there, why, in words.

    Args:
        node: who looks.
        names: of the nodes that belong to the graph.
        gone: ends that are known to belong to processes that died, and linger.
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
            why.setdefault(name, f'quality of service does not fit on {topic.name}')
    return why


def why_silent(node: Node, name: str, names: Sequence[str]) -> str:
    """What a node of a graph lacks that says nothing, or '': a topic, or an end that fits.

    Args:
        node: who looks.
        name: of the silent one.
        names: of the nodes that belong to the graph.
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
    """All ends that a node of a graph is known to have."""
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
    """Nodes of the graph that subscribe where another one of it cannot reach them."""
    for speaker in speakers:
        for listener in listeners:
            ours = {speaker.node_name, listener.node_name} <= names
            if ours and not fits(speaker.qos_profile, listener.qos_profile):
                yield str(listener.node_name)


UNKNOWN = 'unknown'
"""Who it was, where nobody knows: it was gone again before its name was told."""
NAMELESS = '_NODE_NAME_UNKNOWN_'
"""What rmw calls the node of an end that is known a moment before its name is."""
_MATCHED = rclpy_implementation.rcl_subscription_event_type_t.RCL_SUBSCRIPTION_MATCHED
_NAME_WAIT_S, _NAME_PERIOD_S = 0.5, 0.02
Gid = tuple[int, ...]


@dataclass(frozen=True, kw_only=True)
class Stranger:
    """Somebody who publishes on a topic of a run without a part in it.

    Attributes:
        name: of the node; :data:`UNKNOWN` where it was gone before its name was known.
        topic: what it publishes on.
        speakers: names of the nodes that may.
    """

    name: str
    topic: Topic
    speakers: tuple[str, ...]

    @property
    def detail(self) -> str:
        """One line for people."""
        if self.name == UNKNOWN:
            return f'somebody who is gone again published on {self.topic.name}'
        if self.name in self.speakers:
            return f'a second node of this name publishes {self.topic.name}'
        return f'publishes {self.topic.name}, which is for {" and ".join(self.speakers)}'

    def error(self, step: int) -> InfraError:
        """What it means for a run at a control step."""
        return InfraError(InfraKind.INTRUDER, self.name, step, self.detail)


class Speakers:
    """The publishers of one topic as a node knows them, and which of them belong to a run."""

    def __init__(self, node: Node, topic: Topic, name: str = '') -> None:
        """Nobody is known before :meth:`pin`.

        Args:
            node: who looks.
            topic: what is published.
            name: as it is in this graph, namespace and remapping included, where that is known.
        """
        self.topic = topic
        self._node, self._name = node, name or topic.name
        self._pinned = False
        self._known: set[Gid] = set()
        self._named: tuple[str, ...] = ()
        self._besides: set[str] = set()

    def wanted(self, participants: Collection[str]) -> set[str]:
        """Nodes that must be there, one end each, before a run with these participants begins.

        Where none of them takes part, whoever plays the simulator stands in, as in a replay.
        """
        return self.topic.speakers(tuple(participants)) or {SIMULATOR}

    def settled(self, participants: Collection[str]) -> bool:
        """Whether each speaker of a run is there once, and nobody else.

        What a node leaves behind that died without a goodbye is another end, until DDS forgets it
        after some 20 s: nobody can tell it from a living one.
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
        """Those of the speakers of a run that are not there."""
        return self.wanted(participants) - {end.node_name for end in self._ends()}

    def pin(self, participants: Collection[str]) -> None:
        """From now on whoever is there speaks for the run, and who comes is a stranger."""
        wanted = self.wanted(participants)
        self._named, self._besides = tuple(sorted(wanted)), self._tolerated(wanted)
        self._known = {_gid(end) for end in self._ends()}
        self._pinned = True

    def release(self) -> None:
        """The run is over: who comes is no stranger any more."""
        self._pinned = False

    def early_stranger(self, participants: Collection[str]) -> Stranger | None:
        """Who keeps the speakers of a run that has not begun from being alone."""
        wanted = self.wanted(participants)
        tolerated = self._tolerated(wanted)
        seen: set[str] = set()
        for end in self._ends():
            name = end.node_name
            if name == NAMELESS:
                continue  # It may be one of the run's; a moment later everybody knows.
            if name in seen or name not in wanted | tolerated:
                return Stranger(name=name, topic=self.topic, speakers=tuple(sorted(wanted)))
            seen.add(name)
        return None

    def stranger(self) -> Stranger | None:
        """Who has come to a run that goes on, as far as the graph knows now."""
        return self._newcomer() if self._pinned else None

    def may_have_changed(self) -> bool:
        """Whether there may be somebody: a look that costs a few microseconds."""
        return self._pinned and self._node.count_publishers(self._name) != len(self._known)

    def _newcomer(self) -> Stranger | None:
        """Who is there and was not when the run began; takes in who does no harm."""
        new = self._new_ends()
        for end in new:
            if end.node_name not in self._besides:
                return self._named_stranger(end.node_name)
        self._known |= {_gid(end) for end in new}
        return None

    def _named_stranger(self, name: str) -> Stranger:
        return Stranger(name=_word(name), topic=self.topic, speakers=self._named)

    def _new_ends(self) -> list[Any]:
        """Ends that were not there at the beginning, with names if these come within a moment."""
        deadline = time.monotonic() + _NAME_WAIT_S
        while True:
            new = [end for end in self._ends() if _gid(end) not in self._known]
            nameless = any(end.node_name == NAMELESS for end in new)
            if not nameless or time.monotonic() > deadline:
                return new
            # The middleware's own threads learn the name meanwhile.
            time.sleep(_NAME_PERIOD_S)

    def _tolerated(self, wanted: Collection[str]) -> set[str]:
        """Nodes of the graph that take no part in the run, and say nothing in it."""
        return set(self.topic.publishers) - set(wanted)

    def _ends(self) -> list[Any]:
        return list(self._node.get_publishers_info_by_topic(self._name))


class HeardSpeakers(Speakers):
    """Those of a topic that the node subscribes to: even who comes and goes is counted."""

    def __init__(
        self, node: Node, topic: Topic, callback: Callable[[Any], None], *, raw: bool,
        on_match: Callable[[], object], qos: QoSProfile | None = None,
    ) -> None:
        """Subscribe.

        Args:
            node: who hears.
            topic: what.
            callback: takes the messages; where ``raw``, their bytes.
            raw: see above.
            on_match: called after a publisher was found or lost.
            qos: of the subscription, where it is not the topic's.
        """
        def matched(_: object) -> None:
            on_match()

        self.subscription = node.create_subscription(
            topic.type, topic.name, callback, qos or topic.end_qos, raw=raw,
            event_callbacks=SubscriptionEventCallbacks(matched=matched),
        )
        super().__init__(node, topic, self.subscription.topic_name)
        # One of its own: that of the event callback is read when the executor comes to it.
        self._matched = rclpy_implementation.EventHandle(self.subscription.handle, _MATCHED)
        self._ever = 0

    def close(self) -> None:
        """Let go of the subscription; called before its node is destroyed."""
        self._matched.destroy_when_not_in_use()

    def settled(self, participants: Collection[str]) -> bool:
        """See :class:`Speakers`; and whatever they say is heard."""
        # Far cheaper than what follows, and asked many times.
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
        """See :class:`Speakers`; asks the middleware itself, whatever callbacks are yet to come."""
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
        """How many publishers have been matched since the subscription was made."""
        with self._matched:
            return int(self._matched.take_event().total_count)


def first_stranger(topics: Iterable[Speakers], thorough: bool = False) -> Stranger | None:
    """The first that one of some topics has; one with a name before one without.

    Args:
        topics: where to look.
        thorough: look at every end, also where nothing stirs.
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

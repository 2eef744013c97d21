"""Play a bag back: what to publish when, in the order of time; the node is ``bag_player``."""

from __future__ import annotations

import heapq
from collections.abc import Callable, Collection, Iterator, Mapping
from itertools import groupby
from pathlib import Path
from typing import NamedTuple

from taxinet_ros.bag.cdr.decode import decoder
from taxinet_ros.bag.errors import BagCorrupt, BagError
from taxinet_ros.bag.reader import BagInfo, read_info, stored_messages
from taxinet_ros.bag.run.topics import IMAGE, SCENARIO, is_topic
from taxinet_ros.bag.storage.reader import StoredMessage
from taxinet_ros.bag.topics import TopicInfo, describe_topic, qos_profiles
from taxinet_ros.core import topics
from taxinet_ros.core.types import NS_PER_S
from taxinet_ros.errors import UsageError


def open_bag(path: str) -> BagInfo:
    """Open a bag for playback and return its table of contents.

    Raises:
        UsageError: the bag does not exist, is damaged or empty.
    """
    if not path:
        raise UsageError('bag_player: parameter bag is required: -p bag:=FOLDER or FILE.mcap')
    try:
        info = read_info(Path(path))
    except BagError as error:
        raise UsageError(' '.join(str(error).split())) from error
    if not info.complete:
        hint = f'save the intact part: taxinet bag recover {path} --out NEW'
        raise UsageError(f'{info.trouble}; {hint}')
    scenes = [count for name, count in info.counts.items() if is_topic(name, SCENARIO)]
    if info.back_ns > NS_PER_S and max(scenes, default=0) > 1:
        raise UsageError(
            f'{path}: time jumps back by {info.back_ns / NS_PER_S:g} s, so it holds several runs; '
            f'split it with: taxinet bag split {path} --out DIR'
        )
    if not any(info.counts.values()):
        raise UsageError(f'{path}: no messages to play')
    return info


class Window(NamedTuple):
    """Time window of a recording, both ends included [ns on the bag's clock]."""

    start_ns: int
    end_ns: int


def window(info: BagInfo, start_offset_s: float, duration_s: float) -> Window:
    """The window from ``start_offset_s`` on; a duration of 0 s means to the end.

    Raises:
        UsageError: it starts after the end of the recording.
    """
    start_ns = info.start_ns + round(start_offset_s * NS_PER_S)
    if start_ns > info.end_ns:
        raise UsageError(
            f'bag_player: start_offset is {start_offset_s:g} s; {info.path} is '
            f'{info.duration_s:g} s long'
        )
    end_ns = start_ns + round(duration_s * NS_PER_S) if duration_s else info.end_ns
    return Window(start_ns, end_ns)


def known_topics(info: BagInfo, names: Collection[str], parameter: str) -> frozenset[str]:
    """Full names of the topics listed in a parameter, with or without leading slash.

    Args:
        info: table of contents of the bag.
        names: value of the parameter.
        parameter: its name.

    Raises:
        UsageError: the bag has no such topic.
    """
    recorded = {topic.name for topic in info.topics}
    wanted = frozenset('/' + name.lstrip('/') for name in names if name)
    for name in sorted(wanted - recorded):
        frames = name == f'/{IMAGE}'
        known = 'add the frames with taxinet bag render' if frames else (
            f'it has {", ".join(sorted(recorded))}'
        )
        raise UsageError(f'bag_player: {parameter}: {info.path} has no topic {name}; {known}')
    return wanted


_MOST_HELD = 1000
"""Maximum history depth taken from a bag, since it costs memory of the player."""
_POLICIES = {
    'history': ('keep_last', 'keep_all'), 'reliability': ('reliable', 'best_effort'),
    'durability': ('transient_local', 'volatile'),
}


def recorded_quality(topic: TopicInfo) -> topics.Quality:
    """Quality of service of the first recorded publisher; by default reliable and volatile.

    A policy is a name (rosbag2's metadata from version 9 on) or a number from 1 (before).
    """
    try:
        recorded = next(iter(qos_profiles(topic.qos)), {})
    except ValueError:
        recorded = {}
    depth = recorded.get('depth')
    return topics.Quality(
        depth=min(max(depth, 1), _MOST_HELD) if isinstance(depth, int) else 10,
        **{
            name: word for name, words in _POLICIES.items()
            for number, word in enumerate(words, 1) if recorded.get(name) in (word, number)
        },
    )


Check = Callable[[bytes], None]


def message_check(topic: TopicInfo) -> Check | None:
    """A check of recorded bytes of a topic; None if its type is not installed.

    The check raises :class:`BagError` for bytes that are not such a message.

    Raises:
        UsageError: the installed message definition differs from the recorded one.
    """
    try:
        installed = describe_topic(name=topic.name, type_name=topic.type, qos=topic.qos)
    except UsageError:
        return None
    if topic.type_hash not in ('', installed.type_hash):
        raise UsageError(
            f'{topic.name}: {topic.type} has another version than the installed one; leave it '
            f'out: exclude:=["{topic.name}"]'
        )
    # An empty message, such as std_msgs/msg/Empty, has no definition to check.
    decode = decoder(installed) if installed.definition.strip() else bytes

    def check(cdr: bytes) -> None:
        try:
            decode(cdr)
        except BagCorrupt as error:
            if 'size mismatch' not in str(error):  # rclpy's serialize_message leaves room behind
                raise

    return check


class Portion(NamedTuple):
    """Messages recorded at the same time.

    Attributes:
        stamp_ns: time [ns] on the bag's clock.
        messages: in the order of the bag.
    """

    stamp_ns: int
    messages: tuple[StoredMessage, ...]


def portions(
    path: Path, names: Collection[str], part: Window, latched: Collection[str], back_ns: int = 0,
) -> Iterator[Portion]:
    """Yield the messages to play, in the order of time, and at equal times in that of the bag.

    Args:
        path: the bag.
        names: names of the topics to play.
        part: time window.
        latched: topics whose messages from before the window form its first portion.
        back_ns: that of the bag's :class:`BagInfo`.
    """
    messages = _by_time(stored_messages(path, frozenset(names).__contains__), back_ns)
    wanted = (
        message for message in messages
        if message.stamp_ns <= part.end_ns
        and (message.stamp_ns >= part.start_ns or message.topic.name in latched)
    )
    for stamp_ns, group in groupby(wanted, lambda one: max(one.stamp_ns, part.start_ns)):
        yield Portion(stamp_ns=stamp_ns, messages=tuple(group))


def _by_time(messages: Iterator[StoredMessage], back_ns: int) -> Iterator[StoredMessage]:
    held: list[tuple[int, int, StoredMessage]] = []
    newest = 0
    for number, message in enumerate(messages):
        heapq.heappush(held, (message.stamp_ns, number, message))
        newest = max(newest, message.stamp_ns)
        while held[0][0] < newest - back_ns:
            yield heapq.heappop(held)[-1]
    while held:
        yield heapq.heappop(held)[-1]


class Playback:
    """A bag that is played back at a rate of the wall clock, with pauses.

    Attributes:
        part: the time window.
        rate: recorded per wall-clock seconds.
        late_s: by how much a portion was late at most [s].
    """

    def __init__(
        self, info: BagInfo, part: Window, *, checks: Mapping[str, Check],
        latched: Collection[str], rate: float, clock: Callable[[], float],
        on_unfit: Callable[[str], None],
    ) -> None:
        """Start with the first portion that is asked for.

        Args:
            info: table of contents of the bag.
            part: time window.
            checks: check of each topic to play, by name.
            latched: see :func:`portions`.
            rate: recorded per wall-clock seconds.
            clock: steady wall clock [s].
            on_unfit: called once a topic with a line on messages that are none of its type.
        """
        self.late_s = 0.0
        self._info, self._checks, self._latched = info, checks, latched
        self._types = {topic.name: topic.type for topic in info.topics}
        self.rate, self._clock, self._on_unfit = rate, clock, on_unfit
        self._unfit: set[str] = set()
        self._paused_s: float | None = None
        self.part = part
        self.begin()

    def begin(self) -> None:
        """Go on with the start of the window."""
        self._portions = portions(
            self._info.path, self._checks.keys(), self.part, self._latched, self._info.back_ns
        )
        self._next = next(self._portions, None)
        self._origin_s: float | None = None

    @property
    def over(self) -> bool:
        """Whether everything has been played."""
        return self._next is None

    @property
    def paused(self) -> bool:
        """Whether time stands still."""
        return self._paused_s is not None

    def pause(self, paused: bool) -> None:
        """Stop time, or go on where it was stopped."""
        if paused and self._paused_s is None:
            self._paused_s = self._clock()
        elif not paused and self._paused_s is not None:
            self.delay(self._clock() - self._paused_s)
            self._paused_s = None

    def delay(self, seconds: float) -> None:
        """Have everything that follows due by so much later."""
        if self._origin_s is not None:
            self._origin_s += seconds

    def due(self) -> Portion | None:
        """The next portion if it is due, without messages that are none of their topic's type.

        Raises:
            BagError: the bag cannot be read.
        """
        if self._next is None or self._paused_s is not None:
            return None
        now_s = self._clock()
        if self._origin_s is None:
            self._origin_s = now_s
        offset_s = (self._next.stamp_ns - self.part.start_ns) / NS_PER_S
        late_s = now_s - self._origin_s - offset_s / self.rate
        if late_s < 0:
            return None
        self.late_s = max(self.late_s, late_s)
        portion, self._next = self._next, next(self._portions, None)
        return portion._replace(messages=tuple(filter(self._fits, portion.messages)))

    def _fits(self, message: StoredMessage) -> bool:
        name, kind = message.topic.name, self._types[message.topic.name]
        try:
            if message.topic.type == kind:
                self._checks[name](message.cdr)
                return True
            why = f'topic {name}: a {message.topic.type} among {kind}'
        except BagError as error:
            why = str(error)
        if name not in self._unfit:
            self._unfit.add(name)
            self._on_unfit(f'skipping messages: {why}')
        return False

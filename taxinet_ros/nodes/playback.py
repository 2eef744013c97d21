"""Which messages of a bag are played, and in which portions."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path

from taxinet_ros.bag.errors import BagError
from taxinet_ros.bag.reader import BagInfo, StoredMessage, read_info, stored_messages
from taxinet_ros.core.errors import UsageError
from taxinet_ros.core.types import NS_PER_S


@dataclass(frozen=True, kw_only=True)
class Portion:
    """Messages that were recorded at one time.

    Attributes:
        stamp_ns: when [ns], on the bag's clock.
        messages: in the order of the bag.
    """

    stamp_ns: int
    messages: tuple[StoredMessage, ...]


@dataclass(frozen=True, kw_only=True)
class Window:
    """A part of a recording, both ends included [ns on the bag's clock]."""

    start_ns: int
    end_ns: int


def open_bag(path: str) -> BagInfo:
    """Table of contents of a bag that can be played.

    Raises:
        UsageError: there is no such bag, it is damaged, or nothing is in it.
    """
    if not path:
        raise UsageError('bag_player: parameter bag: which one? -p bag:=FOLDER or FILE.mcap')
    try:
        info = read_info(Path(path))
    except BagError as error:
        raise UsageError(' '.join(str(error).split())) from error
    if not info.complete:
        hint = f'save what is sound: taxinet bag recover {path} --out NEW'
        raise UsageError(f'{info.trouble}; {hint}')
    if info.back_ns > NS_PER_S:
        raise UsageError(
            f'{path}: its time begins anew {info.back_ns / NS_PER_S:g} s earlier, so it holds '
            f'several runs; a bag of each makes: taxinet bag split {path} --out DIR'
        )
    if not any(info.counts.values()):
        raise UsageError(f'{path}: no messages to play')
    return info


def window(info: BagInfo, start_offset_s: float, duration_s: float) -> Window:
    """The part that begins ``start_offset_s`` into the recording; 0 s of duration: to its end.

    Raises:
        UsageError: it begins after the recording's end.
    """
    start_ns = info.start_ns + round(start_offset_s * NS_PER_S)
    if start_ns > info.end_ns:
        raise UsageError(
            f'bag_player: start_offset is {start_offset_s:g} s; {info.path} is '
            f'{info.duration_s:g} s long'
        )
    end_ns = start_ns + round(duration_s * NS_PER_S) if duration_s else info.end_ns
    return Window(start_ns=start_ns, end_ns=end_ns)


def known_topics(
    info: BagInfo, names: Collection[str], parameter: str, made: Collection[str] = ()
) -> frozenset[str]:
    """Full names of topics that a parameter names, with or without the leading slash.

    Args:
        info: of the bag.
        names: what the parameter says.
        parameter: its name.
        made: topics that the player makes of others.

    Raises:
        UsageError: the bag has no such topic.
    """
    recorded = {topic.name for topic in info.topics}
    wanted = frozenset('/' + name.lstrip('/') for name in names if name)
    for name in sorted(wanted - recorded - {*made}):
        frames = name == '/camera/image_raw'
        known = 'taxinet bag render puts the frames in' if frames else (
            f'it has {", ".join(sorted(recorded))}'
        )
        raise UsageError(f'bag_player: {parameter}: {info.path} has no topic {name}; {known}')
    return wanted


def portions(
    path: Path, topics: Collection[str], part: Window, latched: Collection[str]
) -> Iterator[Portion]:
    """What is to be played, in the order of the bag.

    Args:
        path: the bag.
        topics: names of the topics to play.
        part: when.
        latched: topics whose messages from before the part belong to it, as its first portion.
    """
    messages = stored_messages(path, frozenset(topics).__contains__)

    def moment(message: StoredMessage) -> int:
        return max(message.stamp_ns, part.start_ns)

    wanted = (
        message for message in messages
        if message.stamp_ns <= part.end_ns
        and (message.stamp_ns >= part.start_ns or message.topic.name in latched)
    )
    for stamp_ns, group in groupby(wanted, moment):
        yield Portion(stamp_ns=stamp_ns, messages=tuple(group))

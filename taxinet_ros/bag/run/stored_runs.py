"""The messages of a bag, separated by run, and data of the bag as a whole.

What they mean is for the readers of this folder, which take this, and for
:class:`.recording.Recording`, which offers what they read.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from functools import cached_property
from typing import NamedTuple

from taxinet_ros.bag.errors import BagCorrupt, BagEmpty, BagError, BagTruncated
from taxinet_ros.bag.layout import METADATA_FILE
from taxinet_ros.bag.reader import BagInfo, Contents, StoredMessage, stored_messages
from taxinet_ros.bag.run.runs import (
    RunPart,
    RunsWithin,
    messages_of_runs,
    tell_runs_apart,
    topic_parts,
)
from taxinet_ros.bag.run.topics import IMAGE, is_of_frames
from taxinet_ros.bag.topics import TopicInfo
from taxinet_ros.errors import UsageError

_HEAD_OF_A_PICTURE = 64
"""Its stamp is in the first bytes."""


class Within(NamedTuple):
    """Which run of a recording another one is."""

    whole: StoredRuns
    number: int
    part: RunPart


def kept_bytes(topic: str) -> int:
    """How many bytes of a message on a topic are kept: see :func:`.read_contents`."""
    relative = topic_parts(topic)[0]
    if relative == IMAGE:
        return _HEAD_OF_A_PICTURE
    return sys.maxsize if relative or is_of_frames(topic) else 0


class StoredRuns:
    """A bag's messages, and which run each is of.

    Attributes:
        path: as given.
        name: of one run out of several: its id, with its namespace where there are some, and with
            ``#2`` where it is the second of that id; else ''.
    """

    def __init__(self, contents: Contents, within: Within | None = None) -> None:
        """``within`` says which run of another bag's it is."""
        self.path = contents.path
        self.name = within.part.name if within is not None else ''
        self._contents = contents
        self._within = within

    # ---- the bag -----------------------------------------------------------------------------

    @cached_property
    def info(self) -> BagInfo:
        """The bag's table of contents: topics, counts, times [ns], metadata, attachments."""
        return self._contents.info if self._within is None else self._within.whole.info

    @property
    def topics(self) -> tuple[TopicInfo, ...]:
        """Its topics, in the order of the file."""
        return tuple(self._contents.topics.values())

    @property
    def metadata(self) -> Mapping[str, Mapping[str, str]]:
        """Metadata records by name; of several by one name, the last."""
        return self._contents.metadata if self._within is None else self._within.whole.metadata

    @property
    def complete(self) -> bool:
        """Whether the recording was finished and nothing is damaged."""
        return self.info.complete

    @property
    def finished(self) -> bool:
        """Whether the recorder closed the bag, or it is a file without its folder."""
        return self.path.is_file() or (self.path / METADATA_FILE).is_file()

    @property
    def checked(self) -> bool:
        """Whether it is one file, and every byte stands under a checksum that holds."""
        return self._contents.checked

    @property
    def damage(self) -> tuple[BagError, ...]:
        """What could not be read: damaged places, then messages that are not what they say."""
        return (*self.damaged_places, *self._apart.broken)

    @property
    def damaged_places(self) -> tuple[BagError, ...]:
        """Damaged places of the files."""
        return tuple(error for _, error in self._contents.damage)

    @property
    def broken(self) -> tuple[BagError, ...]:
        """Messages that are not what their topics say."""
        return self._apart.broken

    # ---- its runs ----------------------------------------------------------------------------

    @cached_property
    def _apart(self) -> RunsWithin:
        return tell_runs_apart(self._contents)

    @property
    def runs(self) -> tuple[RunPart, ...]:
        """What runs it holds, in the order in which they were first heard of."""
        return self._apart.runs

    @property
    def owners(self) -> Sequence[int]:
        """For each message on a topic of a run, the number of the run it belongs to, or -1."""
        return self._apart.owners

    @property
    def plain(self) -> bool:
        """Whether it is one run and nothing else, logged as our recorder does."""
        return self._apart.plain

    @cached_property
    def _messages_by_run(self) -> Sequence[list[StoredMessage]]:
        found: list[list[StoredMessage]] = [[] for _ in self.runs]
        for number, stored in self.messages_of_runs():
            found[number].append(stored)
        return found

    def choose(self, name: str | None) -> RunPart:
        """The run of that name, or the only one that was recorded.

        Raises:
            UsageError: there are several, or none of that name.
            BagEmpty: there is none at all.
        """
        present = [run for run in self.runs if not run.absent] or list(self.runs)
        if name is not None:
            chosen = [run for run in self.runs if name in (run.name, run.run_id)]
            if len(chosen) != 1:
                known = ', '.join(run.name for run in self.runs) or 'none'
                raise UsageError(f'--run {name}: no such run in {self.path}; it holds {known}')
            return chosen[0]
        if not present:
            raise self.without_run()
        if len(present) > 1:
            raise UsageError(
                f'{self.path}: holds {len(present)} runs: '
                f'{", ".join(run.words() for run in present)}; choose one with --run, or split it: '
                f'taxinet bag split {self.path} --out DIR'
            )
        return present[0]

    def without_run(self) -> BagEmpty:
        """What to raise where there is no run; damage may have taken it."""
        why = f': {self.damage[0]}' if self.damage else ''
        return BagEmpty(f'{self.path}: contains no run of taxinet_ros{why}', path=self.path)

    # ---- its messages ------------------------------------------------------------------------

    def messages(
        self, relative: Collection[str], *, strict: bool = False
    ) -> Iterator[tuple[str, StoredMessage]]:
        """Messages on some topics of a run, in the order of the recording; pictures cut short.

        Args:
            relative: names of the topics without a namespace, see :mod:`.topics`.
            strict: whether damage is an error, raised where it lies.

        Yields:
            The topic's relative name, and the message as stored.

        Raises:
            BagTruncated, BagCorrupt: it is damaged, and ``strict``; all before that was yielded.
        """
        damage = self._contents.damage[:1] if strict else []
        count = 0
        names = {
            topic.name: name for topic in self.topics
            if (name := topic_parts(topic.name)[0]) in relative
        }
        messages = self._contents.messages
        for stored in messages[:damage[0][0]] if damage else messages:
            name = stored.topic.name
            if name in names:
                yield names[name], stored
                count += 1
        for _, error in damage:
            text = str(error)
            if isinstance(error, BagTruncated | BagCorrupt):
                text = f'{text}; {count} intact messages before'
            raise type(error)(text, path=error.path, recovered=count, offset=error.offset)

    def messages_of_runs(
        self, wanted: Callable[[int, str], bool] = lambda run, topic: True, *,
        whole: bool = False,
    ) -> Iterator[tuple[int, StoredMessage]]:
        """Messages of all its runs, as our recorder would have them, each with its run's number.

        Args:
            wanted: whether a run, by its number, needs a topic, by its relative name.
            whole: whether pictures are not cut short, which takes a pass over the files.
        """
        messages = self.all_messages() if whole else self._contents.messages
        return messages_of_runs(messages, self._apart, wanted)

    def all_messages(self) -> Iterator[StoredMessage]:
        """Every sound message, whoever's, in the order of the recording; pictures take a pass.

        Of one run out of several: as our recorder would have them.
        """
        if self._within is not None:
            whole, number = self._within.whole, self._within.number
            mine = whole.messages_of_runs(lambda run, _: run == number, whole=True)
            return (stored for _, stored in mine)
        if all(kept_bytes(name) == sys.maxsize for name, n in self.info.counts.items() if n):
            return iter(self._contents.messages)
        return stored_messages(self.path, on_damage=lambda error: None)

    def whole_messages(self, wanted: Callable[[str], bool]) -> Iterator[StoredMessage]:
        """Messages on topics of these names, pictures and others' topics too; takes a pass.

        Raises:
            BagTruncated, BagCorrupt: it is damaged; all before that was yielded.
        """
        if self._within is None:
            return stored_messages(self.path, wanted)
        whole, number = self._within.whole, self._within.number
        mine = messages_of_runs(
            stored_messages(self.path), whole._apart,
            lambda run, topic: run == number and wanted(f'/{topic}'),
        )
        return (stored for _, stored in mine)

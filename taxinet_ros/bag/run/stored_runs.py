"""Messages of a bag, separated by run, and data of the whole bag.

Base of :class:`.recording.Recording` and input of the readers in this folder, which interpret the
messages.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from functools import cached_property
from typing import NamedTuple

from taxinet_ros.bag.errors import BagEmpty, BagError
from taxinet_ros.bag.layout import METADATA_FILE
from taxinet_ros.bag.reader import BagInfo, Contents, intact_records, stored_messages
from taxinet_ros.bag.run.runs import (
    RunPart,
    RunsWithin,
    messages_of_runs,
    tell_runs_apart,
    topic_parts,
)
from taxinet_ros.bag.run.topics import IMAGE, is_of_frames
from taxinet_ros.bag.storage.reader import StoredMessage
from taxinet_ros.bag.topics import TopicInfo
from taxinet_ros.errors import UsageError

_HEAD_OF_A_PICTURE = 64
"""Bytes kept of an image; they contain its stamp."""


class Within(NamedTuple):
    """Position of a single-run recording within a recording."""

    whole: StoredRuns
    number: int
    part: RunPart


def kept_bytes(topic: str) -> int:
    """Number of bytes kept of each message on a topic, see :func:`.read_contents`."""
    relative = topic_parts(topic)[0]
    if relative == IMAGE:
        return _HEAD_OF_A_PICTURE
    return sys.maxsize if relative or is_of_frames(topic) else 0


class StoredRuns:
    """Messages of a bag, assigned to runs.

    Attributes:
        path: as given.
        name: name of the run if it is one of several, see :class:`.RunPart`; else ''.
    """

    def __init__(self, contents: Contents, within: Within | None = None) -> None:
        """``within``: position in a recording of several runs, for one of its runs."""
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
        """Topics in the order of the file."""
        return tuple(self._contents.topics.values())

    @property
    def metadata(self) -> Mapping[str, Mapping[str, str]]:
        """Metadata records by name; the last one if a name is repeated."""
        return self._contents.metadata if self._within is None else self._within.whole.metadata

    @property
    def complete(self) -> bool:
        """Whether the recording was finished and nothing is damaged."""
        return self.info.complete

    @property
    def finished(self) -> bool:
        """Whether the recorder closed the bag; always True for a single file."""
        return self.path.is_file() or (self.path / METADATA_FILE).is_file()

    @property
    def unchecked(self) -> str:
        """One line about messages not covered by a checksum, or ''."""
        return self._contents.unchecked

    @property
    def damage(self) -> tuple[BagError, ...]:
        """All damage: damaged places, then invalid messages."""
        return (*self.damaged_places, *self._apart.broken)

    @property
    def damaged_places(self) -> tuple[BagError, ...]:
        """Damaged places of the files."""
        return tuple(error for _, error in self._contents.damage)

    @property
    def broken(self) -> tuple[BagError, ...]:
        """Errors of messages that do not match their topic's definition."""
        return self._apart.broken

    # ---- its runs ----------------------------------------------------------------------------

    @cached_property
    def _apart(self) -> RunsWithin:
        return tell_runs_apart(self._contents)

    @property
    def runs(self) -> tuple[RunPart, ...]:
        """Runs in order of first appearance."""
        return self._apart.runs

    @property
    def owners(self) -> Sequence[int]:
        """For each message on a topic of a run, the number of its run, or -1."""
        return self._apart.owners

    @property
    def plain(self) -> bool:
        """Whether it is exactly one run, logged like by the recorder of taxinet_ros."""
        return self._apart.plain

    @cached_property
    def _messages_by_run(self) -> Sequence[list[StoredMessage]]:
        found: list[list[StoredMessage]] = [[] for _ in self.runs]
        for number, stored in self.messages_of_runs():
            found[number].append(stored)
        return found

    def choose(self, name: str | None) -> RunPart:
        """Select the run of a name; None: the only run.

        Raises:
            UsageError: several runs, or none of that name.
            BagEmpty: no run at all.
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
        """Error for a bag without a run, which may be lost by damage."""
        why = f': {self.damage[0]}' if self.damage else ''
        return BagEmpty(f'{self.path}: contains no run of taxinet_ros{why}', path=self.path)

    # ---- its messages ------------------------------------------------------------------------

    def messages(
        self, relative: Collection[str], *, strict: bool = False
    ) -> Iterator[tuple[str, StoredMessage]]:
        """Messages on topics of a run, in recording order; images are truncated.

        Args:
            relative: names of the topics without a namespace, see :mod:`.topics`.
            strict: whether to raise damage at its position.

        Yields:
            Relative name of the topic, and the stored message.

        Raises:
            BagTruncated, BagCorrupt: damage, with ``strict``; all messages before it were yielded.
        """
        damage = self._contents.damage[:1] if strict else []
        names = {
            topic.name: name for topic in self.topics
            if (name := topic_parts(topic.name)[0]) in relative
        }
        messages = self._contents.messages
        for stored in messages[:damage[0][0]] if damage else messages:
            name = stored.topic.name
            if name in names:
                yield names[name], stored
        for _, error in damage:
            raise error

    def messages_of_runs(
        self, wanted: Callable[[int, str], bool] = lambda run, topic: True, *,
        whole: bool = False,
    ) -> Iterator[tuple[int, StoredMessage]]:
        """Messages of all runs in the recorder's form, each with the number of its run.

        Args:
            wanted: whether a run (by number) needs a topic (by relative name).
            whole: whether to include complete images, which needs another pass.
        """
        messages = self.all_messages() if whole else self._contents.messages
        return messages_of_runs(messages, self._apart, wanted)

    def all_messages(self) -> Iterator[StoredMessage]:
        """All intact messages in recording order; images need another pass.

        For one run of several: its messages in the recorder's form.
        """
        if self._within is not None:
            whole, number = self._within.whole, self._within.number
            mine = whole.messages_of_runs(lambda run, _: run == number, whole=True)
            return (stored for _, stored in mine)
        if all(kept_bytes(name) == sys.maxsize for name, n in self.info.counts.items() if n):
            return iter(self._contents.messages)
        found = intact_records(self.path)
        return (record for record in found if isinstance(record, StoredMessage))

    def whole_messages(self, wanted: Callable[[str], bool]) -> Iterator[StoredMessage]:
        """Complete messages on any topics, including images; needs another pass.

        Raises:
            BagTruncated, BagCorrupt: damage; all messages before it were yielded.
        """
        if self._within is None:
            return stored_messages(self.path, wanted)
        whole, number = self._within.whole, self._within.number
        mine = messages_of_runs(
            stored_messages(self.path), whole._apart,
            lambda run, topic: run == number and wanted(f'/{topic}'),
        )
        return (stored for _, stored in mine)

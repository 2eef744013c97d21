"""Separate the runs within a bag of any recorder, and assign simulated time.

The recorder of taxinet_ros writes one bag per run, with simulated log times. ``ros2 bag record``
writes one bag of everything: several consecutive runs, logged by the wall clock or by simulated
time that restarts with each run; other topics; graphs in several namespaces; an incomplete first or
last run. Messages are assigned by their run id and header stamp. Images, camera info, odometry and
clock have no run id; on each of these topics time restarts with a run, and such a stretch of
messages is assigned to the run that was stepping at that time.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from itertools import chain
from typing import Any

from taxinet_ros.bag.cdr.alignment import stamp_of_cdr
from taxinet_ros.bag.cdr.decode import typestore
from taxinet_ros.bag.errors import BagError
from taxinet_ros.bag.reader import BagInfo
from taxinet_ros.bag.run.topics import (
    CAMERA_INFO,
    CLOCK,
    COMMAND,
    ESTIMATE,
    IMAGE,
    NODE_READY,
    NODE_STATUS,
    ODOMETRY,
    ROBUSTNESS,
    RUN_ENDED,
    RUN_STATUS,
    SCENARIO,
    TRUTH,
    VERDICT,
    is_of_frames,
    is_of_sensors,
    is_topic,
)
from taxinet_ros.bag.storage.reader import StoredMessage
from taxinet_ros.bag.topics import TopicInfo
from taxinet_ros.core.topics import RECORDER, SIMULATOR
from taxinet_ros.core.types import NS_PER_S

_ORDER = (
    SCENARIO, NODE_STATUS, CLOCK, IMAGE, CAMERA_INFO, ODOMETRY, TRUTH, ESTIMATE, COMMAND,
    ROBUSTNESS, VERDICT, RUN_STATUS,
)
"""Topics of a run, in the recorder's order within a step."""
_WITHOUT_RUN_ID = frozenset({CLOCK, IMAGE, CAMERA_INFO, ODOMETRY})
"""Topics whose messages have no run id."""
_STEPPED = frozenset({TRUTH, ESTIMATE, COMMAND, ROBUSTNESS})
"""Topics with a run id that are published in every control step."""
RANK_IN_STEP = {topic: rank for rank, topic in enumerate(_ORDER)}
_NO_RUN = -1


@dataclass(kw_only=True)
class RunPart:
    """One run of a recording.

    Attributes:
        name: unique name: its id, with its namespace if there are several, and with ``#2`` for the
            second run of an id.
        run_id, namespace: as recorded; the namespace with its slash, or ''.
        stamps_ns: simulated times with a ground truth [ns].
        scenario: scenario message, or None.
        outcome: outcome, or '' if not recorded.
        told: whether its end or its verdict is recorded.
        unclear: one line about data that cannot be assigned, or ''.
    """

    name: str
    run_id: str
    namespace: str
    stamps_ns: set[int] = field(default_factory=set)
    scenario: StoredMessage | None = None
    outcome: str = ''
    told: bool = False
    unclear: str = ''
    first: int = -1
    last: int = -1

    @property
    def absent(self) -> bool:
        """Whether the recording has the end of the run but none of its steps.

        A recorder that joins a graph late receives the ends of earlier runs; and a run may fail
        before its first step.
        """
        return self.told and not self.stamps_ns

    def words(self) -> str:
        """Display text: name and recorded time range."""
        if not self.stamps_ns:
            return f'{self.name} (no steps)'
        low, high = min(self.stamps_ns) / NS_PER_S, max(self.stamps_ns) / NS_PER_S
        return f'{self.name} ({low:g}-{high:g} s)'


@dataclass(frozen=True, kw_only=True)
class RunsWithin:
    """Runs in a bag.

    Attributes:
        runs: runs in order of first appearance.
        plain: whether it is exactly one run, logged like by the recorder of taxinet_ros.
        owners: for each message on a topic of a run, the number of its run, or -1.
        reports: replacements of some of these messages, by index: the recorder sorts the reports of
            a run's nodes by name.
        broken: errors of messages that do not match their topic's definition.
    """

    runs: tuple[RunPart, ...]
    plain: bool
    owners: Sequence[int]
    reports: Mapping[int, bytes]
    broken: tuple[BagError, ...]


def tell_runs_apart(info: BagInfo, decode: Callable[[StoredMessage], Any]) -> RunsWithin:
    """Determine the runs in a bag.

    Args:
        info: contents of the bag, with all messages on topics of a run; the first bytes are
            sufficient for images.
        decode: decodes one of its messages.
    """
    broken: list[BagError] = []
    index = _RunsReader(decode)
    for stored in info.messages:
        try:
            index.note(stored)
        except BagError as error:  # An invalid message belongs to no run.
            broken.append(error)
            index.broken.add(len(index.owners) - 1)
    # Transforms are ignored: those of a run are derived from odometry. Sensors are no part of what
    # a run is judged by.
    others = any(
        info.counts[topic.name]
        and not (is_of_frames(topic.name) or is_of_sensors(topic.name))
        and (topic.encoding != 'cdr' or not topic_parts(topic.name)[0]) for topic in info.topics
    )
    return index.found(tuple(broken), others=others)


def messages_of_runs(
    messages: Iterable[StoredMessage], within: RunsWithin,
    wanted: Callable[[int, str], bool] = lambda run, topic: True,
) -> Iterator[tuple[int, StoredMessage]]:
    """Messages of all runs in recording order, converted to the recorder's form.

    Names are without namespace, stamps are simulated times, and of node and run status only the
    messages that a run's bag keeps are included.

    Args:
        messages: messages of the recording; those on other topics are skipped.
        within: runs of that recording.
        wanted: whether a run (by number) needs a topic (by relative name).

    Yields:
        Number of the run, and a message of it.
    """
    place = 0
    for stored in messages:
        relative, _ = topic_parts(stored.topic.name)
        if not relative:
            continue
        owner, cdr = within.owners[place], within.reports.get(place, stored.cdr)
        place += 1
        if owner != _NO_RUN and wanted(owner, relative):
            stamp_ns = 0 if relative in (SCENARIO, NODE_STATUS) else stamp_of_cdr(cdr)
            yield owner, StoredMessage(_renamed(stored.topic, relative), stamp_ns, cdr, stamp_ns)


class _RunsReader:
    """Collects runs from the messages of a bag."""

    def __init__(self, decode: Callable[[StoredMessage], Any]) -> None:
        self._decode = decode
        self.owners: list[int] = []
        self.runs: list[RunPart] = []
        self.broken: set[int] = set()
        self._current: dict[tuple[str, str], int] = {}
        self._stretches: dict[tuple[str, str], list[_Stretch]] = {}
        self._ready: dict[int, dict[str, tuple[int, bytes]]] = {}
        self._restamped = False
        self._named = False

    def note(self, stored: StoredMessage) -> None:
        """Process a message."""
        relative, namespace = topic_parts(stored.topic.name)
        if not relative:
            return
        self._named |= bool(namespace)
        place = len(self.owners)
        self.owners.append(_NO_RUN)
        if relative in _WITHOUT_RUN_ID:
            if relative == ODOMETRY:
                self._decode(stored)
            stamp_ns = stamp_of_cdr(stored.cdr)
            stretches = self._stretches.setdefault((namespace, relative), [])
            if not stretches or stamp_ns <= stretches[-1].last_ns:
                stretches.append(_Stretch())
            stretches[-1].places.append(place)
            stretches[-1].last_ns = stamp_ns
            self._restamped |= stamp_ns != stored.stamp_ns
            return
        message = self._decode(stored)
        run_id = getattr(message, 'run_id', None)
        if not isinstance(run_id, str):
            return  # another package's topic of the same name
        number = self._run(namespace, run_id, fresh=relative == SCENARIO)
        run = self.runs[number]
        if relative in _STEPPED:
            stamp_ns = stamp_of_cdr(stored.cdr)
            self._restamped |= stamp_ns != stored.stamp_ns
            run.first, run.last = place if run.first < 0 else run.first, place
            if relative == TRUTH:
                run.stamps_ns.add(stamp_ns)
        elif not self._keep(number, relative, stored, message):
            return
        self.owners[place] = number

    def found(self, broken: tuple[BagError, ...], *, others: bool) -> RunsWithin:
        """Return the result; ``others``: whether there are messages on other topics."""
        # Messages in a namespace without scenario and truth, such as those repeated by a player
        # under another name, are not a run.
        real = [run.scenario is not None or bool(run.stamps_ns) for run in self.runs]
        self._find_owners(real)
        numbers = {old: new for new, old in enumerate(i for i, is_run in enumerate(real) if is_run)}
        runs = [run for run, is_run in zip(self.runs, real, strict=True) if is_run]
        _name_runs(runs)
        stray = any(
            owner == _NO_RUN and place not in self.broken
            for place, owner in enumerate(self.owners)
        )
        return RunsWithin(
            runs=tuple(runs), broken=broken,
            owners=[numbers.get(owner, _NO_RUN) for owner in self.owners],
            reports=dict(chain.from_iterable(map(_filed, self._ready.values()))),
            plain=len(runs) == 1 and not (self._restamped or self._named or others or stray),
        )

    def _run(self, namespace: str, run_id: str, *, fresh: bool) -> int:
        """Number of the run with this id; a second scenario message of that id starts a new run."""
        number = self._current.get((namespace, run_id))
        if number is None or (fresh and self.runs[number].scenario is not None):
            number = self._current[namespace, run_id] = len(self.runs)
            self.runs.append(RunPart(name='', run_id=run_id, namespace=namespace))
        return number

    def _keep(self, number: int, relative: str, stored: StoredMessage, message: Any) -> bool:
        """Whether a message of a once-only topic belongs in the bag of its run."""
        run = self.runs[number]
        if relative == SCENARIO:
            run.scenario = StoredMessage(_renamed(stored.topic, SCENARIO), 0, stored.cdr, 0)
        elif relative == NODE_STATUS:
            node, reports = str(getattr(message, 'node', '')), self._ready.setdefault(number, {})
            if getattr(message, 'state', None) != NODE_READY or node in reports:
                return False
            says = any(getattr(message, word, '') for word in ('implementation', 'detail'))
            if node == SIMULATOR and not says:
                return False  # Like the recorder: immediate answers in the simulated world.
            cdr = _without_topics(stored, message) if node == RECORDER else stored.cdr
            reports[node] = len(self.owners) - 1, cdr
        elif relative == RUN_STATUS:
            if getattr(message, 'state', None) != RUN_ENDED:
                return False
            run.outcome, run.told = str(getattr(message, 'outcome', '')), True
        else:
            run.told = True
        return True

    def _find_owners(self, real: Sequence[bool]) -> None:
        """Assign stretches of topics without run id to the runs that were stepping then."""
        stepping = [i for i, run in enumerate(self.runs) if real[i] and run.first >= 0]
        for i in stepping:
            run = self.runs[i]
            mixed = [
                other.run_id for j in stepping if j != i
                for other in (self.runs[j],) if other.namespace == run.namespace
                and _overlap(run.first, run.last, other) > min(
                    run.last - run.first, other.last - other.first) / 2 > 0
            ]
            if mixed:
                run.unclear = (
                    f'its messages lie among those of {mixed[0]}; odometry and frames have no '
                    'run_id, so they cannot be assigned'
                )
        namespaces = {self.runs[i].namespace for i in stepping}
        for (namespace, relative), stretches in self._stretches.items():
            shared = relative == CLOCK and namespace not in namespaces and len(namespaces) == 1
            here = [i for i in range(len(self.runs))
                    if real[i] and (shared or self.runs[i].namespace == namespace)]
            mine = [i for i in here if i in stepping] or here
            for stretch in stretches:
                first, last = stretch.places[0], stretch.places[-1]
                best = max(mine, key=lambda i: _overlap(first, last, self.runs[i]), default=None)
                if best is not None and not self.runs[best].unclear:
                    for place in stretch.places:
                        self.owners[place] = best


@dataclass
class _Stretch:
    """Consecutive messages of one topic with increasing time: indices, and last stamp [ns]."""

    places: list[int] = field(default_factory=list)
    last_ns: int = -1


def _overlap(first: int, last: int, run: RunPart) -> int:
    """Length of the overlap of two stretches in messages; negative: their distance."""
    return min(last, run.last) - max(first, run.first)


def _without_topics(stored: StoredMessage, report: Any) -> bytes:
    """The recorder's report as it stores it: without its topics and its folder."""
    if not isinstance(getattr(report, 'listens', None), list):
        return stored.cdr
    report = dataclasses.replace(report, listens=[], detail='')
    return bytes(typestore(stored.topic).serialize_cdr(report, stored.topic.type))


def _filed(reports: Mapping[str, tuple[int, bytes]]) -> Iterator[tuple[int, bytes]]:
    """Reports of a run's nodes sorted by name, with their indices in the recording."""
    places = sorted(place for place, _ in reports.values())
    return zip(places, (reports[node][1] for node in sorted(reports)), strict=True)


def _name_runs(runs: Sequence[RunPart]) -> None:
    """Assign unique names to the runs."""
    several = len({run.namespace for run in runs}) > 1
    seen: dict[str, int] = {}
    for run in runs:
        name = f'{run.namespace}/{run.run_id}'.removeprefix('/') if several else run.run_id
        seen[name] = seen.get(name, 0) + 1
        run.name = name if seen[name] == 1 else f'{name}#{seen[name]}'


def is_run_topic(name: str) -> bool:
    """Whether a topic belongs to a run, with or without namespace and leading slash."""
    return bool(topic_parts('/' + name.lstrip('/'))[0])


@lru_cache(maxsize=256)
def topic_parts(name: str) -> tuple[str, str]:
    """Relative name and namespace of a run's topic; ('', '') for other topics."""
    relative = next((topic for topic in _ORDER if is_topic(name, topic)), '')
    namespace = name.removesuffix(relative).rstrip('/')
    return (relative, namespace) if relative else ('', '')


@lru_cache(maxsize=256)
def _renamed(topic: TopicInfo, relative: str) -> TopicInfo:
    return dataclasses.replace(topic, name=f'/{relative}')

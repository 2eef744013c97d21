"""Audits of runs that were made without ROS: some are repeated on the graph and compared.

One run in every k is chosen by its number and the campaign's seed, the first run always. Its bag
and result must be equal to the bit; a difference ends the campaign.
"""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
import json
import shutil
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Self

from taxinet_ros.bag.check.compare import TopicComparison, compare_bags
from taxinet_ros.bag.errors import BagError
from taxinet_ros.bag.layout import bag_files
from taxinet_ros.bag.reader import read_info
from taxinet_ros.bag.run.facts import made_on
from taxinet_ros.core.provenance import differences
from taxinet_ros.core.verdict.outcome import Outcome, RunRequest, RunResult
from taxinet_ros.errors import UsageError
from taxinet_ros.files.record import RECORD_NAME
from taxinet_ros.files.sealed_json import file_sha256
from taxinet_ros.trials.options import AUDIT, AUDIT_FOLDER, LOOP
from taxinet_ros.trials.worker_pool import WorkerPool, encode_line

_LOOK_S = 0.2
_SILENCE_S = 60.0


def is_audited(seed: int, index: int, percent: float) -> bool:
    """Whether a run is audited: one in every ``100 / percent`` consecutive runs, and the first.

    Args:
        seed: seed of the campaign.
        index: number of the run.
        percent: share of the runs to audit [%].
    """
    if percent <= 0:
        return False
    every = round(100 / percent)
    block, place = divmod(index, every)
    if block == 0:
        return place == 0
    drawn = hashlib.sha256(f'{seed} {block}'.encode()).digest()
    return place == int.from_bytes(drawn) % every


class Auditor:
    """Repeats runs on a graph of its own, started for the first of them; a context manager."""

    def __init__(self, command: Callable[[], Sequence[str]], out: Path, percent: float) -> None:
        """Create it; nothing is started or written before the first audit.

        Args:
            command: makes the command of a graph worker that writes its bags to
                :data:`AUDIT_FOLDER`; called at the first audit.
            out: folder of the campaign.
            percent: share of the runs to audit [%].
        """
        self._command = command
        self._out, self._percent = out, percent
        self._opened = contextlib.ExitStack()
        self._pool: WorkerPool | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        """Stop the graph."""
        self._opened.close()

    def audited(
        self, request: RunRequest, result: RunResult,
        on_step: Callable[[int], None] = lambda seq: None,
    ) -> RunResult:
        """The result of a run, after its audit if it is chosen for one.

        Args:
            request: the run.
            result: its result in the loop.
            on_step: called with the graph's control step from time to time.

        Returns:
            ``result``; an infrastructure error of kind :data:`AUDIT` if the graph's run differs,
            or the graph's own if it broke.

        Raises:
            UsageError: the graph cannot be started.
        """
        chosen = is_audited(request.seed, request.index, self._percent)
        if not (chosen and result.outcome.judged):
            return result
        folder = self._out / AUDIT_FOLDER
        shutil.rmtree(folder / request.run_id, ignore_errors=True)
        pool = self._started()
        pool.give(request)
        while not (answers := pool.answers(_LOOK_S)):
            on_step(max((worker.seq for worker in pool.workers), default=-1))
        (_, found), = answers
        if found.outcome is Outcome.INFRA_ERROR:
            detail = f'audit on the graph: {found.detail}'
            return RunResult.infra_error(found.kind, found.who, detail, found.last_seq)
        bags = self._out / request.run_id, folder / request.run_id
        difference = bag_difference(*bags) or result_difference(result, found)
        if difference:
            detail = f'loop and graph differ: {difference}; bag of the graph: {bags[1]}'
            return RunResult.infra_error(AUDIT, LOOP, detail, result.last_seq)
        shutil.rmtree(bags[1])
        return result

    def _started(self) -> WorkerPool:
        if self._pool is None:
            folder = self._out / AUDIT_FOLDER
            folder.mkdir(parents=True, exist_ok=True)
            with contextlib.suppress(FileExistsError):  # from here the bags get the program's text
                (folder / RECORD_NAME).symlink_to(Path('..', '..', RECORD_NAME))
            pool = WorkerPool(self._command(), 1, folder, silence_s=_SILENCE_S)
            self._pool = self._opened.enter_context(pool)
        return self._pool


def bag_difference(one: Path, other: Path) -> str:
    """Text on the first difference of two bags of one run, in simulated time; '' if none."""
    digests = [{file.name: file_sha256(file) for file in bag_files(bag)} for bag in (one, other)]
    if digests[0] == digests[1]:
        return ''
    try:
        topics = [topic for topic in compare_bags(one, other) if not topic.equal]
    except (BagError, UsageError) as error:
        return f'a bag cannot be read: {error}'
    if topics:
        return _first_difference(topics)
    if code := differences(*(made_on(read_info(bag)) for bag in (one, other))):
        return f'the same messages, but their workers loaded different code: {code}'
    files = sorted({name for name, _ in digests[0].items() ^ digests[1].items()})
    return f'the bags have the same messages, but not the same bytes: {", ".join(files)}'


def _first_difference(topics: Sequence[TopicComparison]) -> str:
    different = [topic for topic in topics if topic.first is not None]
    if not different:
        topic = topics[0]
        return f'{topic.topic}: {topic.counts[0]} messages | {topic.counts[1]}'
    first = min(different, key=lambda topic: topic.first.seq if topic.first else 0)
    return f'{first.topic}, {first.first}'


def result_difference(one: RunResult, other: RunResult) -> str:
    """Text on the first value in which two results differ, except for their time; '' if none."""
    values = [json.loads(encode_line(dataclasses.asdict(result))) for result in (one, other)]
    for name in values[0]:
        texts = [json.dumps(each[name]) for each in values]  # as text, NaN equals NaN
        if name != 'wall_s' and texts[0] != texts[1]:
            return f'{name}: {texts[0]} | {texts[1]}'
    return ''

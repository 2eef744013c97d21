"""Record of a study: its options, and the state of each of its stages."""

from __future__ import annotations

import contextlib
import datetime
import os
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Self

from taxinet_ros.core.provenance import Provenance, begun_elsewhere, provenance
from taxinet_ros.errors import UsageError
from taxinet_ros.files.record import (
    RECORD_NAME,
    Entries,
    Record,
    read_record,
    repair_record,
    repaired,
)
from taxinet_ros.version import __version__

STAGE, OPTIONS = 'stage', 'options'
"""Kinds of entries: a stage by its name, and the options by the study's command."""


@dataclass(frozen=True, kw_only=True)
class StageRecord:
    """Recorded state of one stage.

    Attributes:
        identity: identity of the last start (:meth:`.stage.Stage.identity`), '' if never started.
        key, outputs: those of the last completion; '' and empty if it is not done.
        runs: number of runs requested by the last start.
        wall_s: wall time of all sittings since it was last started afresh [s].
        sittings: number of these sittings. A killed one has left no time.
        killed: whether one was killed.
        begun: whether a sitting has begun and not ended.
        facts: facts of its last end: date, cores, workers, version.
        stacks: machine, libraries and code of each sitting; empty if not recorded.
        skipped: reason why there was nothing to do, or ''.
    """

    identity: str = ''
    key: str = ''
    outputs: Mapping[str, str] = field(default_factory=dict)
    runs: int = 0
    wall_s: float = 0.0
    sittings: int = 0
    killed: bool = False
    begun: bool = False
    facts: Mapping[str, Any] = field(default_factory=dict)
    skipped: str = ''
    stacks: tuple[Provenance, ...] = ()

    def started(self, identity: str, runs: int, *, resumed: bool) -> Self:
        """The state at the start of a sitting."""
        before = self if resumed else type(self)()
        return replace(
            before, identity=identity, runs=runs, killed=before.killed or before.begun,
            key='', outputs={}, skipped='', begun=True, stacks=(*before.stacks, provenance()),
        )

    def stopped(self, wall_s: float) -> Self:
        """The state at the end of a sitting that did not complete it."""
        return replace(
            self, wall_s=self.wall_s + wall_s, sittings=self.sittings + 1, begun=False)

    def done(
        self, key: str, outputs: Mapping[str, str], wall_s: float, workers: int, skipped: str = ''
    ) -> Self:
        """The state at its completion."""
        return replace(self.stopped(wall_s), key=key, outputs=outputs, skipped=skipped, facts={
            'date': datetime.datetime.now(datetime.UTC).isoformat(timespec='seconds'),
            'cores': len(os.sched_getaffinity(0)), 'workers': workers, 'version': __version__,
        })


Stages = Mapping[str, StageRecord]
"""Recorded states by name of the stage."""


@contextlib.contextmanager
def open_study(out: Path, show: Callable[[str], None]) -> Iterator[Record]:
    """Context of the open record of a study, for one command at a time.

    Of a damaged one the intact entries are kept; the stages that it lacks are made again. If stages
    were made on another machine or version, a line says so.

    Args:
        out: folder of the study.
        show: prints a line.

    Raises:
        UsageError: another command has it open, or it cannot be read.
    """
    path = out / RECORD_NAME
    if line := repair_record(path):
        show(line)
    with Record(path) as record:
        if record.entries.keys() & {STAGE, OPTIONS}:
            repaired(record)
            if warning := stack_warning(_stages_of(record.entries)):
                show(warning)
        yield record


def stack_warning(records: Stages) -> str:
    """Warning if a stage was started on another machine or version than this; else ''."""
    before = [stack for record in records.values() for stack in record.stacks]
    return begun_elsewhere(before, provenance(), 'all the stages so far')


def read_stages(out: Path) -> dict[str, StageRecord]:
    """Read the state of each stage by name; also possible while the study is running.

    Raises:
        UsageError: the record is damaged.
    """
    path = out / RECORD_NAME
    return _stages_of(read_record(path)) if path.exists() else {}


def _stages_of(entries: Entries) -> dict[str, StageRecord]:
    return {
        name: StageRecord(**{**values, 'stacks': tuple(values['stacks'])})
        for name, values in entries.get(STAGE, {}).items()
    }


def read_options(out: Path, command: str, option: str) -> dict[str, Any]:
    """Read the options of the study in ``out``.

    Args:
        out: folder of the study.
        command: its command.
        option: option that needs them, for the error message.

    Raises:
        UsageError: it has no such study, or the record is damaged.
    """
    path = out / RECORD_NAME
    found = read_record(path).get(OPTIONS, {}) if path.is_file() else {}
    if command not in found:
        raise UsageError(
            f'{option}: {out}: no study of taxinet {command}; name the folder of one with --out'
        )
    return dict(found[command])


def claim_study(record: Record, command: str, about: Mapping[str, Any]) -> None:
    """Note what a new record is about, or check that it is about this.

    Args:
        record: the open record.
        command: the study's command.
        about: its subject, as options.

    Raises:
        UsageError: it is about something else.
    """
    before = record.entries.get(OPTIONS, {})
    if before.get(command, about) != about or (not before and record.entries.keys() - {STAGE}):
        raise UsageError(
            f'--out {record.path.parent}: is about something else; choose another folder')
    record.put(OPTIONS, command, about)

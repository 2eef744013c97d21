"""Log of the stages of a study: ``stages.jsonl``, append-only and flushed to disk."""

from __future__ import annotations

import datetime
import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from taxinet_ros.core.provenance import Provenance, begun_elsewhere, known, provenance
from taxinet_ros.files.atomic import sync_folder
from taxinet_ros.files.journal import JournalOwner, damaged_line, open_journal, read_journal
from taxinet_ros.version import __version__

LOG_NAME = 'stages.jsonl'


@dataclass(kw_only=True)
class StageRecord:
    """Logged state of one stage.

    Attributes:
        identity: identity of the last start (:meth:`.stage.Stage.identity`), '' if never started.
        key, outputs: those of the last completion; '' and empty if it is not done.
        runs: number of runs requested by the last start.
        wall_s: wall time of all sittings since it was last started afresh [s].
        sittings: number of these sittings. A killed one has left no time.
        killed: whether one was killed.
        facts: facts of its last end: command, date, cores, version.
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
    facts: Mapping[str, Any] = field(default_factory=dict)
    skipped: str = ''
    stacks: tuple[Provenance, ...] = ()
    _open: bool = False

    def take(self, event: Mapping[str, Any]) -> None:
        """Apply another event of the stage."""
        if event['event'] == 'begin':
            self.killed = self._open or (self.killed and event['resumed'])
            if not event['resumed']:
                self.wall_s, self.sittings, self.killed, self.stacks = 0.0, 0, False, ()
            self.identity, self.runs, self._open = event['identity'], event['runs'], True
            self.stacks = (*self.stacks, known(event.get('provenance')))
            self.key, self.outputs, self.skipped = '', {}, ''
            return
        self._open = False
        self.wall_s += event['wall_s']
        self.sittings += 1
        if event['event'] == 'end':
            self.key, self.outputs, self.facts = event['key'], event['outputs'], event
            self.skipped = event.get('skipped', '')


class StageLog(JournalOwner):
    """The open log of a study, for one process at a time. A context manager."""

    def __init__(self, out: Path) -> None:
        """Open the log in the study's folder, creating it if needed.

        Raises:
            UsageError: another process has it open, or it is damaged.
        """
        self._journal = open_journal(out / LOG_NAME, 'taxinet case-study or improve')
        sync_folder(out)
        self.records = read_records(out)

    def write(self, event: str, stage: str, **values: Any) -> None:
        """Append an event: ``begin``, ``end`` or ``stopped``."""
        line = {
            'event': event, 'stage': stage, **values,
            'date': datetime.datetime.now(datetime.UTC).isoformat(timespec='seconds'),
            'cores': len(os.sched_getaffinity(0)), 'version': __version__,
        }
        if event == 'begin':
            line['provenance'] = dict(provenance())
        self._journal.append(line)
        self._journal.sync()
        self.records.setdefault(stage, StageRecord()).take(line)


def stack_warning(records: Mapping[str, StageRecord]) -> str:
    """Warning if a stage was started on another machine or version than this; else ''."""
    before = [stack for record in records.values() for stack in record.stacks]
    return begun_elsewhere(before, provenance(), 'all the stages so far')


def read_records(out: Path) -> dict[str, StageRecord]:
    """Read the state of each stage by name; also possible while the study is running.

    Raises:
        UsageError: a complete line is damaged.
    """
    path = out / LOG_NAME
    if not path.exists():
        return {}
    records: dict[str, StageRecord] = {}
    for number, event in enumerate(read_journal(path), start=1):
        try:
            records.setdefault(event['stage'], StageRecord()).take(event)
        except (ValueError, KeyError, TypeError) as error:
            raise damaged_line(path, number, str(error)) from error
    return records

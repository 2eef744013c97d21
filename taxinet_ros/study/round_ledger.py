"""What the rounds of ``taxinet improve`` decided: ``rounds.jsonl``, append-only, on the disk."""

from __future__ import annotations

import datetime
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from taxinet_ros.bag.layout import disk_error
from taxinet_ros.campaign.journal import JournalOwner, open_journal

ROUNDS_NAME = 'rounds.jsonl'
_WHEN = 'date'


class RoundLedger(JournalOwner):
    """The open ledger; one process at a time. A context manager."""

    def __init__(self, out: Path) -> None:
        """Open it in the loop's folder, making it if need be.

        Raises:
            UsageError: another process has it open, or it is damaged.
        """
        self._path = out / ROUNDS_NAME
        self._journal = open_journal(self._path, 'taxinet improve')
        self._known = [_undated(event) for event in self._journal.events]

    def write(self, values: Mapping[str, Any]) -> None:
        """Put a round down, unless it says what it said before."""
        plain = json.loads(json.dumps(values))
        if plain in self._known:
            return
        now = datetime.datetime.now(datetime.UTC).isoformat(timespec='seconds')
        try:
            self._journal.append({**plain, _WHEN: now})
            self._journal.sync()
        except OSError as error:
            raise disk_error(self._path, error) from error
        self._known.append(plain)


def _undated(values: Mapping[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in values.items() if key != _WHEN}

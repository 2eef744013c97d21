"""What a study cost: wall time, cores and sample of every stage."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from typing import Any

import pandas as pd

from taxinet_ros.study.progress import Records
from taxinet_ros.study.stage import Stage
from taxinet_ros.study.stage_log import StageRecord


def stages_frame(found: Sequence[Stage], records: Records) -> pd.DataFrame:
    """One line for each stage; ``done`` is False where the log has no end of it."""
    return pd.DataFrame([
        _line(stage, records.get(stage.name, StageRecord())) for stage in found
    ])


def _line(stage: Stage, record: StageRecord) -> dict[str, Any]:
    facts = record.facts if record.key else {}
    return {
        'stage': stage.name, 'done': bool(record.key), 'runs': stage.runs,
        'wall_s': record.wall_s if record.sittings else None, 'sittings': record.sittings,
        'at_least': record.killed, 'cores': facts.get('cores'), 'workers': facts.get('workers'),
        'date': facts.get('date', ''), 'version': facts.get('version', ''),
        'skipped': record.skipped, 'command': shlex.join(['taxinet', *stage.command()]),
    }

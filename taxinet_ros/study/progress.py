"""How far a study is: what is done, what has to be done again, and how long the rest takes."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from enum import Enum
from pathlib import Path

from taxinet_ros.campaign.facts import LEDGER_NAME
from taxinet_ros.study.stage import Kind, Stage
from taxinet_ros.study.stage_log import StageRecord

Records = Mapping[str, StageRecord]

_SECONDS = {Kind.RUNS: 3.5, Kind.TRIALS: 2.0, Kind.LOOKS: 0.0025, Kind.REPORT: 60.0}
"""What one takes where this study does not know yet: on one core of a small machine."""

_START_S = 25.0
"""What every command takes before it gets to work."""

_SHARED = (Kind.RUNS, Kind.TRIALS)
"""What workers share among themselves."""


class State(Enum):
    """How far a stage is."""

    DONE = 'done'
    BEGUN = 'begun'
    STALE = 'other'
    """Its folder holds what another command, other inputs or another version has made."""
    OPEN = 'to do'


def state_of(stage: Stage, records: Records, out: Path) -> State:
    """How far a stage is, by what it depends on now and what lies in its folder.

    Raises:
        UsageError: a program, an experiment or a network cannot be read.
    """
    record = records.get(stage.name, StageRecord())
    there = _holds_something(out / stage.name)
    if not stage.ready(out):
        return State.STALE if there else State.OPEN
    if record.key and record.key == stage.key(out) and stage.results(out) == record.outputs:
        return State.DONE
    if not there:
        return State.OPEN
    return State.BEGUN if record.identity == stage.identity(out) else State.STALE


def can_resume(folder: Path) -> bool:
    """Whether a campaign, or an arm of an experiment, has got as far as its ledger."""
    return any((folder / place / LEDGER_NAME).is_file() for place in ('', *_names(folder)))


def seconds_left(
    rest: Iterable[Stage], found: Sequence[Stage], records: Records, workers: int
) -> float:
    """About how long some stages take [s].

    Args:
        rest: these stages.
        found: all stages; those of them that are done tell how fast this machine is.
        records: of them.
        workers: processes that work at once.
    """
    pace = {
        kind: one_s / (workers if kind in _SHARED else 1) for kind, one_s in _SECONDS.items()
    }
    pace |= _measured(found, records)
    return sum(_START_S + stage.amount * pace[stage.kind] for stage in rest)


def _measured(found: Sequence[Stage], records: Records) -> dict[Kind, float]:
    """Wall time of one of each kind, of the stages that are done."""
    sums: dict[Kind, tuple[float, float]] = {}
    for stage in found:
        record = records.get(stage.name, StageRecord())
        if record.key and not record.killed and not record.skipped:
            wall_s, amount = sums.get(stage.kind, (0.0, 0.0))
            work_s = max(record.wall_s - _START_S, 0.2 * record.wall_s)
            sums[stage.kind] = (wall_s + work_s, amount + stage.amount)
    return {kind: wall_s / amount for kind, (wall_s, amount) in sums.items()}


def _holds_something(folder: Path) -> bool:
    return folder.is_dir() and any(folder.iterdir())


def _names(folder: Path) -> list[str]:
    return [path.name for path in folder.iterdir()] if folder.is_dir() else []

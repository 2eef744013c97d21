"""Evaluate further requirements on a recorded campaign, and add columns to its table."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from taxinet_ros.bag.check.judge import JudgedBag
from taxinet_ros.bag.layout import STORAGE_ID
from taxinet_ros.bag.run.recording import open_recording
from taxinet_ros.core.mtl import RobustnessInterval, Spec
from taxinet_ros.errors import UsageError
from taxinet_ros.files.record import RECORD_NAME, Record
from taxinet_ros.trials.past_runs.recorded_campaign import check_same_run
from taxinet_ros.trials.record.content import (
    AS_TEXT,
    REQUIREMENT,
    campaign_content,
    read_campaign,
    run_key,
)
from taxinet_ros.trials.record.facts import is_campaign
from taxinet_ros.trials.record.row import RunRow
from taxinet_ros.trials.record.table import write_tables


def bags_at(place: Path) -> list[Path]:
    """The bags at a path: itself, or those of the runs in a campaign's folder, by index.

    Without a record: every subfolder with an ``.mcap`` file, by name.

    Raises:
        UsageError: there is none, or the record is damaged.
    """
    if place.is_file():
        return [place]
    if not place.is_dir():
        raise UsageError(f'{place}: no such bag; give a run folder, an .mcap file or a campaign')
    # Compressed bags and other storage formats are refused by name.
    if any(path for kind in (f'*.{STORAGE_ID}*', '*.db3') for path in place.glob(kind)):
        return [place]
    bags = sorted({file.parent for file in place.glob(f'*/*.{STORAGE_ID}')})
    if is_campaign(place):
        finished = [place / row.bag for row in read_campaign(place).rows if row.bag]
        if bags and not finished:
            raise UsageError(
                f'{place}: no finished run left a bag; for that of one that did not end, name '
                f'{bags[0]}'
            )
        bags = finished
    if not bags:
        what = 'none of its runs left a bag' if is_campaign(place) else 'holds no bag'
        raise UsageError(f'{place}: {what}')
    return bags


def addable(folder: Path, specs: Iterable[Spec]) -> list[Spec]:
    """The requirements without a column in a campaign's table, or with an added one.

    Raises:
        UsageError: the folder contains no campaign or a running one, or its runs were judged by
            another formula of that name.
    """
    if not is_campaign(folder):
        raise UsageError(f'add: {folder / RECORD_NAME}: no such file; not a campaign')
    content = read_campaign(folder)
    _opened(folder).close()
    own = dict(content.facts.get('specs', {}))
    chosen = list(specs)
    for spec in chosen:
        before = own.get(spec.name) or content.added.get(spec.name, spec.text)
        if before != spec.text:
            raise UsageError(
                f'add: in {folder} {spec.name} is {before}; choose another name, NAME=FORMULA'
            )
    return [spec for spec in chosen if spec.name not in own]


def add_requirements(
    folder: Path, specs: Sequence[Spec], bags: Mapping[Path, JudgedBag]
) -> dict[str, int]:
    """Record further requirements evaluated on a campaign's bags, and rewrite its table.

    The outcomes do not change: they are those of the campaign's original requirements.

    Args:
        folder: folder of the campaign.
        specs: requirements returned by :func:`addable`.
        bags: judged bags by path.

    Returns:
        Number of runs with a value, by name. Runs whose bag is damaged, incomplete or missing have
        none.

    Raises:
        UsageError: the campaign is running, its record damaged, or a bag belongs to another run.
    """
    with _opened(folder) as record:
        content = campaign_content(record.path, record.entries)
        for row in content.rows:
            if row.outcome.judged and (bag := bags.get(folder / row.bag)) and not bag.trouble:
                check_same_run(row, content.facts, open_recording(bag.path))
        entries = {
            spec.name: {'formula': spec.text, 'intervals': {
                run_key(row.index): interval for row in content.rows
                if (interval := _interval(row, spec, bags.get(folder / row.bag))) is not None
            }}
            for spec in specs
        }
        record.put_all((REQUIREMENT, name, values) for name, values in entries.items())
        added = {**record.entries.get(REQUIREMENT, {}), **entries}
        now = campaign_content(record.path, {**record.entries, REQUIREMENT: added})
        write_tables(now.rows, folder, now.facts)
    return {name: len(values['intervals']) for name, values in entries.items()}


def _opened(folder: Path) -> Record:
    """The record of an intact campaign that no command writes."""
    return Record(folder / RECORD_NAME, create=False, as_text=AS_TEXT)


def _interval(row: RunRow, spec: Spec, bag: JudgedBag | None) -> RobustnessInterval | None:
    if bag is None or not row.outcome.judged or bag.trouble:
        return None
    one = next((one for one in bag.verdicts if one.spec.name == spec.name), None)
    known = one is not None and (one.verdict.judged or bag.stopped_early)
    return one.interval if one is not None and known else None

"""Evaluate further requirements on a recorded campaign, and add columns to its table."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from taxinet_ros.bag.check.judge import JudgedBag
from taxinet_ros.bag.layout import STORAGE_ID
from taxinet_ros.bag.run.recording import open_recording
from taxinet_ros.campaign.past_runs.judged_run import check_same_run
from taxinet_ros.campaign.record.facts import LEDGER_NAME
from taxinet_ros.campaign.record.ledger import Ledger, LedgerContent, read_ledger
from taxinet_ros.campaign.record.row import RunRow
from taxinet_ros.campaign.record.table import write_tables
from taxinet_ros.core.mtl import RobustnessInterval, Spec
from taxinet_ros.errors import UsageError


def campaign_bags(folder: Path) -> list[Path]:
    """The bags in a campaign's folder: one for each run on record that left one, by index.

    Where there is no record, every folder in it that holds an ``.mcap`` file, by name.

    Raises:
        UsageError: the record is damaged.
    """
    ledger = folder / LEDGER_NAME
    if ledger.is_file():
        return [folder / row.bag for row in read_ledger(ledger).rows if row.bag]
    return sorted({file.parent for file in folder.glob(f'*/*.{STORAGE_ID}')})


def addable(folder: Path, specs: Iterable[Spec]) -> list[Spec]:
    """Those of some requirements that a campaign's table has no column for, or an added one.

    Raises:
        UsageError: the folder holds no campaign, or one that is under way, or another formula of
            that name judged its runs.
    """
    if not (folder / LEDGER_NAME).is_file():
        raise UsageError(f'--add: {folder / LEDGER_NAME}: no such file; not a campaign')
    with Ledger(folder / LEDGER_NAME):
        content = read_ledger(folder / LEDGER_NAME)
    own = _own_formulas(content)
    chosen = list(specs)
    for spec in chosen:
        before = own.get(spec.name) or content.added.get(spec.name, spec.text)
        if before != spec.text:
            raise UsageError(
                f'--add: in {folder} {spec.name} is {before}; choose another name, NAME=FORMULA'
            )
    return [spec for spec in chosen if spec.name not in own]


def add_requirements(
    folder: Path, specs: Sequence[Spec], bags: Mapping[Path, JudgedBag]
) -> dict[str, int]:
    """Put on record what the bags of a campaign say of more requirements, and write its table anew.

    The outcomes stay: they are those of the requirements that the campaign was begun with.

    Args:
        folder: the campaign's.
        specs: what :func:`addable` has let through.
        bags: each judged by ``specs``, by path.

    Returns:
        By name, how many runs have a value now. One whose bag is damaged, incomplete or gone has
        none.

    Raises:
        UsageError: the campaign is under way, its record is damaged, or a bag is of another run.
    """
    with Ledger(folder / LEDGER_NAME) as ledger:
        content = read_ledger(folder / LEDGER_NAME)
        for row in content.rows:
            if row.outcome.judged and (bag := bags.get(folder / row.bag)) and not bag.trouble:
                check_same_run(row, content.campaign, open_recording(bag.path))
        counts = {}
        for spec in specs:
            intervals = {
                row.index: interval for row in content.rows
                if (interval := _interval(row, spec, bags.get(folder / row.bag))) is not None
            }
            ledger.requirement(spec.name, spec.text, intervals)
            counts[spec.name] = len(intervals)
        rows = read_ledger(folder / LEDGER_NAME).rows
        write_tables(rows, folder, [*_own_formulas(content)])
    return counts


def _own_formulas(content: LedgerContent) -> dict[str, str]:
    return dict(content.campaign.get('specs', {}))


def _interval(row: RunRow, spec: Spec, bag: JudgedBag | None) -> RobustnessInterval | None:
    if bag is None or not row.outcome.judged or bag.trouble:
        return None
    one = next((one for one in bag.verdicts if one.spec.name == spec.name), None)
    known = one is not None and (one.verdict.judged or bag.stopped_early)
    return one.interval if one is not None and known else None

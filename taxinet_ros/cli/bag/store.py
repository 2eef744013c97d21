"""``taxinet bag store`` and ``fetch``: bags of a campaign far away, and back."""

from __future__ import annotations

import sys
from pathlib import Path

from taxinet_ros.bag.store import bring_back, check_store, stored_bag
from taxinet_ros.campaign.record.facts import LEDGER_NAME
from taxinet_ros.campaign.stored_bags import bring_campaign_back, store_campaign
from taxinet_ros.errors import ExitCode, UsageError


def run_store(folder: Path, url: str, *, keep: bool) -> int:
    """Store the bags of a campaign, and print how many there are.

    Returns:
        Exit code: 0 all bags of runs with a verdict are stored.

    Raises:
        UsageError, RecordError: as :func:`store_campaign`.
    """
    url = check_store(url)
    bags, uploaded = store_campaign(folder, url, keep=keep, on_bag=_show)
    _show(None)
    print(f'{bags} bags in {url}/{folder.resolve().name}/, {uploaded} uploaded now')
    return ExitCode.OK


def run_fetch(folder: Path) -> int:
    """Bring a stored bag, or all of a campaign, back.

    Returns:
        Exit code: 0.

    Raises:
        UsageError: nothing is stored, or it is missing or another file there.
        RecordError: the store failed.
    """
    if (folder / LEDGER_NAME).is_file():
        number = bring_campaign_back(folder, _show)
        _show(None)
    else:
        number = int(stored_bag(folder) is not None)
        bring_back(folder)
    if not number:
        raise UsageError(f'{folder}: no bag of it is stored elsewhere')
    print(f'{number} bags are back in {folder}')
    return ExitCode.OK


def _show(bag: Path | None) -> None:
    if sys.stderr.isatty():
        name = '' if bag is None else bag.name
        print(f'\r\033[K{name}', end='', file=sys.stderr, flush=True)

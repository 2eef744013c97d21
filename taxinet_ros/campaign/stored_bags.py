"""Bags of a campaign in a store far away: uploaded during it or afterwards, and brought back.

Only bags of runs with a verdict are stored, each after it was checked like ``taxinet bag doctor``
does: a run that has none is repeated by ``--resume`` under the same name.
"""

from __future__ import annotations

import contextlib
import queue
import shlex
import threading
from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import Self

from taxinet_ros.bag.check.doctor import check_bag
from taxinet_ros.bag.errors import BagError
from taxinet_ros.bag.layout import STORAGE_ID
from taxinet_ros.bag.rewrite.frames import only_frames_added
from taxinet_ros.bag.store import bring_back, check_stored, store_bag, stored_bag
from taxinet_ros.campaign.past_runs.recorded_campaign import open_campaign
from taxinet_ros.campaign.record.row import RunRow
from taxinet_ros.errors import RecordError, UsageError


def store_campaign(
    folder: Path, url: str, *, keep: bool = False,
    on_bag: Callable[[Path], None] = lambda bag: None,
) -> tuple[int, int]:
    """Store the bags of all runs with a verdict; continues an interrupted upload.

    Args:
        folder: folder of the campaign.
        url: result of :func:`.store.check_store`; below it is a folder named like the campaign's.
        keep: do not remove bags here.
        on_bag: called with each bag before it is checked and uploaded, which takes time.

    Returns:
        Number of bags in the store, and of those that were uploaded now.

    Raises:
        UsageError: not a campaign, a bag is damaged or was changed here, another file is there, or
            a bag that is not here is missing there; of these, the other bags are stored before.
        RecordError: the store failed.
    """
    bags = uploaded = 0
    lost: list[UsageError] = []
    for row in open_campaign(folder).rows:
        if row.outcome.judged and row.bag:
            on_bag(folder / row.bag)
            try:
                check_stored(folder / row.bag)
            except UsageError as error:
                lost.append(error)
                continue
            uploaded += _store_run(folder, row, url, keep=keep)
            bags += 1
    if lost:
        others = f' (and {len(lost) - 1} bags more)' if len(lost) > 1 else ''
        raise UsageError(
            f'{lost[0]}{others}; {bags} other bags are stored, {uploaded} uploaded now'
        )
    return bags, uploaded


def bring_campaign_back(folder: Path, on_bag: Callable[[Path], None] = lambda bag: None) -> int:
    """Bring all bags of a campaign back; return the number of bags that were stored.

    Raises:
        UsageError: not a campaign, or a bag is missing or another one there.
        RecordError: the store failed.
    """
    bags = [folder / row.bag for row in open_campaign(folder).rows if row.bag]
    stored = [bag for bag in bags if stored_bag(bag) is not None]
    for bag in stored:
        on_bag(bag)
        bring_back(bag)
    return len(stored)


def _store_run(folder: Path, row: RunRow, url: str, *, keep: bool = False) -> bool:
    bag, place = folder / row.bag, f'{url}/{folder.resolve().name}'
    here, stored = any(bag.glob(f'*.{STORAGE_ID}')), stored_bag(bag)
    if stored is not None and stored.url.startswith(f'{place}/') and not here:
        return False  # also by a worker of a cluster, in a folder of its own
    if here or stored is None:
        try:
            for wrong in check_bag(bag).findings:
                raise UsageError(f'{bag}: is not stored, {wrong.where}: {wrong.what}')
        except BagError as error:
            raise UsageError(f'{bag}: is not stored: {error}') from error
    return store_bag(bag, place, keep=keep, replaces=_has_got_frames)


def _has_got_frames(before: Path, now: Path, names: frozenset[str]) -> bool:
    """Whether a bag differs from the stored one as ``taxinet bag render`` changes it."""
    return any(Path(name).suffix == f'.{STORAGE_ID}' for name in names) and (
        only_frames_added(before, now)
    )


class BagUploads:
    """Uploads bags of finished runs in a thread while others run; a context manager.

    An error ends the uploads but not the campaign; :meth:`finish` stores what is left, and raises.
    """

    def __init__(self, folder: Path, url: str) -> None:
        """Create it without uploading anything.

        Args:
            folder: folder of the campaign.
            url: result of :func:`.store.check_store`.
        """
        self._folder, self._url = folder, url
        self._rows: queue.SimpleQueue[RunRow | None] = queue.SimpleQueue()
        self._thread = threading.Thread(target=self._work, name='uploads', daemon=True)
        self._ended = False

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """End the thread after the current bag; the others are left to :meth:`finish`."""
        self._ended = True
        self._rows.put(None)
        self._thread.join()

    def add(self, row: RunRow) -> None:
        """Upload the bag of a recorded run soon."""
        if row.outcome.judged and row.bag:
            self._rows.put(row)

    def finish(self) -> str:
        """Store what is left, after the campaign has ended; return a line on it.

        Raises:
            RecordError: a bag cannot be stored; all that are not are in the campaign's folder.
        """
        try:
            bags, _ = store_campaign(self._folder, self._url)
        except (RecordError, UsageError, OSError) as error:
            again = shlex.join(['taxinet', 'bag', 'store', str(self._folder), self._url])
            raise RecordError(
                f'{error}; the bags that are not stored are still here, continue with: {again}'
            ) from error
        return f'stored: {bags} bags in {self._url}/{self._folder.resolve().name}/'

    def _work(self) -> None:
        # Whatever fails is tried again by finish(), which reports it.
        with contextlib.suppress(RecordError, UsageError, OSError):
            while (row := self._rows.get()) is not None and not self._ended:
                _store_run(self._folder, row, self._url)

"""A campaign's folder, read: its runs, its counterexamples, how often its program fails."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from taxinet_ros.arguments import PATH, takes
from taxinet_ros.bag.layout import STORAGE_ID
from taxinet_ros.bag.run import recording
from taxinet_ros.bag.run.recording import Recording
from taxinet_ros.campaign.past_runs import recorded_campaign
from taxinet_ros.campaign.past_runs.recorded_campaign import RecordedCampaign
from taxinet_ros.campaign.rates import ProgramRate
from taxinet_ros.campaign.record.facts import LEDGER_NAME
from taxinet_ros.campaign.record.row import RunRow
from taxinet_ros.core.mtl.interval import RobustnessInterval
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.errors import UsageError

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True, kw_only=True, eq=False)
class Counterexample:
    """A run of a campaign that failed.

    Attributes:
        row: what the campaign's ledger says of it.
        campaign: the campaign.
    """

    row: RunRow
    campaign: RecordedCampaign = field(repr=False)

    @property
    def run_id(self) -> str:
        """Its name, which is that of its folder too."""
        return self.row.run_id

    @property
    def rho(self) -> Mapping[str, RobustnessInterval]:
        """Least and greatest robustness by requirement, equal where it is known exactly."""
        return self.row.robustness

    @property
    def headline(self) -> RobustnessInterval:
        """That of the first requirement."""
        return next(iter(self.rho.values()))

    @cached_property
    def scenario(self) -> Scenario:
        """What was run: to the last bit where there is a bag, else to nine decimals.

        Raises:
            UsageError: the bag beside the campaign is of another run.
        """
        return self.campaign.scenario(self.row)[0]

    @property
    def bag(self) -> Path | None:
        """Folder of its bag; None where there is none."""
        return self.campaign.bag(self.row)


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Campaign:
    """The runs of ``taxinet run``, ``falsify``, ``shrink`` or an arm of an experiment, read only.

    Attributes:
        recorded: all that the record tells.
    """

    recorded: RecordedCampaign

    @property
    def folder(self) -> Path:
        """The campaign's."""
        return self.recorded.folder

    @property
    def facts(self) -> Mapping[str, Any]:
        """What it is: program, seed, sampler, perception, requirements, version, machines."""
        return self.recorded.facts

    @cached_property
    def rows(self) -> pd.DataFrame:
        """A row per run, by index; the columns of ``runs.parquet`` (``docs/analysis.md``).

        ``outcome``, ``rho`` of the headline, ``rho_<name>`` of each requirement (its unit), the
        scenario in human units, which the columns name (``heading_deg``, ``rain_percent``,
        ``time_of_day_h``), and the figures of the run.
        """
        return self.recorded.table()

    @cached_property
    def counterexamples(self) -> tuple[Counterexample, ...]:
        """The runs that failed, by index."""
        return tuple(
            Counterexample(row=row, campaign=self.recorded) for row in self.recorded.counterexamples
        )

    @property
    def rates(self) -> Mapping[str, ProgramRate]:
        """How often runs of the program itself fail: ``failed``, and ``off_runway`` if known.

        ``.rate`` is the share with its 95 % interval, as fractions, or None where no run tells
        (``.why_not`` says why): it rests on the runs that the program drew, not on those that a
        sampler chose.
        """
        off = self.recorded.off_runway_rate
        return {'failed': self.recorded.failure_rate} | ({'off_runway': off} if off else {})

    def __repr__(self) -> str:
        return f'<Campaign {self.folder}: {len(self.recorded.rows)} runs>'


@takes(path=PATH)
def open_campaign(path: str | os.PathLike[str]) -> Campaign:
    """Read a campaign's folder; one that is under way gives the runs so far.

    Args:
        path: the folder.

    Raises:
        UsageError: it is no campaign, or its ledger is damaged.
    """
    folder = Path(path)
    if not (folder / LEDGER_NAME).is_file():
        if folder.suffix == f'.{STORAGE_ID}' or any(folder.glob(f'*.{STORAGE_ID}')):
            raise UsageError(f'{folder}: a bag, no campaign; open it with tx.open_recording')
        if not folder.exists():
            raise UsageError(f'{folder}: no such folder; give that of a campaign')
    return Campaign(recorded=recorded_campaign.open_campaign(folder))


@takes(path=PATH)
def open_recording(path: str | os.PathLike[str]) -> Recording:
    """Open a bag, of one run or of several; its messages are read, in one pass.

    Damage is no error here: what is sound is there, see :attr:`Recording.damage`.

    Args:
        path: a bag's folder or an ``.mcap`` file.

    Raises:
        UsageError: there is nothing at ``path``, it is a campaign, or a format that is not read.
        BagError: there is nothing in it, it is no ROS 2 bag, or it cannot be read.
    """
    folder = Path(path)
    if (folder / LEDGER_NAME).is_file():
        raise UsageError(
            f'{folder}: a campaign, no bag; open it with tx.open_campaign, or one of the folders '
            'in it'
        )
    return recording.open_recording(folder)

"""A campaign's folder, read: its runs, its counterexamples, how often its program fails."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from taxinet_ros.campaign.past_runs.counterexamples import scenario_of_row
from taxinet_ros.campaign.rates import ProgramRate, failure_rate, off_runway_rate
from taxinet_ros.campaign.record.facts import LEDGER_NAME
from taxinet_ros.campaign.record.ledger import LedgerContent, read_ledger
from taxinet_ros.campaign.record.row import RunRow
from taxinet_ros.campaign.record.table import table
from taxinet_ros.core.outcome import Outcome
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
    campaign: Campaign = field(repr=False)

    @property
    def run_id(self) -> str:
        """Its name, which is that of its folder too."""
        return self.row.run_id

    @property
    def rho(self) -> Mapping[str, tuple[float, float]]:
        """Least and greatest robustness by requirement, equal where it is known exactly."""
        found = {name: self.row.interval(name) for name in (*self.row.rho, *self.row.rho_upper)}
        return {name: interval for name, interval in found.items() if interval is not None}

    @property
    def headline(self) -> tuple[float, float]:
        """That of the first requirement."""
        return self.row.headline or (math.nan, math.nan)

    @cached_property
    def scenario(self) -> Scenario:
        """What was run: to the last bit where there is a bag, else to nine decimals.

        Raises:
            UsageError: the bag beside the campaign is of another run.
        """
        return scenario_of_row(self.row, self.campaign.folder, self.campaign.facts)[0]

    @property
    def bag(self) -> Path | None:
        """Folder of its bag, where there is one."""
        folder = self.campaign.folder / self.run_id
        return folder if any(folder.glob('*.mcap')) else None


class Campaign:
    """The runs of ``taxinet run``, ``falsify``, ``shrink`` or an arm of an experiment, read only.

    Attributes:
        folder: the campaign's.
        facts: what it is: program, seed, sampler, perception, requirements, version, machines.
    """

    def __init__(self, folder: Path, content: LedgerContent) -> None:
        """See :func:`open_campaign`."""
        self.folder = folder
        self.facts: Mapping[str, Any] = content.campaign
        self._rows = content.rows

    @cached_property
    def rows(self) -> pd.DataFrame:
        """A row per run, by index; the columns of ``runs.parquet`` (``docs/analysis.md``).

        ``outcome``, ``rho`` of the headline, ``rho_<name>`` of each requirement (its unit), the
        scenario in human units, which the columns name (``heading_deg``, ``rain_percent``,
        ``time_of_day_h``), and the figures of the run.
        """
        return table(self._rows, tuple(self.facts.get('specs', {})))

    @cached_property
    def counterexamples(self) -> tuple[Counterexample, ...]:
        """The runs that failed, by index."""
        return tuple(
            Counterexample(row=row, campaign=self) for row in self._rows
            if row.outcome is Outcome.FAIL
        )

    @property
    def rates(self) -> Mapping[str, ProgramRate]:
        """How often runs of the program itself fail: ``failed``, and ``off_runway`` if known.

        ``.rate`` is the share with its 95 % interval, as fractions, or None where no run tells
        (``.why_not`` says why): it rests on the runs that the program drew, not on those that a
        sampler chose.
        """
        planned = self.facts.get('first_runs', self.facts.get('runs'))
        found = {
            'failed': failure_rate(self._rows, planned),
            'off_runway': off_runway_rate(self._rows, planned),
        }
        return {name: rate for name, rate in found.items() if rate is not None}

    def __repr__(self) -> str:
        return f'<Campaign {self.folder}: {len(self._rows)} runs>'


def open_campaign(path: str | os.PathLike[str]) -> Campaign:
    """Read a campaign's folder; one that is under way gives the runs so far.

    Args:
        path: the folder.

    Raises:
        UsageError: it is no campaign, or its ledger is damaged.
    """
    folder = Path(path)
    ledger = folder / LEDGER_NAME
    if not ledger.is_file():
        raise UsageError(f'{folder}: no campaign, for it has no {LEDGER_NAME}')
    return Campaign(folder, read_ledger(ledger))

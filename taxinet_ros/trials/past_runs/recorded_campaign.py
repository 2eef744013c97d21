"""Read-only access to a recorded campaign: facts, runs, rates and counterexamples."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from taxinet_ros.bag.errors import BagError
from taxinet_ros.bag.layout import holds_bag
from taxinet_ros.core.scenario import Scenario, scenario_from_human
from taxinet_ros.core.verdict.judging import Judging
from taxinet_ros.core.verdict.outcome import Outcome
from taxinet_ros.errors import UsageError
from taxinet_ros.files.record import RECORD_NAME
from taxinet_ros.trials.rates import ProgramRate, failure_rate, off_runway_rate
from taxinet_ros.trials.record.content import CampaignContent, read_campaign
from taxinet_ros.trials.record.facts import is_campaign, planned_runs
from taxinet_ros.trials.record.row import RunRow
from taxinet_ros.trials.record.table import campaign_table

if TYPE_CHECKING:
    import pandas as pd


_Row = TypeVar('_Row')


@dataclass(frozen=True, kw_only=True)
class RecordedCampaign:
    """A recorded campaign, whether finished, interrupted or running.

    Attributes:
        folder: folder of the campaign.
        content: content of its record.
    """

    folder: Path
    content: CampaignContent

    @property
    def facts(self) -> Mapping[str, Any]:
        """Facts of the campaign: program, seed, perception, formulas."""
        return self.content.facts

    @property
    def rows(self) -> Sequence[RunRow]:
        """Latest result of each run, by index, in display units; many are read when asked for."""
        return self.content.rows

    @property
    def judged(self) -> tuple[RunRow, ...]:
        """The runs with a verdict."""
        return self._with(Outcome.PASS, Outcome.FAIL)

    @property
    def counterexamples(self) -> tuple[RunRow, ...]:
        """The runs that failed."""
        return self._with(Outcome.FAIL)

    def _with(self, *outcomes: Outcome) -> tuple[RunRow, ...]:
        found = enumerate(self.content.values('outcome'))
        return tuple(self.rows[at] for at, (outcome,) in found if outcome in outcomes)

    @property
    def judging(self) -> Judging:
        """Judging options; ``specs`` is empty if not recorded."""
        return Judging.from_facts(self.facts)

    @property
    def gains(self) -> Mapping[str, float]:
        """Steering gains that differ from the defaults."""
        found: Mapping[str, float] = self.facts.get('gains', {})
        return found

    @property
    def timing(self) -> str:
        """Timing of answers as text (:mod:`taxinet_ros.core.pacing.timing`)."""
        told = next((row.timing for row in self.counterexamples or self.rows), '')
        return str(self.facts.get('timing') or told)

    @property
    def sampler(self) -> str:
        """Word of the sampler; '' if the program drew the scenes."""
        return next((row.sampler for row in self.counterexamples or self.rows), '')

    @property
    def planned_runs(self) -> range | None:
        """Indices of the runs planned before the first one, if known."""
        return planned_runs(self.facts)

    @property
    def failure_rate(self) -> ProgramRate:
        """Failure rate of the program with its interval (:mod:`taxinet_ros.trials.rates`)."""
        return failure_rate(self.rows, self.planned_runs)

    @property
    def off_runway_rate(self) -> ProgramRate | None:
        """Off-runway rate; None if a run was stopped too early to tell."""
        return off_runway_rate(self.rows, self.planned_runs)

    def table(self) -> pd.DataFrame:
        """Table with one row per run, by index, with the columns and types of ``runs.parquet``."""
        return campaign_table(self.content)

    def bag(self, row: RunRow) -> Path | None:
        """Folder of a run's bag; None if there is none."""
        found = self.folder / row.bag
        return found if row.bag and found.is_dir() else None

    def scenario(self, row: RunRow) -> tuple[Scenario, bool]:
        """The scenario of a run, and whether it is bit-exact.

        Raises:
            UsageError: it has no recorded scene, or its bag belongs to another run.
        """
        return scenario_of_row(row, self.folder, self.facts)


def open_campaign(folder: Path) -> RecordedCampaign:
    """Open the campaign in a folder read-only; it may be running.

    Raises:
        UsageError: it is not a campaign, or its record is damaged.
    """
    if not is_campaign(folder):
        old = ' (ledger.jsonl is of version 0.1.0, whose campaigns are not read any more)'
        also = old if (folder / 'ledger.jsonl').is_file() else ''
        raise UsageError(f'{folder}: not a campaign: no {RECORD_NAME} of one{also}')
    return RecordedCampaign(folder=folder, content=read_campaign(folder))


def open_failed_campaign(folder: Path) -> RecordedCampaign:
    """Open a campaign that has counterexamples.

    Raises:
        UsageError: as :func:`open_campaign`, or no run failed.
    """
    found = open_campaign(folder)
    if not found.counterexamples:
        raise UsageError(f'{folder}: none of its {len(found.judged)} judged runs failed')
    return found


def spread_evenly(rows: Sequence[_Row], most: int | None) -> tuple[_Row, ...]:
    """At most ``most`` of the rows, evenly spread; all if None."""
    if most is None or most >= len(rows):
        return tuple(rows)
    # The middle of each of ``most`` equal parts: no row twice, no bias to the first.
    return tuple(rows[(2 * k + 1) * len(rows) // (2 * most)] for k in range(most))


def scenario_of_row(
    row: RunRow, folder: Path, facts: Mapping[str, Any]
) -> tuple[Scenario, bool]:
    """The scenario of a run, and whether it is bit-exact.

    The bag is bit-exact; the record has nine decimals in human units. That is not enough to repeat
    a run: some pixels differ by one level, and the closed loop propagates it.

    Args:
        row: row of the run.
        folder: folder of its campaign.
        facts: facts of its campaign.

    Raises:
        UsageError: the record has no scene of it, or the bag belongs to another run.
    """
    # Imported here because reading a campaign's rows does not need the bag reader.
    from taxinet_ros.bag.run.recording import open_recording
    from taxinet_ros.trials.past_runs.judged_run import check_same_run

    bag = folder / row.run_id
    if holds_bag(bag):
        try:
            recording = open_recording(bag)
            check_same_run(row, facts, recording)
            return recording.scenario, True
        except BagError:
            pass  # a damaged bag has less information than the record
    if None in row.scene.values():
        raise UsageError(f'{folder / row.run_id}: has neither a bag nor a recorded scene')
    return scenario_from_human(row.scene), False

"""A campaign that is on disk, read without writing: its facts, runs, rates and counterexamples."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from taxinet_ros.bag.errors import BagError
from taxinet_ros.campaign.rates import ProgramRate, failure_rate, off_runway_rate
from taxinet_ros.campaign.record.facts import LEDGER_NAME
from taxinet_ros.campaign.record.ledger import LedgerContent, read_ledger
from taxinet_ros.campaign.record.row import RunRow
from taxinet_ros.campaign.record.table import table
from taxinet_ros.core.judging import Judging
from taxinet_ros.core.outcome import Outcome
from taxinet_ros.core.scenario import Scenario, scenario_from_human
from taxinet_ros.errors import UsageError

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True, kw_only=True)
class RecordedCampaign:
    """A campaign as its ledger has it, be it over, interrupted or under way.

    Attributes:
        folder: the campaign's.
        content: what the ledger says.
    """

    folder: Path
    content: LedgerContent

    @property
    def facts(self) -> Mapping[str, Any]:
        """What the campaign is, as in ``campaign.json``: program, seed, perception, formulas, …."""
        return self.content.campaign

    @property
    def rows(self) -> tuple[RunRow, ...]:
        """The newest result of each run, by index, in the units people read."""
        return self.content.rows

    @property
    def judged(self) -> tuple[RunRow, ...]:
        """The runs that have a verdict."""
        return tuple(row for row in self.rows if row.outcome.judged)

    @property
    def counterexamples(self) -> tuple[RunRow, ...]:
        """The runs that failed."""
        return tuple(row for row in self.rows if row.outcome is Outcome.FAIL)

    @property
    def judging(self) -> Judging:
        """What decided the verdicts; its ``specs`` are empty where the ledger does not tell."""
        return Judging.from_facts(self.facts)

    @property
    def gains(self) -> Mapping[str, float]:
        """Steering gains that differ from the defaults."""
        found: Mapping[str, float] = self.facts.get('gains', {})
        return found

    @property
    def timing(self) -> str:
        """When answers took effect, in words (:mod:`taxinet_ros.core.pacing.timing`)."""
        told = next((row.timing for row in self.counterexamples or self.rows), '')
        return str(self.facts.get('timing') or told)

    @property
    def sampler(self) -> str:
        """Word of the sampler that chose the scenes, '' where they were simply drawn."""
        return next((row.sampler for row in self.counterexamples or self.rows), '')

    @property
    def planned_runs(self) -> int | None:
        """Number of runs that was settled before the first of them, where that is known."""
        planned = self.facts.get('first_runs', self.facts.get('runs'))
        return None if planned is None else int(planned)

    @property
    def failure_rate(self) -> ProgramRate:
        """How often the program fails, with its interval (:mod:`taxinet_ros.campaign.rates`)."""
        return failure_rate(self.rows, self.planned_runs)

    @property
    def off_runway_rate(self) -> ProgramRate | None:
        """How often the aircraft leaves the runway; None if a run was stopped before one knew."""
        return off_runway_rate(self.rows, self.planned_runs)

    def table(self) -> pd.DataFrame:
        """One line per run, by index, with the columns and types of ``runs.parquet``."""
        return table(self.rows, tuple(self.facts.get('specs', {})))

    def bag(self, row: RunRow) -> Path | None:
        """Folder of a run's bag; None where there is none."""
        found = self.folder / row.bag
        return found if row.bag and found.is_dir() else None

    def scenario(self, row: RunRow) -> tuple[Scenario, bool]:
        """The scenario of a run, and whether it is known to the last bit.

        Raises:
            UsageError: there is no scene of it, or its bag is of another run.
        """
        return scenario_of_row(row, self.folder, self.facts)


def open_campaign(folder: Path) -> RecordedCampaign:
    """The campaign in a folder; nothing is written, and one that is under way may be read.

    Raises:
        UsageError: it is no campaign, or its ledger is damaged.
    """
    path = folder / LEDGER_NAME
    if not path.is_file():
        raise UsageError(f'{folder}: no campaign, for it has no {LEDGER_NAME}')
    return RecordedCampaign(folder=folder, content=read_ledger(path))


def open_failed_campaign(folder: Path) -> RecordedCampaign:
    """The campaign in a folder, which has counterexamples.

    Raises:
        UsageError: as :func:`open_campaign`, or no run failed.
    """
    found = open_campaign(folder)
    if not found.counterexamples:
        raise UsageError(f'{folder}: none of its {len(found.judged)} judged runs failed')
    return found


def spread_evenly(rows: Sequence[RunRow], most: int | None) -> tuple[RunRow, ...]:
    """At most ``most`` of the rows, evenly spread over them; all where None."""
    if most is None or most >= len(rows):
        return tuple(rows)
    # The middles of as many equal parts: no row twice, none favoured for being first.
    return tuple(rows[(2 * k + 1) * len(rows) // (2 * most)] for k in range(most))


def scenario_of_row(
    row: RunRow, folder: Path, facts: Mapping[str, Any]
) -> tuple[Scenario, bool]:
    """The scenario of a run, and whether it is known to the last bit.

    The bag has all its bits; the ledger has nine decimals in the units people read. That is not
    enough to repeat a run: a picture differs by a code here and there, and the loop carries it on.

    Args:
        row: of the run.
        folder: of its campaign.
        facts: of its campaign.

    Raises:
        UsageError: the ledger has no scene of it, or the bag is of another run.
    """
    # Who reads a campaign's rows need not wait for what reads bags.
    from taxinet_ros.bag.run.recording import open_recording
    from taxinet_ros.campaign.past_runs.judged_run import check_same_run

    bag = folder / row.run_id
    if any(bag.glob('*.mcap')):
        try:
            recording = open_recording(bag)
            check_same_run(row, facts, recording)
            return recording.scenario, True
        except BagError:
            pass  # a damaged bag says less than the ledger does
    if None in row.scene.values():
        raise UsageError(f'{folder / row.run_id}: has neither a bag nor a scene in the ledger')
    return scenario_from_human(row.scene), False

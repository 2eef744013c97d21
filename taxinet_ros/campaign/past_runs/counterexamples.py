"""The failed runs of a campaign, to be run again: what they were, and what came of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from taxinet_ros.bag.errors import BagError
from taxinet_ros.bag.run.recording import open_recording
from taxinet_ros.campaign.past_runs.judged_run import check_same_run
from taxinet_ros.campaign.record.facts import LEDGER_NAME
from taxinet_ros.campaign.record.ledger import read_ledger
from taxinet_ros.campaign.record.row import RunRow
from taxinet_ros.core.outcome import Outcome, StopOn, parse_stop_on
from taxinet_ros.core.scenario import HUMAN_KEYS, Scenario, scenario_from_human
from taxinet_ros.errors import UsageError


@dataclass(frozen=True, kw_only=True)
class FailedRuns:
    """The failed runs of a campaign.

    Attributes:
        folder: the campaign's.
        facts: what the campaign is, as in ``campaign.json``.
        rows: its failed runs, by index.
        runs: number of its judged runs.
        chosen_by: word of the sampler that chose the scenes, '' where they were simply drawn.
    """

    folder: Path
    facts: Mapping[str, Any]
    rows: tuple[RunRow, ...]
    runs: int
    chosen_by: str

    @property
    def specs(self) -> tuple[str, ...]:
        """The campaign's formulas as text, the headline first."""
        return tuple(f'{name}={text}' for name, text in self.facts.get('specs', {}).items())

    @property
    def gains(self) -> Mapping[str, float]:
        """Steering gains that differ from the defaults."""
        found: Mapping[str, float] = self.facts.get('gains', {})
        return found

    @property
    def stop_on(self) -> StopOn:
        """What ended a run before its end."""
        return parse_stop_on(self.facts.get('stop_on', ''))

    @property
    def timing(self) -> str:
        """When answers took effect, in words."""
        return str(self.facts.get('timing') or self.rows[0].timing)


def failed_runs(folder: Path) -> FailedRuns:
    """Read the failed runs out of a campaign's ledger.

    Raises:
        UsageError: it is no campaign, its ledger is damaged, or no run failed.
    """
    path = folder / LEDGER_NAME
    if not path.is_file():
        raise UsageError(f'{folder}: no campaign, for it has no {LEDGER_NAME}')
    content = read_ledger(path)
    judged = [row for row in content.rows if row.outcome.judged]
    rows = tuple(row for row in judged if row.outcome is Outcome.FAIL)
    if not rows:
        raise UsageError(f'{folder}: none of its {len(judged)} judged runs failed')
    return FailedRuns(
        folder=folder, facts=content.campaign, rows=rows, runs=len(judged),
        chosen_by=rows[0].sampler,
    )


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
    bag = folder / row.run_id
    if any(bag.glob('*.mcap')):
        try:
            recording = open_recording(bag)
            check_same_run(row, facts, recording)
            return recording.scenario, True
        except BagError:
            pass  # a damaged bag says less than the ledger does
    values = {key: getattr(row, key) for key in HUMAN_KEYS}
    if None in values.values():
        raise UsageError(f'{folder / row.run_id}: has neither a bag nor a scene in the ledger')
    return scenario_from_human(values), False

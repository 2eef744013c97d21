"""A plain campaign, whose scenes are drawn from the program one by one.

A campaign's folder contains ``campaign.db`` (the record: options, program text and rows), one bag
folder per run, and ``runs.csv``/``runs.parquet`` (made from the record).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from typing import Any

from taxinet_ros.core.pacing.timing import timing_words
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.verdict.judge import SpecCheck
from taxinet_ros.core.verdict.outcome import Outcome, RunResult
from taxinet_ros.errors import ExitCode, UsageError
from taxinet_ros.scenes.source import Rejected, SceneSource, first_scene, some_scenes
from taxinet_ros.trials.engine import Proposer
from taxinet_ros.trials.options import CampaignOptions
from taxinet_ros.trials.record.facts import campaign_facts
from taxinet_ros.trials.record.row import RunRow
from taxinet_ros.trials.summary import Summary


class ProgramOrder(Proposer):
    """Proposes the scenes of a program in its own order.

    Attributes:
        notes: warnings about the program, once prepared.
        check: result of checking the requirements, once prepared.
    """

    source: SceneSource
    patience, retries = 2, False

    def __init__(
        self, campaign: CampaignOptions, meanwhile: Callable[[], None] = lambda: None
    ) -> None:
        """Create it; nothing is started.

        Args:
            campaign: options of the campaign.
            meanwhile: called while the program's process starts, which takes seconds.
        """
        self.campaign = campaign
        self.runs = campaign.runs
        self.notes: tuple[str, ...] = ()
        self.check: SpecCheck
        self.source = SceneSource(
            campaign.program, seed=campaign.seed, overrides=campaign.overrides,
            laid_over=campaign.laid_over, meanwhile=meanwhile,
        )
        self._next = 0
        self._refused: dict[int, int] = {}
        self._timing: str | None = None
        self._fingerprint: str | None = None

    def prepare(self) -> dict[str, Any]:
        """See :class:`.Proposer`."""
        source = self.source
        self.check = self.campaign.check(
            first_scene(source), lambda: source.search_space().drawn,
            some_scenes(source, self.campaign.runs),
        )
        self.notes = source.drawn_notes
        facts = campaign_facts(self.campaign, source.program, source.text)
        return {**facts, 'warnings': list(self.check.warnings)}

    def propose(self) -> int:
        """See :class:`.Proposer`."""
        self._next += 1
        return self._next - 1

    def scene(self, index: int) -> Scenario:
        """See :class:`.Proposer`."""
        try:
            scenario = self.source.scene(index)
        except Rejected as error:
            self._refused[index] = error.refused
            raise
        self._refused[index] = self.source.refused
        return scenario

    def completed(self, row: RunRow) -> RunRow:
        """See :class:`.Proposer`."""
        return dataclasses.replace(row, refused=self._refused.pop(row.index, 0))

    def hear(self, facts: Mapping[str, Any], result: RunResult) -> Mapping[str, Any]:
        """See :class:`.Proposer`."""
        if result.outcome.judged:
            self._timing = result.timing if self._timing is None else self._timing
            if result.timing != self._timing:
                raise UsageError(
                    f'the graph now has {timing_words(result.timing)}, but earlier runs had '
                    f'{timing_words(self._timing)}: they cannot be mixed; start another campaign'
                )
            if self._fingerprint not in (None, result.fingerprint):
                raise UsageError(
                    f'perception {self.campaign.perception or result.perception}: changed during '
                    'the campaign, whose earlier runs had another; start another campaign'
                )
            self._fingerprint = result.fingerprint
        return {}


def exit_code(found: Summary) -> ExitCode:
    """Exit code for a campaign's rows.

    Returns:
        0 all satisfied, 1 some violated, 4 infrastructure error, 130 interrupted.

    Raises:
        UsageError: no scene could be run.
    """
    outcomes = found.outcomes.keys()
    if Outcome.INTERRUPTED in outcomes:
        return ExitCode.INTERRUPTED
    if Outcome.INFRA_ERROR in outcomes:
        return ExitCode.INFRA
    if Outcome.FAIL in outcomes:
        return ExitCode.VIOLATED
    if Outcome.PASS not in outcomes:
        why = f'; the first: {found.first_rejected}' if found.first_rejected else ''
        raise UsageError(f'no run could be judged: every scene was rejected{why}')
    return ExitCode.OK

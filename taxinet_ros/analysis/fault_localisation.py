"""Whose fault failures are, from counterexamples that were run again with the truth in place.

The paper's fault localisation (section "Error analysis and debugging"), for each counterexample on
its own and in sum.
"""

from __future__ import annotations

import enum
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from taxinet_ros.campaign.localize import Trials
from taxinet_ros.campaign.rates import Rate, rate
from taxinet_ros.campaign.row import RunRow
from taxinet_ros.campaign.trials import Trial
from taxinet_ros.core.substituted_perception import (
    AS_RECORDED,
    TRUTH,
    TRUTH_CTE,
    TRUTH_HEADING,
)


class Blame(enum.StrEnum):
    """What a failure is put down to."""

    PERCEPTION = 'perception'
    """With a perfect estimate the run passes."""
    CONTROLLER = 'controller'
    """It fails with a perfect estimate too: steering law, dynamics or the formula itself."""
    NOT_REPRODUCED = 'not reproduced'
    """Run once more as it was, it came out otherwise: the world is another one. Not counted."""
    UNKNOWN = 'unknown'
    """A trial that it rests on was not made, or could not be judged. Not counted."""


class Suffices(enum.StrEnum):
    """Which of the two estimates has to be perfect for a run to pass."""

    EITHER = 'either'
    HEADING = 'heading'
    CTE = 'cte'
    NEITHER = 'neither'
    """Neither alone is enough; where the perception is to blame, it takes both."""
    UNKNOWN = ''


@dataclass(frozen=True, kw_only=True, slots=True)
class Case:
    """One counterexample.

    Attributes:
        row: as it was recorded.
        trials: by word of the substitution, those that were made.
        blame: whose fault it is.
        suffices: which perfect estimate alone makes it pass.
    """

    row: RunRow
    trials: Mapping[str, Trial]
    blame: Blame
    suffices: Suffices

    @property
    def counted(self) -> bool:
        """Whether it came out as recorded, so that its other trials mean something."""
        control = self.trials.get(AS_RECORDED)
        return control is not None and reproduced(self.row, control)

    def passed(self, word: str) -> bool | None:
        """Whether it passed with a substitution; None where nobody knows."""
        trial = self.trials.get(word)
        return None if trial is None else trial.passed


@dataclass(frozen=True, kw_only=True)
class Localisation:
    """A campaign's counterexamples, each with its verdict.

    Attributes:
        spec: name of the headline formula.
        specs: number of formulas; to pass is to satisfy all.
        perception: word or file of the network.
        failed, runs: failed and judged runs of the campaign.
        chosen_by: sampler of its scenes, '' where they were drawn.
        words: substitutions that were asked for, the control first.
        cases: the counterexamples that were looked into.
    """

    spec: str
    specs: int
    perception: str
    failed: int
    runs: int
    chosen_by: str
    words: tuple[str, ...]
    cases: tuple[Case, ...]

    @property
    def counted(self) -> tuple[Case, ...]:
        """Those that came out as recorded."""
        return tuple(case for case in self.cases if case.counted)

    @property
    def not_reproduced(self) -> tuple[Case, ...]:
        """Those that came out otherwise than recorded."""
        return tuple(case for case in self.cases if case.blame is Blame.NOT_REPRODUCED)

    @property
    def rounded(self) -> int:
        """Counted cases whose scene was known from the ledger only."""
        return sum(not case.trials[AS_RECORDED].exact for case in self.counted)

    def passing(self, word: str) -> tuple[int, int, Rate]:
        """Cases that pass with a substitution, those that were judged, and the share.

        The share has its 95 % Clopper-Pearson interval.
        """
        answers = [case.passed(word) for case in self.counted]
        passed, judged = answers.count(True), len(answers) - answers.count(None)
        return passed, judged, rate(passed, judged)

    @property
    def blames(self) -> Mapping[Blame, int]:
        """Cases by whose fault they are."""
        return Counter(case.blame for case in self.cases)

    @property
    def sufficing(self) -> Mapping[Suffices, int]:
        """Cases that are the perception's fault, by what alone makes them pass."""
        return Counter(
            case.suffices for case in self.cases if case.blame is Blame.PERCEPTION
        )


def reproduced(row: RunRow, control: Trial) -> bool:
    """Whether a run came out as it was recorded.

    To the last bit where the scene is known so; else it has to fail again.
    """
    if control.passed is not False:
        return False
    return not control.exact or (control.rho_lower, control.rho_upper) == row.headline


def judge_case(row: RunRow, trials: Mapping[str, Trial]) -> Case:
    """The verdict on one counterexample."""
    heading, cte = (_passed(trials, word) for word in (TRUTH_HEADING, TRUTH_CTE))
    return Case(
        row=row, trials=trials, blame=_blame(row, trials), suffices=_suffices(heading, cte)
    )


def localisation(
    rows: Sequence[RunRow], trials: Trials, *, words: Sequence[str], spec: str, specs: int,
    perception: str, failed: int, runs: int, chosen_by: str,
) -> Localisation:
    """Put the trials of some counterexamples together; see :class:`Localisation`."""
    cases = (
        judge_case(row, {w: trials[row.run_id, w] for w in words if (row.run_id, w) in trials})
        for row in rows
    )
    return Localisation(
        spec=spec, specs=specs, perception=perception, failed=failed, runs=runs,
        chosen_by=chosen_by, words=tuple(words), cases=tuple(cases),
    )


def _passed(trials: Mapping[str, Trial], word: str) -> bool | None:
    trial = trials.get(word)
    return None if trial is None else trial.passed


def _blame(row: RunRow, trials: Mapping[str, Trial]) -> Blame:
    control = trials.get(AS_RECORDED)
    if control is None:
        return Blame.UNKNOWN
    if not reproduced(row, control):
        return Blame.NOT_REPRODUCED
    passed = _passed(trials, TRUTH)
    if passed is None:
        return Blame.UNKNOWN
    return Blame.PERCEPTION if passed else Blame.CONTROLLER


def _suffices(heading: bool | None, cte: bool | None) -> Suffices:
    if heading is None or cte is None:
        return Suffices.UNKNOWN
    names = {
        (True, True): Suffices.EITHER, (True, False): Suffices.HEADING,
        (False, True): Suffices.CTE, (False, False): Suffices.NEITHER,
    }
    return names[heading, cte]

"""Fault localisation: find whether network or controller causes failures.

The paper's method (section "Error analysis and debugging"): counterexamples are rerun with the
truth instead of the network's estimates. This module contains the verdicts and the report on them:
sentences, a table of counts, a figure, JSON.
"""

from __future__ import annotations

import enum
import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from shlex import quote
from typing import Any

import pandas as pd
from matplotlib.figure import Figure

from taxinet_ros.analysis.report.parts import (
    Column,
    Picture,
    Report,
    Table,
    Theme,
    style_axes,
)
from taxinet_ros.analysis.report.text import fill_report, sentences
from taxinet_ros.bag.layout import holds_bag
from taxinet_ros.core.perception.substituted import AS_RECORDED, TRUTH, TRUTH_CTE, TRUTH_HEADING
from taxinet_ros.core.provenance import provenance
from taxinet_ros.core.scenario_fields import PAPER_FIELDS
from taxinet_ros.core.verdict.examined import Examined
from taxinet_ros.files.atomic import make_atomically, write_parquet
from taxinet_ros.files.plain_values import plain
from taxinet_ros.trials.past_runs.localisation import Trials
from taxinet_ros.trials.past_runs.recorded_campaign import RecordedCampaign
from taxinet_ros.trials.past_runs.trials import Trial
from taxinet_ros.trials.rates import Rate, rate
from taxinet_ros.trials.record.row import RunRow


class Blame(enum.StrEnum):
    """The cause to which a failure is attributed."""

    PERCEPTION = 'perception'
    """The run passes with a perfect estimate."""
    CONTROLLER = 'controller'
    """The run fails with a perfect estimate too: steering law, dynamics or the formula itself."""
    NOT_REPRODUCED = 'not reproduced'
    """The unchanged rerun differs from the recording (other version or machine). Not counted."""
    UNKNOWN = 'unknown'
    """A required trial was not made or could not be judged. Not counted."""


class Suffices(enum.StrEnum):
    """Which of the two estimates must be perfect for a run to pass."""

    EITHER = 'either'
    HEADING = 'heading'
    CTE = 'cte'
    NEITHER = 'neither'
    """Neither alone is sufficient; both are needed."""
    UNKNOWN = ''


@dataclass(frozen=True, kw_only=True, slots=True)
class Case:
    """One counterexample.

    Attributes:
        row: the recorded run.
        trials: the trials made, by word of the substitution.
        blame: the attributed cause.
        suffices: which perfect estimate alone makes it pass.
    """

    row: RunRow
    trials: Mapping[str, Trial]
    blame: Blame
    suffices: Suffices

    @property
    def counted(self) -> bool:
        """Whether its rerun reproduced the recording, so that its other trials are meaningful."""
        control = self.trials.get(AS_RECORDED)
        return control is not None and reproduced(self.row, control)

    def passed(self, word: str) -> bool | None:
        """Whether it passed with a substitution; None if unknown."""
        trial = self.trials.get(word)
        return None if trial is None else trial.passed


@dataclass(frozen=True, kw_only=True)
class Localisation:
    """A campaign's counterexamples, each with its verdict.

    Attributes:
        spec: name of the formula looked into; a run passes if it satisfies it.
        perception: word or file of the network.
        failed, runs: number of runs of the campaign that violate it, and of judged ones.
        chosen_by: sampler of its scenes, '' if the program drew them.
        words: requested substitutions, the control first.
        cases: the analysed counterexamples.
        chosen: why another formula than the headline is looked into, in words; ''.
        also: sentence on the other formulas that are violated; ''.
    """

    spec: str
    perception: str
    failed: int
    runs: int
    chosen_by: str
    words: tuple[str, ...]
    cases: tuple[Case, ...]
    chosen: str = ''
    also: str = ''

    @property
    def counted(self) -> tuple[Case, ...]:
        """Cases that were reproduced."""
        return tuple(case for case in self.cases if case.counted)

    @property
    def not_reproduced(self) -> tuple[Case, ...]:
        """Cases that were not reproduced."""
        return tuple(case for case in self.cases if case.blame is Blame.NOT_REPRODUCED)

    @property
    def unjudged(self) -> tuple[Trial, ...]:
        """Trials that could not be judged."""
        return tuple(
            trial for case in self.cases for trial in case.trials.values() if not trial.judged
        )

    @property
    def rounded(self) -> int:
        """Counted cases whose scene is known only from the record."""
        return sum(not case.trials[AS_RECORDED].exact for case in self.counted)

    def passing(self, word: str) -> tuple[int, int, Rate]:
        """Number of cases that pass with a substitution, number judged, and the share.

        The share has its 95 % Clopper-Pearson interval.
        """
        answers = [case.passed(word) for case in self.counted]
        passed, judged = answers.count(True), len(answers) - answers.count(None)
        return passed, judged, rate(passed, judged)

    @property
    def blames(self) -> Mapping[Blame, int]:
        """Cases by attributed cause."""
        return Counter(case.blame for case in self.cases)

    @property
    def sufficing(self) -> Mapping[Suffices, int]:
        """Cases attributed to perception, by the estimate that alone makes them pass."""
        return Counter(
            case.suffices for case in self.cases if case.blame is Blame.PERCEPTION
        )


def reproduced(row: RunRow, control: Trial) -> bool:
    """Whether a rerun reproduced the recording.

    It must be bit-exact if the scene is; otherwise it must fail again.
    """
    if control.passed is not False:
        return False
    return not control.exact or control.robustness == row.headline


def judge_case(row: RunRow, trials: Mapping[str, Trial]) -> Case:
    """The verdict on one counterexample."""
    heading, cte = (_passed(trials, word) for word in (TRUTH_HEADING, TRUTH_CTE))
    return Case(
        row=row, trials=trials, blame=_blame(row, trials), suffices=_suffices(heading, cte)
    )


def localisation(
    campaign: RecordedCampaign, rows: Sequence[RunRow], trials: Trials, *, words: Sequence[str],
    perception: str, examined: Examined,
) -> Localisation:
    """The localisation of a campaign.

    Args:
        campaign: the campaign.
        rows: its failed runs that were analysed.
        trials: their trials.
        words: requested substitutions, the control first.
        perception: word or file of the network; of a file its name is shown.
        examined: the requirement looked into, the headline of the rows.
    """
    return Localisation(
        spec=examined.spec, chosen=examined.chosen,
        also=examined.also(f'taxinet localize {quote(str(campaign.folder))}'),
        perception=Path(perception).name, failed=examined.failed,
        runs=examined.judged, chosen_by=campaign.sampler, words=tuple(words),
        cases=tuple(
            judge_case(row, {w: trials[row.run_id, w] for w in words if (row.run_id, w) in trials})
            for row in rows
        ),
    )


def _passed(trials: Mapping[str, Trial], word: str) -> bool | None:
    trial = trials.get(word)
    return None if trial is None else trial.passed


def _blame(row: RunRow, trials: Mapping[str, Trial]) -> Blame:
    control = trials.get(AS_RECORDED)
    if control is None or not control.judged:
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


_TEXT = Path(__file__).with_suffix('.j2')
CSV_NAME, PARQUET_NAME, JSON_NAME = 'localize.csv', 'localize.parquet', 'localize.json'
_FAULT = {
    Blame.PERCEPTION: "the network's fault", Blame.CONTROLLER: 'not the fault of the network',
    Blame.NOT_REPRODUCED: 'which was not reproduced', Blame.UNKNOWN: 'of unknown fault',
}
_MEANINGS = {
    AS_RECORDED: 'as recorded (control)',
    TRUTH: 'perfect estimates',
    TRUTH_HEADING: 'a perfect heading error alone',
    TRUTH_CTE: 'a perfect cross-track error alone',
}


def worst_cases(found: Localisation, folder: Path) -> tuple[Case, ...]:
    """The worst counterexample with a bag of each cause of failure, the worst first.

    Args:
        found: the localisation.
        folder: folder of the campaign, with a folder of each run that has a bag.
    """
    rho = {case.row.run_id: _rho(case) for case in found.cases}
    there = [
        case for case in found.cases if case.row.bag and holds_bag(folder / case.row.bag)
    ]
    ordered = sorted(there, key=lambda case: (rho[case.row.run_id], case.row.run_id))
    first = {case.blame: case for case in reversed(ordered)}
    return tuple(case for case in ordered if first[case.blame] is case)


def _rho(case: Case) -> float:
    return case.row.headline.upper if case.row.headline else math.inf


def localisation_report(
    found: Localisation, worst: Sequence[Case] = (), folder: Path = Path()
) -> Report:
    """Report on a localisation.

    Args:
        found: the localisation.
        worst: counterexamples to show step by step, the first of them on the first screen.
        folder: folder of their campaign.
    """
    return fill_report(
        _TEXT, {'f': found, 'meaning': _meaning},
        {'fault-localisation': (_picture(found), _table(found))},
        runs={case.row.run_id: folder / case.row.bag for case in worst},
        worst=worst[0].row.run_id if worst else '',
        worst_words=f'The worst run, {_FAULT[worst[0].blame]}' if worst else '',
        rho={case.row.run_id: _rho(case) for case in worst if case.row.headline},
    )


def localisation_sentences(found: Localisation) -> tuple[str, ...]:
    """The findings, the most important first."""
    return sentences(_TEXT, 'findings', f=found, meaning=_meaning)


def localisation_json(found: Localisation) -> dict[str, Any]:
    """The findings as plain values, without NaN."""
    return plain({
        'perception': found.perception, 'spec': found.spec, 'failed': found.failed,
        'judged': found.runs, 'looked_into': len(found.cases), 'counted': len(found.counted),
        'scenes_from_record': found.rounded, 'made_on': dict(provenance()),
        'not_reproduced': [case.row.run_id for case in found.not_reproduced],
        'unjudged': {f'{one.run_id} {one.word}': one.detail for one in found.unjudged},
        'blame': {blame.value: found.blames.get(blame, 0) for blame in Blame},
        'suffices': {
            kind.value or 'unknown': found.sufficing.get(kind, 0) for kind in Suffices
        },
        'substitutions': [_share_json(found, word) for word in found.words],
        'sentences': localisation_sentences(found),
    })


def cases_frame(found: Localisation) -> pd.DataFrame:
    """Table with one row per counterexample, by index."""
    cases = sorted(found.cases, key=lambda case: case.row.index)
    return pd.DataFrame([_case_values(case, found.words) for case in cases]).convert_dtypes()


def write_cases(found: Localisation, folder: Path) -> tuple[Path, Path]:
    """Write the table of counterexamples as CSV and as Parquet."""
    frame = cases_frame(found)
    csv, parquet = folder / CSV_NAME, folder / PARQUET_NAME
    make_atomically(csv, lambda draft: frame.to_csv(draft, index=False))
    write_parquet(parquet, frame)
    return csv, parquet


def _meaning(word: str) -> str:
    kind, _, amount = word.partition(':')
    return _MEANINGS.get(word) or {
        'delayed': f"the network's estimate of {amount} s ago",
        'truth-delayed': f'the truth of {amount} s ago',
        'noisy': f'the truth and noise of {amount} m on the cross-track error',
    }[kind]


# Table and picture -------------------------------------------------------------------------------


def _table(found: Localisation) -> Table:
    return Table(
        name='fault_localisation', title='Runs that pass with other estimates',
        caption='Shares with exact 95 % intervals (Clopper and Pearson); the control has to fail.',
        columns=(
            Column(name='substitution', title='substitution'),
            Column(name='meaning', title='with'),
            Column(name='passed', title='pass'),
            Column(name='judged', title='of'),
            Column(name='share_percent', title='share [%]', decimals=1),
            Column(name='low_percent', title='from [%]', decimals=1),
            Column(name='high_percent', title='to [%]', decimals=1),
        ),
        rows=tuple(
            (word, _meaning(word), passed, judged, *(100 * value for value in share))
            for word, (passed, judged, share) in ((w, found.passing(w)) for w in found.words)
        ),
    )


def _picture(found: Localisation) -> Picture:
    words = [word for word in found.words if word != AS_RECORDED]
    return Picture(
        name='fault_localisation', title='What makes the failed runs pass',
        caption=f'Share of {len(found.counted)} failed runs that pass with other estimates, with '
                '95 % intervals.',
        draw=partial(_draw, found, words), size_in=(7.0, 0.9 + 0.5 * len(words)),
    )


def _draw(found: Localisation, words: list[str], figure: Figure, theme: Theme) -> None:
    axes = figure.subplots()
    shares = [found.passing(word)[2] for word in words]
    rates = [0.0 if math.isnan(share.rate) else 100 * share.rate for share in shares]
    spans = [
        [rate - 100 * share.low for rate, share in zip(rates, shares, strict=True)],
        [100 * share.high - rate for rate, share in zip(rates, shares, strict=True)],
    ]
    places = range(len(words))
    axes.barh(places, rates, height=0.55, color=theme.passed)
    axes.errorbar(rates, places, xerr=spans, fmt='none', ecolor=theme.ink, capsize=4)
    for place, percent, above in zip(places, rates, spans[1], strict=True):
        axes.annotate(
            f'{percent:.0f} %', (percent + above, place), xytext=(6, 0), textcoords='offset points',
            va='center', color=theme.ink,
        )
    axes.set_yticks(places, [_meaning(word) for word in words])
    axes.invert_yaxis()
    axes.set(xlim=(0, 112), xlabel='failed runs that pass [%]')
    axes.set_xticks(range(0, 101, 20))
    style_axes(axes, grid='x')


def _share_json(found: Localisation, word: str) -> dict[str, Any]:
    passed, judged, share = found.passing(word)
    return {
        'substitution': word, 'passed': passed, 'judged': judged,
        'share': share.rate, 'low': share.low, 'high': share.high,
    }


def _case_values(case: Case, words: tuple[str, ...]) -> dict[str, Any]:
    row, control = case.row, case.trials.get(AS_RECORDED)
    values: dict[str, Any] = {
        'run_id': row.run_id, 'index': row.index,
        **{field.key: row.scene[field.key] for field in PAPER_FIELDS},
        'rho': row.headline.lower if row.headline else None, 'blame': case.blame.value,
        'suffices': case.suffices.value, 'counted': case.counted,
        'scene_exact': None if control is None else control.exact,
    }
    for word in words:
        trial, name = case.trials.get(word), word.replace('-', '_').replace(':', '_')
        values |= {
            f'passed_{name}': trial.passed if trial else None,
            f'rho_{name}': trial.robustness.lower if trial and trial.robustness else None,
            f'max_cross_track_m_{name}': trial.max_cross_track_m if trial else None,
        }
    return values

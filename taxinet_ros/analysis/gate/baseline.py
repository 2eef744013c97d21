"""A campaign against a baseline on the same scenes: worse, no worse, or not known.

The *loss* is the share of scenes that only the baseline satisfies, less the share that only the new
system satisfies: by how much satisfaction falls in the scenes of the program. Three answers, for a
confidence 1 - alpha:

- FAIL: the system is worse. McNemar's exact test (Psychometrika 12, 1947), on one side: of the
  scenes that changed, so many got worse that this, or more, has a probability of at most alpha when
  getting worse and better are equally likely.
- PASS: the loss is at most a stated margin. The upper bound of the loss is that of the share that
  got worse less the lower bound of the share that got better, each by Clopper and Pearson
  (Biometrika 26, 1934) with alpha/2: exact, by Bonferroni's inequality, and somewhat wide.
- INCONCLUSIVE: neither is shown, or no test is valid.

A loss that is proven, but proven to be within the margin, passes. So a system without a loss fails,
and one that loses more than the margin passes, with a probability of at most alpha each.

A scene of which either run was not judged may have come out either way: it counts as worse for
PASS, and as better for FAIL.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import pandas as pd
from scipy.stats import binom

from taxinet_ros.analysis.campaign.compared import Compared, compared
from taxinet_ros.analysis.campaign.findings import paired_scenes
from taxinet_ros.analysis.experiment.pairs import PairedRates
from taxinet_ros.analysis.gate.criteria import MOST_RUNS, TEXT, Bounds, Criterion, Kind, Verdict
from taxinet_ros.analysis.report.text import macro_text
from taxinet_ros.analysis.runs.campaign import CampaignRuns, runs_of
from taxinet_ros.analysis.runs.features import SCENE_COLUMNS, scene_columns
from taxinet_ros.core.verdict.outcome import OPEN, Outcome
from taxinet_ros.errors import UsageError
from taxinet_ros.trials.rates import share_bounds
from taxinet_ros.trials.record.row import rho_column
from taxinet_ros.trials.record.table import read_table

DEFAULT_MARGIN = 0.05
_DIGITS = 6
"""Digits to which scenes are shown as different; the tables have more."""
_OF_THE_SYSTEM = ('controller', 'gains', 'timing')
"""Settings that the system under test may differ in; others change what is asked of it."""


class Loss(NamedTuple):
    """Loss of satisfaction against a baseline, as fractions of the scenes.

    Attributes:
        share: the loss in these scenes; negative is a gain.
        low, high: its one-sided bounds.
        p_value: McNemar's exact test of "no worse", on one side.
    """

    share: float
    low: float
    high: float
    p_value: float


def loss_of(rates: PairedRates, unknown: int, confidence: float) -> Loss:
    """The loss in scenes of a number that was fixed beforehand.

    Args:
        rates: the judged pairs, the baseline first.
        unknown: number of further scenes of which a run was not judged.
        confidence: of each bound.
    """
    worse, better = rates.only_first, rates.only_second
    number = rates.pairs + unknown
    if not number:
        return Loss(0.0, -1.0, 1.0, 1.0)
    tail = (1 - confidence) / 2

    def ends(most: int, least: int) -> float:
        """Upper end of the difference of the shares of two numbers of scenes."""
        return share_bounds(most, number - most, tail)[1] - share_bounds(
            least, number - least, tail)[0]

    return Loss(
        share=(worse - better) / max(rates.pairs, 1), low=-ends(better + unknown, worse),
        high=ends(worse + unknown, better),
        p_value=float(binom.sf(worse - 1, worse + better + unknown, 0.5)),
    )


def loss_verdict(found: Loss, margin: float, confidence: float) -> Verdict:
    """The answer; a proven loss within the margin passes."""
    if found.high <= margin:
        return Verdict.PASS
    return Verdict.FAIL if found.p_value <= 1 - confidence else Verdict.INCONCLUSIVE


def further_scenes(rates: PairedRates, margin: float, confidence: float) -> int | None:
    """Approximate number of further scenes for an answer if all shares stay the same.

    Returns:
        0 if the judged pairs alone would do; None if more than
        :data:`~taxinet_ros.analysis.gate.criteria.MOST_RUNS` would be needed.
    """
    pairs = max(rates.pairs, 1)

    def decided(number: int) -> bool:
        worse, better = (
            round(count * number / pairs) for count in (rates.only_first, rates.only_second))
        both = number - worse - better
        scaled = PairedRates(both=both, only_first=worse, only_second=better, neither=0)
        return loss_verdict(
            loss_of(scaled, 0, confidence), margin, confidence) is not Verdict.INCONCLUSIVE

    low, high = rates.pairs, MOST_RUNS
    if decided(low):
        return 0
    if not decided(high):
        return None
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (low, middle) if decided(middle) else (middle, high)
    return high - rates.pairs


class Changed(NamedTuple):
    """A scene with another verdict than the baseline's: the runs, and rho of both."""

    run_id: str
    baseline_run_id: str
    rho: float
    baseline_rho: float


@dataclass(frozen=True, kw_only=True)
class AgainstBaseline:
    """A system and its baseline on the same scenes.

    Attributes:
        found: the comparison of the judged pairs, the baseline first.
        unknown: number of further common scenes of which a run was not judged.
        worse, better: scenes that changed, the greatest change of rho first.
        notes: further remarks.
    """

    found: Compared
    unknown: int
    worse: tuple[Changed, ...]
    better: tuple[Changed, ...]
    notes: tuple[str, ...]

    def loss(self, confidence: float) -> Loss:
        """The loss with its bounds; :func:`loss_of`."""
        return loss_of(self.found.satisfied, self.unknown, confidence)

    def criterion(self, margin: float, confidence: float, command: str) -> Criterion:
        """The gate's criterion.

        Args:
            margin: largest loss that counts as no worse.
            confidence: of each answer.
            command: the command that shows the scenes that changed.
        """
        found, rates = self.loss(confidence), self.found.satisfied
        verdict, bounds, more = Verdict.INCONCLUSIVE, None, None
        if self.found.tested:
            verdict = loss_verdict(found, margin, confidence)
            bounds = Bounds(found.share, found.low, found.high)
            if verdict is Verdict.INCONCLUSIVE:
                more = further_scenes(rates, margin, confidence)
        return Criterion(
            kind=Kind.BASELINE, name=f'no worse than the baseline, margin {margin:g}',
            verdict=verdict, against=frozenset(one.run_id for one in self.worse), bounds=bounds,
            more_runs=more, next=command, sentence=macro_text(
                TEXT, 'against', one=self, rates=rates, loss=found, confidence=confidence,
                more=more, undecided=verdict is Verdict.INCONCLUSIVE,
            ),
        )


def against_baseline(
    frame: pd.DataFrame, path: Path, baseline: Path, *, again: bool = False
) -> AgainstBaseline:
    """Pair a system's runs with those of a baseline in the same scenes.

    Args:
        frame: table of the system's runs.
        path: its folder, or the file of the table.
        baseline: the baseline's folder or table.
        again: the runs were made in the baseline's scenes, with its settings.

    Raises:
        UsageError: these are not the same scenes, or other things were asked of both; by name.
    """
    other = read_table(baseline)
    after = runs_of(frame, path)
    same = rho_column(after.spec) in other.columns
    before = runs_of(other, baseline, after.spec if same else None)
    if before.spec != after.spec:
        raise UsageError(
            f'baseline {baseline}: was judged by {before.spec}, not by {after.spec}, so the '
            'verdicts cannot be paired'
        )
    if not again:
        _check_origin(frame, other, after, before)
    found = compared(before, after)
    notes = []
    if not again:
        _check_settings(found, baseline)
        if own := [name for name in found.differing if name in _OF_THE_SYSTEM]:
            notes.append(f'beside the network, the baseline has other settings: {", ".join(own)}')
        if not (before.facts and after.facts):
            notes.append('the settings of the baseline are not recorded; taken to be the same')
    lacking = len(after.frame) - len(found.scenes)
    if lacking:
        notes.append(f'{lacking:,} judged runs have no counterpart in the baseline')
    unused = len(before.frame) - len(found.scenes)
    if unused:
        notes.append(f'{unused:,} judged runs of the baseline have no counterpart')
    changed = found.scenes[found.scenes['failed_before'] != found.scenes['failed_after']]
    return AgainstBaseline(
        found=found, unknown=_unknown(frame, other), worse=_changed(changed, worse=True),
        better=_changed(changed, worse=False), notes=tuple(notes),
    )


def _changed(changed: pd.DataFrame, *, worse: bool) -> tuple[Changed, ...]:
    some = changed[changed['failed_after'] == worse]
    fall = (some['rho_before'] - some['rho_after']) * (1 if worse else -1)
    some = some.loc[fall.sort_values(ascending=False, kind='stable').index]
    return tuple(
        Changed(str(run), str(was), float(rho), float(before)) for run, was, rho, before in zip(
            some['run_id'], some['run_before'], some['rho_after'], some['rho_before'], strict=True)
    )


def _unknown(frame: pd.DataFrame, other: pd.DataFrame) -> int:
    """Number of scenes that both have, of which a run was not judged."""
    both = paired_scenes(*(
        scene_columns(one).assign(open=one['outcome'].isin(OPEN)) for one in (frame, other)
    ))
    return int((both['open'] | both['open_there']).sum())


def _scenes(frame: pd.DataFrame) -> pd.DataFrame:
    return scene_columns(frame).round(_DIGITS)


def _check_origin(
    frame: pd.DataFrame, other: pd.DataFrame, after: CampaignRuns, before: CampaignRuns
) -> None:
    """Refuse scenes that are not the baseline's, by what they differ in."""
    where = f'baseline {before.path}'
    facts, was = after.facts, before.facts
    named: list[tuple[str, Any, Any]] = [
        ('program', after.program, before.program),
        ('seed', _seeds(frame), _seeds(other)),
        ('sampler', after.sampler or 'random', before.sampler or 'random'),
    ]
    if facts and was:
        named += [
            ('text of the program (program_sha256)', facts.get('program_sha256'),
             was.get('program_sha256')),
            *_settings_named(facts, was),
        ]
    for name, value, there in named:
        if value != there:
            raise UsageError(
                f'{where}: its {name} is {_told(there)}, here {_told(value)}; a comparison in '
                'pairs needs the same scenes: run both with the same program, seed and settings'
            )
    scenes = [
        _scenes(one).assign(index=one['index'], run_id=one['run_id'])[
            one['outcome'] != Outcome.REJECTED.value] for one in (frame, other)
    ]
    both = scenes[0].merge(scenes[1], on='index', suffixes=('', ' there'))
    for key in SCENE_COLUMNS:
        one, two = both[key], both[f'{key} there']
        differ = (one != two) & ~(one.isna() & two.isna())
        if differ.any():
            line = both[differ].iloc[0]
            raise UsageError(
                f'{where}: its run {line["run_id there"]} is another scene than {line["run_id"]}: '
                f'{key} is {_told(line[f"{key} there"])}, here {_told(line[key])}'
            )


def _settings_named(
    facts: Mapping[str, Any], was: Mapping[str, Any]
) -> Sequence[tuple[str, Any, Any]]:
    """Values of ``--set`` and of an experiment's arms, such as the place."""
    one, other = (
        {**some.get('overrides', {}), **some.get('laid_over', {})} for some in (facts, was))
    return [
        (f'setting {key}', one.get(key, 'not set'), other.get(key, 'not set'))
        for key in sorted({*one, *other})
    ]


def _seeds(frame: pd.DataFrame) -> str:
    return ', '.join(map(str, sorted(set(frame['seed'])))) if 'seed' in frame.columns else ''


def _told(value: Any) -> str:
    return 'not recorded' if value in (None, '') else str(value)


def _check_settings(found: Compared, baseline: Path) -> None:
    asked = [
        name for name in found.differing
        if name not in (*_OF_THE_SYSTEM, 'weights', 'program')
        and not name.startswith('the settings')
    ]
    if asked:
        raise UsageError(
            f'baseline {baseline}: had another {asked[0]}, so that its verdicts are not '
            'comparable; run both with the same'
        )

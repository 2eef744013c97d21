"""The runs of a campaign, ready for analysis, and the failure rates of groups of them.

Judged runs have features; the others are counted. Rates use drawn runs only: those drawn by the
scenario program itself, not by a sampler.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from taxinet_ros.analysis.runs.features import (
    PAPER_FEATURES,
    Floats,
    Mask,
    feature_columns,
    scene_columns,
)
from taxinet_ros.core.mtl.interval import lower_column, upper_column
from taxinet_ros.core.mtl.specs import MOST_UNUSABLE_SHARE
from taxinet_ros.core.pacing.timing import timing_words
from taxinet_ros.core.provenance import Provenance
from taxinet_ros.core.verdict.examined import Examined, examine
from taxinet_ros.core.verdict.outcome import Outcome
from taxinet_ros.errors import UsageError
from taxinet_ros.files.record import RECORD_NAME
from taxinet_ros.scenes.overrides import scenes_words
from taxinet_ros.trials.rates import (
    count_kinds,
    count_words,
    rate,
    sample_size_was_fixed,
    without_gaps,
)
from taxinet_ros.trials.record.facts import (
    planned_runs,
    read_facts,
    recorded_stacks,
)
from taxinet_ros.trials.record.row import SIMPLY_DRAWN, rho_column, specs_of
from taxinet_ros.trials.record.table import PARQUET_NAME, read_table


class GroupRate(NamedTuple):
    """Failure rate of a group of runs.

    Attributes:
        runs, failures: numbers of runs and failures as made.
        rate, low, high: share of failures under the program's own distribution with its 95 %
            interval, from the runs drawn by the program itself. NaN if it drew others, but none of
            these. If it drew none at all, the share among the runs as made, with NaN for the ends.
        effective: number of runs that the interval is based on; NaN if there is none.
    """

    runs: int
    failures: int
    rate: float
    low: float
    high: float
    effective: float

    def words(self) -> str:
        """Rate and interval, such as ``49.9 % (48.3–51.5 %)``."""
        return rate_words(self.runs, self.rate, self.low, self.high)


def rate_words(runs: int, rate: float, low: float, high: float) -> str:
    """Rate and interval from counts; ``low`` is NaN if there is no interval."""
    if not runs:
        return 'no run'
    if math.isnan(rate):
        return 'no rate, as the program itself drew none of them'
    if math.isnan(low):
        return f'{rate:.1%} of the runs made'.replace('%', ' %')
    return f'{rate:.1%} ({100 * low:.1f}–{high:.1%})'.replace('%', ' %')


def group_rate(failed: Mask, weight: Floats, *, anytime: bool = False) -> GroupRate:
    """Failure rate of a group chosen independently of the outcomes.

    Args:
        failed: whether each run failed.
        weight: 1 if the program itself drew the run and it counts, else 0; NaN if there is no
            such run in the campaign.
        anytime: whether the number of runs was open (:mod:`taxinet_ros.trials.rates`).
    """
    runs, failures = len(failed), int(np.count_nonzero(failed))
    drawn = weight == 1
    number = int(np.count_nonzero(drawn))
    if not runs:
        return GroupRate(0, 0, *rate(0, 0), 0.0)
    if not number:
        share = failures / runs if np.isnan(weight).all() else math.nan
        return GroupRate(runs, failures, share, math.nan, math.nan, math.nan)
    found = rate(int(np.count_nonzero(failed & drawn)), number, anytime=anytime)
    return GroupRate(runs, failures, *found, float(number))


def holm(p_values: Sequence[float]) -> list[float]:
    """P values of a family, adjusted by Holm's step-down procedure; NaN stays NaN.

    Scandinavian Journal of Statistics 6, 1979, pp. 65-70; whatever the dependence of the tests.
    """
    found = np.asarray(p_values, dtype=np.float64)
    order = np.argsort(found, kind='stable')
    stepped = found[order] * np.arange(len(found), 0, -1)
    adjusted = np.empty_like(found)
    adjusted[order] = np.minimum(np.maximum.accumulate(stepped), 1.0)
    return [float(one) for one in adjusted]


class ConfidenceInterval(NamedTuple):
    """A value with its 95 % interval; NaN if it has none."""

    value: float
    low: float
    high: float

    @property
    def clear(self) -> bool:
        """Whether the interval excludes zero."""
        return self.low > 0 or self.high < 0


def difference(one: GroupRate, other: GroupRate) -> ConfidenceInterval:
    """Difference between the rate of ``one`` and that of another, independent group.

    The interval combines those of the two rates (Newcombe, Statistics in Medicine 17,
    1998, method 10; for any intervals Zou and Donner, Statistics in Medicine 27, 2008).
    """
    value = one.rate - other.rate
    below = math.hypot(one.rate - one.low, other.high - other.rate)
    above = math.hypot(one.high - one.rate, other.rate - other.low)
    return ConfidenceInterval(value, value - below, value + above)


_SCENE = [feature.source for feature in PAPER_FEATURES]
_NEEDED = ['run_id', 'index', 'program', 'perception', 'outcome', 'weight', *_SCENE]
_JUDGED = [Outcome.PASS.value, Outcome.FAIL.value]


class Weighting(Enum):
    """How a share of runs relates to the program's own distribution."""

    DRAWN = 'drawn'
    """The runs were drawn from it: shares are its rates."""
    WEIGHTED = 'partly drawn'
    """A sampler chose most runs, the program itself drew some: rates are of those alone."""
    UNKNOWN = 'unknown'
    """No run counts, as a sampler chose all, or the first one has no result: there is no rate,
    shares are of these runs only."""
    UNDECIDED = 'undecided'
    """Runs were stopped before the formula was decided, which depends on their results: there is no
    rate, only bounds of it; shares are of the decided runs only."""

    @property
    def rated(self) -> bool:
        """Whether there are failure rates."""
        return self in (Weighting.DRAWN, Weighting.WEIGHTED)


@dataclass(frozen=True, kw_only=True)
class CampaignRuns:
    """A campaign's runs.

    Attributes:
        label: unique name: its network, and the folder if needed.
        path: folder or file that it was read from.
        program, perception, sampler: scenario program, perception, and sampler of the scenes.
        spec: name of the formula that defines failure.
        examined: how it was chosen, if it was chosen by what is violated.
        facts: facts of the campaign, if they are recorded beside the table.
        stacks: machines, libraries and code of the runs; empty if not recorded.
        frame: judged runs, by index: ``run_id``, ``index``, ``bag``, ``weight``, ``failed``,
            ``rho`` (NaN if its size is unknown), ``rho_exact`` (False if the run was stopped early
            and ``rho`` is the bound known then), ``left_runway`` (1, 0 or NaN), and the features.
        scenes: scene of each of them, by scenario key.
        others: number of runs without a verdict, by outcome.
        kinds: number of infrastructure errors by kind.
        undecided: number of judged runs stopped before this formula was decided.
        uncounted: number of runs that the program drew and that are in no rate, since an earlier
            one has no result.
        weighting: interpretation of shares of these runs.
        bounds: least and greatest failure rate under the program's own distribution, at 95 %
            confidence: with the undecided runs as satisfied, and as violated.
        anytime: whether the number of runs was not fixed before the first one.
        blind: number of runs that passed though more of their frames had no usable estimate than
            the requirement ``usable`` allows.
        claimed: what covariances claimed of the errors, and how it fits, as a sentence; ''.
        unrecorded: what is not recorded and had to be assumed, as a sentence without its full
            stop; ''.
    """

    label: str
    path: Path
    program: str
    perception: str
    sampler: str
    spec: str
    facts: Mapping[str, Any]
    stacks: tuple[Provenance, ...]
    frame: pd.DataFrame
    scenes: pd.DataFrame
    others: Mapping[str, int]
    kinds: Mapping[str, int]
    undecided: int
    weighting: Weighting
    bounds: tuple[float, float] = (0.0, 1.0)
    uncounted: int = 0
    anytime: bool = False
    blind: int = 0
    claimed: str = ''
    unrecorded: str = ''
    examined: Examined | None = None

    @property
    def no_rate(self) -> str:
        """Why there is no failure rate, as a clause; '' if there is one."""
        if self.weighting.rated:
            return ''
        if self.weighting is Weighting.UNDECIDED:
            return f'runs were stopped before {self.spec} was decided'
        if self.uncounted:
            return 'the runs that the program itself drew follow one without a result'
        return f'{f"the sampler {self.sampler}" if self.sampler else "a sampler"} chose the scenes'

    @property
    def formula(self) -> str:
        """Text of the formula that defines failure; '' if it is not recorded."""
        return str(self.facts.get('specs', {}).get(self.spec, ''))

    @property
    def scenes_words(self) -> str:
        """Display text of the scenes that rates are of: the program, with what was set of them."""
        overrides = {**self.facts.get('overrides', {}), **self.facts.get('laid_over', {})}
        return scenes_words(self.program, overrides)

    @property
    def warnings(self) -> tuple[str, ...]:
        """Caveats of the rates, one line each."""
        told = self.facts.get('warnings')
        lines = [str(line) for line in told] if isinstance(told, list) else []
        lines += [self.unrecorded] * bool(self.unrecorded)
        if self.uncounted:
            lines.append(
                f'{self.uncounted:,} of the runs are in no rate: they follow one without a result, '
                'and runs that finish early are a biased sample'
            )
        if self.blind:
            lines.append(
                f'{self.blind:,} {"run" if self.blind == 1 else "runs"} passed with more than '
                f'{100 * MOST_UNUSABLE_SHARE:g} % of their frames without a usable estimate'
            )
        return tuple(lines)

    @property
    def folder(self) -> Path:
        """Folder of the bags, or None."""
        return self.path if self.path.is_dir() else self.path.parent

    @property
    def failed(self) -> Mask:
        """Which runs failed."""
        return self.frame['failed'].to_numpy(dtype=bool)

    @property
    def weight(self) -> Floats:
        """1 for each run that the program drew and that counts, else 0; NaN if there is none."""
        return self.frame['weight'].to_numpy(dtype=np.float64)

    @property
    def stopped(self) -> int:
        """Number of runs that were stopped early, whose rho is a bound."""
        return int((~self.frame['rho_exact']).sum())

    def rate(self, among: Mask | None = None) -> GroupRate:
        """Failure rate of all runs, or of those in ``among``."""
        among = np.ones(len(self.frame), dtype=bool) if among is None else among
        return group_rate(self.failed[among], self.weight[among], anytime=self.anytime)

    def off_runway(self) -> GroupRate | None:
        """Off-runway rate; None if a run was stopped before it was known."""
        left = self.frame['left_runway']
        if self.undecided or left.isna().any():
            return None
        return group_rate(left.to_numpy() > 0, self.weight, anytime=self.anytime)


def read_runs(path: Path, spec: str | None = None) -> CampaignRuns:
    """Read the runs of a campaign's folder or table.

    Args:
        path: folder, or ``.parquet`` file; an unfinished campaign gives its runs so far.
        spec: formula that defines failure; None for the headline.

    Raises:
        UsageError: there is no such table or formula, or no run was judged.
    """
    return runs_of(read_table(path), path, spec)


def read_examined(path: Path, spec: str | None = None) -> CampaignRuns:
    """Read the runs of a campaign with the requirement to look into (:mod:`.examined`).

    Requirements that were added later count if asked for: no run failed by them.

    Args:
        path: as of :func:`read_runs`.
        spec: its name; None to choose it.

    Raises:
        UsageError: as of :func:`read_runs`.
    """
    table = read_table(path)
    _check_columns(table, path)
    known = _specs(table, path)
    own = facts_beside(path).get('specs') or known
    judged = table[table['outcome'].isin(_JUDGED)]
    examined = examine({
        name: int((_rho(judged, name)[0] <= 0).sum()) for name in known
        if name in own or name == spec
    } or dict.fromkeys(known, 0), len(judged), asked=spec, where=str(path))
    return replace(runs_of(table, path, examined.spec), examined=examined)


def runs_of(table: pd.DataFrame, path: Path, spec: str | None = None) -> CampaignRuns:
    """The judged runs of a table that was read from ``path``; see :func:`read_runs`."""
    _check_columns(table, path)
    name = _spec_name(table, path, spec)
    facts = facts_beside(path)
    anytime, counted = _plan(table, facts)
    counts = table.loc[~table['outcome'].isin(_JUDGED), 'outcome'].value_counts()
    others = {str(outcome): int(count) for outcome, count in sorted(counts.items())}
    broken = table[table['outcome'] == Outcome.INFRA_ERROR]
    kinds = count_kinds(broken['kind'].astype(str)) if 'kind' in table.columns else {}
    judged = table[table['outcome'].isin(_JUDGED)].sort_values('index', ignore_index=True)
    frame = _frame(judged, name)
    drawn = _drawn(judged)
    frame['weight'] = _weights(drawn, judged['index'] < counted)
    decided = ~frame['failed'].isna()
    _check(judged, decided, count_words(others, kinds), path, name, _first_words(broken))
    bounds = _bounds(frame, anytime=anytime)
    weighting = _weighting(drawn, frame['weight'], decided)
    if not decided.all():
        frame['weight'] = math.nan
    frame = frame[decided].astype({'failed': bool}).reset_index(drop=True)
    perception, timing = _common(table['perception']), _timing(judged, path)
    return CampaignRuns(
        label=', '.join(filter(None, (_network(perception), timing))), path=path,
        program=_common(table['program']),
        perception=perception,
        sampler=_common(table['sampler']) if 'sampler' in table.columns else '',
        spec=name, facts=facts, stacks=_stacks(table, path), frame=frame, anytime=anytime,
        others=others, kinds=kinds,
        undecided=int((~decided).sum()), weighting=weighting, bounds=bounds,
        uncounted=int((drawn & (judged['index'] >= counted)).sum()), blind=_blind(judged),
        claimed=_claimed(judged), unrecorded=_unrecorded(table, facts),
        scenes=scene_columns(judged)[decided].reset_index(drop=True),
    )


def _timing(judged: pd.DataFrame, path: Path) -> str:
    """Timing of the answers in the runs; '' if each took effect at once.

    Raises:
        UsageError: it differs between runs, so they have no common rate.
    """
    found = judged['timing'].fillna('').unique().tolist() if 'timing' in judged.columns else []
    if len(found) > 1:
        raise UsageError(
            f'{path}: mixes runs with {" and with ".join(map(timing_words, found))}, which are not '
            'counted together; make a table of each'
        )
    return str(found[0]) if found else ''


def distinct_labels(campaigns: Sequence[CampaignRuns]) -> list[CampaignRuns]:
    """The campaigns with unique labels."""
    labels = [one.label for one in campaigns]
    named = [
        replace(one, label=f'{one.label} ({one.path.stem})') if labels.count(one.label) > 1
        else one for one in campaigns
    ]
    again = [one.label for one in named]
    return [
        replace(one, label=f'{one.label} {number}') if again.count(one.label) > 1 else one
        for number, one in enumerate(named, 1)
    ]


def _check_columns(table: pd.DataFrame, path: Path) -> None:
    missing = [name for name in _NEEDED if name not in table.columns]
    if missing:
        raise UsageError(f'{path}: the table has no column {missing[0]}; of an older version?')


def _specs(table: pd.DataFrame, path: Path) -> list[str]:
    names = specs_of(table.columns)
    if not names:
        raise UsageError(f'{path}: the table has no robustness')
    return names


def _spec_name(table: pd.DataFrame, path: Path, spec: str | None) -> str:
    names = _specs(table, path)
    if spec is not None and spec not in names:
        raise UsageError(f'spec {spec}: not judged in {path}; known: {", ".join(names)}')
    return spec or names[0]


def _rho(judged: pd.DataFrame, spec: str) -> tuple[Floats, Mask]:
    """Robustness of judged runs, NaN if the sign is not known, and whether it is exact."""
    rho = judged[rho_column(spec)].to_numpy(dtype=np.float64)
    empty = np.full(len(rho), np.nan)
    lower, upper = (
        judged[column].to_numpy(dtype=np.float64) if column in judged.columns else empty
        for column in (lower_column(spec), upper_column(spec))
    )
    exact = ~np.isnan(rho)
    bound = np.where(upper <= 0, upper, np.where(lower > 0, lower, np.nan))
    return np.where(exact, rho, bound), exact


def _frame(judged: pd.DataFrame, spec: str) -> pd.DataFrame:
    """Features and outcome of judged runs; ``failed`` is missing if the sign is not known."""
    rho, exact = _rho(judged, spec)
    empty = np.full(len(rho), np.nan)
    failed = pd.Series(rho <= 0, dtype='boolean').mask(pd.Series(np.isnan(rho)))
    left = judged['left_runway'].astype('Float64') if 'left_runway' in judged.columns else None
    facts = pd.DataFrame({
        'run_id': judged['run_id'].astype(str), 'index': judged['index'],
        'bag': judged['bag'].fillna('').astype(str) if 'bag' in judged.columns else '',
        'rho': rho, 'rho_exact': exact, 'failed': failed,
        'left_runway': empty if left is None else left.to_numpy(dtype=np.float64, na_value=np.nan),
    })
    return pd.concat([facts, feature_columns(judged)], axis=1)


def _drawn(judged: pd.DataFrame) -> pd.Series[bool]:
    """Which runs the program itself drew; all, if the table says nothing of samplers."""
    drawn = pd.Series(True, judged.index)
    if 'sampler' in judged.columns:
        drawn = judged['sampler'].fillna('').isin(SIMPLY_DRAWN)
    if 'drawn' in judged.columns:
        drawn = judged['drawn'].fillna(drawn).astype(bool)
    return drawn


def _weights(drawn: pd.Series[bool], counted: pd.Series[bool]) -> pd.Series[float]:
    """1 for a run that was drawn and counts, else 0; all NaN if there is none."""
    both = drawn & counted
    return both.astype(np.float64) if both.any() else pd.Series(math.nan, drawn.index)


def _bounds(frame: pd.DataFrame, *, anytime: bool) -> tuple[float, float]:
    """Ends of the interval with undecided runs as satisfied, and as violated."""
    failed = frame.loc[frame['weight'] == 1, 'failed']
    least, most = (
        rate(int(failed.fillna(value).sum()), len(failed), anytime=anytime)
        for value in (False, True)
    )
    return least.low, most.high


def _plan(table: pd.DataFrame, facts: Mapping[str, Any]) -> tuple[bool, float]:
    """Whether the number of runs was not fixed beforehand, and the index below which runs count."""
    planned = planned_runs(facts)
    outcomes = dict(zip(table['index'].tolist(), table['outcome'].tolist(), strict=True))
    if len(outcomes) < len(table):
        return planned is not None, math.inf  # several campaigns, joined
    if sample_size_was_fixed(outcomes, planned):
        return False, math.inf
    return True, without_gaps(outcomes, planned)


def _unrecorded(table: pd.DataFrame, facts: Mapping[str, Any]) -> str:
    """What had to be assumed about the runs, or ''."""
    assumed = []
    if not facts:
        assumed.append(f'that their number was fixed beforehand (no {RECORD_NAME} beside it)')
    if not {'sampler', 'drawn'} & set(table.columns):
        assumed.append('that their program drew them (the table has no column sampler)')
    return f'about the runs it is assumed {" and ".join(assumed)}' if assumed else ''


def _first_words(broken: pd.DataFrame) -> str:
    """What broke the first of these runs; '' if that is not recorded."""
    words = broken[[name for name in ('who', 'detail') if name in broken.columns]]
    return ': '.join(filter(None, words.fillna('').iloc[0])) if len(words) else ''


def _check(
    judged: pd.DataFrame, decided: pd.Series[bool], others: str, path: Path, spec: str, first: str
) -> None:
    if not decided.any():
        why = f' ({others})' if others else ''
        if len(judged):
            why = f' by {spec}: all {len(judged)} were stopped before'
        first = f'; the first: {first}' if first else ''
        raise UsageError(f'{path}: no run was judged{why}, so there is nothing to analyse{first}')
    for name in _SCENE:
        if judged[name].isna().any():
            run = judged.loc[judged[name].isna(), 'run_id'].iloc[0]
            raise UsageError(f'{path}: run {run} was judged, but has no {name}; a damaged table?')


def _weighting(
    drawn: pd.Series[bool], weight: pd.Series[float], decided: pd.Series[bool]
) -> Weighting:
    if not (weight == 1).any():
        return Weighting.UNKNOWN
    if not decided.all():
        return Weighting.UNDECIDED
    return Weighting.DRAWN if drawn.all() else Weighting.WEIGHTED


def _blind(judged: pd.DataFrame) -> int:
    if not {'unusable_estimates', 'steps'} <= set(judged.columns):
        return 0
    share = judged['unusable_estimates'].astype('Float64') / judged['steps']
    passed = judged['outcome'] == Outcome.PASS.value
    return int((passed & (share > MOST_UNUSABLE_SHARE).fillna(value=False)).sum())


def _claimed(judged: pd.DataFrame) -> str:
    words = []
    for name, unit in (('cte', 'm'), ('he', 'deg')):
        most = judged.get(f'sigma_{name}_max_{unit}')
        if most is not None and most.notna().any():
            one, two = (judged[f'sigma_{name}_within_{times}'].mean() for times in (1, 2))
            words.append(
                f'of {name.upper()} at most {most.max():.2f} {unit}, {100 * one:.0f} % of the '
                f'errors within one, {100 * two:.0f} % within two'
            )
    if not words:
        return ''
    return 'Standard deviations that the estimates claim (if right and normal, 68 % of the ' \
        f'errors are within one, 95 % within two): {"; ".join(words)}.'


def _stacks(table: pd.DataFrame, path: Path) -> tuple[Provenance, ...]:
    """The provenance stored with the table, or with its campaign."""
    with_table = {str(name): value for name, value in table.attrs.items()}
    told = recorded_stacks(with_table) or recorded_stacks(facts_beside(path))
    return tuple(told.values())


def _common(column: pd.Series[str]) -> str:
    """The unique values of a column."""
    return ', '.join(dict.fromkeys(str(value) for value in column.dropna() if str(value)))


def _network(perception: str) -> str:
    return Path(perception).stem if perception.endswith(('.safetensors', '.onnx')) else perception


def facts_beside(path: Path) -> dict[str, Any]:
    """Facts of the campaign in the folder of a table; empty if there are none.

    Raises:
        UsageError: it is damaged.
    """
    if path.is_file() and path.name != PARQUET_NAME:
        return {}
    return read_facts(path if path.is_dir() else path.parent) or {}

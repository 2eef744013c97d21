"""What campaigns cover of an operational design domain, and with which failure rates.

A cell, or a combination of t cells, is covered if a *judged* run inside the ODD was in it. Runs
without a verdict cover nothing. Rates and their intervals are those of :mod:`.runs.campaign`: from
the runs that the program itself drew; they hold for one cell at a time, not for all together.

Coverage by cells is t-wise combinatorial coverage (Kuhn, Mendoza, Kacker and Lei, Combinatorial
coverage measurement concepts and applications, IWCT 2013).
"""

from __future__ import annotations

import math
import shlex
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd

from taxinet_ros.analysis.report.text import macro_text
from taxinet_ros.analysis.runs.campaign import CampaignRuns, GroupRate, group_rate
from taxinet_ros.analysis.runs.features import SCENE_COLUMNS
from taxinet_ros.core.scenario_fields import BY_KEY, CATALOGUES, DURATION, HUMAN_KEYS
from taxinet_ros.core.signals import points_of
from taxinet_ros.errors import UsageError
from taxinet_ros.files.plain_values import plain
from taxinet_ros.scenes.programs import SUFFIX, known_programs
from taxinet_ros.trials.odd.odd_file import OUTSIDE, Combination, Odd
from taxinet_ros.trials.rates import rate
from taxinet_ros.trials.run_command import RunSettings

Ints = npt.NDArray[np.int64]
Mask = npt.NDArray[np.bool_]

NAMES = {1: 'cells', 2: 'pairs', 3: 'triples'}
"""What combinations of so many cells are called."""
STRENGTHS = tuple(NAMES)
MOST_GAPS = 10


@dataclass(frozen=True, kw_only=True, slots=True)
class CellRuns:
    """The runs in one cell.

    Attributes:
        parameter: number of the parameter.
        cell: number of the cell.
        rate: runs, failures, and the rate of failure.
    """

    parameter: int
    cell: int
    rate: GroupRate


@dataclass(frozen=True, kw_only=True, slots=True)
class Strength:
    """Coverage of the combinations of ``t`` cells.

    Attributes:
        t: number of cells in a combination.
        feasible: number of feasible combinations.
        covered: number of those with a judged run.
        failing: number of those with a failure.
        below: number of those whose failure rate is below the limit at 95 %; None without a limit.
    """

    t: int
    feasible: int
    covered: int
    failing: int
    below: int | None

    @property
    def share(self) -> float:
        """Share of the feasible combinations that is covered."""
        return self.covered / self.feasible


@dataclass(frozen=True, kw_only=True, slots=True)
class Gap:
    """Pairs of cells without a run that have one cell in common.

    Attributes:
        parameter, cell: the common cell.
        other: number of the other parameter.
        cells: its cells.
    """

    parameter: int
    cell: int
    other: int
    cells: tuple[int, ...]


@dataclass(frozen=True, kw_only=True, slots=True)
class Pairs:
    """Runs in the pairs of cells of two parameters.

    Attributes:
        feasible: (sizes) which are feasible.
        runs, failures: (sizes) numbers of judged runs and of failures.
    """

    feasible: Mask
    runs: Ints
    failures: Ints


@dataclass(frozen=True, kw_only=True)
class OddCoverage:
    """What campaigns cover of an ODD.

    Attributes:
        odd: the operational design domain.
        campaigns: labels of the campaigns.
        spec: formula that defines failure.
        judged: number of judged runs, inside and outside.
        rate: failure rate of those inside.
        outside: number of judged runs outside by why; a run may have several reasons.
        unjudged: number of runs without a verdict, by outcome.
        limit: failure rate that ``below`` asks for, or None.
        cells: the runs of every cell.
        strengths: coverage of the combinations of 1, 2, … cells.
        pairs: runs in each pair of cells, by numbers of the two parameters.
        gaps: the largest gaps among feasible pairs of cells, the largest first.
        fixed: keys of parameters with the same value in all runs inside, though they have more.
        unmentioned: keys that varied between the judged runs, but are not in the ODD.
        cautions: what is to be known of the rates, a sentence each.
    """

    odd: Odd
    campaigns: tuple[str, ...]
    spec: str
    judged: int
    rate: GroupRate
    outside: Mapping[str, int]
    unjudged: Mapping[str, int]
    limit: float | None
    cells: tuple[CellRuns, ...]
    strengths: tuple[Strength, ...]
    pairs: Mapping[Combination, Pairs]
    gaps: tuple[Gap, ...]
    fixed: tuple[str, ...]
    unmentioned: tuple[str, ...]
    cautions: tuple[str, ...]

    @property
    def inside(self) -> int:
        """Number of judged runs inside the ODD."""
        return self.rate.runs

    def gap_words(self, gap: Gap) -> str:
        """A gap for people."""
        other = self.odd.parameters[gap.other]
        labels = [other.cells[one].label for one in gap.cells]
        return (
            f'{self.odd.parameters[gap.parameter].words(gap.cell)} with {other.field.label} '
            f'{", ".join(labels)}'
        )


def odd_coverage(
    odd: Odd, campaigns: Sequence[CampaignRuns], *, strengths: Sequence[int] = STRENGTHS,
    limit: float | None = None,
) -> OddCoverage:
    """Measure the coverage.

    Args:
        odd: the operational design domain.
        campaigns: one or more, of one system and judged by one formula.
        strengths: numbers of cells in a combination; those above the number of parameters are
            left out.
        limit: count the combinations whose failure rate is below this, 0..1 exclusively.

    Raises:
        UsageError: the campaigns are of different systems or formulas, or share runs.
    """
    _check_alike(campaigns)
    scenes = pd.concat([one.scenes for one in campaigns], ignore_index=True)
    failed = np.concatenate([one.failed for one in campaigns])
    weight = _weights(campaigns)
    # Who adds campaigns has seen the first before the next: the sum's number of runs was open.
    anytime = len(campaigns) > 1 or any(one.anytime for one in campaigns)
    points = [*map(points_of, scenes['signals'])]
    records: list[dict[str, Any]] = [
        {**dict(zip(odd.keys, values, strict=True)), **later} for values, later in zip(
            scenes[list(odd.keys)].to_numpy(dtype=object).tolist(), points, strict=True)
    ]
    places = np.array([odd.place(scene) for scene in records], dtype=np.int64)
    outside = _outside(odd, records, places)
    inside = np.array([not why for why in outside], dtype=bool)
    among = Inside(
        odd=odd, places=places[inside], failed=failed[inside], weight=weight[inside],
        anytime=anytime, limit=limit,
    )
    varied = [key for key in HUMAN_KEYS if scenes[key].nunique() > 1]
    varied += dict.fromkeys(name for later in points for name in later)
    kept = scenes[inside]
    # Sets of parameters are needed for the pairs even where nobody asks for their share.
    wanted = [t for t in strengths if t <= len(odd.parameters)]
    pairs = among.pairs()
    return OddCoverage(
        odd=odd, campaigns=tuple(one.label for one in campaigns), spec=campaigns[0].spec,
        judged=len(failed), rate=among.rate(np.ones(len(kept), dtype=bool)),
        outside=dict(Counter(why for whys in outside for why in whys).most_common()),
        unjudged=_unjudged(campaigns), limit=limit, cells=among.cells(),
        strengths=tuple(among.strength(t) for t in wanted), pairs=pairs,
        gaps=_gaps(odd, pairs),
        fixed=tuple(
            one.key for one in odd.parameters
            if len(kept) and kept[one.key].nunique() == 1 and (len(one.cells) > 1 or _wide(one))
        ),
        unmentioned=tuple(key for key in varied if key not in (*odd.keys, DURATION.key)),
        cautions=_cautions(campaigns),
    )


@dataclass(frozen=True, kw_only=True)
class Inside:
    """The judged runs inside an ODD, ready to be counted.

    Attributes:
        odd: the operational design domain.
        places: (n, parameters) cell of each run.
        failed: (n,) whether it failed.
        weight: (n,) 1 if the program itself drew it and it counts, else 0; NaN if none counts.
        anytime: whether the number of runs was open.
        limit: see :func:`odd_coverage`.
    """

    odd: Odd
    places: Ints
    failed: Mask
    weight: npt.NDArray[np.float64]
    anytime: bool
    limit: float | None

    def rate(self, among: Mask) -> GroupRate:
        """Failure rate of some of the runs."""
        return group_rate(self.failed[among], self.weight[among], anytime=self.anytime)

    def cells(self) -> tuple[CellRuns, ...]:
        """The runs of every cell."""
        return tuple(
            CellRuns(parameter=number, cell=cell, rate=self.rate(self.places[:, number] == cell))
            for number, one in enumerate(self.odd.parameters) for cell in range(len(one.cells))
        )

    def counts(self, each: Combination, among: Mask | None = None) -> Ints:
        """Number of runs in each combination of cells of some parameters."""
        places = self.places if among is None else self.places[among]
        found = np.zeros([self.odd.sizes[one] for one in each], dtype=np.int64)
        np.add.at(found, tuple(places[:, one] for one in each), 1)
        return found

    def pairs(self) -> dict[Combination, Pairs]:
        """The runs in each pair of cells."""
        if len(self.odd.parameters) < 2:
            return {}
        return {
            each: Pairs(
                feasible=mask, runs=self.counts(each), failures=self.counts(each, self.failed)
            ) for each, mask in self.odd.feasible(2).items()
        }

    def strength(self, t: int) -> Strength:
        """Coverage of the combinations of ``t`` cells."""
        feasible = covered = failing = below = 0
        drawn = self.weight == 1
        for each, mask in self.odd.feasible(t).items():
            feasible += int(mask.sum())
            covered += int((mask & (self.counts(each) > 0)).sum())
            failing += int((mask & (self.counts(each, self.failed) > 0)).sum())
            if self.limit is not None:
                hits = self.counts(each, self.failed & drawn)[mask]
                pairs, often = np.unique(
                    np.stack([hits, self.counts(each, drawn)[mask]]), axis=1, return_counts=True
                )
                below += sum(
                    int(times) for (k, n), times in zip(pairs.T.tolist(), often, strict=True)
                    if n and rate(k, n, anytime=self.anytime).high < self.limit
                )
        return Strength(
            t=t, feasible=feasible, covered=covered, failing=failing,
            below=None if self.limit is None else below,
        )


def _driven(one: CampaignRuns) -> dict[str, str]:
    """What drove a campaign's runs and judged them; '' where that is not recorded."""
    settings = RunSettings.from_facts(one.facts) if one.facts else None
    return {
        'perception': one.perception,
        'weights': str(one.facts.get('perception_sha256', ''))[:12],
        'controller': str(one.facts.get('controller', '')),
        'formula': one.spec, f'formula {one.spec}': one.formula,
        'gains': str(settings.gains) if settings else '',
        'timing': str(settings.timing) if settings else '',
    }


def _check_alike(campaigns: Sequence[CampaignRuns]) -> None:
    first, *_ = campaigns
    alike = _driven(first)
    for one in campaigns:
        for what, mine in _driven(one).items():
            other = alike.get(what, '')
            # A table without its record knows hardly more than names.
            unknown = what not in ('perception', 'formula') and '' in (mine, other)
            if mine != other and not unknown:
                raise UsageError(
                    f'{one.path}: has {what} {mine or "(none)"}, but {first.path} '
                    f'{other or "(none)"}; the coverage of two systems is not added up: name '
                    'campaigns of one'
                )
        if ',' in one.perception:
            raise UsageError(f'{one.path}: mixes runs of {one.perception}; make a table of each')
    seen: dict[tuple[Any, ...], Path] = {}
    for one in campaigns:
        frame = one.scenes[[*SCENE_COLUMNS]]
        scenes = {tuple(values) for values in frame.to_numpy(dtype=object).tolist()}
        double = next((seen[scene] for scene in scenes if scene in seen), None)
        if double is not None:
            raise UsageError(f'{one.path}: has runs that are in {double} too; name each once')
        seen |= dict.fromkeys(scenes, one.path)


def _weights(campaigns: Sequence[CampaignRuns]) -> npt.NDArray[np.float64]:
    """Which runs count for rates; NaN only if none of any campaign does."""
    found = np.concatenate([one.weight for one in campaigns])
    return found if np.isnan(found).all() else np.nan_to_num(found, nan=0.0)


def _outside(
    odd: Odd, records: Sequence[Mapping[str, Any]], places: Ints
) -> list[tuple[str, ...]]:
    """Why each run is outside; empty for those inside."""
    found = []
    for scene, cells in zip(records, places, strict=True):
        whys = [
            f'{one.field.label} {"in none of its cells" if cell == OUTSIDE else "not recorded"}'
            for one, cell in zip(odd.parameters, cells, strict=True) if cell < 0
        ]
        if not whys and (by := odd.excluded_by(scene)) is not None:
            whys = [f'excluded: {by.text} ({by.why})']
        found.append(tuple(whys))
    return found


def _unjudged(campaigns: Sequence[CampaignRuns]) -> dict[str, int]:
    found: Counter[str] = Counter()
    for one in campaigns:
        found.update(one.others)
        if one.undecided:
            found['stopped before the formula was decided'] += one.undecided
    return dict(found)


def _gaps(odd: Odd, pairs: Mapping[Combination, Pairs]) -> tuple[Gap, ...]:
    """Uncovered pairs, gathered by a common cell, the largest groups first."""
    empty = {each: one.feasible & (one.runs == 0) for each, one in pairs.items()}
    found: list[Gap] = []
    while len(found) < MOST_GAPS:
        best: tuple[tuple[int, float], Combination, int, int] | None = None
        for each, mask in empty.items():
            for axis in (0, 1):
                sums = mask.sum(axis=1 - axis)
                shares = sums / np.maximum(pairs[each].feasible.sum(axis=1 - axis), 1)
                # Of as many, those that leave the least over.
                cell = int(np.lexsort((-np.arange(len(sums)), shares, sums))[-1])
                size = int(sums[cell]), float(shares[cell])
                if sums[cell] and (best is None or size > best[0]):
                    best = size, each, axis, cell
        if best is None:
            break
        _, each, axis, cell = best
        line = empty[each][cell] if axis == 0 else empty[each][:, cell]
        cells = tuple(int(one) for one in np.flatnonzero(line))
        found.append(Gap(parameter=each[axis], cell=cell, other=each[1 - axis], cells=cells))
        line[:] = False
    return tuple(found)


def _wide(one: Any) -> bool:
    """Whether a parameter is a number with more than one value."""
    return bool(one.numeric) and one.ends[0] < one.ends[1]


def _cautions(campaigns: Sequence[CampaignRuns]) -> tuple[str, ...]:
    lines = [line for one in campaigns for line in one.warnings]
    lines += [f'no rate of {one.label}: {one.no_rate}' for one in campaigns if one.no_rate]
    programs = dict.fromkeys(one.program for one in campaigns)
    if len(programs) > 1:
        lines.append(
            f'runs of {len(programs)} programs ({", ".join(programs)}) are counted together: a '
            'rate is the mean of their rates, weighted by runs'
        )
    if len(campaigns) > 1:
        lines.append(
            'another campaign could have been added, so intervals are those valid at any number '
            'of runs'
        )
    elif any(one.anytime for one in campaigns):
        lines.append('a number of runs was open, so intervals are those valid at any time')
    return tuple(dict.fromkeys(lines))


def coverage_json(found: OddCoverage) -> dict[str, Any]:
    """Plain values for JSON; null for what is unknown."""
    odd = found.odd

    def rated(one: GroupRate) -> dict[str, Any]:
        return {
            'runs': one.runs, 'failures': one.failures,
            'drawn': 0 if math.isnan(one.effective) else int(one.effective),
            'rate': one.rate, 'low': one.low, 'high': one.high,
        }

    return plain({
        'odd': {'name': odd.name, 'source': odd.source, 'sha256': odd.digest},
        'campaigns': found.campaigns, 'spec': found.spec, 'judged': found.judged,
        'inside': rated(found.rate), 'outside': found.outside,
        'unjudged': found.unjudged, 'limit': found.limit,
        'parameters': [
            {
                'key': one.key, 'unit': one.field.unit, 'source': one.source,
                'cells': [
                    {'label': one.cells[each.cell].label, **rated(each.rate)}
                    for each in found.cells if each.parameter == number
                ],
            } for number, one in enumerate(odd.parameters)
        ],
        'excluded': [{'when': one.text, 'why': one.why} for one in odd.exclusions],
        'combinations': [
            {'t': one.t, 'feasible': one.feasible, 'covered': one.covered, 'share': one.share,
             'failing': one.failing, 'below_limit': one.below} for one in found.strengths
        ],
        'gaps': [
            {'key': odd.parameters[one.parameter].key,
             'cell': odd.parameters[one.parameter].cells[one.cell].label,
             'with': odd.parameters[one.other].key,
             'cells': [odd.parameters[one.other].cells[cell].label for cell in one.cells]}
            for one in found.gaps
        ],
        'never_varied': found.fixed, 'not_in_odd': found.unmentioned,
        'cautions': found.cautions,
    })


def coverage_lines(
    found: OddCoverage, name: str, runs: Sequence[CampaignRuns]
) -> tuple[str, str]:
    """What the command prints before and after the table of cells.

    Args:
        found: the coverage.
        name: what the user calls the ODD.
        runs: the campaigns.
    """
    path = Path(__file__).with_suffix('.j2')
    thin = next((one for one in found.strengths if one.covered < one.feasible), None)
    command = '' if thin is None else _falsify_words(
        found.odd, runs,
        ('--sampler', 'coverage', '--odd', name, '--sampler-option', f'strength={thin.t}'),
    )
    return macro_text(path, 'before', f=found), macro_text(
        path, 'after', f=found, fields=BY_KEY, names=NAMES, command=command)


def _falsify_words(odd: Odd, runs: Sequence[CampaignRuns], words: Sequence[str]) -> str:
    """The command that searches further as one campaign of a shipped program did; else in words."""
    one, program = runs[0], runs[0].program.removesuffix(SUFFIX)
    if len(runs) == 1 and one.facts and one.perception and program in known_programs():
        settings = RunSettings.from_facts(one.facts)
        # What was set of the ODD's own parameters is what leaves gaps.
        values = {
            key: value for key, value in settings.values.items()
            if key not in [parameter.key for parameter in odd.parameters]
        }
        settings = replace(settings, perception=one.perception, values=values)
        if not settings.timing.free and all(
            str(values[key]) in CATALOGUES[key].shipped for key in set(CATALOGUES) & set(values)
        ):
            return settings.command(program, *words, verb='falsify')
    return f'taxinet falsify PROGRAM {shlex.join(words)}, with the other options of these runs'

"""Printed lines of a campaign: heading, one line per run, and summary."""

from __future__ import annotations

import math
import shlex
import statistics
from array import array
from collections import Counter
from collections.abc import Collection, Iterable, Mapping
from pathlib import PurePath
from types import MappingProxyType
from typing import Any

from rich.text import Text

from taxinet_ros.core.motion.controller import STEERING
from taxinet_ros.core.mtl.specs import MOST_UNUSABLE_SHARE
from taxinet_ros.core.pacing.free_run import free_run_line
from taxinet_ros.core.place.catalogue import DEFAULT_PLACE
from taxinet_ros.core.place.track import RUNWAY_TRACK
from taxinet_ros.core.rig.catalogue import DEFAULT_AIRCRAFT, DEFAULT_CAMERA
from taxinet_ros.core.scenario_fields import (
    AIRCRAFT_MODEL,
    CAMERA,
    PLACE,
    RAIN,
    SKY,
    TIME_OF_DAY,
    TRACK,
    along_words,
    clock_words,
    unusual_words,
)
from taxinet_ros.core.types import time_words
from taxinet_ros.core.verdict.judge import SpecCheck
from taxinet_ros.core.verdict.outcome import Outcome
from taxinet_ros.files.plain_values import plain
from taxinet_ros.registry import KMWH
from taxinet_ros.trials.options import LOOP, CampaignOptions
from taxinet_ros.trials.rates import (
    Planned,
    ProgramRate,
    Verdict,
    count_kinds,
    count_words,
    failure_rate,
)
from taxinet_ros.trials.record.row import RunRow

_MOST_NAMED = 5
"""Maximum number of runs named in one line."""
_MOST_COLUMNS = 100
_NOTES_END = 45
_COLUMNS = '  run                    farthest              start left  nose   along  time, sky'
_USUAL = ('', DEFAULT_PLACE, DEFAULT_AIRCRAFT, DEFAULT_CAMERA, RUNWAY_TRACK)

ON_STANDING_GRAPH = 'on the graph that runs'
"""Text for nodes that were started externally."""

_STYLES = {
    Outcome.PASS: 'green',
    Outcome.FAIL: 'red',
    Outcome.REJECTED: 'yellow',
    Outcome.INFRA_ERROR: 'bold magenta',
    Outcome.INTERRUPTED: 'yellow',
}


class Summary:
    """What is said of a campaign's rows at its end. They are taken one by one, and not kept.

    Attributes:
        outcomes: number of rows by outcome.
        worst: the judged row with the least robustness of what it is shown by, if any.
        first_rejected: why the first scene that was rejected was, or ''.
        off_runway: number of runs that left the runway.
    """

    def __init__(self, rows: Iterable[RunRow] = ()) -> None:
        """Take some rows."""
        self.outcomes: Counter[Outcome] = Counter()
        self.worst: RunRow | None = None
        self.first_rejected = ''
        self._kinds: Counter[str] = Counter()
        self._indices = array('q')
        self._verdicts: list[tuple[Outcome, bool | None, bool, str]] = []
        self._same: dict[tuple[Outcome, bool | None, bool, str], Any] = {}
        self._speeds = array('d')
        self._folders: set[PurePath] = set()
        self._free: list[Mapping[str, float]] = []
        self._blind: list[int] = []
        self._refused = self.off_runway = self._stopped = 0
        self._stopped_on = False
        self._whole_s = self._saved_s = 0.0
        for row in rows:
            self.take(row)

    def take(self, row: RunRow) -> None:
        """Take one row."""
        self.outcomes[row.outcome] += 1
        verdict = row.outcome, row.left_runway, row.from_program, row.sampler
        self._indices.append(row.index)
        self._verdicts.append(self._same.setdefault(verdict, verdict))  # not a new one for each
        self._refused += row.refused
        if row.kind:
            self._kinds[row.kind] += 1
        if row.bag:
            self._folders.add(PurePath(row.bag).parent)
        if 'loop_wall_median_s' in row.free:
            self._free.append(row.free)
        if row.outcome is Outcome.REJECTED:
            self.first_rejected = self.first_rejected or row.detail
        if row.outcome.judged:
            self._take_judged(row)

    def _take_judged(self, row: RunRow) -> None:
        self._speeds.append(row.real_time_factor)
        self.off_runway += bool(row.left_runway)
        self._whole_s += row.duration_s or 0.0
        if row.stopped_early:
            self._stopped += 1
            self._saved_s += (row.duration_s or 0.0) - row.sim_s
            self._stopped_on |= not row.left_runway
        if row.passed_blind:
            self._blind.append(row.index)
        if self.worst is None or _least(row) < _least(self.worst):
            self.worst = row

    def __len__(self) -> int:
        return len(self._indices)

    @property
    def judged(self) -> int:
        """Number of judged rows."""
        return len(self._speeds)

    @property
    def indices(self) -> Collection[int]:
        """Indices of the rows."""
        return set(self._indices)

    @property
    def verdicts(self) -> list[Verdict]:
        """What rates need of each row."""
        return [
            Verdict(index, *verdict)
            for index, verdict in zip(self._indices, self._verdicts, strict=True)
        ]

    @property
    def speed(self) -> float:
        """Median real-time factor of the judged rows, of which there are some."""
        return statistics.median(self._speeds)

    def count_words(self) -> str:
        """Number of rows by outcome, e.g. ``4 PASS, 3 INFRA_ERROR (2 timeout, 1 died)``."""
        counts = {outcome.value: self.outcomes[outcome] for outcome in Outcome}
        return count_words(counts, count_kinds(self._kinds.elements()))

    def blind_words(self) -> list[str]:
        """Line on the runs that passed although the perception was blind, if any."""
        blind = sorted(self._blind)
        if not blind:
            return []
        more = ', …' if len(blind) > _MOST_NAMED else ''
        named = ', '.join(map(str, blind[:_MOST_NAMED])) + more
        return [
            f'warning: {len(blind)} passed with more than {MOST_UNUSABLE_SHARE:.0%} of their '
            f'frames without a usable estimate (run {named}); the formula usable fails them'
        ]

    def refused_words(self) -> list[str]:
        """Lines on draws rejected by the requirements, and on impossible scenes."""
        lines = []
        if self._refused:
            lines.append(f'{self._refused} draws refused by the requirements and replaced')
        if rejected := self.outcomes[Outcome.REJECTED]:
            lines.append(
                f'{rejected} of {len(self)} scenes rejected; shares are among the judged runs; '
                f'the first: {self.first_rejected}'
            )
        return lines

    def free_words(self) -> list[str]:
        """Line on free runs, if any."""
        free = self._free
        if not free:
            return []
        frames, unanswered, overruns = (
            sum(one[name] for one in free) for name in ('frames', 'unanswered', 'overruns')
        )
        late = f'; {overruns:.0f} frames out late: not the pace asked for' if overruns else ''
        median_s = statistics.median(one['loop_wall_median_s'] for one in free)
        return [
            f'free runs, which need not come out so again: {unanswered:.0f} of {frames:.0f} frames '
            f'unanswered, loop {median_s:.3f} s by the clock, at most '
            f'{max(one["loop_wall_max_s"] for one in free):.3f} s, '
            f'{statistics.median(one.get("factor", math.nan) for one in free):.2f}x real time{late}'
        ]

    def off_runway_words(self) -> str:
        """Number of runs that left the runway; unknown for runs stopped before."""
        before = ' before they were stopped' if self._stopped_on else ''
        return f'{self.off_runway} off the runway{before}'

    def stopped_words(self) -> list[str]:
        """Line on the runs stopped early and the time saved, if any."""
        if not self._stopped:
            return []
        return [
            f'{self._stopped} stopped early, which saved {self._saved_s:.0f} of '
            f'{self._whole_s:.0f} s of simulated time ({self._saved_s / self._whole_s:.0%})'
        ]

    def table_line(self, options: CampaignOptions) -> str:
        """Line with the paths of table and bags."""
        folders = {options.out / folder for folder in self._folders}
        if not options.standing_graph:
            folders = {options.out}
        bags = ', '.join(f'{folder}/<run>/' for folder in sorted(folders))
        bags = bags or "where the graph's recorder writes them"
        return f'table: {options.out / "runs.csv"}, runs.parquet; bags: {bags}'

    def next_line(self, options: CampaignOptions) -> list[str]:
        """Line with the command that is useful next: for failures the one that explains them."""
        out = shlex.quote(str(options.out))
        if options.standing_graph or not self.judged:
            return []
        if self.outcomes[Outcome.FAIL]:
            return [f'next: taxinet why {out}']
        return [f'next: taxinet gate {out} --min-satisfaction 0.95']


def _least(row: RunRow) -> tuple[float, float, int]:
    return row.shown.upper, row.shown.lower, row.index


def campaign_heading(options: CampaignOptions, here: str = 'one process') -> str:
    """Heading that describes the campaign; ``here`` is what one graph of it runs in."""
    runs = 'run' if options.runs == 1 else 'runs'
    layout = 'separate processes' if options.processes else here
    layout = layout if options.workers == 1 else workers_words(options)
    graph = f'{participants_words(options)}, {layout}'
    return (
        f'{options.runs} {runs} of {options.program}, seed {options.seed}, '
        f'{ON_STANDING_GRAPH if options.standing_graph else graph} -> {options.out}'
    )


def workers_words(options: CampaignOptions) -> str:
    """What makes the runs: workers here, or a cluster."""
    if options.cluster:
        return f'cluster {options.cluster}'
    return '1 worker' if options.workers == 1 else f'{options.workers} workers'


def participants_words(options: CampaignOptions) -> str:
    """Perception, controller and world as text; defaults are omitted."""
    steers = '' if options.controller == STEERING else f', controller {options.controller}'
    there = '' if options.world == KMWH else f', world {options.world}'
    late = f', {options.timing.words}' if options.timing.words else ''
    loop = f', {engine_words(options)}' if options.engine == LOOP else ''
    return f'perception {options.perception}{steers}{there}{late}{loop}'


def engine_words(options: CampaignOptions) -> str:
    """The engine, and which share of its runs is audited on the graph."""
    return f'engine {options.engine}, {options.audit_percent:g} % audited'


def requirement_lines(check: SpecCheck, *, quiet: bool = False) -> list[Text]:
    """Lines on how the requirements are interpreted, with warnings of likely mistakes."""
    lines = [] if quiet else [Text(line, style='dim') for line in check.lines]
    return [*lines, *(Text(f'warning: {line}', style='yellow') for line in check.warnings)]


def row_headings(check: SpecCheck, runs: int, *, columns: bool = True) -> list[Text]:
    """Lines above those of runs: what all scenes have, and the names of the columns."""
    words = circumstances(check.shared)
    lines = [f'{"scene" if runs == 1 else "every scene"}: {words}'] if words else []
    return [Text(line, style='dim') for line in (*lines, *([_COLUMNS] if columns else []))]


def row_line(row: RunRow, shared: Mapping[str, Any] = MappingProxyType({})) -> Text:
    """One run in 100 columns; a longer reason why it was not judged is not cut.

    Args:
        row: the run.
        shared: scenario values that all scenes have, which are not repeated.
    """
    text = Text(f'{row.index:5d}  ')
    text.append(f'{row.outcome:<4}', style=_STYLES[row.outcome])
    if not row.outcome.judged:
        words = [word for word in (row.kind, row.who) if word]
        text.append(f' {" ".join(words)}: ' if words else ' ')
        return text.append(f'{row.detail}  ').append(scene_words(row), style='dim')
    text.append(f'  {rho_words(row, 7)}  {row.max_cross_track_m:5.1f} m  ')
    notes = [name] if (name := _other_than_headline(row)) else []
    if row.stopped_early and row.stopped_s is not None:
        notes.append(f'stopped at {time_words(row.stopped_s)}')
    if row.unusable_share > MOST_UNUSABLE_SHARE:
        notes.append(f'{row.unusable_estimates} of {row.steps} estimates unusable')
    notes += [free_run_line(row.free)] if row.free else []
    notes += [_sigma_words(row.sigma)] if row.sigma else []
    text.append('off runway' if row.left_runway else '', style='red')
    text.append(', '.join(['', *notes] if row.left_runway else notes), style='yellow')
    text.pad_right(_NOTES_END - len(text))
    own = {key: value for key, value in row.scene.items() if shared.get(key) != value}
    start = (
        f'  {row.cross_track_m:+6.1f} m {row.heading_deg:+4.0f}° {row.distance_m:6.0f} m'
        f'  {circumstances(own)}'
    )
    room = max(_MOST_COLUMNS - len(text), 0)
    return text.append(start if len(start) <= room else start[:room - 1] + '…', style='dim')


def _sigma_words(sigma: Mapping[str, float]) -> str:
    """What covariances claimed of the errors, and how it fits."""
    return ', '.join(
        f'{name.upper()} sigma <= {sigma[most]:.2f} {unit}, '
        f'{sigma[f"{name}_within_1"]:.0%} within 1'
        for name, unit in (('cte', 'm'), ('he', 'deg')) if (most := f'{name}_max_{unit}') in sigma
    )


def rho_words(row: RunRow, width: int = 0) -> str:
    """The robustness that a run is shown by, or its bounds if the run was stopped early."""
    return row.shown.bound_words(width)


def worst_words(row: RunRow) -> str:
    """The same, with the name of the formula if it is not the headline."""
    name = _other_than_headline(row)
    return f'{rho_words(row)} of {name}' if name else rho_words(row)


def _other_than_headline(row: RunRow) -> str:
    """Name of the formula that a run is shown by, if it is not the headline; ''."""
    return '' if row.decisive == next(iter(row.robustness)) else row.decisive


def scene_words(row: RunRow) -> str:
    """Short description of a scene in human units; empty if none was drawn."""
    if row.time_of_day_h is None or row.rain_percent is None:
        return ''
    track = '' if row.track in ('', RUNWAY_TRACK) else f' {along_words(row.track)}'
    return (
        f'CTE {row.cross_track_m:+.1f} m  HE {row.heading_deg:+.0f} deg  '
        f'at {row.distance_m:.0f} m{track}  {circumstances(row.scene)}'
    )


def circumstances(scene: Mapping[str, Any]) -> str:
    """What a scene has beside its start, such as ``17:58 overcast rain 30 %``.

    Args:
        scene: in human units, by key; missing ones are left out.
    """
    hour, rain = scene.get(TIME_OF_DAY.key), scene.get(RAIN.key)
    words = ' '.join(filter(None, [
        '' if hour is None else clock_words(hour), scene.get(SKY.key),
        f'rain {_percent(rain)} %' if rain else '',
    ]))
    named = ((key, str(scene.get(key) or '')) for key in (
        PLACE.key, TRACK.key, AIRCRAFT_MODEL.key, CAMERA.key))
    where = ''.join(f', {key} {name.partition("@")[0]}' for key, name in named
                    if name not in _USUAL)
    return f'{words}{unusual_words(scene)}{where}'.lstrip(' ,')


def _percent(value: float) -> str:
    """A percentage without decimals; positive values are never shown as 0."""
    return f'{value:.0f}' if value >= 1 else f'{value:.1g}'


def campaign_summary(found: Summary, options: CampaignOptions) -> str:
    """Text of the summary: counts, rate with its interval, speed, and path of the table."""
    lines = [found.count_words()]
    if found.judged:
        rate = _satisfied_words(failure_rate(found.verdicts, options.runs))
        lines.append(f'{rate}, {found.off_runway_words()}, median {found.speed:.1f}x real time')
        lines += [*found.stopped_words(), *found.blind_words()]
    lines += [*found.free_words(), *found.refused_words()]
    lines += [found.table_line(options), *found.next_line(options)]
    return '\n'.join(line for line in lines if line)


def summary_json(found: Summary, options: CampaignOptions, planned: Planned) -> dict[str, Any]:
    """The summary as plain values for JSON.

    Args:
        found: the summary.
        options: of the campaign.
        planned: see :func:`~taxinet_ros.trials.rates.failure_rate`.
    """
    failed, row = failure_rate(found.verdicts, planned), found.worst
    rate, worst = None, None
    if row is not None:
        other = _other_than_headline(row)
        worst = {
            'run_id': row.run_id, 'outcome': row.outcome.value,
            'rho': row.shown, **({'spec': other} if other else {}),
        }
    if failed.rate is not None:
        value, low, high = failed.rate.other
        rate = {
            'value': value, 'low': low, 'high': high, 'confidence': 0.95,
            'anytime': failed.anytime,
        }
    return plain({
        'program': options.program, 'seed': options.seed, 'perception': options.perception,
        'controller': options.controller, 'runs': len(found),
        'outcomes': {
            outcome.value: number for outcome in Outcome if (number := found.outcomes[outcome])
        },
        'off_runway': found.off_runway,
        'satisfied': rate, 'why_no_rate': failed.why_not or None,
        'worst': worst, 'out': options.out,
    })


def _satisfied_words(failed: ProgramRate) -> str:
    if failed.rate is None:
        return failed.why_not
    value, low, high = failed.rate.other
    when = ' that holds wherever a campaign stops' if failed.anytime else ''
    return f'satisfied {value:.0%} (95 % interval{when} {low:.0%}-{high:.0%})'

"""Shrinking of a failed run: a campaign whose scenes :mod:`.algorithm` chooses.

Its folder is a campaign folder. The next run depends only on the results, so a resumed shrinking
takes those of earlier sessions by their scenes. Runs without a verdict are repeated under their old
numbers, so the table equals that of an uninterrupted one. A :class:`Report` says what each
parameter has to do with the failure.
"""

from __future__ import annotations

import contextlib
import dataclasses
import json
import shlex
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.table import Table
from rich.text import Text

from taxinet_ros.core.assurance.switch import check_controller
from taxinet_ros.core.motion.controller import STEERING
from taxinet_ros.core.mtl.interval import rho_text
from taxinet_ros.core.perception.perception import check_perception
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.scenario_fields import BY_KEY, RAIN_CLOUDS
from taxinet_ros.core.verdict.judging import Judging
from taxinet_ros.core.verdict.outcome import Outcome
from taxinet_ros.errors import InfraError, UsageError
from taxinet_ros.trials.engine import Engine, Proposer, with_workers
from taxinet_ros.trials.options import (
    AUDIT,
    DEFAULT_ROOT,
    CampaignOptions,
    make_options,
    new_folder,
)
from taxinet_ros.trials.past_runs.recorded_campaign import JudgedRun, check_unchanged, find_run
from taxinet_ros.trials.record.content import CampaignContent
from taxinet_ros.trials.record.facts import facts_of_runs
from taxinet_ros.trials.record.row import RunRow
from taxinet_ros.trials.run_command import RunSettings
from taxinet_ros.trials.shrink.algorithm import LEAST_ASKED, End, Point, ShrinkSearch, State
from taxinet_ros.trials.shrink.space import STEPS, Parameter, ShrinkSpace, make_shrink_space
from taxinet_ros.trials.summary import participants_words, scene_words, workers_words

PROGRAM = 'shrink'
"""Program name of runs without a program, in run names and in the table."""


class Shrinking(Proposer):
    """Proposes the scenes that a failed run is shrunk with.

    Attributes:
        run: the failed run.
        space: the scenarios that may be run.
        headline: name of the formula that must stay violated.
        told: what is said of it and of the others that the run violates, in sentences.
        search: search state.
        judged: the judged run of each point asked for.
    """

    patience, runs = 1, None

    def __init__(
        self, run: JudgedRun, space: ShrinkSpace, campaign: CampaignOptions,
        told: Sequence[str] = (),
    ) -> None:
        """Create it; nothing is written.

        Args:
            run: the failed run.
            space: the scenarios that may be run.
            campaign: options of the runs; ``runs`` limits those of the search.
            told: see the class.
        """
        self.run, self.space, self.campaign = run, space, campaign
        self.headline, self.told = campaign.judging.headline, tuple(told)
        self.source: AbstractContextManager[None] = contextlib.nullcontext()
        self.search = ShrinkSearch(
            [one.axis for one in space.moving], most=campaign.runs, rule=space.possible
        )
        self.judged: dict[Point, RunRow] = {}
        self._points: dict[int, Point] = {}
        self._numbers: dict[str, int] = {}
        self._broken_before: dict[str, int] = {}
        self._undone: list[int] = []
        self._next = 0

    def prepare(self) -> dict[str, Any]:
        """See :class:`.Proposer`."""
        space, perception = self.space, self.campaign.perception
        return facts_of_runs(self.campaign, {
            'program': PROGRAM,
            'shrinks': self.run.run_id,
            'original': space.original.to_human(),
            'nominal': space.nominal.to_human(),
            'parameters': [one.key for one in space.parameters],
            'steps': STEPS,
            'perception_sha256': check_perception(perception, graph=True),
        })

    def resume(self, content: CampaignContent) -> tuple[Mapping[int, RunRow], Mapping[str, Any]]:
        """See :class:`.Proposer`."""
        self._next = content.begun
        done = {row.index: row for row in content.rows if row.outcome.judged}
        self._numbers = {_key(row.scene): row.index for row in done.values()}
        self._undone = sorted(set(range(self._next)) - done.keys())
        self._broken_before = {
            _key(row.scene): row.retries + (row.outcome is Outcome.INFRA_ERROR)
            for row in content.rows if not row.outcome.judged
        }
        return done, {}

    def stop_reason(self) -> str:
        """See :class:`.Proposer`."""
        return self.search.state.end.value

    def propose(self) -> int | None:
        """See :class:`.Proposer`."""
        under_way = set(self._points.values()) - self.judged.keys()
        point = next((point for point in self.search.wanted if point not in under_way), None)
        if point is None:
            return None
        index = self._numbers.get(_key(self.space.scenario(point).to_human()))
        if index is None and self._undone:
            index = self._undone.pop(0)
        elif index is None:
            index, self._next = self._next, self._next + 1
        self._points[index] = point
        return index

    def scene(self, index: int) -> Scenario:
        """See :class:`.Proposer`."""
        return self.space.scenario(self._points[index])

    def completed(self, row: RunRow) -> RunRow:
        """See :class:`.Proposer`."""
        return row.with_choice(
            sampler=PROGRAM, point={}, weight=None,
            retries=self._broken_before.get(_key(row.scene), 0),
        )

    def take(self, row: RunRow) -> None:
        """See :class:`.Proposer`."""
        if row.outcome.judged:
            point = self._points[row.index]
            self.judged[point] = row
            self.search.tell(point, row.rho[self.headline])


def make_shrinking(
    path: Path, *, runs: int, out: Path | None, perception: str | None = None,
    controller: str | None = None, specs: Sequence[str] = (), nominal: Sequence[str] = (),
    images: str = 'none', resume: bool = False, workers: int = 1, cluster: str | None = None,
    **others: Any,
) -> Shrinking:
    """Check what a user asks for; what is not named here is as in :func:`.make_options`.

    Args:
        path: folder of the failed run.
        runs: maximum number of runs of the search.
        out: as there.
        perception: perception, if not the run's.
        controller: controller, if not the run's.
        specs: formulas as text; if empty the run's, the one to look into first. The name of one of
            several of the run's names that one.
        nominal: ``key=value`` of the nominal scenario.
        images: record ``all`` or ``none`` of the camera frames.
        resume: as there.
        workers: see :func:`.with_workers`.
        cluster: likewise.
        others: engine and audit.

    Raises:
        UsageError: one line on the first error.
    """
    if runs < LEAST_ASKED:
        raise UsageError(f'runs {runs}: needs to be {LEAST_ASKED} or more')
    run = find_run(path)
    if why := run.not_again:
        raise UsageError(
            f'{path}: {why}, so nothing tells a scenario that matters from chance; shrink a run '
            'in lockstep'
        )
    several = Judging(specs=run.specs).names if len(run.specs) > 1 else ()
    asked = specs[0] if len(specs) == 1 and specs[0] in several else None
    _check_failed(path, run, asked, other_specs=bool(specs) and asked is None)
    told: Sequence[str] = ()
    if run.specs and (asked or not specs):
        examined = run.examine(asked)
        specs = Judging(specs=run.specs).headed_by(examined.spec).specs
        told = tuple(filter(None, [
            examined.chosen, examined.also(f'taxinet shrink {shlex.quote(str(path))}')]))
    if out is None and not resume:
        out = new_folder(DEFAULT_ROOT / f'{PROGRAM}-{run.run_id}')
    if perception is None:
        perception = run.perception
        check_unchanged(
            'perception', perception, lambda: check_perception(run.perception, graph=True),
            run.fingerprint, 'name it as perception, at its new place or as it is',
        )
    if not controller:
        controller = run.controller
        check_unchanged(
            'controller', controller, lambda: check_controller(run.controller, graph=True),
            run.controller_sha256, 'name what to steer with as controller',
        )
    campaign = make_options(
        program=PROGRAM, runs=runs, seed=run.seed, out=out, images=images, resume=resume,
        perception=perception, controller=controller, specs=specs, world=run.world,
        **others,
    )
    space = make_shrink_space(run.scenario, nominal, campaign.judging.parsed_specs)
    gains = dict(run.gains) if campaign.controller == STEERING else {}
    campaign = dataclasses.replace(campaign, gains=gains, timing=run.timing)
    return Shrinking(run, space, with_workers(campaign, workers, cluster), told)


def _check_failed(path: Path, run: JudgedRun, asked: str | None, *, other_specs: bool) -> None:
    if not run.outcome.judged:
        raise UsageError(f'{path}: {run.outcome}, so it was never judged; name a run that failed')
    if other_specs:
        return
    spec = run.examine(asked).spec
    interval = run.robustness.get(spec)
    if interval is not None and interval.satisfied:
        raise UsageError(
            f'{path}: satisfied {spec} with {interval.words(".2f")}; name a run that '
            'failed, or a formula that it failed'
        )


def _key(scene: Mapping[str, Any]) -> str:
    """Key of a scene in human units."""
    return json.dumps(scene)


@dataclass(frozen=True, kw_only=True, slots=True)
class Finding:
    """Result for one parameter, in human units; None for values that were not run.

    Attributes:
        key: name of the parameter.
        original, nominal, shrunk: its value in the failed, the nominal and the shrunk scenario.
        rho_in_original, rho_in_shrunk: robustness of either with this parameter set to nominal.
        passes_at: the value one step nearer to nominal than ``shrunk``, if it passes.
        rho_passes_at: robustness there, above 0.
    """

    key: str
    original: Any
    nominal: Any
    shrunk: Any
    rho_in_original: float | None = None
    rho_in_shrunk: float | None = None
    passes_at: Any = None
    rho_passes_at: float | None = None

    @property
    def off_nominal(self) -> bool:
        """Whether it differs from nominal in the shrunk scenario."""
        return bool(self.shrunk != self.nominal)

    @property
    def matters(self) -> bool | None:
        """Whether the shrunk scenario passes with it at nominal; None if that was not run."""
        if not self.off_nominal:
            return False
        return None if self.rho_in_shrunk is None else self.rho_in_shrunk > 0

    def words(self, value: Any) -> str:
        """A value of the parameter, with its unit."""
        return BY_KEY[self.key].value_words(value)


@dataclass(frozen=True, kw_only=True, slots=True)
class Report:
    """Result of a shrinking.

    Attributes:
        state: progress of the search, and why it ended.
        findings: one for each parameter.
        scenario: the shrunk scenario.
        original, nominal, shrunk: rows of the three runs; None if missing.
        dry: whether nominal clouds also remove the rain, since no rain falls from that sky.
    """

    state: State
    findings: tuple[Finding, ...]
    scenario: Scenario
    original: RunRow | None
    nominal: RunRow | None
    shrunk: RunRow | None
    dry: bool


def make_report(shrinking: Shrinking) -> Report:
    """Report of the results so far."""
    space, search = shrinking.space, shrinking.search
    state = search.state
    axes = {one.key: number for number, one in enumerate(space.moving)}
    return Report(
        state=state,
        findings=tuple(
            _finding(shrinking, one, axes[one.key], state.at) if one.key in axes
            else Finding(key=one.key, original=one.values[0], nominal=one.values[0],
                         shrunk=one.values[0])
            for one in space.parameters
        ),
        scenario=space.scenario(state.at),
        original=shrinking.judged.get(search.start), nominal=shrinking.judged.get(search.origin),
        shrunk=shrinking.judged.get(state.at),
        dry=space.original.rain_fraction > 0 and space.nominal.clouds not in RAIN_CLOUDS,
    )


def check_run(engine: Engine[Shrinking], found: Report) -> None:
    """Check that the runs have a result, and that the original one failed again.

    Raises:
        InfraError: the test bench failed.
        UsageError: the run does not fail again.
    """
    if (row := engine.broken) is not None:
        often = '' if row.kind == AUDIT else 'twice '
        detail = f'{row.detail or row.outcome} ({often}in run {row.run_id}; resume it)'
        raise InfraError(row.kind or 'broken', row.who or 'bench', row.steps - 1, detail)
    if found.state.end is not End.NOT_REPRODUCED:
        return
    shrinking = engine.proposer
    assert found.original is not None
    name = shrinking.headline
    interval = shrinking.run.robustness.get(name)
    before = f', recorded as {interval.bound_words().removeprefix("rho ")}' if interval else ''
    raise UsageError(
        f'{shrinking.run.run_id}: not reproduced: on rerun, {name} has rho '
        f'{rho_text(found.original.rho[name])}{before}; was it recorded with another version, '
        'perception or gains?'
    )


def _finding(shrinking: Shrinking, one: Parameter, axis: int, at: Point) -> Finding:
    search, steps = shrinking.search, at[axis]
    beside = search.rho(search.moved(at, axis, steps - 1)) if steps else None
    passes = beside if beside is not None and beside > 0 else None
    return Finding(
        key=one.key, original=one.values[-1], nominal=one.values[0], shrunk=one.values[steps],
        rho_in_original=search.rho(search.moved(search.start, axis, 0)),
        rho_in_shrunk=search.rho(search.moved(at, axis, 0)) if steps else None,
        passes_at=None if passes is None else one.values[steps - 1], rho_passes_at=passes,
    )


_MATTERS = {
    True: Text('matters', style='bold red'), False: Text('does not matter', style='dim'),
    None: Text('not known', style='dim'),
}


def shrink_heading(shrinking: Shrinking) -> str:
    """Heading that describes the shrinking."""
    campaign, run = shrinking.campaign, shrinking.run
    verb = 'resuming to shrink' if campaign.resume else 'shrinking'
    interval = run.robustness.get(shrinking.headline)
    rho = f', {interval.bound_words()}' if interval else ''
    return (
        f'{verb} {run.run_id} ({shrinking.headline}{rho}), {participants_words(campaign)}, '
        f'{workers_words(campaign)} -> {campaign.out}'
    )


_LONG_KEY = 20
"""Longer names of parameters leave less room between columns of a terminal of 80."""


def parameter_table(report: Report) -> Table:
    """Every parameter with its three values, and whether it matters."""
    long = max(len(one.key) for one in report.findings) > _LONG_KEY
    table = Table(box=None, pad_edge=False, padding=(0, 1 if long else 2, 0, 0))
    table.add_column('parameter', no_wrap=True)
    for name in ('original', 'nominal', 'shrunk'):
        words = [name, *(one.words(getattr(one, name)) for one in report.findings)]
        # Several objects take several lines.
        table.add_column(
            name, justify='right', min_width=max(map(len, ' '.join(words).split())))
    for name in ('rho in\noriginal', 'rho in\nshrunk'):
        table.add_column(name, justify='right', no_wrap=True)
    table.add_column('verdict')
    for one in report.findings:
        verdict = _MATTERS[one.matters]
        if one.original == one.nominal:
            verdict = Text('nominal already', style='dim')
        table.add_row(
            one.key, one.words(one.original), one.words(one.nominal), one.words(one.shrunk),
            _rho(one.rho_in_original), _rho(one.rho_in_shrunk), verdict,
        )
    return table


def finding_lines(report: Report) -> list[str]:
    """Lines that explain the table and where the failure begins."""
    lines = ['rho in original, in shrunk: of that run with this one parameter made nominal']
    if report.dry:
        lines[0] += ' (a clear sky is dry too)'
    for one in report.findings:
        if one.matters and one.passes_at is not None and one.rho_passes_at is not None:
            lines.append(f'{one.key}: {edge_words(one)}')
        if one.matters and one.rho_in_original is not None and one.rho_in_original <= 0:
            lines.append(f'{one.key}: the original fails without it too, so it has another cause')
    return lines


def edge_words(one: Finding) -> str:
    """Text on where the failure begins along one parameter, others as in the shrunk run."""
    fails, passes = one.words(one.shrunk), one.words(one.passes_at)
    return f'{fails} fails, {passes} passes (rho {_rho(one.rho_passes_at)})'


def off_nominal(report: Report) -> str:
    """Short description of the shrunk scenario: its parameters that are not nominal."""
    words = [
        f'{one.key} {one.words(one.shrunk)}' for one in report.findings if one.off_nominal
    ]
    return ', '.join(words) or 'everything nominal'


def result_lines(report: Report, shrinking: Shrinking, wall_s: float) -> list[str]:
    """Lines on how the shrinking ended and its cost."""
    lines = [_ended(report)] if report.state.end is not End.MINIMAL else []
    if report.shrunk is not None:
        rho = report.shrunk.rho[shrinking.headline]
        lines.append(
            f'shrunk: run {report.shrunk.index}, rho {rho_text(rho)}: {scene_words(report.shrunk)}'
        )
    took = ' in all' if shrinking.campaign.resume else f' in {wall_s:.0f} s'
    lines.append(f'{len(shrinking.judged)} runs{took}')
    return lines


def run_command(shrinking: Shrinking, program: str) -> str:
    """Shell command to run the shrunk scenario."""
    return RunSettings.of_options(shrinking.campaign).command(program)


def _rho(value: float | None) -> str:
    return '' if value is None else rho_text(value)


def _ended(report: Report) -> str:
    if report.state.end is End.NOMINAL_FAILS:
        return 'the nominal scenario fails itself, so no parameter matters; give another'
    if report.state.end is End.SPENT:
        return 'ended before it was minimal: its runs are spent; resume it with more'
    return 'ended before it was minimal; resume it'

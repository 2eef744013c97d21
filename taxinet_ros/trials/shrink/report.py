"""Result of a shrinking, and its printed lines: what each parameter has to do with the failure."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from rich.table import Table
from rich.text import Text

from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.scenario_fields import BY_KEY, RAIN_CLOUDS
from taxinet_ros.errors import InfraError, UsageError
from taxinet_ros.trials.engine import Engine
from taxinet_ros.trials.options import AUDIT
from taxinet_ros.trials.record.row import RunRow
from taxinet_ros.trials.run_command import RunSettings
from taxinet_ros.trials.shrink.algorithm import End, Point, State
from taxinet_ros.trials.shrink.shrinking import Shrinking
from taxinet_ros.trials.shrink.space import Parameter
from taxinet_ros.trials.summary import participants_words, scene_words, workers_words


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
        detail = (
            f'{row.detail or row.outcome} ({often}in run {row.run_id}; continue with --resume)'
        )
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
        f'{found.original.rho[name]:+.2f}{before}; was it recorded with another version, '
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


def parameter_table(report: Report) -> Table:
    """Every parameter with its three values, and whether it matters."""
    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0))
    table.add_column('parameter', no_wrap=True)
    for name in ('original', 'nominal', 'shrunk', 'rho in\noriginal', 'rho in\nshrunk'):
        table.add_column(name, justify='right', no_wrap=True)
    table.add_column('verdict', no_wrap=True)
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
    return f'{fails} fails, {passes} passes (rho {one.rho_passes_at:+.2f})'


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
            f'shrunk: run {report.shrunk.index}, rho {rho:+.2f}: {scene_words(report.shrunk)}'
        )
    took = ' in all' if shrinking.campaign.resume else f' in {wall_s:.0f} s'
    lines.append(f'{len(shrinking.judged)} runs{took}')
    return lines


def run_command(shrinking: Shrinking, program: str) -> str:
    """Shell command to run the shrunk scenario."""
    return RunSettings.of_options(shrinking.campaign).command(program)


def _rho(value: float | None) -> str:
    return '' if value is None else f'{value:+.2f}'


def _ended(report: Report) -> str:
    if report.state.end is End.NOMINAL_FAILS:
        return 'the nominal scenario fails itself, so no parameter matters; see --nominal'
    if report.state.end is End.SPENT:
        return 'ended before it was minimal: --runs are spent; --resume with more goes on'
    return 'ended before it was minimal; --resume goes on'

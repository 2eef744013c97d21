"""Parameters of the monitor on its own: what is judged, on which samples, for how long."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from rclpy.node import Node

from taxinet_ros.core.errors import UsageError
from taxinet_ros.core.mtl import Assumptions, Spec, parse_assumptions, parse_spec
from taxinet_ros.core.mtl.lint import check_windows
from taxinet_ros.core.signal_source import SignalSource, parse_signals
from taxinet_ros.core.types import NS_PER_S
from taxinet_ros.nodes.parameters import Parameter, declare_all, refuse_unknown

ALONE = (
    Parameter(
        name='signals', default=[''], takes='NAME[unit]=/topic:field.path*factor each',
        description='where the signals come from, one for each that formulas read',
    ),
    Parameter(
        name='specs', default=[''], takes='NAME=FORMULA over the signals each',
        description='the requirements',
    ),
    Parameter(
        name='bounds', default=[''], takes='SIGNAL=LOW:HIGH each',
        description='vouched for: bounds of signals',
    ),
    Parameter(
        name='rates', default=[''], takes='SIGNAL=CHANGE per second each',
        description='vouched for: how fast signals change',
    ),
    Parameter(
        name='sampled_on', default='', takes='a signal, or empty for the first',
        description='signal whose messages make samples',
    ),
    Parameter(
        name='period', default=0.0, limits=(0.0, 1e6),
        description='sample on a grid instead [s]; 0: do not',
    ),
    Parameter(
        name='max_age', default=1.0, limits=(0.0, 1e6),
        description='older values, and longer times without a sample, are not judged [s]; 0: any '
        'age',
    ),
    Parameter(
        name='horizon', default=0.0, limits=(0.0, 1e9),
        description='length of what is judged, from the first sample on [s]; 0: no end',
    ),
    Parameter(
        name='repeat', default=False, description='begin anew where the horizon is reached',
    ),
    Parameter(
        name='time_source', default='header', words=('header', 'clock'),
        description="whose time a sample has: the messages' stamps where they have any, or the "
        'clock',
    ),
)
"""Parameters of the monitor on its own; with none of them it is the one of a graph."""


@dataclass(frozen=True, kw_only=True)
class AloneOptions:
    """What the node is told, checked.

    Attributes:
        sources: where the signals come from.
        specs: the formulas.
        assumptions: what is vouched for of the signals.
        sampled_on: signal whose messages each make a sample, or '' on a grid.
        period_ns: step of the grid [ns], or 0.
        max_age_ns: greatest age of a held value, and longest time between samples [ns]; 0: any.
        horizon_ns: length of a stretch [ns]; 0: it has no end.
        repeat: whether a stretch begins where one ended.
        by_clock: whether to ignore the headers' stamps.
    """

    sources: tuple[SignalSource, ...]
    specs: tuple[Spec, ...]
    assumptions: Assumptions
    sampled_on: str
    period_ns: int
    max_age_ns: int
    horizon_ns: int
    repeat: bool
    by_clock: bool


def declared_options(node: Node) -> AloneOptions:
    """Declare the parameters of a node, and check what was given.

    Raises:
        UsageError: a parameter is unknown, missing or wrong.
    """
    given = declare_all(node, ALONE)
    refuse_unknown(node)
    horizon_ns = round(given['horizon'] * NS_PER_S)
    try:
        found = parse_signals(given['signals'])
        names = {source.name: source.unit for source in found}
        return AloneOptions(
            sources=found,
            specs=_parse_specs(given['specs'], names, horizon_ns),
            assumptions=_parse_assumptions(given['bounds'], given['rates'], list(names)),
            sampled_on=_sampler(given['sampled_on'], given['period'], found),
            period_ns=round(given['period'] * NS_PER_S),
            max_age_ns=round(given['max_age'] * NS_PER_S),
            horizon_ns=horizon_ns,
            repeat=_repeats(given['repeat'], given['horizon']),
            by_clock=given['time_source'] == 'clock',
        )
    except UsageError as error:
        raise UsageError(f'{node.get_name()}: parameter {error}') from None


def _parse_specs(
    texts: Sequence[str], signals: Mapping[str, str], horizon_ns: int
) -> tuple[Spec, ...]:
    if not signals:
        raise UsageError('signals: give one at least, e.g. cte=/robot/odom:pose.pose.position.y')
    if not texts:
        first = next(iter(signals))
        raise UsageError(f'specs: give one at least, e.g. near=always(abs({first}) <= 1.5)')
    try:
        specs = tuple(parse_spec(text, signals=signals) for text in texts)
        for spec in specs if horizon_ns else ():
            check_windows(spec, horizon_ns)
    except UsageError as error:
        raise UsageError(f'specs: {error}') from None
    names = [spec.name for spec in specs]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise UsageError(f'specs: {twice} is there twice')
    return specs


def _parse_assumptions(
    bounds: Sequence[str], rates: Sequence[str], signals: Sequence[str]
) -> Assumptions:
    try:
        return parse_assumptions(bounds, rates, signals)
    except UsageError as error:
        kind, _, rest = str(error).partition(' ')
        raise UsageError(f'{kind}s: {rest}') from None


def _sampler(sampled_on: str, period_s: float, sources: Sequence[SignalSource]) -> str:
    names = [source.name for source in sources]
    if sampled_on and period_s:
        raise UsageError('sampled_on: with a period no signal makes the samples; give one of both')
    if sampled_on and sampled_on not in names:
        raise UsageError(f'sampled_on: {sampled_on!r} is no signal; known: {", ".join(names)}')
    return '' if period_s else sampled_on or names[0]


def _repeats(repeat: bool, horizon_s: float) -> bool:
    if repeat and not horizon_s:
        raise UsageError('repeat: needs a horizon > 0, after which to begin anew')
    return repeat

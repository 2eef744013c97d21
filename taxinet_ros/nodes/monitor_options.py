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
from taxinet_ros.nodes.parameters import declare, refuse_unknown


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
    text = 'NAME[unit]=/topic:field.path*factor, one for each signal that formulas read'
    sources = _texts(node, 'signals', text)
    specs = _texts(node, 'specs', 'NAME=FORMULA over the signals, one for each requirement')
    bounds = _texts(node, 'bounds', 'vouched for: SIGNAL=LOW:HIGH')
    rates = _texts(node, 'rates', 'vouched for: SIGNAL=CHANGE per second')
    sampled_on = declare(node, 'sampled_on', '', 'signal whose messages make samples; the first')
    period_s = declare(node, 'period', 0.0, 'sample on a grid instead [s]; 0: do not', (0.0, 1e6))
    text = 'older values, and longer times without a sample, are not judged [s]; 0: any age'
    max_age_s = declare(node, 'max_age', 1.0, text, (0.0, 1e6))
    text = 'length of what is judged, from the first sample on [s]; 0: no end'
    horizon_s = declare(node, 'horizon', 0.0, text, (0.0, 1e9))
    repeat = declare(node, 'repeat', False, 'begin anew where the horizon is reached')
    time_source = declare(
        node, 'time_source', 'header', "header: the messages' stamps where they have any; clock"
    )
    refuse_unknown(node)
    try:
        found = parse_signals(sources)
        names = {source.name: source.unit for source in found}
        return AloneOptions(
            sources=found,
            specs=_parse_specs(specs, names, round(horizon_s * NS_PER_S)),
            assumptions=_parse_assumptions(bounds, rates, list(names)),
            sampled_on=_sampler(sampled_on, period_s, found),
            period_ns=round(period_s * NS_PER_S),
            max_age_ns=round(max_age_s * NS_PER_S),
            horizon_ns=round(horizon_s * NS_PER_S),
            repeat=_repeats(repeat, horizon_s),
            by_clock=_by_clock(time_source),
        )
    except UsageError as error:
        raise UsageError(f'{node.get_name()}: parameter {error}') from None


def _texts(node: Node, name: str, description: str) -> list[str]:
    # An empty list would have no type, so one empty text stands for none.
    return [text for text in declare(node, name, [''], description) if text]


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


def _by_clock(time_source: str) -> bool:
    if time_source not in ('header', 'clock'):
        raise UsageError(f'time_source: {time_source!r} is unknown; known: header, clock')
    return time_source == 'clock'

"""MTL monitor for numeric fields of any robot's topics: ``ros2 run taxinet_ros live_monitor``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import compress
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.clock import Clock, ClockType
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.task import Future
from std_srvs.srv import Trigger

from taxinet_ros.core.mtl import Assumptions, Spec, check_read, parse_assumptions, parse_spec
from taxinet_ros.core.mtl.lint import check_windows
from taxinet_ros.core.types import NS_PER_S
from taxinet_ros.errors import UsageError
from taxinet_ros.extras.live_monitor import outputs
from taxinet_ros.extras.live_monitor.sample_hold import Sample, SampleHold
from taxinet_ros.extras.live_monitor.signal_source import SignalSource, parse_signals
from taxinet_ros.extras.live_monitor.stretch import Level, Stretch, standing_level, standing_line
from taxinet_ros.extras.live_monitor.topic_reader import Readings, TopicReader
from taxinet_ros.nodes.messages.convert import header
from taxinet_ros.nodes.running.node_main import run_node
from taxinet_ros.nodes.running.parameters import Parameter, Usage, declare_all, refuse_unknown

LIVE_PARAMETERS = (
    Parameter(
        name='signals', default=[''], takes='NAME[unit]=/topic:field.path*factor each',
        description='sources of the signals, one per signal in the formulas',
    ),
    Parameter(
        name='specs', default=[''], takes='NAME=FORMULA over the signals each',
        description='the requirements',
    ),
    Parameter(
        name='bounds', default=[''], takes='SIGNAL=LOW:HIGH each',
        description='assumed ranges of signals',
    ),
    Parameter(
        name='rates', default=[''], takes='SIGNAL=CHANGE per second each',
        description='assumed maximum rates of change',
    ),
    Parameter(
        name='sampled_on', default='', takes='a signal; empty: the first',
        description='signal whose messages trigger samples',
    ),
    Parameter(
        name='max_age', default=1.0, limits=(0.0, 1e6),
        description='maximum age of values and of gaps between samples [s]; 0: unlimited',
    ),
    Parameter(
        name='horizon', default=0.0, limits=(0.0, 1e9),
        description='length of the evaluation from the first sample [s]; 0: unlimited',
    ),
    Parameter(
        name='repeat', default=False, description='restart when the horizon is reached',
    ),
    Parameter(
        name='time_source', default='header', words=('header', 'clock'),
        description='time of a sample: message stamps (if any) or the clock',
    ),
)

NAME = 'live_monitor'
RESTART = 'monitor/restart'
"""Service that ends the current stretch and starts a new one."""
USAGE = Usage(
    executable=NAME,
    does='Evaluates formulas on numeric fields of any topics as messages arrive, without a '
    'simulator.',
    publishes=tuple(topic for _, topic, _ in outputs.OUTPUTS.values()),
    other=f'subscribes to the topics in signals, serves {RESTART} (std_srvs/srv/Trigger)',
    parameters=LIVE_PARAMETERS,
)


def _parse_specs(
    texts: Sequence[str], signals: Mapping[str, str], horizon_ns: int
) -> tuple[Spec, ...]:
    if not signals:
        raise UsageError(
            'signals: at least one is required, e.g. cte=/robot/odom:pose.pose.position.y'
        )
    if not texts:
        first = next(iter(signals))
        raise UsageError(f'specs: at least one is required, e.g. near=always(abs({first}) <= 1.5)')
    try:
        specs = tuple(parse_spec(text, signals=signals) for text in texts)
        for spec in specs if horizon_ns else ():
            check_windows(spec, horizon_ns)
    except UsageError as error:
        raise UsageError(f'specs: {error}') from None
    names = [spec.name for spec in specs]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise UsageError(f'specs: {twice} is given twice')
    return specs


def _parse_assumptions(
    bounds: Sequence[str], rates: Sequence[str], signals: Sequence[str], specs: Sequence[Spec]
) -> Assumptions:
    found = parse_assumptions(bounds, rates, signals)
    check_read(found, (spec.formula for spec in specs))
    return found


def _sampler(sampled_on: str, names: Sequence[str]) -> str:
    if sampled_on and sampled_on not in names:
        raise UsageError(f'sampled_on: {sampled_on!r} is no signal; known: {", ".join(names)}')
    return sampled_on or names[0]


_FIND_PERIOD_S = 0.1
_STATUS_PERIOD_S = 1.0
_REMINDER_TICKS = 5
"""Number of diagnostics after which the log repeats what is awaited."""


class LiveMonitor(Node):
    """Evaluates formulas on any topics, from the first sample of all signals on.

    Attributes:
        ended: done, with an exception, when the node cannot continue.
    """

    def __init__(self, **node: Any) -> None:
        """Create the node; ``node`` goes to :class:`rclpy.node.Node`."""
        super().__init__(NAME, **node)
        self.ended: Future = Future()
        self._read_parameters()
        self._outputs = {
            name: self.create_publisher(kind, topic, qos)
            for name, (kind, topic, qos) in outputs.OUTPUTS.items()
        }
        self._readers = self._make_readers()
        self._holder = self._make_holder()
        self._clock_missing = False
        self._stretch_number = 0
        self._begin_stretch()
        self._ticks = 0
        self._last_sample_ns = self._steady_ns()
        self.create_service(Trigger, RESTART, self._restart)
        # Graph discovery and operators use wall time, whatever clock the robot uses.
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._finding = self.create_timer(_FIND_PERIOD_S, self._find_publishers, clock=steady)
        self.create_timer(_STATUS_PERIOD_S, self._publish_status_regularly, clock=steady)
        for spec in self._specs:
            self.get_logger().info(f'{spec.name}: {spec.text}')

    def close(self) -> None:
        """Release the node; every change has been published already."""

    def _read_parameters(self) -> None:
        """Declare the parameters and validate their values."""
        given = declare_all(self, LIVE_PARAMETERS)
        refuse_unknown(self)
        self._horizon_ns = round(given['horizon'] * NS_PER_S)
        """Length of a stretch; 0: unlimited."""
        self._max_age_ns = round(given['max_age'] * NS_PER_S)
        """Maximum age of a held value and maximum gap between samples; 0: unlimited."""
        self._repeat, self._by_clock = given['repeat'], given['time_source'] == 'clock'
        try:
            if self._repeat and not self._horizon_ns:
                raise UsageError('repeat: needs a horizon > 0')
            self._sources = parse_signals(given['signals'])
            units = {source.name: source.unit for source in self._sources}
            self._specs = _parse_specs(given['specs'], units, self._horizon_ns)
            self._assumptions = _parse_assumptions(
                given['bounds'], given['rates'], list(units), self._specs
            )
            self._sampled_on = _sampler(given['sampled_on'], list(units))
        except UsageError as error:
            raise UsageError(f'{self.get_name()}: parameter {error}') from None

    def _make_readers(self) -> dict[str, TopicReader]:
        by_topic: dict[str, list[SignalSource]] = {}
        for source in self._sources:
            by_topic.setdefault(self._full_name(source), []).append(source)
        return {
            topic: TopicReader(self, topic, sources, self._arrive)
            for topic, sources in by_topic.items()
        }

    def _full_name(self, source: SignalSource) -> str:
        try:
            return self.resolve_topic_name(source.topic)
        except rclpy_implementation.RCLError as error:
            # The rest of the message is a location in C code.
            reason = str(error).split(', at /')[0]
            raise UsageError(
                f"{self.get_name()}: parameter signals: '{source}': {reason}"
            ) from None

    def _make_holder(self) -> SampleHold:
        topics = {
            source.name: topic for topic, reader in self._readers.items()
            for source in reader.sources
        }
        return SampleHold(
            topics, sampled_on=topics[self._sampled_on], max_age_ns=self._max_age_ns
        )

    def _begin_stretch(self) -> None:
        self._stretch_number += 1
        self._run_id = f'stretch-{self._stretch_number}'
        self._seq = -1
        self._newest_ns = 0
        self._stretch = Stretch(
            self._specs, horizon_ns=self._horizon_ns, max_gap_ns=self._max_age_ns,
            assumptions=self._assumptions,
        )

    def _find_publishers(self) -> None:
        """Subscribe to available topics; once all are available, publish the specs."""
        if self.ended.done():
            return
        try:
            found = [reader.find_publishers() for reader in self._readers.values()]
        except UsageError as error:
            self._finding.cancel()
            self.ended.set_exception(UsageError(f'{self.get_name()}: {error}'))
            return
        if all(found) and not self._finding.is_canceled():
            self._finding.cancel()
            self._publish_specs()

    def _publish_specs(self) -> None:
        signals = [
            {
                'name': source.name, 'topic': topic, 'type': reader.type_name,
                'field': str(source.path), 'factor': source.factor,
            }
            for topic, reader in self._readers.items() for source in reader.sources
        ]
        self._outputs['specs'].publish(outputs.specs_message(
            self._specs, signals, sampled_on=self._sampled_on,
            max_age=self._max_age_ns / NS_PER_S, horizon=self._horizon_ns / NS_PER_S,
            time_source='clock' if self._by_clock else 'header',
        ))

    def _arrive(self, topic: str, stamp_ns: int | None, readings: Readings) -> None:
        if stamp_ns is None or self._by_clock:
            stamp_ns = self.get_clock().now().nanoseconds
            self._clock_missing = stamp_ns == 0  # use_sim_time, and /clock is not published yet
            if self._clock_missing:
                return
        sample = self._holder.arrive(topic, stamp_ns, readings)
        if sample is not None:
            self._judge(sample)

    def _judge(self, sample: Sample) -> None:
        self._last_sample_ns = self._steady_ns()
        if self._stretch.ended:
            if not self._repeat:
                return
            self._begin_stretch()
        beyond = self._stretch.beyond(sample.stamp_ns)
        changed = self._stretch.push(sample)
        self._seq += 1
        self._newest_ns = sample.stamp_ns
        results = self._results()
        for result in results:
            self._outputs['robustness'].publish(result)
        if any(changed) or self._seq == 0 or self._stretch.ended:
            self._outputs['verdict'].publish(outputs.verdict_message(results))
            self._publish_status()
            self._log(changed)
        if beyond and self._repeat:
            self._judge(sample)

    def _results(self) -> list[Any]:
        return outputs.robustness_messages(
            self._specs, self._stretch.standings, self._newest_ns, self._run_id, self._seq
        )

    def _restart(self, request: Any, response: Any) -> Any:
        """End the stretch with its current verdict, and restart with the next sample."""
        if not self._stretch.begun:
            response.success, response.message = False, 'nothing to restart: no sample yet'
            return response
        lines = '; '.join(self._lines())
        response.success = True
        response.message = f'{self._run_id} ended at {self._stretch.length_s:g} s: {lines}'
        self._outputs['verdict'].publish(outputs.verdict_message(self._results()))
        self.get_logger().info(response.message)
        self._holder.restart()
        self._begin_stretch()
        self._publish_status()
        return response

    def _lines(self) -> list[str]:
        pairs = zip(self._specs, self._stretch.standings, strict=True)
        return [f'{spec.name} {standing_line(standing)}' for spec, standing in pairs]

    def _log(self, changed: list[bool]) -> None:
        for standing, line in compress(
            zip(self._stretch.standings, self._lines(), strict=True), changed
        ):
            if standing_level(standing) is Level.OK:
                self.get_logger().info(line)
            else:  # rclpy allows only one severity per line of code
                self.get_logger().error(line)

    def _publish_status_regularly(self) -> None:
        self._find_publishers()
        awaited = self._awaited()
        if awaited and self._ticks % _REMINDER_TICKS == 0:
            self.get_logger().warning(awaited)
        self._ticks += 1
        self._publish_status()

    def _awaited(self) -> str:
        """What the first sample is waiting for, or ''."""
        absent = [reader.awaited() for reader in self._readers.values() if not reader.received]
        if absent:
            return '; '.join(absent)
        if self._clock_missing:
            return 'waiting for /clock (use_sim_time)'
        if self._stretch.begun:
            return ''
        missing = ', '.join(self._holder.missing) or 'every signal, with stamps close together'
        return f'waiting for a value of {missing}'

    def _silence(self) -> str:
        limit_ns = self._max_age_ns
        silent_ns = self._steady_ns() - self._last_sample_ns
        if self._stretch.ended or not limit_ns or silent_ns <= limit_ns:
            return ''
        return f'no sample for {silent_ns / NS_PER_S:.1f} s'

    def _publish_status(self) -> None:
        """Publish the current diagnostics."""
        node, awaited = self.get_name(), self._awaited()
        silence = awaited or self._silence()
        pairs = zip(self._specs, self._stretch.standings, strict=True)
        statuses = [
            outputs.spec_status(node, spec, standing, silence) for spec, standing in pairs
        ]
        values = {
            topic: f'{reader.received} messages, {reader.type_name}, {reader.qos}'
            for topic, reader in self._readers.items()
        }
        level = Level.WARN if silence else Level.OK
        line = silence or f'{self._run_id}, {self._stretch.length_s:g} s'
        statuses.append(outputs.status(level, f'{node}: signals', line, values))
        stamp_ns = self.get_clock().now().nanoseconds
        message = DiagnosticArray(header=header(stamp_ns, ''), status=statuses)
        self._outputs['diagnostics'].publish(message)

    @staticmethod
    def _steady_ns() -> int:
        return Clock(clock_type=ClockType.STEADY_TIME).now().nanoseconds


def main() -> None:
    """Entry point of ``ros2 run taxinet_ros live_monitor``."""
    run_node(LiveMonitor, usage=USAGE)


if __name__ == '__main__':
    main()

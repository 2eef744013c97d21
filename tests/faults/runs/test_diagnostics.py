"""What ``/diagnostics`` tells of a graph: who waits for whom, what broke, and how fast it goes."""

from __future__ import annotations

import contextlib
import dataclasses
import itertools
import re
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from graph_runs import once, request, run
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from tampering import tamper
from waiting import wait_for

from taxinet_ros.core.pacing.timing import AT_ONCE, free_timing
from taxinet_ros.core.verdict.outcome import Outcome, RunResult
from taxinet_ros.errors import UsageError
from taxinet_ros.nodes import interface
from taxinet_ros.nodes.graph.runner import GraphOptions, composed_graph
from taxinet_ros.nodes.interface import PARTICIPANTS, RECORDER, SIMULATOR, STEERING_CONTROLLER
from taxinet_ros.nodes.lockstep import diagnostics
from taxinet_ros.nodes.messages.convert import death_notice
from taxinet_ros.nodes.running.domain import own_domain
from taxinet_ros.nodes.running.leave import leave_graph
from taxinet_ros.nodes.simulator import Simulator

pytestmark = pytest.mark.ros

OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR


@pytest.fixture(autouse=True)
def impatient(monkeypatch):
    """Told often, and warned of soon."""
    often = dataclasses.replace(diagnostics.PARAMETER, default=0.05)
    monkeypatch.setattr(diagnostics, 'PARAMETER', often)
    monkeypatch.setattr(diagnostics, 'PATIENCE_S', 0.3)


class Gatherer(Node):
    """Somebody who looks at all diagnostics, as an aggregator or rqt does."""

    def __init__(self, **node: Any) -> None:
        super().__init__('gatherer', **node)
        self.heard: list[DiagnosticStatus] = []
        self.create_subscription(DiagnosticArray, '/diagnostics', self._on_report, 100)
        topic = interface.OBITUARY
        self.obituaries = self.create_publisher(topic.type, topic.name, topic.qos)

    def _on_report(self, report: DiagnosticArray) -> None:
        assert report.header.stamp.sec > 0
        self.heard += report.status

    def told(self, node: str, level: bytes | None = None, words: str = '', key: str = '') -> Any:
        """The newest that a node has told: at a level, words (a regular expression), a figure."""
        return next((
            status for status in reversed(list(self.heard))
            if status.name == f'{node}: run' and level in (None, status.level)
            and re.search(words, status.message)
            and (not key or key in {value.key for value in status.values if value.value})
        ), None)


@contextlib.contextmanager
def gathering(domain: int) -> Iterator[Gatherer]:
    """A gatherer that listens in a thread of its own."""
    context = Context()
    rclpy.init(context=context, domain_id=domain)
    node = Gatherer(context=context)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    thread = threading.Thread(target=executor.spin, daemon=True)
    thread.start()
    try:
        yield node
    finally:
        executor.shutdown()
        thread.join()
        leave_graph(node)
        rclpy.try_shutdown(context=context)


def values_of(status: DiagnosticStatus | None) -> dict[str, str]:
    assert status is not None
    return {value.key: value.value for value in status.values}


def runs_until(done: Callable[[], bool]) -> Iterator[Any]:
    """Short runs, one after the other, until something holds."""
    for number in itertools.count():
        yield request(f'run-{number}', duration=2.0)
        if done():
            return


def simulator_of(graph: Any) -> Any:
    return next(node for node in graph.nodes if node.get_name() == SIMULATOR)


def test_ros21_given_a_graph_at_work_then_each_node_tells_how_it_is_doing(tmp_path):
    options = GraphOptions(perception='truth', out=tmp_path / 'told', images='none')
    with composed_graph(options) as graph, gathering(graph.domain) as gatherer:
        def all_told() -> bool:
            return any(
                status.name == 'simulator: run' and float(values_of(status)['frames'])
                for status in list(gatherer.heard)
            ) and all(
                gatherer.told(name, OK, 'run run-', figures.get(name, ''))
                for name in (SIMULATOR, *PARTICIPANTS))

        def judged(_: Any, result: RunResult) -> bool:
            walls_s.append(result.wall_s)
            return result.outcome.judged

        figures = {'mtl_monitor': 'phi_always', SIMULATOR: 'perception'}
        begun_s, walls_s = time.monotonic(), []
        graph.run(runs_until(all_told), judged)
        assert 0 < sum(walls_s) < time.monotonic() - begun_s
        told = {
            name: values_of(gatherer.told(name, OK, 'run run-', figures.get(name, '')))
            for name in (SIMULATOR, *PARTICIPANTS)
        }
    simulator = told.pop(SIMULATOR)
    assert float(simulator['real-time factor']) == pytest.approx(
        float(simulator['step rate [1/s]']) / 10, rel=1e-4)
    mean, most = (float(simulator[f'frame time, {one} [ms]']) for one in ('mean', 'max'))
    assert 0 <= mean <= most < 1e3 * (time.monotonic() - begun_s)
    assert simulator['run'].startswith('run-')
    assert (simulator['last step'], simulator['perception']) == ('20', 'truth')
    assert told['perception']['implementation'] == 'truth'
    assert ' ... ' in told['mtl_monitor']['phi_always']
    assert float(told[RECORDER]['bag size [MB]']) >= 0
    assert float(told[RECORDER]['disk free [MB]']) > 0
    assert all(float(values['messages']) >= 0 for values in told.values())
    with composed_graph(GraphOptions(
        perception='truth', out=tmp_path / 'untold', images='none'
    )) as graph:
        run(graph, request('run-0', duration=2.0))
    bags = [(tmp_path / how / 'run-0' / 'run-0_0.mcap').read_bytes() for how in ('told', 'untold')]
    assert bags[0] == bags[1], 'who asks how it goes has changed the bag'


def test_given_operations_when_looked_at_then_their_number_and_times_are_told():
    pace = diagnostics.Pace()
    pace.took(0.002)
    pace.took(0.004)
    _, figures = pace.look('frame')
    assert figures == {
        'frames': 2, 'frame time, mean [ms]': pytest.approx(3), 'frame time, max [ms]': 4.0,
    }
    assert pace.look('frame')[1]['frames'] == 0


@pytest.mark.parametrize('timing', [AT_ONCE, free_timing('1')], ids=['lockstep', 'free'])
def test_ros21_given_a_controller_that_is_silent_then_the_simulator_warns_and_names_it(
    timing, tmp_path
):
    options = GraphOptions(
        perception='truth', out=tmp_path, images='none', timing=timing,
        timeouts={'answer_timeout': 600.0},
    )
    # A busy machine makes others slow for a moment as well: the one who stays silent remains.
    how = f's for {STEERING_CONTROLLER}$' if timing is AT_ONCE else STEERING_CONTROLLER
    warning = SIMULATOR, WARN, how
    with composed_graph(options) as graph, gathering(graph.domain) as gatherer:
        tamper(graph, interface.COMMAND, lambda step, message: [message] if step < 5 else [])
        dead = death_notice('run', STEERING_CONTROLLER, 'nobody knows why')
        with once(
            lambda: gatherer.told(*warning),
            lambda: gatherer.obituaries.publish(dead),
        ):
            (result,) = run(graph, request())
        warned = values_of(gatherer.told(*warning))
        after = simulator_of(graph).health()
    assert (result.outcome, result.who) == (Outcome.INFRA_ERROR, STEERING_CONTROLLER)
    if timing is AT_ONCE:
        assert warned['waits for'] == STEERING_CONTROLLER
        assert float(warned['silent for [s]']) > 0.3
    else:
        assert int(float(warned['step'])) > 5
        assert float(warned['free run, unanswered']) > 0
    assert after.level == ERROR
    assert f'run run broke: died {STEERING_CONTROLLER}' in after.message
    assert (after.values['runs ended'], after.values['runs INFRA_ERROR']) == (1, 1)


def test_ros21_given_a_run_that_cannot_begin_then_nodes_warn_of_the_topic_and_then_go_on(tmp_path):
    options = GraphOptions(
        perception='truth', out=tmp_path, images='none', timeouts={'ready_timeout': 600.0})
    with composed_graph(options) as graph, gathering(graph.domain) as gatherer:
        topic = interface.ESTIMATE
        second = gatherer.create_publisher(topic.type, topic.name, topic.qos)
        wait_for(lambda: second.get_subscription_count() == 4 and all(
            node.count_publishers(topic.name) == 2 for node in graph.nodes))
        with once(
            lambda: gatherer.told(STEERING_CONTROLLER, WARN, topic.name)
            and gatherer.told(SIMULATOR, WARN, 'gatherer'),
            lambda: gatherer.destroy_publisher(second),
        ):
            (result,) = run(graph, request(duration=1.0))
    assert result.outcome.judged


def test_ros21_given_nobody_who_asks_or_an_answer_that_fails_then_the_run_is_none_the_worse(
    tmp_path, monkeypatch
):
    asked = []

    def fail(node: Simulator) -> diagnostics.Health:
        asked.append(node)
        raise ValueError('no idea')

    monkeypatch.setattr(Simulator, 'health', fail)
    options = GraphOptions(perception='truth', out=tmp_path, images='none')
    with composed_graph(options) as graph:
        (result,) = run(graph, request('alone', duration=30.0))
        assert result.outcome.judged
        assert asked == []
        with gathering(graph.domain) as gatherer:
            graph.run(
                runs_until(lambda: gatherer.told(SIMULATOR) is not None),
                lambda request, result: result.outcome.judged,
            )
            told = gatherer.told(SIMULATOR)
    assert (told.level, told.message) == (ERROR, 'ValueError: no idea')


def test_ros21_given_too_little_space_then_the_recorder_warns(tmp_path: Path, monkeypatch):
    with composed_graph(GraphOptions(perception='truth', out=tmp_path)) as graph:
        recorder = next(node for node in graph.nodes if node.get_name() == RECORDER)
        assert recorder.health().level == OK
        monkeypatch.setattr(recorder, '_min_free', 10**18)
        health = recorder.health()
    assert health.level == WARN
    assert 'min_free is 1000000000000' in health.message


def test_ros21_given_the_parameter_then_0_is_silence_and_less_is_refused():
    with own_domain() as domain:
        context = Context()
        rclpy.init(context=context, domain_id=domain)
        try:
            for period, speaks in ((0.0, False), (0.5, True)):
                values = [Parameter('diagnostics', value=period)]
                node = Simulator(context=context, parameter_overrides=values)
                names = {publisher.topic_name for publisher in node.publishers}
                assert ('/diagnostics' in names) is speaks
                leave_graph(node)
            with pytest.raises(UsageError, match=r'parameter diagnostics: .*allowed: 0\.0\.\.3600'):
                Simulator(
                    context=context, parameter_overrides=[Parameter('diagnostics', value=-1.0)])
        finally:
            rclpy.try_shutdown(context=context)

"""Trouble in the graph ends the run as INFRA_ERROR naming who failed; the bag stays readable."""

import threading

import pytest
from graph_runs import request, run, steps_in
from waiting import wait_for

from taxinet_ros.core.verdict.outcome import Outcome
from taxinet_ros.nodes import interface
from taxinet_ros.nodes.graph.runner import GraphOptions, composed_graph
from taxinet_ros.nodes.interface import PARTICIPANTS
from taxinet_ros.nodes.lockstep import sampler
from taxinet_ros.nodes.messages.convert import scenario_message

pytestmark = pytest.mark.ros


def node_of(graph, name):
    return next(node for node in graph.nodes if node.get_name() == name)


def after_steps(graph, steps: int, act) -> None:
    """Call ``act`` from another thread once the recorder has written so many steps."""
    recorder = node_of(graph, interface.RECORDER)

    def wait() -> None:
        wait_for(lambda: recorder.bag is not None and recorder.bag.written >= steps)
        act()

    threading.Thread(target=wait, daemon=True).start()


def test_given_a_result_that_is_lost_on_its_way_then_the_sampler_asks_again(tmp_path, monkeypatch):
    options = GraphOptions(perception='truth', out=tmp_path, images='none')
    with composed_graph(options) as graph:
        server = node_of(graph, interface.SIMULATOR)._servers[0]
        sent = server._send_result_response
        lost: list[object] = []
        monkeypatch.setattr(
            server, '_send_result_response',
            lambda header, future: sent(header, future) if lost else lost.append(future),
        )
        (result,) = run(graph, request(duration=1.0))
    assert lost
    assert result.outcome.judged, result


@pytest.mark.nightly
def test_given_an_acceptance_that_is_lost_on_its_way_then_the_sampler_asks_for_the_result(
    tmp_path, monkeypatch
):
    original, lost = sampler.ActionClient.execute, []

    async def execute(self, taken):
        if 'goal' in taken and not lost:
            lost.append(taken.pop('goal'))
        await original(self, taken)

    monkeypatch.setattr(sampler.ActionClient, 'execute', execute)
    options = GraphOptions(perception='truth', out=tmp_path, images='none')
    with composed_graph(options) as graph:
        (result,) = run(graph, request(duration=1.0))
    assert lost
    assert result.outcome.judged, result


@pytest.mark.one_in(2)
@pytest.mark.parametrize(
    ('who', 'method'),
    [
        (interface.PERCEPTION, '_know'),
        (interface.STEERING_CONTROLLER, '_answer'),
        (interface.MTL_MONITOR, '_judge_step'),
    ],
)
def test_given_a_node_that_raises_mid_run_then_the_run_names_it_and_why(
    who, method, tmp_path, monkeypatch
):
    options = GraphOptions(perception='truth', out=tmp_path)
    calls = {'n': 0}
    kind, _ = options.nodes()[who]
    owner = next(base for base in kind.__mro__ if method in vars(base))
    original = getattr(owner, method)

    def failing(self, *args):
        calls['n'] += 1
        if calls['n'] == 20:
            raise RuntimeError('lost the plot')
        return original(self, *args)

    monkeypatch.setattr(owner, method, failing)
    with composed_graph(options) as graph:
        (result,) = run(graph, request())
    assert result.outcome is Outcome.INFRA_ERROR
    assert (result.kind, result.who) == ('node_error', who)
    assert 'lost the plot' in result.detail
    assert result.rho == {}
    steps = steps_in(tmp_path / 'run')
    assert len(steps) >= 19
    assert steps == sorted(steps)


def test_given_a_node_that_falls_silent_then_the_watchdog_names_it(tmp_path, monkeypatch):
    from taxinet_ros.nodes.steering_controller import SteeringController

    original = SteeringController._answer
    monkeypatch.setattr(
        SteeringController, '_answer',
        lambda self, message: original(self, message) if message.seq < 15 else None,
    )
    options = GraphOptions(perception='truth', out=tmp_path, timeouts={'answer_timeout': 2.0})
    with composed_graph(options) as graph:
        (result,) = run(graph, request())
    assert (result.outcome, result.kind) == (Outcome.INFRA_ERROR, 'timeout')
    assert result.who == interface.STEERING_CONTROLLER
    assert result.last_seq == 15
    assert len(steps_in(tmp_path / 'run')) == 16


@pytest.mark.one_in(2)
@pytest.mark.parametrize('who', PARTICIPANTS)
def test_r8_given_a_missing_node_then_the_run_is_not_begun_and_it_is_named_alone(who, tmp_path):
    class Without(GraphOptions):
        def nodes(self):
            nodes = super().nodes()
            del nodes[who]
            return nodes

    options = Without(
        perception='truth', out=tmp_path, timeouts={'ready_timeout': 1.0}
    )
    with composed_graph(options) as graph:
        (result,) = run(graph, request())
    assert (result.outcome, result.kind) == (Outcome.INFRA_ERROR, 'not_ready')
    assert result.who == who
    assert result.detail.startswith('not ready within 1 s: does not ')


def test_given_a_bag_that_exists_then_it_is_not_overwritten_and_the_run_fails(tmp_path):
    (tmp_path / 'run').mkdir()
    (tmp_path / 'run' / 'precious').write_text('data')
    with composed_graph(GraphOptions(perception='truth', out=tmp_path)) as graph:
        (result,) = run(graph, request(duration=1.0))
    assert (result.outcome, result.who) == (Outcome.INFRA_ERROR, interface.RECORDER)
    assert [file.name for file in (tmp_path / 'run').iterdir()] == ['precious']


def test_given_an_interrupt_then_the_run_at_hand_ends_in_order_and_no_more_are_begun(tmp_path):
    with composed_graph(GraphOptions(perception='truth', out=tmp_path)) as graph:
        after_steps(graph, 10, graph.interrupt)
        results = run(graph, request('one', 600.0), request('two', 600.0))
    assert [result.outcome for result in results] == [Outcome.INTERRUPTED]
    assert (tmp_path / 'one' / 'metadata.yaml').exists()
    assert not (tmp_path / 'two').exists()


def test_given_an_impossible_scenario_in_a_request_then_it_is_rejected_with_a_reason(
    tmp_path, monkeypatch
):
    def broken(asked):
        message = scenario_message(asked)
        message.cross_track_m = 99.0
        return message

    monkeypatch.setattr(sampler, 'scenario_message', broken)
    with composed_graph(GraphOptions(perception='truth', out=tmp_path)) as graph:
        (result,) = run(graph, request(duration=1.0))
    assert result.outcome is Outcome.REJECTED
    assert 'cross_track_m is 99' in result.detail

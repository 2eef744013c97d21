"""The simulator's own troubles, and a perception that is merely slow."""

from __future__ import annotations

import math
import time

import pytest
from graph_runs import files, request, run, steps_in

from taxinet_ros.core.camera.camera import Camera
from taxinet_ros.core.motion.aircraft import Aircraft
from taxinet_ros.core.perception.perception import NetworkPerception
from taxinet_ros.core.verdict.outcome import Outcome
from taxinet_ros.errors import InfraError
from taxinet_ros.nodes import interface
from taxinet_ros.nodes.graph.runner import GraphOptions, composed_graph
from taxinet_ros.nodes.interface import RECORDER
from taxinet_ros.nodes.recorder import Recorder

pytestmark = pytest.mark.ros

STEP = 6


def at_call(number: int, original, act):
    """A method that does something else once, at a call of a number."""
    calls = iter(range(10**6))
    return lambda self, *a, **k: (act if next(calls) == number else original)(self, *a, **k)


def no_wind(aircraft: Aircraft, command) -> None:
    aircraft._fdm['atmosphere/wind-north-fps'] = math.nan
    ADVANCE(aircraft, command)


def refuse(aircraft: Aircraft, command) -> None:
    raise InfraError('sim', 'simulator', STEP, 'JSBSim, run: no reason given')


def stumble(camera: Camera, *args, **values) -> None:
    raise RuntimeError('out of film')


ADVANCE, RENDER = Aircraft.advance, Camera.render
BREAK = {
    'a state that is not finite': (Aircraft, 'advance', no_wind, 'JSBSim is not finite: '),
    'physics that refuse': (Aircraft, 'advance', refuse, 'JSBSim, run: no reason given'),
    'a camera that raises': (Camera, 'render', stumble, 'RuntimeError: out of film'),
}


@pytest.mark.parametrize('case', BREAK)
def test_given_a_world_that_breaks_then_that_run_has_no_verdict_and_the_next_is_sound(
    case, tmp_path, monkeypatch
):
    kind, method, act, words = BREAK[case]
    monkeypatch.setattr(kind, method, at_call(STEP, getattr(kind, method), act))
    with composed_graph(GraphOptions(perception='truth', out=tmp_path)) as graph:
        broken, after = run(graph, request('broken', 2.0), request('after', 2.0))
    assert (broken.outcome, broken.kind, broken.who) == (
        Outcome.INFRA_ERROR, 'sim', interface.SIMULATOR
    )
    assert words in broken.detail
    assert (broken.rho, after.outcome.judged) == ({}, True)
    assert steps_in(tmp_path / 'after') == list(range(21))
    steps = steps_in(tmp_path / 'broken')
    assert steps == list(range(len(steps)))
    assert len(steps) >= STEP


@pytest.mark.parametrize('error', [
    InfraError('sim', 'simulator', -1, 'JSBSim, loading caravan: no such file'),
    OSError('no such file'),
], ids=['JSBSim', 'system'])
def test_given_a_world_that_cannot_be_built_then_that_run_has_no_verdict_and_the_next_is_sound(
    error, tmp_path, monkeypatch
):
    def fail(self, scenario) -> None:
        raise error

    original = Aircraft.__init__
    monkeypatch.setattr(Aircraft, '__init__', at_call(0, original, fail))
    with composed_graph(GraphOptions(perception='truth', out=tmp_path, images='none')) as graph:
        broken, after = run(graph, request('broken', 1.0), request('after', 1.0))
    assert (broken.outcome, broken.kind, broken.who) == (
        Outcome.INFRA_ERROR, 'sim', interface.SIMULATOR
    )
    assert 'no such file' in broken.detail
    assert after.outcome.judged
    assert not (tmp_path / 'broken').exists(), 'it was never begun'


def test_given_a_perception_that_takes_its_time_then_not_a_byte_changes(tmp_path, monkeypatch):
    original = NetworkPerception.estimate
    calls = iter(range(10**6))

    def slow(self, image, truth):
        if 4 <= next(calls) < 9:
            time.sleep(0.2)
        return original(self, image, truth)

    results = {}
    for name in ('quick', 'slow'):
        if name == 'slow':
            monkeypatch.setattr(NetworkPerception, 'estimate', slow)
        options = GraphOptions(perception='taxinet', out=tmp_path / name)
        with composed_graph(options) as graph:
            (results[name],) = run(graph, request(duration=2.0))
    assert next(calls) == 21
    assert results['quick'].outcome.judged
    assert results['quick'].rho == results['slow'].rho
    quick, slow_one = (files(tmp_path / name / 'run') for name in results)
    assert quick == slow_one


def test_given_a_picture_that_takes_longer_than_answers_may_then_nobody_is_blamed(
    tmp_path, monkeypatch
):
    """FlightGear may have to load terrain before it shows where it is put."""
    def slow(camera: Camera, *args, **more):
        time.sleep(1.5)
        return RENDER(camera, *args, **more)

    monkeypatch.setattr(Camera, 'render', at_call(STEP, RENDER, slow))
    options = GraphOptions(perception='truth', out=tmp_path, timeouts={'answer_timeout': 1.0})
    with composed_graph(options) as graph:
        (result,) = run(graph, request(duration=1.0))
    assert result.outcome.judged, result


def test_given_a_recorder_that_misses_a_message_then_the_run_has_no_verdict(tmp_path, monkeypatch):
    original, lost = Recorder._record, []

    def lose(self, topic, cdr: bytes) -> None:
        if topic is interface.COMMAND and not lost and self.bag.written == STEP:
            lost.append(topic)
        else:
            original(self, topic, cdr)

    monkeypatch.setattr(Recorder, '_record', lose)
    options = GraphOptions(
        perception='truth', out=tmp_path, images='none', timeouts={'answer_timeout': 1.0}
    )
    with composed_graph(options) as graph:
        (result,) = run(graph, request(duration=2.0))
    assert lost == [interface.COMMAND]
    assert (result.outcome, result.kind, result.who) == (Outcome.INFRA_ERROR, 'timeout', RECORDER)
    assert result.rho == {}
    assert steps_in(tmp_path / 'run')[:STEP] == list(range(STEP))

"""A run that may end early ends at the same step in every layout, and its bag holds just that."""

import math
from dataclasses import replace

import numpy as np
import pytest
from graph_runs import files, request, run_in

from taxinet_ros.bag.check.doctor import check_bag
from taxinet_ros.bag.check.judge import judge_runs
from taxinet_ros.bag.reader import read_info
from taxinet_ros.bag.run.recording import open_recording
from taxinet_ros.core.loop import run_closed_loop
from taxinet_ros.core.mtl import Assumptions, parse_spec
from taxinet_ros.core.perception.perception import make_perception
from taxinet_ros.core.scenario import scenario_from_human
from taxinet_ros.core.verdict.judging import Judging, StopOn
from taxinet_ros.core.verdict.outcome import Outcome, RunRequest
from taxinet_ros.nodes.graph.runner import GraphOptions, composed_graph, process_graph

pytestmark = pytest.mark.ros

SPECS = ('soon=eventually[0:1.7](always(abs(cte) <= 1.5))', 'on_runway')
LATE = scenario_from_human({'cross_track': 6, 'heading': 15, 'duration': 5})
GOOD = scenario_from_human({'cross_track': 0.5, 'heading': 0, 'duration': 5})


def requests(stop_on: StopOn) -> list[RunRequest]:
    return [
        request(f'run-{index}', scenario=scene, judging=Judging(specs=SPECS, stop_on=stop_on))
        for index, scene in enumerate((LATE, GOOD))
    ]


@pytest.mark.nightly
def test_given_violated_when_run_in_three_layouts_then_the_last_step_is_the_same(tmp_path):
    asked = requests(StopOn.VIOLATED)
    options = [GraphOptions(perception='truth', out=tmp_path / name) for name in ('one', 'many')]
    composed = run_in(composed_graph(options[0]), *asked)
    run_in(process_graph(options[1], tmp_path / 'logs'), *asked)

    late, good = composed
    steps = []
    judgement = run_closed_loop(
        LATE, make_perception('truth'), specs=[parse_spec(text) for text in SPECS],
        stop_on=StopOn.VIOLATED, on_step=steps.append,
    )
    assert 17 <= len(steps) - 1 < 50
    assert (late.outcome, late.stopped_early) == (Outcome.FAIL, True)
    assert late.last_seq == len(steps) - 1
    assert late.rho == {}
    assert list(late.robustness.values()) == [r.interval for r in judgement.readings]
    soon, on_runway = late.robustness['soon'], late.robustness['on_runway']
    assert soon.lower == -math.inf
    assert soon.upper < 0 < on_runway.upper
    assert repr(late.statistics) == repr(judgement.statistics), 'NaN where there is nothing'

    bag = tmp_path / 'one' / 'run-0'
    trace = open_recording(bag).columns
    assert trace['cte_m'].tobytes() == np.array(
        [step.observation.state.tracking_error.cte_m for step in steps]
    ).tobytes()
    assert trace['rho_upper.soon'].tobytes() == np.array(
        [step.readings[0].upper for step in steps]
    ).tobytes()
    info = read_info(bag)
    assert info.complete, info.trouble
    assert info.counts['/camera/image_raw'] == info.counts['/taxi_command'] == len(steps)
    assert info.counts['/monitor/robustness'] == 2 * len(steps)

    assert (good.outcome, good.stopped_early, good.last_seq) == (Outcome.PASS, False, 50)
    assert set(good.rho) == {'soon', 'on_runway'}
    for run in ('run-0', 'run-1'):
        one, many = (files(tmp_path / name / run) for name in ('one', 'many'))
        assert len(one) == 2
        assert one == many, 'the bags differ in bytes'


def test_given_decided_when_a_run_ends_then_every_formula_is_decided_or_the_run_is_whole(tmp_path):
    options = GraphOptions(perception='truth', out=tmp_path, images='none')
    late, good = run_in(composed_graph(options), *requests(StopOn.DECIDED))
    assert (late.stopped_early, late.last_seq) == (False, 50), 'on_runway is open to the end'
    assert set(late.rho) == {'soon', 'on_runway'}
    assert late.outcome is Outcome.FAIL
    assert good.outcome is Outcome.PASS


def test_given_rates_that_the_user_vouches_for_then_it_is_decided_earlier_as_without_ros(tmp_path):
    specs = ('wide=always(abs(cte) <= 8)',)
    base = replace(
        requests(StopOn.DECIDED)[1],
        judging=Judging(specs=specs, stop_on=StopOn.DECIDED, rates=('cte=3',)),
    )
    asked = [base, replace(base, run_id='run-x', judging=Judging(
        specs=specs, rates=('cte=0.001',), bounds=('cte=-20:20',),
    ))]
    options = GraphOptions(perception='truth', out=tmp_path, images='none')
    kept, broken = run_in(composed_graph(options), *asked)

    steps = []
    judgement = run_closed_loop(
        GOOD, make_perception('truth'), specs=base.judging.parsed_specs,
        stop_on=StopOn.DECIDED, assumptions=Assumptions(rates={'cte': 3.0}), on_step=steps.append,
    )
    assert (kept.outcome, kept.stopped_early) == (Outcome.PASS, True)
    assert 20 < kept.last_seq == len(steps) - 1 < 30
    assert kept.robustness['wide'].lower == judgement.readings[0].lower > 0

    assert (broken.outcome, broken.stopped_early, broken.last_seq) == (Outcome.PASS, False, 50)
    assert broken.rho['wide'] > 0, 'the run goes on without what it has broken'

    for one, early in zip(asked, (True, False), strict=True):
        (judged,) = judge_runs(tmp_path / one.run_id)
        assert judged.stopped_early is early
        assert judged.verdicts[0].same is True
        assert (judged.verdicts[0].breach_s is None) is early
        assert check_bag(tmp_path / one.run_id).findings == ()
    (other,) = judge_runs(tmp_path / 'run-1', assumptions=Assumptions())
    assert other.verdicts[0].same is None, 'an open interval is another one without the rates'

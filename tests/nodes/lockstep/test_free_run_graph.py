"""Free runs on the real graph: slow, silent and dead perceptions, and what their bags tell."""

from __future__ import annotations

import math
from pathlib import Path

import pytest
from graph_runs import request, run_in

from taxinet_ros.bag.check.doctor import check_bag
from taxinet_ros.bag.reader import read_info
from taxinet_ros.bag.run.facts import free_account
from taxinet_ros.bag.run.recording import open_recording
from taxinet_ros.cli.bag.replay import replay
from taxinet_ros.core.pacing.timing import free_timing
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.verdict.judging import Judging, StopOn
from taxinet_ros.core.verdict.outcome import Outcome, RunRequest, RunResult
from taxinet_ros.errors import UsageError
from taxinet_ros.nodes.graph.replay import rerun
from taxinet_ros.nodes.graph.runner import GraphOptions, composed_graph, process_graph
from taxinet_ros.trials.past_runs.recorded_campaign import find_run
from taxinet_ros.trials.shrink.shrinking import make_shrinking

pytestmark = pytest.mark.ros

SLEEP_S = 0.25
MINE = f"""
import os
import signal
import time


class Slow:
    needs_image = False

    def __call__(self, truth):
        time.sleep({SLEEP_S})
        return truth


class Silent:
    needs_image = False

    def __init__(self):
        self.frames = 0

    def __call__(self, truth):
        self.frames += 1
        if self.frames > 3:
            time.sleep(4)
        return truth


class Dying(Silent):
    def __call__(self, truth):
        self.frames += 1
        if self.frames > 3:
            os.kill(os.getpid(), signal.SIGKILL)
        return truth
"""
STEPS = 101


def asked(**changes) -> RunRequest:
    return request('free', **{
        'scenario': Scenario(cross_track_m=2.0, duration_s=10.0),
        'judging': Judging(specs=('phi_eventually',)), **changes,
    })


def run(opened, one: RunRequest) -> RunResult:
    (result,) = run_in(opened, one)
    return result


@pytest.fixture(scope='module')
def mine(tmp_path_factory) -> Path:
    """A file with perceptions that take their time."""
    file = tmp_path_factory.mktemp('mine') / 'mine.py'
    file.write_text(MINE)
    return file


def options(out: Path, perception: str, factor: str, **more) -> GraphOptions:
    return GraphOptions(
        perception=perception, out=out, images='none', timing=free_timing(factor), **more,
    )


@pytest.fixture(scope='module')
def slow(mine, tmp_path_factory) -> tuple[RunResult, Path]:
    """A run at ten times real time with a perception that takes 25 steps for an answer."""
    out = tmp_path_factory.mktemp('slow')
    graph = process_graph(options(out, f'{mine}:Slow', '10'), out / 'logs')
    return run(graph, asked()), out / 'free'


def test_r5_given_a_slow_perception_then_what_it_does_not_answer_is_counted(slow):
    result, bag = slow
    assert result.outcome.judged, result
    assert result.timing == 'free real_time_factor=10' == open_recording(bag).run.timing.words
    figures, counts = result.free, read_info(bag).counts
    assert figures['frames'] == STEPS == counts['/ground_truth/odom']
    assert figures['unanswered'] == STEPS - counts['/taxi_command'] > 0
    assert result.statistics.unusable_estimates == STEPS - counts['/perception/tracking_error']
    # It cannot have been faster than it sleeps, however slow the machine is.
    assert figures['perception_wall_median_s'] >= SLEEP_S
    assert figures['loop_wall_max_s'] >= figures['loop_wall_p95_s'] >= SLEEP_S
    assert figures['late'] > 0


def test_r5_given_the_bag_of_a_free_run_then_its_account_is_that_of_its_messages(slow):
    result, bag = slow
    account = free_account(read_info(bag))
    assert account is not None
    assert account.figures() == pytest.approx(result.free)
    commanded = [seq for seq in range(STEPS) if not math.isnan(account.command_s[seq])]
    assert len(commanded) == read_info(bag).counts['/taxi_command']
    # What held is some command that was given before, and in the end one did.
    assert set(account.applied) <= {-1, *commanded}
    assert all(held < seq for seq, held in enumerate(account.applied))


def test_r5_given_the_bag_of_a_free_run_then_it_is_whole_and_can_be_driven_again(slow):
    _, bag = slow
    checked = check_bag(bag)
    assert checked.findings == ()
    steps = next(check for check in checked.checks if check.name == 'lockstep')
    assert 'a free run: ' in steps.looked_at
    # Compares each state with the recorded one, to the bit.
    assert len(list(open_recording(bag).observations())) == STEPS


def test_r5_given_a_free_run_then_what_counts_on_its_coming_again_refuses_it(slow, tmp_path):
    _, bag = slow
    assert find_run(bag).timing.free
    with pytest.raises(UsageError, match='free runs depend on the speed'):
        make_shrinking(
            bag, perception='truth', specs=('phi_always',), runs=100, out=tmp_path / 'never'
        )
    with pytest.raises(UsageError, match='a free run, whose unanswered frames'):
        replay(bag, perception='truth', out=tmp_path / 'r')
    assert list(tmp_path.iterdir()) == []


def test_r5_given_a_free_run_when_run_again_then_it_is_free_again(slow, tmp_path):
    _, bag = slow
    results = rerun([(open_recording(bag).run, 'truth', 'steering')], tmp_path, images='none')
    assert results['free'].timing == 'free real_time_factor=10'
    assert results['free'].free['frames'] == STEPS


@pytest.mark.parametrize(('name', 'kind', 'says'), [
    pytest.param('Silent', 'timeout', 'silent for 2 s', marks=pytest.mark.nightly),
    ('Dying', 'died', 'killed by SIGKILL'),
])
def test_r5_given_a_perception_that_falls_silent_or_dies_then_the_run_breaks_and_names_it(
    mine, tmp_path, name, kind, says
):
    graph = options(tmp_path, f'{mine}:{name}', '1', timeouts={'answer_timeout': 2.0})
    one = asked(scenario=Scenario(duration_s=600.0))
    result = run(process_graph(graph, tmp_path / 'logs'), one)
    assert (result.outcome, result.kind, result.who) == (Outcome.INFRA_ERROR, kind, 'perception')
    assert says in result.detail
    # The bag tells what there was: the commands of three frames, and all frames since.
    counts = read_info(tmp_path / 'free').counts
    assert counts['/taxi_command'] == 3
    assert counts['/ground_truth/odom'] >= 3
    assert check_bag(tmp_path / 'free').findings == ()


def test_r5_given_no_pace_then_it_goes_as_fast_as_it_can_and_nothing_is_lost(tmp_path):
    one = asked(judging=Judging(specs=('phi_always', 'phi_eventually', 'on_runway')))
    result = run(composed_graph(options(tmp_path, 'truth', 'max')), one)
    assert result.outcome.judged, result
    assert result.free['overruns'] == 0
    assert check_bag(tmp_path / 'free').findings == ()


def test_r5_given_a_free_graph_then_a_rule_to_stop_is_refused(tmp_path):
    one = asked(judging=Judging(specs=('phi_eventually',), stop_on=StopOn.VIOLATED))
    result = run(composed_graph(options(tmp_path, 'truth', '1')), one)
    assert (result.outcome, result.detail) == (
        Outcome.REJECTED,
        'stop_on violated: not in a free run, which does not wait for the monitor',
    )

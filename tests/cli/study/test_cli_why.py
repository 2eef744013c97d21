"""What is found out about real runs."""

from __future__ import annotations

import json
import math
import shutil
from pathlib import Path

import pytest
from recorded_runs import record_runs

import taxinet_ros as tx
from taxinet_ros.analysis.report import pictures as picture_files
from taxinet_ros.analysis.report.text import sentences
from taxinet_ros.analysis.search.shrinking import TEXT
from taxinet_ros.cli.study.stages import call_stage
from taxinet_ros.core.mtl import exact_intervals
from taxinet_ros.core.perception.weights import SHIPPED, card_path
from taxinet_ros.core.scenario_fields import BY_KEY
from taxinet_ros.core.verdict.judging import Judging
from taxinet_ros.core.verdict.outcome import Outcome
from taxinet_ros.core.world import SimulatedWorld
from taxinet_ros.errors import UsageError
from taxinet_ros.study.stages.stage import with_engine
from taxinet_ros.study.why.investigation import (
    Investigation,
    kind_of,
    unsatisfiable,
    violated_at_start,
)
from taxinet_ros.study.why.plan import Budget
from taxinet_ros.study.why.verdict import Blames, Fault, judge
from taxinet_ros.trials.record.row import RunRow
from taxinet_ros.trials.record.table import write_tables

pytestmark = pytest.mark.nightly

WET = tx.Scenario(
    cross_track_m=-5.0, distance_m=620.0, heading_rad=math.radians(19), clouds='stratus',
    rain_fraction=0.9, time_of_day_s=8 * 3600, duration_s=5.0,
)
NEAR = 'near=eventually(abs(cte) <= 1.5)'


@pytest.fixture(autouse=True)
def coarse(monkeypatch):
    """Drawing takes by far the longest; here only that it is done matters."""
    monkeypatch.setattr(picture_files, 'DOTS_PER_INCH', 30)


class Stages:
    """Runs stages, and notes them."""

    def __init__(self, out: Path) -> None:
        self.out, self.done = out, []

    def run(self, stages):
        refused = {}
        for stage in stages:
            assert stage.ready(self.out), stage.name
            (self.out / stage.name).mkdir(exist_ok=True)
            self.done.append(stage.name)
            try:
                assert call_stage(*with_engine([stage], 'loop', '0'), False) in stage.accepts
            except UsageError as error:
                assert stage.optional, stage.name
                refused[stage.name] = str(error)
        return refused


def looked_into(path: Path, tmp_path: Path, **options):
    out = tmp_path / 'why'
    out.mkdir()
    stages = Stages(out)
    found = Investigation(
        path=path, out=out, perception=None, budget=Budget(runs=24), workers=1,
        run_stages=stages.run, **options,
    ).evidence()
    return found, stages


@pytest.mark.ros
def test_given_a_run_that_the_network_lost_in_rain_then_the_rain_is_found_and_confirmed(
    tmp_path
):
    bag = tx.run(WET, perception='original', specs=NEAR).save_bag(
        tmp_path / 'runs' / 'wet', images=False)
    found, stages = looked_into(bag, tmp_path)
    assert found.blames == Blames(network=1)
    assert stages.done == ['explain', 'shrink', 'confirm']
    (cause,) = found.causes
    assert cause.bag == bag
    assert cause.removed > 0.25
    assert (cause.without.scenes, cause.without.before) == (4, 0) == (
        cause.truth.scenes, cause.truth.before)
    assert cause.truth.after == 4  # the truth always reaches the line
    assert cause.fresh == (4, 4)
    verdict = judge(found)
    assert verdict.fault is Fault.NETWORK
    assert 'the failed run, driven again' in verdict.sentences[0]
    assert verdict.sentences[0].startswith(
        'The network original was trained with clouds cirrus, clear')


@pytest.mark.parametrize(('offset_m', 'specs', 'options', 'blames', 'fault', 'done', 'said'), [
    (5.0, 'inside=always(abs(cte) <= 1.5)', {}, Blames(requirement=1), Fault.REQUIREMENT,
     ['shrink'], 'violated at the first sample'),
    (5.0, NEAR, {'controller': tx.SteeringLaw(tx.SteeringGains(heading_gain=0.01))},
     Blames(controller=1), Fault.CONTROLLER, ['shrink'], 'The controller steering is at fault'),
    (0.0, NEAR, {}, None, Fault.NOTHING, [], 'nothing failed'),
])
def test_given_a_run_driven_by_the_truth_then_what_is_at_fault_is_found(
    offset_m, specs, options, blames, fault, done, said, tmp_path
):
    scene = tx.Scenario(cross_track_m=offset_m, duration_s=3.0)
    bag = tx.run(scene, perception='truth', specs=specs, **options).save_bag(
        tmp_path / 'runs' / 'one', images=False)
    found, stages = looked_into(bag, tmp_path)
    assert (found.blames, judge(found).fault, stages.done) == (blames, fault, done)
    whose, where, _ = judge(found).sentences
    assert said in whose
    assert not done or 'no network to examine' in found.troubles['explain']
    # Its share is few runs.
    assert not options or where.startswith('The scene may not be the plainest that fails')


def test_given_a_campaign_whose_runs_are_all_lost_at_once_then_no_network_is_blamed(
    tmp_path
):
    found = tx.falsify(
        'nominal', runs=3, perception='truth', specs='far=always(abs(cte) >= 3)',
        settings={'duration_s': 1}, out=tmp_path / 'found',
    ).folder
    found, stages = looked_into(found, tmp_path)
    assert stages.done == ['analyze', 'localize', 'shrink']
    assert found.blames == Blames(requirement=2)  # the budget is for two of the three
    assert judge(found).fault is Fault.REQUIREMENT
    assert (found.judged, found.failed) == (3, 3)
    assert 'all runs fail, so causes cannot be distinguished' in found.troubles['causes']


TWO = ('near=eventually(abs(cte) <= 9)', 'far=always(abs(cte) >= 3)')
"""The first is satisfied by all runs, the second is violated at the first sample."""


def test_given_a_campaign_that_satisfies_its_headline_then_what_it_violates_is_looked_into(
    tmp_path, taxinet, monkeypatch, capfd
):
    folder = tx.falsify(
        'nominal', runs=2, perception='truth', specs=TWO, settings={'duration_s': 1},
        out=tmp_path / 'c',
    ).folder
    found, stages = looked_into(folder, tmp_path)
    assert stages.done == ['analyze', 'localize', 'shrink']
    assert (found.spec, found.blames, found.failed) == ('far', Blames(requirement=2), 2)
    verdict = judge(found)
    assert verdict.sentences[0].startswith(
        'No run violates near; looked into: far, violated by 2 of 2 runs. The requirement far, ')
    assert found.settings.judging.names == ('far', 'near')

    # Asked for the headline, it says that another is violated, and by what that is looked into.
    monkeypatch.chdir(tmp_path)
    capfd.readouterr()
    code, said, _ = taxinet('why', 'c', '--spec', 'near', '--out', 'page', '--json')
    told = json.loads(said)
    assert (code, told['verdict'], told['spec']) == (0, 'nothing failed', 'near')
    assert told['sentences'][0] == 'All 2 judged runs satisfy near.'
    assert told['sentences'][-1] == (
        'Runs violate far (2 of 2); look into that by: taxinet why c --spec far.')
    assert told['sentences'][-1] in (tmp_path / 'page' / 'why.html').read_text()


@pytest.mark.parametrize('asked', [None, 'far'])
def test_given_a_run_that_satisfies_its_headline_then_what_it_violates_is_looked_into(
    asked, tmp_path
):
    bag = tx.run(tx.Scenario(cross_track_m=1.0, duration_s=1.0), perception='truth',
                 specs=TWO).save_bag(tmp_path / 'runs' / 'one', images=False)
    found, stages = looked_into(bag, tmp_path, spec=asked)
    assert (found.spec, found.blames, stages.done) == ('far', Blames(requirement=1), ['shrink'])
    first, *_ = judge(found).sentences
    assert first.startswith('The run does not violate near; looked into: far.') is (asked is None)
    assert 'The requirement far' in first


def test_given_weights_that_are_gone_then_the_verdict_is_unclear_and_says_which(
    tmp_path
):
    weights = tmp_path / 'mine.safetensors'
    for one, other in ((card_path(SHIPPED['original']), card_path(weights)),
                       (SHIPPED['original'], weights)):
        shutil.copyfile(one, other)
    scene = tx.Scenario(cross_track_m=5.0, duration_s=1.0)
    bag = tx.run(scene, perception=str(weights), specs=NEAR).save_bag(
        tmp_path / 'runs' / 'gone', images=False)
    weights.unlink()
    found, stages = looked_into(bag, tmp_path)
    assert stages.done == []
    verdict = judge(found)
    assert verdict.fault is Fault.UNCLEAR
    assert "the run's perception 'weights' (sha256 " in verdict.sentences[0]
    assert 'name its file as perception' in verdict.sentences[0]
    assert found.troubles['explain'] == found.troubles['localize']


def recorded(folder: Path, outcomes: list[Outcome]) -> Path:
    """A campaign with these outcomes, without bags."""
    rows = [
        RunRow(
            run_id=f'r{index}', index=index, program='s_falsif', seed=0, perception='original',
            outcome=outcome, sampler='random',
            robustness={} if not outcome.judged else exact_intervals(
                {'phi': 1.0 if outcome is Outcome.PASS else -1.0}),
            kind='' if outcome.judged else 'timeout', who='' if outcome.judged else 'perception',
            **tx.Scenario(cross_track_m=float(index)).to_human(),
        ) for index, outcome in enumerate(outcomes)
    ]
    facts = {
        'program': 's_falsif.scenic', 'perception': 'original',
        'specs': {'phi': 'always((abs(cte) <= 1.5))'}, 'controller': 'steering',
    }
    record_runs(folder, facts, rows)
    write_tables(rows, folder, facts)
    return folder


@pytest.mark.parametrize(('outcomes', 'fault', 'others'), [
    ([Outcome.INFRA_ERROR] * 3 + [Outcome.REJECTED], Fault.BENCH,
     {'INFRA_ERROR (timeout)': 3, 'REJECTED': 1}),
    ([Outcome.PASS] * 3 + [Outcome.INFRA_ERROR], Fault.NOTHING, {'INFRA_ERROR (timeout)': 1}),
])
def test_given_a_campaign_without_failures_then_nothing_is_run_and_the_verdict_says_why(
    outcomes, fault, others, tmp_path, taxinet
):
    (tmp_path / 'found').mkdir()
    folder = recorded(tmp_path / 'found', outcomes)
    found, stages = looked_into(folder, tmp_path)
    assert (judge(found).fault, stages.done, dict(found.others)) == (fault, [], others)
    code, said, _ = taxinet('why', folder, '--out', tmp_path / 'page', '--json')
    told = json.loads(said)
    assert (code, told['verdict']) == (3 if fault is Fault.BENCH else 0, fault.value)
    page = (tmp_path / 'page' / 'why.html').read_text()
    assert told['sentences'][0] in page.replace('&#39;', "'")


def test_given_a_stage_that_is_interrupted_then_nothing_is_concluded(
    tmp_path, taxinet, monkeypatch
):
    (tmp_path / 'found').mkdir()
    folder = recorded(tmp_path / 'found', [Outcome.PASS, Outcome.FAIL])
    monkeypatch.setattr('taxinet_ros.cli.study.stages.call_stage', lambda stage, resume: 130)
    code, said, _ = taxinet('why', folder, '--out', tmp_path / 'why')
    assert code == 130
    assert said.endswith('interrupted in analyze; the same command goes on\n')
    assert not (tmp_path / 'why' / 'why.html').exists()


def test_what_is_neither_campaign_nor_run_is_refused_with_what_could_be_named(tmp_path):
    with pytest.raises(UsageError, match='neither the folder of a campaign nor the bag'):
        kind_of(tmp_path)
    tx.run(tx.Scenario(duration_s=0.5), perception='truth', specs='low=always(cte < 9)').save_bag(
        tmp_path / 'one', images=False)
    with pytest.raises(UsageError, match=r'bags without the campaign.db .* as .*/one'):
        kind_of(tmp_path)
    assert kind_of(tmp_path / 'one') == 'run'


@pytest.mark.parametrize(('offset_m', 'formula', 'doomed'), [
    (5.0, 'always(abs(cte) <= 1.5)', True),
    (1.4, 'always(abs(cte) <= 1.5)', False),
    (5.0, 'eventually[0:1](abs(cte) <= 1.5)', False),
    (5.0, 'eventually(abs(cte) > 1e6)', False),  # no sample decides it, but no run satisfies it
])
def test_a_run_is_violated_at_its_start_only_if_nothing_after_it_could_help(
    offset_m, formula, doomed
):
    scene = tx.Scenario(cross_track_m=offset_m, duration_s=1.0)
    judging = Judging(specs=(f'phi={formula}',))
    assert violated_at_start(scene, judging, SimulatedWorld) is doomed
    assert bool(unsatisfiable(scene, judging, {})) is ('1e6' in formula)


def test_what_shrinking_found_is_told_in_sentences():
    def said_of(values):
        return sentences(TEXT, 'summary', values=values, fields=BY_KEY)

    def parameter(original, nominal, shrunk, **values):
        return {'original': original, 'nominal': nominal, 'shrunk': shrunk, 'matters': False,
                'passes_at': None, 'rho_in_original': 1.0, **values}

    values = {'end': 'minimal', 'spec': 'phi', 'parameters': {
        'rain_percent': parameter(90.0, 0.0, 13.0, matters=True, passes_at=12.0),
        'cross_track_m': parameter(3.0, 0.0, 0.0),
    }}
    assert said_of(values) == (
        'Shrunk to what matters, rain 13 % alone is enough to violate phi; everything else is '
        'nominal.', 'Rain: 13 % fails, 12 % passes.',
    )
    (plainest,) = said_of({**values, 'end': 'nominal fails'})
    assert 'look at camera, place or network' in plainest
    rain = {**values['parameters']['rain_percent'], 'rho_in_original': -0.1}
    two = {**values, 'parameters': {'rain_percent': rain}}
    assert said_of(two)[-1].startswith('Rain: the original fails without it too')
    unknown = {'rain_percent': {**rain, 'matters': None}}
    (spent,) = said_of({**two, 'end': 'spent', 'parameters': unknown})
    assert spent.startswith('The scene may not be the plainest that fails')
    assert said_of({**two, 'end': 'interrupted', 'parameters': unknown}) == (
        'Which parameters matter is not known yet.',)
    (nothing,) = said_of({**two, 'parameters': {'rain_percent': {**rain, 'matters': False}}})
    assert nothing.startswith('No single parameter matters')

"""A search's options, sequence, record and resumption, with answers in any order."""

from __future__ import annotations

import dataclasses
import shutil
from pathlib import Path

import falsify_samples as toy
import pandas as pd
import pytest
from campaign_records import change_row, write_campaign

from taxinet_ros.core.verdict.outcome import Outcome, RunRequest, RunResult
from taxinet_ros.errors import UsageError
from taxinet_ros.samplers.sampler import LAG
from taxinet_ros.samplers.space import Dimension
from taxinet_ros.scenes import source as scene_source
from taxinet_ros.scenes.search_space import Choice, SearchSpace
from taxinet_ros.trials import search as search_module
from taxinet_ros.trials.engine import Engine
from taxinet_ros.trials.options import make_options
from taxinet_ros.trials.record.content import read_campaign
from taxinet_ros.trials.record.facts import read_facts
from taxinet_ros.trials.record.table import read_table
from taxinet_ros.trials.search import Search, make_search
from taxinet_ros.trials.search_summary import search_summary
from taxinet_ros.trials.sequential import StopRule, parse_stop_rule


@pytest.fixture(autouse=True)
def _toy(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(search_module, 'SceneSource', toy.ToySource)


@pytest.fixture(scope='module')
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of a search that nobody disturbed."""
    out = tmp_path_factory.mktemp('search') / 'whole'
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(search_module, 'SceneSource', toy.ToySource)
        toy.finish(toy.options(out))
    return out


@pytest.fixture
def copy(whole: Path, tmp_path: Path) -> Path:
    """A copy of it, to be continued."""
    return Path(shutil.copytree(whole, tmp_path / 'copy'))


def test_given_a_search_then_its_table_has_a_row_for_every_run_and_how_it_was_chosen(whole):
    table = read_table(whole)
    pd.testing.assert_frame_equal(read_table(whole / 'runs.parquet'), table)
    assert list(table['index']) == list(range(20))
    assert {'PASS', 'FAIL', 'REJECTED'} == set(table['outcome'])
    assert set(table['sampler']) == {'ce'}
    assert table[['u_x', 'u_y']].notna().all(axis=None)
    assert list(table['weight'].notna()) == list(table['refused'] == 0)
    drawn = table[table['outcome'] != 'REJECTED']
    assert list(drawn['cross_track_m']) == pytest.approx(list(10 * drawn['u_x'] - 5))
    assert (table['weight'] != 1).any(), 'the sampler has learned nothing, so the test would not'


def test_s9_given_refused_points_then_they_use_up_no_run_and_are_counted(whole):
    """A point in six is refused, and none of the 20 runs is lost to one."""
    table = read_table(whole)
    assert table['refused'].sum() >= 1
    assert not (table[['u_x', 'u_y']].min(axis=1) > 0.6).any()
    assert table['detail'].str.contains('requirements').sum() == 0
    assert [row.refused for row in read_campaign(whole).rows] == list(table['refused'])


def test_s6_given_draws_that_are_no_scenario_then_they_are_rejected_with_the_reason(whole):
    table = read_table(whole)
    rejected = table[table['outcome'] == 'REJECTED']
    assert 1 <= len(rejected) <= 8
    assert (rejected['u_y'] > 0.88).all()
    assert list(rejected['detail']) == [
        f'toy: scene {index}: distance_m is 2601' for index in rejected['index']
    ]
    assert rejected['rho'].isna().all()


def test_s9_given_a_point_that_is_never_accepted_then_the_run_is_rejected_and_the_search_goes_on(
    tmp_path, monkeypatch
):
    monkeypatch.setattr(scene_source, 'MAX_ITERATIONS', 1)
    done = toy.finish(toy.options(tmp_path / 'one', runs=200, sampler='random'))
    never = [row for row in done.rows if row.refused == 1]
    assert never
    assert {row.detail.split(': ')[-1] for row in never} == {
        'no point met the requirements in 1 tries',
    }
    assert len(done.rows) == 200
    with toy.searching(toy.options(tmp_path / 'two', runs=200, sampler='random')) as search:
        for number, _ in enumerate(toy.answers(search, 2)):
            if number == 60:
                break
    toy.finish(toy.options(tmp_path / 'two', runs=200, sampler='random', resume=True))
    toy.same_table(tmp_path / 'one', tmp_path / 'two')


def test_t11_given_a_grid_with_an_end_then_the_search_ends_there_and_says_so(
    tmp_path, monkeypatch
):
    kinds = SearchSpace(choices=tuple(
        Choice(dimension=Dimension(name=name, weights=(1, 1, 1))) for name in ('x', 'y')
    ))
    monkeypatch.setattr(toy, 'SPACE', kinds)
    done = toy.finish(toy.options(tmp_path / 'grid', runs=36, sampler='grid'))
    assert len(done.rows) == 8  # of nine cells one is refused
    assert sum(row.refused for row in done.rows) <= 1  # unless it was the last
    assert done.exhausted
    assert search_summary(done)[-1] == (
        'ended before its 36 runs: all 9 combinations of the grid have been tried'
    )


def test_s3_given_requirements_that_hold_in_a_share_only_then_a_learned_density_is_not_known(
    tmp_path, monkeypatch
):
    monkeypatch.setattr(toy, 'SPACE', dataclasses.replace(toy.SPACE, soft=True))
    for sampler, weights in (('ce', {None, 1.0}), ('random', {1.0}), ('mab', {None})):
        done = toy.finish(toy.options(tmp_path / sampler, sampler=sampler))
        assert {row.weight for row in done.rows} == weights, sampler


@pytest.mark.parametrize(('workers', 'pick'), [(2, toy.first), (3, toy.last), (8, toy.last)])
def test_given_workers_that_answer_in_any_order_then_the_table_is_that_of_one(
    workers, pick, whole, tmp_path
):
    toy.finish(toy.options(tmp_path / 'many', workers=workers), workers, pick)
    toy.same_table(whole, tmp_path / 'many')


def test_given_a_kill_after_any_answer_when_resumed_then_the_table_is_that_of_an_undisturbed_one(
    whole, tmp_path
):
    killed = tmp_path / 'killed'
    with toy.searching(toy.options(killed)) as search:
        for number, _ in enumerate(toy.answers(search, 3, toy.last)):
            copy = tmp_path / f'copy-{number}'
            shutil.copytree(killed, copy)
            ended = {row.index for row in search.rows}
            began = {path.name for path in copy.glob('nominal-*')}
            resumed = toy.finish(toy.options(copy, resume=True), 2)
            assert len(resumed.rows) == 20
            toy.same_table(whole, copy)
            aside = {path.name for path in copy.glob('*.broken-1')}
            lost = {name for name in began if int(name[-5:]) not in ended}
            assert aside == {f'{name}.broken-1' for name in lost}
    assert number > 10


def test_given_a_finished_search_when_resumed_with_more_runs_then_only_those_are_done(
    copy, tmp_path
):
    toy.finish(toy.options(tmp_path / 'longer', runs=25))
    new = []
    chosen = toy.options(copy, runs=25, resume=True)
    with Engine(chosen, ('perception',), new.append) as search:
        for _ in toy.answers(search, 1):
            pass
    assert [row.index for row in new] == [20, 21, 22, 23, 24]
    toy.same_table(copy, tmp_path / 'longer')
    assert read_facts(copy)['runs'] == 25


def break_once(indices: set[int]):
    """Results of a bench that breaks at the first try of some runs."""
    tried: set[int] = set()

    def judge(request: RunRequest) -> RunResult:
        broken = request.index in indices - tried
        tried.add(request.index)
        return toy.result(request, Outcome.INFRA_ERROR if broken else None)

    return judge


def test_given_runs_that_break_once_then_a_second_try_fixes_them_and_keeps_what_is_left(
    whole, tmp_path
):
    out = tmp_path / 'fixed'
    undisturbed = read_table(whole)
    broken = list(undisturbed['index'][undisturbed['rho'].notna()][:9:4])
    toy.finish(toy.options(out), 2, judge=break_once(set(broken)))
    table = read_table(out)
    assert list(table['retries']) == [int(index in broken) for index in range(20)]
    assert list(table['rho'].dropna()) == list(undisturbed['rho'].dropna())
    assert sorted(path.name for path in out.glob('*.broken-*')) == [
        f'nominal-s3-{index:05d}.broken-1' for index in broken
    ]


def test_given_a_run_that_breaks_twice_then_it_counts_as_broken_and_is_not_learned_from(tmp_path):
    def judge(request: RunRequest) -> RunResult:
        return toy.result(request, Outcome.INFRA_ERROR if request.index == 4 else None)

    search = toy.finish(toy.options(tmp_path / 'one'), judge=judge)
    (broken,) = (row for row in search.rows if row.outcome is Outcome.INFRA_ERROR)
    assert (broken.index, broken.retries, broken.rho) == (4, 1, {})
    assert len(search.rows) == 20
    again = toy.finish(toy.options(tmp_path / 'many', workers=8), 8, toy.last, judge)
    assert len(again.rows) == 20
    toy.same_table(tmp_path / 'one', tmp_path / 'many')


@pytest.mark.parametrize(('rule', 'runs'), [('failures=3', 200), ('half-width=0.2', 200)])
def test_given_a_stop_rule_then_the_search_ends_with_the_run_that_meets_it(rule, runs, tmp_path):
    chosen = toy.options(tmp_path / 'c', runs=runs, sampler='random', stop=parse_stop_rule(rule))
    search = toy.finish(chosen)
    assert 3 <= len(search.rows) < runs
    assert search.stopped == f'{rule} reached'
    assert toy.is_met(chosen.stop, list(search.rows)[:1 - LAG])
    assert not toy.is_met(chosen.stop, list(search.rows)[:-LAG])
    again = toy.finish(
        toy.options(tmp_path / 'c', runs=runs, sampler='random', stop=chosen.stop, resume=True)
    )
    assert len(again.rows) == len(search.rows)


@pytest.mark.one_in(3)
@pytest.mark.parametrize('rule', ['failures=2', 'half-width=0.3', 'min-satisfaction=0.2'])
def test_t15_given_a_stop_rule_then_workers_make_no_difference(rule, tmp_path):
    """One worker stopped after 10 runs, two after 11."""
    folders = []
    for workers, pick in ((1, toy.first), (2, toy.last), (8, toy.last)):
        chosen = toy.options(
            tmp_path / str(workers), runs=200, workers=workers, stop=parse_stop_rule(rule))
        search = toy.finish(chosen, workers, pick)
        assert search.stopped == chosen.stop.reached
        assert search.book.facts['until'] == [rule]
        folders.append(tmp_path / str(workers))
    for folder in folders[1:]:
        toy.same_table(folders[0], folder)


def test_given_a_search_resumed_with_another_rule_then_the_record_names_both(tmp_path):
    first = parse_stop_rule('failures=1')
    toy.finish(toy.options(tmp_path / 'c', runs=200, sampler='random', stop=first))
    test = parse_stop_rule('min-satisfaction=0.2')
    again = toy.finish(
        toy.options(tmp_path / 'c', runs=200, sampler='random', stop=test, resume=True)
    )
    assert again.stopped == 'min-satisfaction=0.2 decided'
    assert read_facts(tmp_path / 'c')['until'] == ['failures=1', 'min-satisfaction=0.2']


def summary(done: Engine[Search]) -> str:
    return '\n'.join(search_summary(done))


def test_t15_given_an_open_number_of_runs_then_the_summary_and_the_record_say_so(tmp_path):
    stop = parse_stop_rule('failures=1')
    words = summary(toy.finish(toy.options(tmp_path / 'a', runs=200, stop=stop)))
    assert 'too high on average; the interval holds all the same' in words
    assert 'valid whenever a search stops' in words
    words = summary(toy.finish(toy.options(tmp_path / 'b', sampler='random')))
    assert 'too high' not in words
    assert '(95 % intervals)' in words
    toy.finish(toy.options(tmp_path / 'c', runs=20))
    search = toy.finish(toy.options(tmp_path / 'c', runs=30, resume=True))
    assert search.first_planned == range(20)
    assert read_facts(tmp_path / 'c')['first_runs'] == 20
    assert 'valid whenever a search stops' in summary(search)


def test_t1_given_a_search_without_draws_then_its_summary_says_that_there_is_no_rate(tmp_path):
    lines = search_summary(toy.finish(toy.options(tmp_path / 'c', sampler='grid')))
    (line,) = [line for line in lines if 'rate' in line]
    assert line.startswith('no rate from this search: grid chose all of its')
    assert not any('%' in line for line in lines)


def test_given_a_budget_then_no_run_begins_after_it_is_spent(tmp_path, monkeypatch):
    now = [0.0]
    monkeypatch.setattr(search_module.time, 'monotonic', lambda: now[0])

    def judge(request: RunRequest) -> RunResult:
        now[0] += 10
        return toy.result(request)

    search = toy.finish(
        toy.options(tmp_path / 'c', sampler='random', budget_s=35.0), judge=judge
    )
    assert sum(row.outcome.judged for row in search.rows) == 4
    assert 'budget' in search.stopped


def test_given_interrupted_runs_then_they_are_in_the_table_and_run_again_when_resumed(
    whole, tmp_path
):
    out = tmp_path / 'c'
    with toy.searching(toy.options(out)) as search:
        begun = [search.next() for _ in range(3)]
        search.take(begun[0], toy.result(begun[0]))
        search.interrupt()
        assert search.next() is None
        for request in begun[1:]:
            search.take(request, toy.result(request, Outcome.INTERRUPTED))
    assert list(read_table(out)['outcome']) == ['PASS', 'INTERRUPTED', 'INTERRUPTED']
    assert read_campaign(out).unfinished == ()
    toy.finish(toy.options(out, resume=True))
    resumed, undisturbed = read_table(out), read_table(whole)
    assert list(resumed['outcome']) == list(undisturbed['outcome'])
    assert list(resumed['u_x']) == list(undisturbed['u_x'])


def test_given_the_same_values_in_other_words_when_resumed_then_it_goes_on(tmp_path):
    """1 and 1.0 are one value, and a key is its short form."""
    first = {'overrides': {'rain': '0', 'shadows': 'on'}, 'sampler_options': {'every': '1'}}
    again = {'overrides': {'shadows': 'ON', 'rain_percent': '0.0'},
             'sampler_options': {'every': '1.0'}}
    toy.finish(toy.options(tmp_path / 'c', runs=4, **first))
    toy.finish(toy.options(tmp_path / 'whole', runs=8, **first))
    toy.finish(toy.options(tmp_path / 'c', runs=8, resume=True, **again))
    toy.same_table(tmp_path / 'c', tmp_path / 'whole')


OTHERS = {
    'seed': ({'seed': 4}, 'begun with seed 3, not 4'),
    'sampler': ({'sampler': 'random'}, 'begun with sampler "ce", not "random"'),
    'option': ({'sampler_options': {'every': '2'}}, 'begun with sampler_options'),
    'specs': ({'specs': ('phi_always',)}, 'begun with specs'),
    'overrides': ({'overrides': {'rain': '0'}}, 'begun with overrides'),
    'weights': ({'perception': 'original'}, 'begun with perception "truth", not "original"'),
    'fewer runs': ({'runs': 5}, 'runs 5: 20 were started'),
}


@pytest.mark.parametrize('case', OTHERS)
def test_given_another_search_in_the_folder_when_resumed_then_it_is_refused_and_left_alone(
    case, copy
):
    changes, expected = OTHERS[case]
    before = {path: path.read_bytes() for path in copy.iterdir() if path.is_file()}
    with pytest.raises(UsageError) as caught:
        toy.finish(toy.options(copy, resume=True, **changes))
    assert expected in str(caught.value)
    assert '\n' not in str(caught.value)
    assert {path: path.read_bytes() for path in copy.iterdir() if path.is_file()} == before


def test_given_a_changed_program_or_weights_file_when_resumed_then_it_is_refused(
    copy, monkeypatch
):
    monkeypatch.setattr(search_module, 'check_perception', lambda word, **others: 'abc')
    with pytest.raises(UsageError, match='begun with perception_sha256 "", not "abc"'):
        toy.finish(toy.options(copy, resume=True))
    monkeypatch.setattr(toy.ToySource, 'text', '# --- nominal.scenic ---\nother\n')
    with pytest.raises(UsageError, match=r'begun with another text of nominal\.scenic'):
        toy.finish(toy.options(copy, resume=True))


def test_given_nothing_to_resume_or_a_campaign_of_another_kind_then_one_line_says_so(tmp_path):
    with pytest.raises(UsageError, match=r'there is nothing to resume; leave resume out'):
        toy.finish(toy.options(tmp_path, resume=True))
    write_campaign(tmp_path, facts={'seed': 3})
    with pytest.raises(UsageError, match='not written by taxinet falsify'):
        toy.finish(toy.options(tmp_path, resume=True))


def test_given_a_sampler_that_chooses_another_point_when_resumed_then_it_is_refused(copy):
    point = read_campaign(copy).rows[7].point
    change_row(copy, 7, point={**point, 'x': point['x'] + 1e-9})
    before = read_campaign(copy)
    with pytest.raises(UsageError, match='another point for run 7'):
        toy.finish(toy.options(copy, resume=True))
    assert read_campaign(copy) == before


@pytest.mark.parametrize(('sampler', 'rule'), [
    ('halton', 'half-width=0.1'), ('sobol', 'half-width=0.1'), ('grid', 'min-satisfaction=0.2'),
])
def test_given_a_sampler_without_draws_then_no_rate_can_be_waited_for(sampler, rule, tmp_path):
    chosen = toy.options(tmp_path / 'c', sampler=sampler, stop=parse_stop_rule(rule))
    with pytest.raises(UsageError, match=f'no rate is known with {sampler}'):
        toy.finish(chosen)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    'text', ['', 'failures', 'failures=0', 'failures=1.5', 'half-width=0', 'half-width=nan', 'x=1']
)
def test_given_a_rule_that_is_none_then_it_is_refused(text):
    with pytest.raises(UsageError, match='until '):
        parse_stop_rule(text)


def ask(folder: Path, **changes) -> Search:
    names = ('out', 'images', 'resume', 'stop_on')
    campaign = {
        'program': 'nominal', 'runs': 5, 'seed': 1, 'perception': 'truth', 'settings': (),
        'specs': (), 'out': folder / 'c', 'processes': False,
        **{name: changes[name] for name in names if name in changes},
    }
    own = {
        'sampler': 'ce', **{name: value for name, value in changes.items() if name not in names},
    }
    return make_search(make_options(**campaign), **own)


def test_given_the_runway_and_runs_that_stop_early_then_the_rule_is_refused(tmp_path):
    with pytest.raises(UsageError, match='not with stop_on violated'):
        ask(tmp_path, until='max-off-runway=0.1', stop_on='violated')


def test_given_wishes_then_they_are_in_the_options(tmp_path):
    asked = ask(
        tmp_path, sampler_options=['floor=0.2', 'every=5'], workers=8, until='half-width=0.02',
        budget_min=2.5, images='none',
    )
    assert asked.sampler_options == {'floor': '0.2', 'every': '5'}
    assert asked.campaign.workers == 8
    assert asked.stop == StopRule(kind='half-width', value=0.02)
    assert asked.budget_s == 150
    assert asked.campaign.images == 'none'

BAD = {
    'no value': ({'sampler_options': ['every']}, 'expected key=value'),
    'no worker': ({'workers': 0}, 'workers 0: needs to be within 1..8'),
    'too many workers': ({'workers': 9}, 'workers 9: needs to be within 1..8'),
    'no budget': ({'budget_min': 0.0}, 'budget 0: needs to be above 0'),
    'budget that is none': ({'budget_min': float('nan')}, 'budget nan'),
    'unknown rule': ({'until': 'bored'}, 'until bored: expected failures=K'),
    'unknown images': ({'images': 'some'}, 'images some: unknown; known: all, failures, none'),
    'resume of nowhere': ({'resume': True, 'out': None}, 'resume: name the campaign to continue'),
}


@pytest.mark.parametrize('case', BAD)
def test_given_a_mistake_then_one_line_says_what(case, tmp_path):
    changes, expected = BAD[case]
    with pytest.raises(UsageError) as caught:
        ask(tmp_path, **changes)
    assert expected in str(caught.value)
    assert '\n' not in str(caught.value)

"""Shards of a search, run apart, merged into the campaign of the whole; and what is refused."""

from __future__ import annotations

import dataclasses
import random
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import falsify_samples as toy
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from journal_samples import rewrite

from taxinet_ros.analysis.runs.campaign import read_runs
from taxinet_ros.campaign import merge as merge_module
from taxinet_ros.campaign import search as search_module
from taxinet_ros.campaign.doctor import examine, mend
from taxinet_ros.campaign.merge import merge_shards
from taxinet_ros.campaign.options import make_options
from taxinet_ros.campaign.past_runs.recorded_campaign import open_campaign
from taxinet_ros.campaign.rates import failure_rate, rate
from taxinet_ros.campaign.record.facts import FACTS_NAME, read_facts
from taxinet_ros.campaign.record.ledger import read_ledger
from taxinet_ros.campaign.record.shard import Shard, parse_shard
from taxinet_ros.campaign.record.table import read_table
from taxinet_ros.campaign.samplers.registry import SAMPLERS, DependsOn, make_sampler
from taxinet_ros.campaign.samplers.space import Dimension
from taxinet_ros.campaign.scenes.search_space import Choice, SearchSpace
from taxinet_ros.campaign.search import search_summary
from taxinet_ros.campaign.search_options import SearchOptions, make_search_options
from taxinet_ros.core.verdict.outcome import Outcome, RunRequest, RunResult
from taxinet_ros.errors import UsageError

RUNS = 14
BY_INDEX = ('random', 'halton', 'sobol', 'grid')


@pytest.fixture(autouse=True)
def _toy(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(search_module, 'SceneSource', toy.ToySource)


def options(out: Path, shard: str = '', **changes: Any) -> SearchOptions:
    """A search of the toy program, whose runs leave no bags."""
    chosen = toy.options(out, **{'runs': RUNS, 'sampler': 'random', **changes})
    return dataclasses.replace(
        chosen, campaign=dataclasses.replace(chosen.campaign, bags=False),
        shard=parse_shard(shard) if shard else None,
    )


def made(folder: Path, shards: Sequence[str], **changes: Any) -> list[Path]:
    """Complete shards of one search."""
    folders = [folder / f'shard-{shard.replace("/", "-")}' for shard in shards]
    for out, shard in zip(folders, shards, strict=True):
        toy.finish(options(out, shard, **changes))
    return folders


def all_of(count: int) -> list[str]:
    return [f'{number}/{count}' for number in range(1, count + 1)]


def merged(folders: Sequence[Path], out: Path) -> Path:
    merge_shards(folders, out)
    assert examine(out).findings == []
    assert mend(out) == []
    return out


PARTITIONS = [*map(all_of, range(1, 8)), ['1/2', '2/4', '4/4'], ['3/3', '1/6', '4/6', '2/3']]


@settings(
    max_examples=5, deadline=None, suppress_health_check=[
        HealthCheck.too_slow, HealthCheck.function_scoped_fixture,
    ],
)
@given(
    sampler=st.sampled_from([*((name, {}) for name in BY_INDEX), ('halton', {'floor': '0.3'}),
                             ('grid', {'points': '3', 'floor': '0.2'})]),
    parts=st.sampled_from(PARTITIONS).flatmap(st.permutations),
    runs=st.integers(7, 25), workers=st.integers(1, 8), seed=st.integers(0, 99),
)
@example(sampler=('grid', {}), parts=['2/2', '1/2'], runs=25, workers=8, seed=3)
def test_given_any_partition_in_any_order_then_the_merged_table_is_that_of_the_whole(
    tmp_path_factory, sampler, parts, runs, workers, seed
):
    folder = tmp_path_factory.mktemp('shards')
    chosen = {'runs': runs, 'sampler': sampler[0], 'sampler_options': sampler[1], 'seed': seed}
    toy.finish(options(folder / 'whole', **chosen))
    folders = [folder / f'part-{number}' for number in range(len(parts))]
    for out, shard in zip(folders, parts, strict=True):
        toy.finish(options(out, shard, **chosen), workers, toy.last)
        assert set(read_table(out)['index']) <= set(parse_shard(shard).runs(runs))
    toy.same_table(folder / 'whole', merged(folders, folder / 'merged'))
    whole, joined = (
        dict(read_facts(folder / name).values) for name in ('whole', 'merged')
    )
    assert [one['shard'] for one in joined.pop('merged')] == parts
    assert whole == joined


def test_given_a_grid_that_ends_before_all_runs_then_its_shards_end_there_too(
    tmp_path, monkeypatch
):
    kinds = SearchSpace(choices=tuple(
        Choice(dimension=Dimension(name=name, weights=(1, 1, 1))) for name in ('x', 'y')
    ))
    monkeypatch.setattr(toy, 'SPACE', kinds)
    whole = toy.finish(options(tmp_path / 'whole', runs=36, sampler='grid'))
    assert whole.exhausted
    assert len(whole.rows) == 8
    folders = made(tmp_path, all_of(3), runs=36, sampler='grid')
    toy.same_table(tmp_path / 'whole', merged(folders, tmp_path / 'merged'))
    with pytest.raises(UsageError, match=r'shard 2 of 3 is missing: run 1, 4, 7 of 8'):
        merge_shards([folders[0], folders[2]], tmp_path / 'two')


def test_given_a_shard_killed_after_any_answer_when_resumed_then_the_merged_table_is_the_same(
    tmp_path
):
    whole, other = tmp_path / 'whole', tmp_path / 'other'
    toy.finish(options(whole, sampler='sobol'))
    toy.finish(options(other, '2/2', sampler='sobol'))
    number = -1
    with toy.searching(options(tmp_path / 'killed', '1/2', sampler='sobol')) as search:
        for number, _ in enumerate(toy.answers(search, 3, toy.last)):
            copy = tmp_path / f'copy-{number}'
            shutil.copytree(tmp_path / 'killed', copy)
            if len(search.rows) < len(range(0, RUNS, 2)):
                with pytest.raises(UsageError, match=r'copy-.: shard 1/2 is not complete: run .*'
                                   r'has no result; continue it with --resume'):
                    merge_shards([copy, other], tmp_path / 'none')
            toy.finish(options(copy, '1/2', sampler='sobol', resume=True), 2)
            toy.same_table(whole, merged([copy, other], tmp_path / f'merged-{number}'))
    assert number >= 3
    assert not (tmp_path / 'none').exists()


def test_given_a_merged_campaign_when_resumed_with_more_runs_then_it_goes_on_as_the_whole(
    tmp_path
):
    joined = merged(made(tmp_path, all_of(2)), tmp_path / 'merged')
    toy.finish(options(tmp_path / 'whole', runs=RUNS + 5))
    new = toy.finish(options(joined, runs=RUNS + 5, resume=True))
    assert len(new.rows) == RUNS + 5
    toy.same_table(tmp_path / 'whole', joined)
    assert [one['shard'] for one in read_facts(joined).values['merged']] == ['1/2', '2/2']


def test_given_shards_resumed_with_more_runs_then_they_are_the_shards_of_the_longer_search(
    tmp_path
):
    folders = made(tmp_path, all_of(2))
    for number, out in enumerate(folders, 1):
        toy.finish(options(out, f'{number}/2', runs=2 * RUNS, resume=True))
    toy.finish(options(tmp_path / 'whole'))
    toy.finish(options(tmp_path / 'whole', runs=2 * RUNS, resume=True))
    joined = merged(folders, tmp_path / 'merged')
    toy.same_table(tmp_path / 'whole', joined)
    assert open_campaign(joined).failure_rate == open_campaign(tmp_path / 'whole').failure_rate
    assert open_campaign(joined).failure_rate.anytime


def test_given_a_run_that_the_bench_broke_then_it_is_merged_and_resuming_repeats_it(tmp_path):
    def judge(request: RunRequest) -> RunResult:
        return toy.result(request, Outcome.INFRA_ERROR if request.index == 5 else None)

    toy.finish(options(tmp_path / 'a', '1/2'))
    toy.finish(options(tmp_path / 'b', '2/2'), judge=judge)
    joined = merged([tmp_path / 'a', tmp_path / 'b'], tmp_path / 'merged')
    assert list(read_table(joined)['outcome']).count('INFRA_ERROR') == 1
    toy.finish(options(joined, resume=True))
    toy.finish(options(tmp_path / 'whole'))
    tables = [read_table(folder).set_index('index') for folder in (joined, tmp_path / 'whole')]
    assert len(tables[0]) == RUNS
    assert list(tables[0]['outcome']) == list(tables[1]['outcome'])


# What one shard says ------------------------------------------------------------------------------


def test_given_one_shard_then_its_rate_is_that_of_its_own_runs_fixed_beforehand(tmp_path):
    shard, = made(tmp_path, ['2/3'], runs=50)
    rows = open_campaign(shard).rows
    judged = [row for row in rows if row.outcome.judged]
    failed = sum(row.outcome is Outcome.FAIL for row in judged)
    assert [row.index for row in rows] == list(range(1, 50, 3))
    assert 0 < failed < len(judged)
    found = open_campaign(shard).failure_rate
    assert (found.drawn, found.drawn_hits, found.anytime) == (len(judged), failed, False)
    assert found.rate == rate(failed, len(judged))
    whole = read_runs(shard).rate()
    assert (whole.low, whole.high) == pytest.approx(rate(failed, len(judged))[1:])


def test_given_a_shard_with_a_gap_then_only_the_runs_before_it_count(tmp_path):
    shard, = made(tmp_path, ['2/3'], runs=50)
    planned = range(1, 50, 3)
    rows = [row for row in open_campaign(shard).rows if row.index != 22]
    found = failure_rate(rows, planned)
    assert found.anytime
    assert found.drawn == sum(row.outcome.judged for row in rows if row.index < 22)


def test_given_a_shard_then_heading_and_summary_say_which_part_it_is(tmp_path):
    with toy.searching(options(tmp_path / 'c', '2/3')) as search:
        for _ in toy.answers(search, 2):
            pass
    assert search_module.search_heading(search.options).startswith(
        'searching nominal for failures: up to 14 runs, shard 2/3 (5 of the 14 runs), sampler '
    )
    lines = search_summary(search)
    assert 'shard 2/3 (5 of the 14 runs): taxinet merge joins all shards' in lines
    assert not any(line.startswith('ended before') for line in lines)


# What is refused ----------------------------------------------------------------------------------


@pytest.mark.parametrize('sampler', [
    name for name, kind in SAMPLERS.items() if kind.depends_on is DependsOn.RESULTS
])
def test_given_a_sampler_that_needs_results_then_it_is_refused_by_name(sampler, tmp_path):
    with pytest.raises(UsageError) as caught:
        toy.finish(options(tmp_path / 'c', '1/2', sampler=sampler, sampler_options={}))
    assert str(caught.value) == (
        f'--shard: the sampler {sampler} chooses scenes by the results of all earlier runs, most '
        'of which a shard does not have; use --sampler random, halton, sobol, grid'
    )
    assert not (tmp_path / 'c').exists()


@pytest.mark.parametrize('name', BY_INDEX)
def test_given_samplers_of_shards_then_no_result_changes_their_points(name):
    assert SAMPLERS[name].depends_on is not DependsOn.RESULTS
    points = []
    for rho in (-1.0, 1.0, None):
        sampler = make_sampler(name, toy.SPACE.dimensions, 3, 30)
        tickets = []
        for _ in range(30):
            tickets.append(sampler.next())
            sampler.tell(tickets[-1][0], rho)
        points.append(tickets)
    assert points[0] == points[1] == points[2]


@pytest.mark.parametrize(
    'text', ['', '0/2', '3/2', '1', '1/0', '-1/2', '1/2/3', 'a/b', '1.0/2', '1/99999999999']
)
def test_given_a_shard_that_is_none_then_it_is_refused(text):
    with pytest.raises(UsageError, match=r'--shard .*: expected I/N, one of 1/N to N/N'):
        parse_shard(text)


def ask(folder: Path, **changes: Any) -> SearchOptions:
    campaign = make_options(
        program='nominal', runs=4, seed=1, perception='truth', settings=(), specs=(),
        out=folder / 'c', processes=False,
    )
    return make_search_options(campaign, **{
        'sampler': 'random', 'sampler_options': (), 'workers': 1, 'resume': False, 'until': None,
        'budget_min': None, 'shard': Shard(1, 2), **changes,
    })


def test_given_wishes_that_a_shard_cannot_fulfil_then_they_are_refused_by_name(tmp_path):
    assert ask(tmp_path, budget_min=5.0).runs == 2
    with pytest.raises(UsageError, match=r'^--until failures=1: not with --shard, since only'):
        ask(tmp_path, until='failures=1')
    with pytest.raises(UsageError, match=r'^--shard 5/5: has none of the 4 runs; use at most 4 '):
        ask(tmp_path, shard=Shard(5, 5))


def test_given_a_shard_when_resumed_as_another_or_as_the_whole_then_it_is_refused(tmp_path):
    shard, = made(tmp_path, ['1/2'])
    toy.finish(options(tmp_path / 'whole'))
    for out, other in ((shard, '2/2'), (shard, '1/3'), (shard, ''), (tmp_path / 'whole', '1/2')):
        with pytest.raises(UsageError, match='was begun with shard'):
            toy.finish(options(out, other, resume=True))


CHANGES: dict[str, dict[str, Any]] = {
    'seed': {'seed': 4},
    'sampler': {'sampler': 'halton'},
    'sampler_options': {'sampler': 'halton', 'sampler_options': {'floor': '0.3'}},
    'runs': {'runs': RUNS + 1},
    'overrides': {'overrides': {'clouds': 'clear'}},
    'specs': {'specs': ('phi_always',)},
}


@pytest.mark.parametrize('name', CHANGES)
def test_given_shards_of_two_searches_then_what_differs_is_named(name, tmp_path):
    change = CHANGES[name]
    first, = made(tmp_path, ['1/2'], **({'sampler': 'halton'} if name == 'sampler_options' else {}))
    toy.finish(options(tmp_path / 'b', '2/2', **change))
    with pytest.raises(UsageError, match=rf'/b: its {name} is .*, but .* in .*/shard-1-2; shards'):
        merge_shards([first, tmp_path / 'b'], tmp_path / 'out')
    assert not (tmp_path / 'out').exists()


def change_facts(monkeypatch: pytest.MonkeyPatch, **changes: Any) -> None:
    before = search_module.campaign_facts
    monkeypatch.setattr(
        search_module, 'campaign_facts', lambda *words: {**before(*words), **changes}
    )


@pytest.mark.parametrize(('name', 'said'), [
    ('program_sha256', 'program_sha256'), ('controller_sha256', 'controller_sha256'),
    ('taxinet_ros_version', 'version'), ('world', 'world'), ('gains', 'gains'),
    ('extensions', 'extensions'), ('timing', 'timing'), ('images', 'images'),
])
def test_given_another_program_version_or_world_then_it_is_named(
    name, said, tmp_path, monkeypatch
):
    first, = made(tmp_path, ['1/2'])
    with monkeypatch.context() as patch:
        change_facts(patch, **{name: {'x': 'other'}})
        second, = made(tmp_path, ['2/2'])
    with pytest.raises(UsageError, match=f'shard-2-2: its {said} is '):
        merge_shards([first, second], tmp_path / 'out')


def test_given_other_weights_then_they_are_named(tmp_path, monkeypatch):
    first, = made(tmp_path, ['1/2'])
    with monkeypatch.context() as patch:
        patch.setattr(search_module, 'check_perception', lambda *words, **named: '1234')
        second, = made(tmp_path, ['2/2'])
    with pytest.raises(UsageError, match=r'its weights \(perception_sha256\) is "1234"'):
        merge_shards([first, second], tmp_path / 'out')


def with_stack(monkeypatch: pytest.MonkeyPatch, **changes: str) -> None:
    from taxinet_ros.campaign.record import facts

    before = facts.provenance()
    monkeypatch.setattr(facts, 'provenance', lambda: {**before, **changes})


def test_given_other_libraries_then_it_is_refused_and_another_machine_is_a_warning(
    tmp_path, monkeypatch
):
    folders = made(tmp_path, ['1/3'])
    with monkeypatch.context() as patch:
        with_stack(patch, numpy='9.9.9')
        other, = made(tmp_path, ['2/3'])
    with pytest.raises(UsageError, match=r'shard-2-3: was made with other versions than .*: numpy'):
        merge_shards([*folders, other, *made(tmp_path, ['3/3'])], tmp_path / 'out')
    shutil.rmtree(other)
    with monkeypatch.context() as patch:
        with_stack(patch, processor='an abacus')
        folders += made(tmp_path, ['2/3'])
    found = merge_shards([*folders, tmp_path / 'shard-3-3'], tmp_path / 'out')
    assert len(found.warnings) == 1
    assert 'different machines: processor' in found.warnings[0]
    assert len(read_facts(tmp_path / 'out').values['stacks']) == 2
    assert examine(tmp_path / 'out').findings == []


def test_given_runs_twice_or_missing_or_no_shard_then_it_is_refused(tmp_path):
    one, two, three = made(tmp_path, all_of(3))
    half, = made(tmp_path, ['1/2'])
    whole = tmp_path / 'whole'
    toy.finish(options(whole))
    for folders, said in (
        ([one, two], r'^shard 3 of 3 is missing: run 2, 5, 8, 11 of 14 is in none of these$'),
        ([one, two, three, one], r'shard 1/3 has run 0, 3, 6, 9, 12, as has shard 1/3 in '),
        ([half, two], r'shard 2/3 has run 4, 10, as has shard 1/2 in .*shard-1-2$'),
        ([half, whole], r'whole: is no shard'),
        ([one, tmp_path / 'nowhere'], r'nowhere: not a campaign'),
    ):
        with pytest.raises(UsageError, match=said):
            merge_shards(folders, tmp_path / 'out')
    with pytest.raises(UsageError, match=r'--out .*whole: already exists'):
        merge_shards([one, two, three], whole)
    with pytest.raises(UsageError, match=r'--bags move: unknown; known: hardlink, copy, symlink'):
        merge_shards([one, two, three], tmp_path / 'out', bags='move')
    assert not (tmp_path / 'out').exists()


def test_given_a_row_of_another_shard_then_it_is_refused(tmp_path):
    one, two = made(tmp_path, all_of(2))

    def slip_in(events: list[dict[str, Any]]) -> None:
        events += [event for event in foreign if event['event'] != 'campaign'][:2]

    foreign: list[dict[str, Any]] = []
    rewrite(two / 'ledger.jsonl', foreign.extend)
    rewrite(one / 'ledger.jsonl', slip_in)
    (one / FACTS_NAME).unlink()
    assert mend(one)
    with pytest.raises(UsageError, match=r'shard-1-2: has run 1, which is not of shard 1/2'):
        merge_shards([one, two], tmp_path / 'out')


def test_given_a_flipped_bit_in_any_file_of_any_shard_then_it_is_named_and_nothing_is_written(
    tmp_path
):
    folders = made(tmp_path, all_of(2))
    files = [path for folder in folders for path in sorted(folder.iterdir()) if path.is_file()]
    assert len(files) == 8
    chance = random.Random(5)
    for path in files:
        sound = path.read_bytes()
        for bit in [0, 8 * len(sound) - 1, *(chance.randrange(8 * len(sound)) for _ in range(3))]:
            damaged = bytearray(sound)
            damaged[bit // 8] ^= 1 << bit % 8
            path.write_bytes(damaged)
            with pytest.raises(UsageError, match=rf'{path.parent.name}[:/]'):
                merge_shards(folders, tmp_path / 'out')
            assert sorted(path.name for path in tmp_path.iterdir()) == ['shard-1-2', 'shard-2-2']
        path.write_bytes(sound)
    merged(folders, tmp_path / 'out')


def test_given_a_merge_that_is_interrupted_then_nothing_is_left_and_the_next_one_succeeds(
    tmp_path, monkeypatch
):
    folders = made(tmp_path, all_of(2))

    def full(*words: object) -> None:
        raise OSError(28, 'No space left on device', 'runs.csv')

    with monkeypatch.context() as patch:
        patch.setattr(merge_module, 'write_tables', full)
        with pytest.raises(OSError, match='No space left'):
            merge_shards(folders, tmp_path / 'out')
    assert len(list(tmp_path.iterdir())) == 2
    (tmp_path / '.out.part').mkdir()  # of a merge that was killed
    (tmp_path / '.out.part' / 'ledger.jsonl').write_text('torn')
    merged(folders, tmp_path / 'out')
    assert len(list(tmp_path.iterdir())) == 3


def test_given_formulas_added_to_the_shards_then_they_are_merged_or_the_difference_is_named(
    tmp_path
):
    folders = made(tmp_path, all_of(2))

    def add(folder: Path) -> None:
        judged = [row.index for row in open_campaign(folder).judged]
        rewrite(folder / 'ledger.jsonl', lambda events: events.append({
            'event': 'requirement', 'name': 'late', 'formula': '(cte > 0)',
            'intervals': {str(index): [index, index] for index in judged},
        }))
        (folder / FACTS_NAME).unlink()
        mend(folder)

    add(folders[0])
    with pytest.raises(UsageError, match=r'late was added \(taxinet monitor --add\) to only one'):
        merge_shards(folders, tmp_path / 'out')
    add(folders[1])
    joined = merged(folders, tmp_path / 'out')
    table = read_table(joined)
    assert table['rho_late'].notna().sum() == table['rho'].notna().sum() > 3
    assert list(table['rho_late'].dropna()) == list(table['index'][table['rho_late'].notna()])
    assert read_ledger(joined / 'ledger.jsonl').added == {'late': '(cte > 0)'}

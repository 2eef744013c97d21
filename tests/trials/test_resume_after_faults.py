"""A campaign that something broke goes on as if nothing had been (F1), or ends at once (F9)."""

from __future__ import annotations

import contextlib
import random
import shutil
from collections.abc import Callable, Collection, Iterator
from pathlib import Path

import falsify_samples as toy
import pandas as pd
import pytest

from taxinet_ros.cli import main as cli
from taxinet_ros.core.verdict.outcome import Outcome, RunRequest, RunResult
from taxinet_ros.errors import RecordError, UsageError
from taxinet_ros.files.record import examine_record, read_record
from taxinet_ros.samplers.sampler import LAG
from taxinet_ros.trials import search as search_module
from taxinet_ros.trials.campaign import exit_code
from taxinet_ros.trials.engine import Engine
from taxinet_ros.trials.past_runs.recorded_campaign import open_campaign
from taxinet_ros.trials.record.content import read_campaign
from taxinet_ros.trials.record.facts import read_facts
from taxinet_ros.trials.record.row import WALL_CLOCK_COLUMNS
from taxinet_ros.trials.record.table import read_table
from taxinet_ros.trials.search import PATIENCE
from taxinet_ros.trials.search_summary import search_summary


@pytest.fixture(autouse=True)
def _toy(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(search_module, 'SceneSource', toy.ToySource)


def break_all(from_index: int = 0, but: Collection[int] = ()) -> Callable[[RunRequest], RunResult]:
    """A bench that breaks at every try of every run from some run on."""

    def judge(request: RunRequest) -> RunResult:
        broken = request.index >= from_index and request.index not in but
        return toy.result(request, Outcome.INFRA_ERROR if broken else None)

    return judge


def same_but_for_tries(one: Path, other: Path) -> None:
    """See that two tables are equal but for the clock and how often runs were begun."""
    tables = [
        read_table(folder).drop(columns=[*WALL_CLOCK_COLUMNS, 'retries']) for folder in (one, other)
    ]
    assert len(tables[0]) > 0
    pd.testing.assert_frame_equal(*tables)


@pytest.mark.one_in(3)
@pytest.mark.parametrize(('workers', 'sampler'), [
    (1, 'ce'), (3, 'ce'), (LAG, 'ce'), (LAG, 'active'), (3, 'halton'), (LAG, 'tpe'),
])
def test_f1_given_a_bench_that_broke_when_resumed_then_the_table_is_that_of_an_undisturbed_one(
    workers, sampler, tmp_path
):
    whole, out = tmp_path / 'whole', tmp_path / 'c'
    undisturbed = toy.finish(toy.options(whole, sampler=sampler))
    broken = toy.finish(toy.options(out, sampler=sampler), workers, toy.last, break_all(6))
    assert 'runs in a row were broken by the bench' in broken.stopped
    assert exit_code(broken.summary) == 4
    resumed = toy.finish(toy.options(out, sampler=sampler, resume=True), workers, toy.last)
    assert resumed.stopped == ''
    same_but_for_tries(whole, out)
    assert exit_code(resumed.summary) == exit_code(undisturbed.summary)
    tried = {row.index for row in broken.rows if row.outcome is Outcome.INFRA_ERROR}
    assert len(tried) >= PATIENCE
    assert {row.index for row in resumed.rows if row.retries} == tried
    assert {row.retries for row in resumed.rows} == {0, 2}


def test_f1_given_a_bench_that_stays_broken_then_every_sitting_tries_and_says_so(tmp_path):
    out = tmp_path / 'c'
    for sitting in range(1, 5):
        asked = []

        def judge(request: RunRequest, asked=asked) -> RunResult:
            asked.append(request.index)
            return toy.result(request, Outcome.INFRA_ERROR)

        search = toy.finish(toy.options(out, sampler='halton', resume=sitting > 1), judge=judge)
        assert len(asked) == 2 * PATIENCE, 'each twice, and no fourth run'
        assert len(set(asked)) == PATIENCE
        assert 'broken by the bench; resuming continues it' in search_summary(search)[-1]
        rows = [row for row in search.rows if row.outcome is Outcome.INFRA_ERROR]
        assert {row.retries for row in rows} == {2 * sitting - 1}
    toy.finish(toy.options(out, sampler='halton', resume=True))
    toy.finish(toy.options(tmp_path / 'whole', sampler='halton'))
    same_but_for_tries(tmp_path / 'whole', out)


def test_f1_given_broken_runs_among_sound_ones_when_the_bench_is_still_broken_then_none_is_lost(
    tmp_path
):
    """Sound runs of before are no sign that the bench works now, and are kept all the same."""
    out = tmp_path / 'c'
    odd = break_all(but=range(0, 20, 2))
    first = toy.finish(toy.options(out, sampler='random'), judge=odd)
    before = read_table(out)
    assert len(before) == 20
    assert search_summary(first)[-1] == 'resuming tries the runs again that the bench broke'
    tried = []

    def judge(request: RunRequest) -> RunResult:
        tried.append(request.index)
        return toy.result(request, Outcome.INFRA_ERROR)

    again = toy.finish(toy.options(out, sampler='random', resume=True), judge=judge)
    assert len(set(tried)) == PATIENCE
    assert exit_code(again.summary) == 4
    assert len(again.rows) == 20
    after = read_table(out)
    assert list(after['outcome']) == list(before['outcome'])
    toy.finish(toy.options(out, sampler='random', resume=True))
    toy.finish(toy.options(tmp_path / 'whole', sampler='random'))
    same_but_for_tries(tmp_path / 'whole', out)


def test_f1_given_a_run_that_others_were_chosen_without_when_retried_then_no_choice_changes(
    tmp_path
):
    """The sampler had been told of nothing; what it chose then was run, and stays."""
    out = tmp_path / 'c'
    toy.finish(toy.options(out), judge=break_all(4, but=range(5, 20)))
    before = read_table(out).set_index('index')
    for runs in (20, 30):  # a third sitting has to know what the second one knew
        toy.finish(toy.options(out, runs=runs, resume=True))
        after = read_table(out).set_index('index')
        changed = before.drop(4).compare(after.loc[:19].drop(4))
        assert changed.empty
        assert after.loc[4, 'outcome'] in ('PASS', 'FAIL')
        assert after.loc[4, 'u_x'] == before.loc[4, 'u_x']
    assert read_facts(out)['untold'] == [4]
    toy.finish(toy.options(tmp_path / 'whole', runs=30), judge=break_all(4, but=range(5, 30)))
    whole = read_table(tmp_path / 'whole').set_index('index')
    assert list(after['u_x']) == list(whole['u_x'])


def test_f1_given_a_run_that_nothing_was_chosen_without_when_retried_then_it_is_told(tmp_path):
    out, at = tmp_path / 'c', 20 - LAG
    toy.finish(toy.options(out), judge=break_all(at, but=range(at + 1, 20)))
    toy.finish(toy.options(out, runs=40, resume=True))
    assert 'untold' not in read_facts(out)
    toy.finish(toy.options(tmp_path / 'whole', runs=40))
    same_but_for_tries(tmp_path / 'whole', out)


def test_f1_given_broken_and_interrupted_runs_when_resumed_for_a_moment_then_all_stay_in_the_table(
    tmp_path
):
    out = tmp_path / 'c'
    toy.finish(toy.options(out, sampler='halton'), judge=break_all(3))
    before = read_table(out)
    with toy.searching(toy.options(out, sampler='halton', resume=True)) as search:
        search.interrupt()
    pd.testing.assert_frame_equal(read_table(out), before)
    assert (before['outcome'] == 'INFRA_ERROR').sum() == PATIENCE
    assert sum(row.outcome is Outcome.INFRA_ERROR for row in search.rows) == PATIENCE


def test_f1_given_a_folder_in_which_nothing_was_begun_then_resuming_begins(tmp_path):
    toy.finish(toy.options(tmp_path / 'whole'))
    for name in ('logs/worker-1.log', 'campaign.db', 'campaign.db-journal'):
        path = tmp_path / name[:12] / name
        path.parent.mkdir(parents=True)
        path.touch()
        out = tmp_path / name[:12]
        toy.finish(toy.options(out, resume=True))
        toy.same_table(tmp_path / 'whole', out)


def test_f1_given_runs_but_no_record_then_resuming_says_what_is_missing(tmp_path):
    out = tmp_path / 'c'
    toy.finish(toy.options(out))
    (out / 'campaign.db').unlink()
    with pytest.raises(UsageError, match='so the earlier options are unknown; put it back'):
        toy.finish(toy.options(out, resume=True))


def damages(data: bytes) -> Iterator[bytes]:
    """The record with a page of zeros, a flipped bit, and without its end."""
    chance = random.Random(3)
    for page in range(2, len(data) // 4096, 3):
        yield data[:4096 * page] + bytes(4096) + data[4096 * (page + 1):]
    for _ in range(12):
        changed = bytearray(data)
        changed[chance.randrange(8192, len(data))] ^= 1 << chance.randrange(8)
        yield bytes(changed)
    yield from (data[:-1], data[:-4096], data[:len(data) // 2])


@pytest.mark.nightly
def test_given_a_damaged_record_when_resumed_then_only_what_it_lacks_is_made_again(
    tmp_path, capsys
):
    whole, fixed = tmp_path / 'whole', 0
    toy.finish(toy.options(whole))
    sound, entries = (whole / 'campaign.db').read_bytes(), read_record(whole / 'campaign.db')
    for number, data in enumerate(damages(sound)):
        out = tmp_path / str(number)
        shutil.copytree(whole, out)
        (out / 'campaign.db').write_bytes(data)
        with contextlib.suppress(UsageError):
            examine_record(out / 'campaign.db')
            continue  # in bytes that nothing uses
        with contextlib.suppress(UsageError):
            assert read_record(out / 'campaign.db') == entries
            continue  # in the index alone, which doctor names and what is read does not need
        for read in (read_campaign, read_table, open_campaign):
            with pytest.raises(UsageError, match=f'^{out}/campaign.db: damaged ') as caught:
                read(out)
            assert '\n' not in str(caught.value)
        capsys.readouterr()
        with toy.searching(toy.options(out, resume=True)) as search:
            kept = len(search.book.earlier.rows)
            search.interrupt()
        assert f'{out}/campaign.db: damaged ' in capsys.readouterr().err
        assert (out / 'campaign.db.damaged-1').read_bytes() == data
        if kept < 20:
            with pytest.raises(UsageError, match=r'was damaged \(.*resume it to its end'):
                read_campaign(out)
        asked: list[int] = []
        toy.finish(toy.options(out, resume=True), judge=lambda request, asked=asked: (
            asked.append(request.index) or toy.result(request)))
        toy.same_table(whole, out)
        examine_record(out / 'campaign.db')
        assert len(asked) <= 20 - kept <= (20 if len(data) < len(sound) - 5000 else 3)
        fixed += 1
    assert fixed > 10


@pytest.mark.nightly
def test_f1_given_a_kill_amid_a_second_sitting_then_a_third_ends_as_if_nothing_had_been(tmp_path):
    whole, killed = tmp_path / 'whole', tmp_path / 'killed'
    toy.finish(toy.options(whole))
    toy.finish(toy.options(killed), 3, toy.last, break_all(5))
    with toy.searching(toy.options(killed, resume=True)) as search:
        for number, _ in enumerate(toy.answers(search, 3, toy.last)):
            copy = tmp_path / f'copy-{number}'
            shutil.copytree(killed, copy)
            toy.finish(toy.options(copy, resume=True), 2)
            same_but_for_tries(whole, copy)
            assert len(read_campaign(copy).rows) == 20
    assert number > 5


def record_moved(out: Path) -> None:
    (out / 'campaign.db').rename(out.parent / 'campaign.db')


def record_copied_over(out: Path) -> None:
    """As by a tool that synchronises folders: the same bytes, but another file."""
    record_moved(out)
    shutil.copy(out.parent / 'campaign.db', out)


def folder_replaced(out: Path) -> None:
    out.rename(out.parent / 'moved')
    out.mkdir()


def folder_deleted(out: Path) -> None:
    shutil.rmtree(out)


@pytest.mark.parametrize(
    'act', [record_moved, record_copied_over, folder_replaced, folder_deleted]
)
def test_f9_given_a_record_that_is_taken_away_then_the_next_row_ends_the_campaign(act, tmp_path):
    out, told = tmp_path / 'c', []
    chosen = toy.options(out, sampler='halton')
    search = Engine(chosen, ('perception',), told.append)

    def disturbed() -> None:
        with search:
            for number, _ in enumerate(toy.answers(search, 1)):
                if number == 3:
                    act(out)

    with pytest.raises(RecordError, match='was moved') as caught:
        disturbed()
    assert '\n' not in str(caught.value)
    assert [row.outcome for row in told] == [row.outcome for row in search.rows]
    assert sum(row.outcome.judged for row in told) in (4, 5), 'the last one is told all the same'
    assert not (out / 'runs.csv').exists()
    assert all(row.bag == row.run_id for row in told if row.outcome.judged), 'wherever it is now'
    if act in (record_moved, record_copied_over):
        kept = read_campaign(tmp_path).rows
        assert len(kept) in (len(told), len(told) - 1)


def test_f9_given_a_record_that_is_taken_away_after_the_last_run_then_no_table_is_written(
    tmp_path
):
    out = tmp_path / 'c'

    def disturbed() -> None:
        with toy.searching(toy.options(out)) as search:
            for _ in toy.answers(search, 1):
                pass
            folder_replaced(out)

    with pytest.raises(RecordError, match='was moved'):
        disturbed()
    assert list(out.iterdir()) == []


def test_f9_given_a_table_that_cannot_be_written_then_the_bench_broke(
    tmp_path, monkeypatch, capsys
):
    """A folder that may be read only; a super user may write to it all the same."""
    def refuse(*arguments: object) -> None:
        raise PermissionError(13, 'Permission denied', str(tmp_path / 'c' / 'runs.csv'))

    monkeypatch.setattr('taxinet_ros.trials.record.book.write_tables', refuse)
    code = cli._exit_code(lambda: toy.finish(toy.options(tmp_path / 'c')))
    assert (code, capsys.readouterr().err) == (4, (
        f'taxinet: error: {tmp_path}/c/runs.csv: [Errno 13] Permission denied; '
        'fix that and resume it\n'
    ))

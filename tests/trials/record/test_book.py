"""One campaign on disk: begun, interrupted, resumed; whoever chooses its scenes."""

from __future__ import annotations

import dataclasses
import resource
import subprocess
import sys
from pathlib import Path
from typing import Any

import falsify_samples as toy
import pytest
from own_place import OWN_PLACE

from taxinet_ros.cli import main as cli
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.traffic.traffic_file import load_traffic
from taxinet_ros.errors import UsageError
from taxinet_ros.trials.options import CampaignOptions
from taxinet_ros.trials.record.book import CampaignBook, finished_row, rejected_row
from taxinet_ros.trials.record.content import read_campaign
from taxinet_ros.trials.record.facts import facts_of_runs
from taxinet_ros.trials.record.resumption import check_same_campaign
from taxinet_ros.trials.record.row import RunRow
from taxinet_ros.trials.record.table import CSV_NAME, read_table

SCENE = Scenario(duration_s=1.0)
OPTIONS = CampaignOptions(
    program='scenes', runs=4, seed=3, perception='truth', out=Path(), images='none'
)


def facts(options: CampaignOptions, **changes: Any) -> dict[str, Any]:
    return {**facts_of_runs(options, {'program': 'scenes'}), **changes}


def goes_on(options: CampaignOptions) -> CampaignBook:
    return CampaignBook(options, ('perception',), resume=True)


def run(book: CampaignBook, index: int, scene: Scenario = SCENE) -> None:
    """Run one scene to its row."""
    request = book.begin_run(index, scene)
    book.keep(finished_row(book.options, request, toy.result(request)))


def test_given_a_new_book_then_facts_starts_results_and_the_table_are_kept_in_step(tmp_path):
    options = dataclasses.replace(OPTIONS, out=tmp_path / 'c')
    shown: list[RunRow] = []
    with CampaignBook(options, ('perception',), shown.append) as book:
        book.begin(facts(options))
        content = read_campaign(options.out)
        assert (content.facts['seed'], content.attempts, content.rows) == (3, {}, ())
        request = book.begin_run(0, SCENE)
        assert read_campaign(options.out).unfinished == (0,)
        with pytest.raises(UsageError, match='another command is writing to it'):
            goes_on(options).__enter__()
        book.keep(finished_row(book.options, request, toy.result(request)))
        book.keep(rejected_row(book.options, 1, 'no scene meets the requirements'))
        content = read_campaign(options.out)
        assert (content.unfinished, content.finished) == ((), False)
        assert shown == list(content.rows)
    assert read_campaign(options.out).finished
    assert list(read_table(options.out)['outcome']) == ['PASS', 'REJECTED']
    with pytest.raises(UsageError, match='already exists'), CampaignBook(options, ()):
        pass


_READ = """
import sys
from pathlib import Path
from taxinet_ros.trials.past_runs.recorded_campaign import open_campaign
found = open_campaign(Path(sys.argv[1]))
for row in found.rows:
    scene, _ = found.scenario(row)
    print(row.place, scene.runway.width_m, row.traffic, [one.x_m for one in scene.others.objects])
"""


def test_given_places_and_traffic_of_ones_own_then_each_is_on_record_once_and_rows_refer_to_it(
    tmp_path
):
    options = dataclasses.replace(OPTIONS, out=tmp_path)
    scenes = [
        dataclasses.replace(SCENE, place=OWN_PLACE),
        *(dataclasses.replace(SCENE, traffic=load_traffic([{'kind': 'cone', 'x_m': x, 'y_m': 2}]))
          for x in (500, 510)),
        SCENE,
    ]
    with CampaignBook(options, ('perception',)) as book:
        book.begin(facts(options))
        for index, scene in enumerate(scenes):
            run(book, index, scene=scene)
    with goes_on(options) as book:
        book.begin(facts(options))
        run(book, 4, scene=scenes[0])
        run(book, 5, scene=scenes[1])
    own, first, second = (
        scene.to_human()[key] for scene, key in zip(scenes, ('place', 'traffic', 'traffic'),
                                                    strict=False)
    )
    assert first != second
    assert read_campaign(tmp_path).documents == {
        ('place', own), ('traffic', first), ('traffic', second)
    }
    # Another process has seen neither the place nor a file of it.
    done = subprocess.run(
        [sys.executable, '-c', _READ, str(tmp_path)], capture_output=True, text=True, check=True
    )
    width = SCENE.runway.width_m
    there, crowded = f'{own} 45.0 nobody []', f'kmwh_04 {width} {first} [500.0]'
    assert done.stdout.splitlines() == [
        there, crowded, f'kmwh_04 {width} {second} [510.0]', f'kmwh_04 {width} nobody []', there,
        crowded,
    ]


def test_given_a_book_that_goes_on_then_its_facts_are_written_with_the_first_thing_that_is_added(
    tmp_path
):
    options = dataclasses.replace(OPTIONS, out=tmp_path)
    with CampaignBook(options, ('perception',)) as book:
        book.begin(facts(options))
        run(book, 0)
    more = dataclasses.replace(options, runs=9)
    with goes_on(more) as book:
        check_same_campaign(tmp_path, book.earlier, facts(more))
        book.begin(facts(more))
        content = read_campaign(tmp_path)
        assert (content.facts['runs'], content.finished) == (4, True)
        run(book, 1)
        content = read_campaign(tmp_path)
        assert (content.facts['runs'], content.finished) == (9, False)
    assert len(read_table(tmp_path)) == 2


def test_given_another_campaign_than_was_begun_then_nothing_is_changed_and_both_are_named(tmp_path):
    options = dataclasses.replace(OPTIONS, out=tmp_path)
    with CampaignBook(options, ('perception',)) as book:
        book.begin(facts(options))
        run(book, 0)
    kept = {path: path.read_bytes() for path in tmp_path.iterdir() if path.is_file()}
    for changes, words in (
        ({'seed': 4}, 'was begun with seed 3, not 4; repeat its options, or choose another folder'),
        ({'sampler': 'ce'}, r'campaign\.db: not written by taxinet falsify'),
        ({'shrinks': 'run-0'}, r'campaign\.db: not written by taxinet shrink'),
    ):
        with pytest.raises(UsageError, match=words), goes_on(options) as book:
            check_same_campaign(tmp_path, book.earlier, facts(options, **changes))
    assert {path: path.read_bytes() for path in kept} == kept


def test_given_a_book_that_was_never_begun_then_no_table_says_otherwise(tmp_path):
    with CampaignBook(dataclasses.replace(OPTIONS, out=tmp_path), ()):
        pass
    assert not (tmp_path / CSV_NAME).exists()


@pytest.mark.parametrize('most_bytes', [40_000, 150_000])
def test_given_a_full_disk_then_the_campaign_ends_with_one_line_and_goes_on_when_there_is_room(
    tmp_path, capsys, most_bytes
):
    """No room for the facts, or for the runs."""
    options = dataclasses.replace(OPTIONS, out=tmp_path / 'c', runs=200)

    def work() -> None:
        resume = (tmp_path / 'c').exists()
        with CampaignBook(options, ('perception',), resume=resume) as book:
            book.begin(facts(options, program_text='x' * 30_000))
            for index in range(len(book.earlier.rows), options.runs):
                run(book, index)

    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (most_bytes, limits[1]))
    try:
        code = cli._exit_code(work)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    err = capsys.readouterr().err
    assert (code, err.count('\n')) == (4, 1)
    assert err.startswith(f'taxinet: error: {tmp_path}/c/campaign.db: [Errno ')
    assert err.endswith('; fix that and resume it\n')
    known = len(read_campaign(tmp_path / 'c').rows)
    assert known < 200
    assert (known > 0) == (most_bytes > 100_000)
    work()
    assert list(read_table(tmp_path / 'c')['index']) == list(range(200))

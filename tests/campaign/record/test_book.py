"""One campaign on disk: begun, interrupted, resumed; whoever chooses its scenes."""

from __future__ import annotations

import dataclasses
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import falsify_samples as toy
import pytest
from own_place import OWN_PLACE

from taxinet_ros.campaign.options import CampaignOptions
from taxinet_ros.campaign.record.book import CampaignBook, read_same_campaign
from taxinet_ros.campaign.record.facts import LEDGER_NAME, facts_of_runs
from taxinet_ros.campaign.record.row import RunRow
from taxinet_ros.campaign.record.table import CSV_NAME, read_table
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.traffic.traffic_file import load_traffic
from taxinet_ros.core.verdict.outcome import Outcome
from taxinet_ros.errors import RecordError, UsageError

SCENE = Scenario(duration_s=1.0)
OPTIONS = CampaignOptions(
    program='scenes', runs=4, seed=3, perception='truth', out=Path(), images='none'
)


def facts(options: CampaignOptions, **changes: Any) -> dict[str, Any]:
    return {**facts_of_runs(options, {'program': 'scenes'}), **changes}


def events(out: Path) -> list[str]:
    lines = (out / LEDGER_NAME).read_text(encoding='utf-8').splitlines()
    return [json.loads(line)['event'] for line in lines]


def run(
    book: CampaignBook, index: int, *broken: bool, scene: Scenario = SCENE
) -> Outcome:
    """Run one scene to its row; ``broken`` says of each attempt whether the bench broke it."""
    request = book.begin_run(index, scene)
    for breaks in (*broken, False):
        result = toy.result(request, Outcome.INFRA_ERROR if breaks else None)
        if not book.second_chance(request, result):
            break
        again = book.next_retry()
        assert again is not None
        request = again
    book.keep(book.finished_row(request, result))
    return result.outcome


def test_given_a_new_book_then_facts_intents_results_and_the_table_are_kept_in_step(tmp_path):
    options = dataclasses.replace(OPTIONS, out=tmp_path / 'c')
    shown: list[RunRow] = []
    with CampaignBook(options, ('perception',), shown.append) as book:
        book.begin(facts(options))
        assert events(options.out) == ['campaign']
        run(book, 0)
        book.keep(book.rejected_row(1, 'no scene meets the requirements'))
        assert events(options.out) == ['campaign', 'intent', 'result', 'result']
        assert shown == list(book.rows.values())
    assert list(read_table(options.out)['outcome']) == ['PASS', 'REJECTED']


def test_given_a_run_that_breaks_then_it_has_one_second_chance_and_its_folder_is_kept_aside(
    tmp_path
):
    options = dataclasses.replace(OPTIONS, out=tmp_path)
    with CampaignBook(options, ('perception',)) as book:
        book.begin(facts(options))
        (tmp_path / 'scenes-s3-00000').mkdir()
        assert run(book, 0, True) is Outcome.PASS
        assert (tmp_path / 'scenes-s3-00000.broken-1').is_dir()
        assert (book.was_retried(0), book.broken_in_a_row) == (True, 0)
        assert run(book, 1, True, True) is Outcome.INFRA_ERROR
        assert run(book, 2, True, True) is Outcome.INFRA_ERROR
        assert book.broken_in_a_row == 2
        book.keep(book.rejected_row(3, 'the bench had no part in it'))
        assert book.broken_in_a_row == 2
        assert book.next_retry() is None
    assert events(tmp_path).count('intent') == 6


_READ = """
import sys
from pathlib import Path
from taxinet_ros.campaign.past_runs.recorded_campaign import open_campaign
found = open_campaign(Path(sys.argv[1]))
for row in found.rows:
    print(row.place, found.scenario(row)[0].runway.width_m)
"""


def test_given_runs_at_a_place_of_ones_own_then_the_ledger_has_it_once_and_rows_its_reference(
    tmp_path
):
    options = dataclasses.replace(OPTIONS, out=tmp_path)
    there = dataclasses.replace(SCENE, place=OWN_PLACE)
    reference = there.to_human()['place']
    with CampaignBook(options, ('perception',)) as book:
        book.begin(facts(options))
        run(book, 0, scene=there)
        run(book, 1)
    with CampaignBook(options, ('perception',), resume=True) as book:
        book.begin(facts(options), read_same_campaign(tmp_path, facts(options)))
        run(book, 2, scene=there)
    assert events(tmp_path).count('place') == 1
    assert list(read_table(tmp_path)['place']) == [reference, 'kmwh_04', reference]
    # Another process has seen neither the place nor a file of it.
    told = subprocess.run(
        [sys.executable, '-c', _READ, str(tmp_path)], capture_output=True, text=True, check=True
    )
    assert told.stdout.splitlines() == [
        f'{reference} 45.0', f'kmwh_04 {SCENE.runway.width_m}', f'{reference} 45.0'
    ]


def test_given_runs_with_others_on_the_ground_then_the_ledger_has_each_once_and_rows_a_reference(
    tmp_path
):
    options = dataclasses.replace(OPTIONS, out=tmp_path)
    crowds = [
        dataclasses.replace(SCENE, traffic=load_traffic([{'kind': 'cone', 'x_m': x, 'y_m': 2}]))
        for x in (500, 510)
    ]
    with CampaignBook(options, ('perception',)) as book:
        book.begin(facts(options))
        for index, scene in enumerate((*crowds, SCENE)):
            run(book, index, scene=scene)
    with CampaignBook(options, ('perception',), resume=True) as book:
        book.begin(facts(options), read_same_campaign(tmp_path, facts(options)))
        run(book, 3, scene=crowds[0])
    assert events(tmp_path).count('traffic') == 2
    first, second = (crowd.to_human()['traffic'] for crowd in crowds)
    assert first != second
    assert list(read_table(tmp_path)['traffic']) == [first, second, 'nobody', first]
    read = _READ.replace('row.place', 'row.traffic').replace(
        '.runway.width_m', '.traffic == "nobody" or found.scenario(row)[0].others.objects[0].x_m'
    )
    told = subprocess.run(
        [sys.executable, '-c', read, str(tmp_path)], capture_output=True, text=True, check=True
    )
    assert told.stdout.splitlines() == [
        f'{first} 500.0', f'{second} 510.0', 'nobody True', f'{first} 500.0'
    ]


def test_given_a_book_that_goes_on_then_its_facts_are_written_with_the_first_thing_that_is_added(
    tmp_path
):
    options = dataclasses.replace(OPTIONS, out=tmp_path)
    with CampaignBook(options, ('perception',)) as book:
        book.begin(facts(options))
        run(book, 0)
    more = dataclasses.replace(options, runs=9)
    with CampaignBook(more, ('perception',), resume=True) as book:
        before = read_same_campaign(tmp_path, facts(more))
        book.begin(facts(more), before)
        assert list(book.rows) == [0]
        assert events(tmp_path) == ['campaign', 'intent', 'result']
        run(book, 1)
        assert events(tmp_path)[3:] == ['campaign', 'intent', 'result']
    assert json.loads((tmp_path / 'campaign.json').read_text())['runs'] == 9
    assert len(read_table(tmp_path)) == 2


def test_given_another_campaign_than_was_begun_then_nothing_is_changed_and_both_are_named(tmp_path):
    options = dataclasses.replace(OPTIONS, out=tmp_path)
    with CampaignBook(options, ('perception',)) as book:
        book.begin(facts(options))
        run(book, 0)
    kept = {path: path.read_bytes() for path in tmp_path.iterdir() if path.is_file()}
    refused = [
        ({'seed': 4}, 'was begun with seed 3, not 4; repeat its options, or choose another --out'),
        ({'sampler': 'ce'}, r'campaign\.json: not written by taxinet falsify'),
        ({'shrinks': 'run-0'}, r'campaign\.json: not written by taxinet shrink'),
    ]
    for changes, words in refused:
        with (
            pytest.raises(UsageError, match=words),
            CampaignBook(options, ('perception',), resume=True),
        ):
            read_same_campaign(tmp_path, facts(options, **changes))
    assert {path: path.read_bytes() for path in kept} == kept
    with pytest.raises(UsageError, match='already exists'), CampaignBook(options, ()):
        pass


def test_given_a_book_that_was_never_begun_then_no_table_says_otherwise(tmp_path):
    options = dataclasses.replace(OPTIONS, out=tmp_path)
    with CampaignBook(options, ()):
        pass
    assert not (tmp_path / CSV_NAME).exists()


def test_given_facts_that_are_deleted_under_way_then_the_campaign_ends_and_says_so(tmp_path):
    options = dataclasses.replace(OPTIONS, out=tmp_path)
    book = CampaignBook(options, ('perception',)).__enter__()
    book.begin(facts(options))
    (tmp_path / 'campaign.json').unlink()
    with pytest.raises(RecordError, match=r'campaign\.json: was moved or deleted while'):
        run(book, 0)
    with pytest.raises(RecordError, match=r'campaign\.json: was moved or deleted while'):
        book.__exit__(None, None, None)

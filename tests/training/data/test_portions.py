"""Scenes along failed runs: a golden run, put down as a campaign's failure."""

import math
import shutil
from pathlib import Path

import numpy as np
import pytest
from campaign_records import write_campaign

from taxinet_ros.bag.run.recording import open_recording
from taxinet_ros.core.mtl import exact_intervals
from taxinet_ros.core.verdict.outcome import Outcome
from taxinet_ros.errors import UsageError
from taxinet_ros.training.data.portions import (
    MAX_CROSS_TRACK_M,
    SPREAD_M,
    SPREAD_RAD,
    Portion,
    counterexample_scenes,
    parse_portion,
    portion_seed,
    record_digest,
)
from taxinet_ros.trials.record.row import RunRow

GOLDEN = Path(__file__).resolve().parents[3] / 'bags' / 'golden' / 'original-early-light'


def campaign(folder: Path, *, bags: bool = True, runs: int = 2, failed: bool = True) -> Path:
    """The golden run first, and further ones that have left no bags."""
    folder.mkdir()
    recorded = open_recording(GOLDEN)
    told = recorded.facts
    rho = {'phi': 1.0}
    if failed:
        rho = {name: one.interval.upper for name, one in told.judged.items()}
    write_campaign(folder, [
        RunRow(
            run_id=GOLDEN.name if index == told.index else f'r{index}', index=index, program='s',
            seed=told.seed, perception='original',
            fingerprint=told.nodes['perception'].fingerprint,
            outcome=Outcome.FAIL if failed else Outcome.PASS, robustness=exact_intervals(rho),
            steps=told.steps, **recorded.scenario.to_human(),
        ) for index in range(told.index, told.index + runs)
    ], {'program': 's_falsif.scenic', 'runs': runs})
    if bags:
        shutil.copytree(GOLDEN, folder / GOLDEN.name)
    return folder


def test_given_a_failed_run_then_scenes_lie_along_its_path_under_its_sky(tmp_path):
    folder = campaign(tmp_path / 'c')
    scenes = counterexample_scenes(folder, 400, 5)
    trace, recorded = open_recording(GOLDEN).columns, open_recording(GOLDEN).run.request.scenario
    assert len(scenes) == 400
    assert {(one.clouds, one.rain_fraction, one.time_of_day_s, one.aircraft) for one in scenes} == {
        (recorded.clouds, recorded.rain_fraction, recorded.time_of_day_s, recorded.aircraft)
    }
    places = {float(x): i for i, x in enumerate(trace['x_m'])}
    rows = [places[one.distance_m] for one in scenes]
    on_the_way = np.abs(trace['cte_m']) <= MAX_CROSS_TRACK_M
    assert not on_the_way.all()  # this run ends up on the grass, where there is nothing to learn
    assert len(set(rows)) > 0.9 * on_the_way.sum()
    assert on_the_way[rows].all()
    aside = np.array([one.cross_track_m for one in scenes]) - trace['cte_m'][rows]
    turned = np.array([one.heading_rad for one in scenes]) - trace['he_rad'][rows]
    # 400 draws put the standard deviation within a sixth of its value, five sigma.
    assert aside.std() == pytest.approx(SPREAD_M, rel=0.18)
    assert turned.std() == pytest.approx(SPREAD_RAD, rel=0.18)
    assert abs(aside.mean()) < 5 * SPREAD_M / 20
    assert math.degrees(abs(turned.mean())) < 5 * math.degrees(SPREAD_RAD) / 20


def test_given_the_same_seed_then_the_scenes_are_the_same_and_others_for_another(tmp_path):
    folder = campaign(tmp_path / 'c')
    one, again, other = (counterexample_scenes(folder, 5, seed) for seed in (1, 1, 2))
    assert one == again != other


def test_given_a_run_without_its_bag_then_the_others_serve(tmp_path):
    told = []
    scenes = counterexample_scenes(
        campaign(tmp_path / 'c', runs=3), 4, 1, lambda *step: told.append(step)
    )
    assert len(scenes) == 4
    assert told[-1] == ('runs', 1, 3)


def test_given_nothing_to_learn_from_then_one_line_says_why(tmp_path):
    for folder, reason in (
        (campaign(tmp_path / 'no_bags', bags=False), 'no bag of its 2 failed runs can be read'),
        (campaign(tmp_path / 'all_well', failed=False), 'none of its 2 judged runs failed'),
        (tmp_path, 'not a campaign'),
    ):
        with pytest.raises(UsageError, match=reason) as caught:
            counterexample_scenes(folder, 3, 1)
        assert '\n' not in str(caught.value)


def test_given_a_portion_of_runs_then_the_card_names_campaign_and_ledger(tmp_path):
    folder = campaign(tmp_path / 'c')
    portion = parse_portion(f'{folder}=3', 'runs')
    source = portion.source()
    assert (source.kind, source.name, source.sha256) == ('runs', 'c', record_digest(folder))
    assert portion.scenes(3, 4, lambda *told: None) == counterexample_scenes(folder, 3, 4)


def test_given_a_word_and_a_count_then_they_are_taken_apart():
    assert parse_portion('crossing=2400', 'program') == Portion(
        kind='program', name='crossing', count=2400
    )
    odd = parse_portion('runs/a=b=7', 'runs')
    assert (odd.name, odd.count, str(odd)) == ('runs/a=b', 7, 'runs/a=b=7')


@pytest.mark.parametrize('text', ['crossing', '=3', 'crossing=', 'crossing=-1', 'crossing=many'])
def test_given_no_portion_then_the_message_shows_one(text):
    with pytest.raises(UsageError, match=r'add .*PROGRAM=COUNT, such as crossing=2400'):
        parse_portion(text, 'program')


@pytest.mark.parametrize('count', ['0', '1000001'])
def test_given_a_count_out_of_range_then_it_is_refused(count):
    with pytest.raises(UsageError, match=r'add_runs .*outside 1\.\.1000000'):
        parse_portion(f'folder={count}', 'runs')


def test_given_the_same_program_twice_then_its_scenes_are_not_the_same():
    seeds = {portion_seed(1, number) for number in range(20)} | {1}
    assert len(seeds) == 21
    assert all(0 <= seed < 2**63 for seed in seeds)


def test_given_a_program_then_its_portion_is_of_it_and_of_no_other():
    portion = parse_portion('crossing=20', 'program')
    scenes = portion.scenes(20, 5, lambda *told: None)
    distances = np.array([scene.distance_m for scene in scenes])
    assert len(scenes) == 20
    assert ((distances >= 1350) & (distances <= 1550)).all()
    assert portion.source().name == 'crossing'

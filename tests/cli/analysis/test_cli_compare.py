"""``taxinet compare`` and ``bisect``: networks on the same scenes, kept, continued, refused."""

from __future__ import annotations

import json
import math
import shutil
from pathlib import Path

import pandas as pd
import pytest

import taxinet_ros as tx
from taxinet_ros.analysis.report import pictures as picture_files
from taxinet_ros.files.record import RECORD_NAME, read_record
from taxinet_ros.trials.past_runs.shared_scenes import scenes_of

BAGS = Path(__file__).resolve().parents[3] / 'bags'
WET = """
model runway_world
param time_of_day_h = 8
param clouds = 'stratus'
param rain_percent = 90
param duration_s = 3
ego = new Plane at (5, Range(600, 650)), facing Range(18, 20) deg
"""
NEAR = 'near=eventually(abs(cte) <= 1.7)'


@pytest.fixture(autouse=True)
def coarse(monkeypatch):
    """Drawing takes by far the longest; here only that it is done matters."""
    monkeypatch.setattr(picture_files, 'DOTS_PER_INCH', 30)


@pytest.fixture(scope='module')
def bag(tmp_path_factory):
    """Three seconds in the rain, in which original does not reach its line."""
    scene = tx.Scenario(
        cross_track_m=-5.0, distance_m=620.0, heading_rad=math.radians(19), clouds='stratus',
        rain_fraction=0.9, time_of_day_s=8 * 3600, duration_s=3.0,
    )
    run = tx.run(scene, perception='original', specs=NEAR)
    assert run.outcome is tx.Outcome.FAIL
    return run.save_bag(tmp_path_factory.mktemp('runs') / 'wet', images=False)


def trials(out: Path) -> tuple[int, bytes]:
    """Number of trials, and the record, which any that is made again would change."""
    path = out / RECORD_NAME
    return len(read_record(path)['trial']), path.read_bytes()


@pytest.mark.nightly
def test_given_two_networks_and_a_program_then_both_drive_its_scenes_and_are_kept(
    tmp_path, taxinet
):
    (tmp_path / 'wet.scenic').write_text(WET)
    words = ('compare', 'original', 'truth', 'wet.scenic', '--runs', '3', '--seed', '4', '--spec',
             NEAR, '--workers', '1', '--out', 'out')
    code, said, err = taxinet(*words)
    assert (code, err) == (0, '')
    assert 'Of 3 scenes that both were run in, original satisfies near in 0, truth in 3' in said
    out = tmp_path / 'out'
    paths = [out / f'{name}.parquet' for name in ('before', 'after')]
    tables = [pd.read_parquet(path) for path in paths]
    assert tables[0]['distance_m'].tolist() == tables[1]['distance_m'].tolist()
    assert [table['perception'].unique().tolist() for table in tables] == [['original'], ['truth']]
    made = trials(out)
    assert made[0] == 6
    code, again, _ = taxinet(*words, '--json')
    told = json.loads(again)
    assert trials(out) == made, 'what is done is kept'
    assert (told['satisfied']['better'], told['satisfied']['worse'], told['tested']) == (3, 0, True)
    assert told['satisfied']['mcnemar_p'] == 0.25  # two sides of three fair tosses
    assert [row['got'] for row in told['changed']] == ['better'] * 3
    assert 'truth on the same scenes' in (out / 'compare.html').read_text()
    code, _, err = taxinet(*words[:7], '5', *words[8:])
    assert (code, err) == (
        2, 'taxinet: error: out out: has runs of other scenes or settings; choose another '
        'folder\n')


@pytest.mark.nightly
def test_given_folders_named_like_networks_and_programs_then_words_that_are_known_win(
    tmp_path, taxinet
):
    (tmp_path / 'wet.scenic').write_text(WET)
    code, *_ = taxinet('run', 'wet.scenic', '--runs', '1', '--perception', 'truth', '--engine',
                       'loop', '--images', 'none', '--spec', NEAR, '--out', 'taxinet')
    assert code == 0
    shutil.copytree(tmp_path / 'taxinet', tmp_path / 'nominal')
    words = '--runs', '1', '--set', 'duration=1', '--workers', '1', '--out', 'out'
    code, said, err = taxinet('compare', 'taxinet', 'truth', 'nominal', *words)
    assert (code, err) == (0, '')
    table = pd.read_parquet(tmp_path / 'out' / 'before.parquet')
    assert table['program'].tolist() == ['nominal with duration_s=1']
    assert table['perception'].tolist() == ['taxinet']
    for names in (('./taxinet', 'truth', 'nominal'), ('taxinet', 'truth')):
        code, _, err = taxinet('compare', *names)
        assert (code, 'name two campaigns, or two networks and the scenes' in err) == (2, True)
    code, said, _ = taxinet('compare', 'taxinet', 'nominal', '--out', 'both')
    assert (code, 'Of 1 scene' in said) == (0, True)


@pytest.mark.filterwarnings('ignore')
def test_given_two_shipped_tables_then_they_are_paired_by_scene(tmp_path, taxinet):
    tables = [tmp_path / name / 'runs.parquet' for name in ('generic', 'specialised')]
    for table in tables:
        table.parent.mkdir()
        shutil.copyfile(BAGS / f's_falsif_{table.parent.name}_400.parquet', table)
    code, said, _ = taxinet('compare', *tables, '--out', 'out')
    assert code == 0
    assert 'No difference between generic and specialised is proven. Of 400 scenes' in said
    assert '13 got better (only specialised satisfies), 5 got worse' in said
    changed = pd.read_csv(tmp_path / 'out' / 'changed.csv')
    assert len(changed) == 18
    assert changed['time_of_day'].str.fullmatch(r'\d\d:\d\d').all(), 'as in all reports'


@pytest.mark.nightly
@pytest.mark.filterwarnings('ignore')
def test_given_a_subset_of_a_tables_scenes_then_it_is_spread_and_as_good_as_fixed():
    scenes = scenes_of(BAGS / 's_falsif_original_4000.parquet', 5)
    assert [scene.row.index for scene in scenes.scenes] == [400, 1200, 2000, 2800, 3600]
    assert scenes.fixed
    assert scenes.judging.specs == (
        'phi_eventually=eventually[0:10](always(abs(cte) <= 1.5))',)
    table = pd.read_parquet(BAGS / 's_falsif_original_4000.parquet').set_index('index')
    for scene in scenes.scenes:
        assert scene.scenario.distance_m == pytest.approx(
            table.loc[scene.row.index, 'distance_m'], abs=1e-6)


@pytest.mark.nightly
def test_given_networks_in_order_then_the_one_that_broke_the_scene_is_named(
    bag, tmp_path, taxinet
):
    words = ('bisect', 'truth', 'taxinet', 'original', '--scene', bag, '--workers', '1', '--out',
             'out')
    code, said, err = taxinet(*words)
    assert (code, err) == (0, '')
    assert 'original breaks 1 scene that taxinet satisfied: wet' in said
    made = trials(tmp_path / 'out')
    assert made[0] == 3
    code, said, _ = taxinet(*words, '--every', '--json')
    told = json.loads(said)
    assert (code, told['broken']) == (0, {'taxinet': [], 'original': ['wet']})
    assert told['scenes']['wet'] == {'truth': True, 'taxinet': True, 'original': False}
    assert trials(tmp_path / 'out') == made, 'what is done is kept'


@pytest.mark.parametrize(('words', 'reason'), [
    (('compare', 'truth', 'taxinet', 's_falsif', '--out', 'full'), 'contains something else'),
    (('compare', 'truth', 'taxinet', 's_falsif', '--spec', NEAR, '--spec', 'far=cte <= 9'),
     'spec far: one requirement here, near; leave this one out'),
    (('tune', '--spec', 'phi_always', '--spec', 'on_runway'), 'spec on_runway: one requirement'),
    (('why', BAGS / 'golden' / 'truth-nominal', '--out', 'full'), 'contains something else'),
])
def test_given_bad_input_then_one_line_and_exit_code_2(words, reason, taxinet, tmp_path):
    (tmp_path / 'full').mkdir()
    (tmp_path / 'full' / 'mine.txt').write_text('')
    code, out, err = taxinet(*words)
    assert (code, out) == (2, '')
    assert reason in err
    assert err.count('\n') == 1

"""``taxinet fork``: bag, picture, curve and point of no return of a recorded run."""

from __future__ import annotations

import csv
import json
import shutil

import pytest

import taxinet_ros as tx
from taxinet_ros.analysis.report import pictures as picture_files
from taxinet_ros.bag.run.recording import open_recording

SCENE = tx.Scenario(
    cross_track_m=2.0, duration_s=2.0, clouds='stratus', rain_fraction=0.5, crossing=False
)


@pytest.fixture(autouse=True)
def coarse(monkeypatch):
    """Drawing takes by far the longest; here only that it is done matters."""
    monkeypatch.setattr(picture_files, 'DOTS_PER_INCH', 30)


@pytest.fixture(scope='module')
def bag(tmp_path_factory):
    """Two seconds in the rain, which violate what is asked of them."""
    run = tx.run(SCENE, perception='taxinet', specs='near=always(abs(cte) <= 1.9)')
    return run.save_bag(tmp_path_factory.mktemp('runs') / 'wet', images=False)


def test_given_a_change_then_bag_and_picture_are_written_and_the_lines_tell_both(
    bag, tmp_path, taxinet
):
    out = tmp_path / 'out'
    code, said, _ = taxinet(
        'fork', bag, '--at', 1, '--set', 'rain=0', '--state', 'cte=-0.5', '--out', out
    )
    assert code == 1  # the start stays outside
    assert 'wet: 10 steps repeated to the bit, forked at 1 s: rain 50 % -> 0 %, cte_m -0.5' in said
    assert 'before: violated, near -0.1' in said
    assert 'after: violated' in said
    forked = open_recording(out / 'wet-at-1s')
    assert forked.run.world == 'fork'
    assert len(forked.recorded_steps) == 21
    assert (out / 'fork.png').read_bytes().startswith(b'\x89PNG')
    assert 'of wet at 1 s: rain 50 % -> 0 %, placed at' in taxinet(
        'bag', 'info', out / 'wet-at-1s')[1]
    for command in (['explain'], ['run', '--from'], ['fork', '--at', '1']):
        code, _, error = taxinet(*command, out / 'wet-at-1s')
        assert (code, 'fork' in error) == (2, True), command


def test_given_json_then_standard_output_is_json_only(bag, tmp_path, taxinet):
    code, said, _ = taxinet(
        'fork', bag, '--at', 1, '--out', tmp_path / 'out', '--images', 'none', '--json'
    )
    told = json.loads(said)
    assert code == 1
    assert told['before'] == told['after']
    assert told['change'] == 'nothing'
    assert told['steps_repeated'] == 10


def test_given_a_sweep_then_the_curve_has_every_value_and_meets_the_recorded_run(
    bag, tmp_path, taxinet
):
    out = tmp_path / 'out'
    assert taxinet('fork', bag, '--at', 0.5, '--sweep', 'rain=0:100:50', '--out', out)[0] == 0
    with (out / 'sweep.csv').open() as file:
        rows = list(csv.DictReader(file))
    assert [float(row['rain_percent']) for row in rows] == [0, 50, 100]
    judged = open_recording(bag).facts.judged['near'].interval
    assert float(rows[1]['rho_lower']) == judged.lower
    assert (out / 'sweep.png').is_file()


def test_given_a_run_that_nothing_saves_then_that_is_told_with_code_1(bag, tmp_path, taxinet):
    code, said, _ = taxinet('fork', bag, '--find', '--out', tmp_path / 'out')
    assert code == 1
    assert 'wet: not saved by perception truth, not even from the start' in said


@pytest.mark.parametrize(('words', 'error'), [
    ([], 'give a moment by --at, or let --find search'),
    (['--at', '1', '--find'], 'one of them'),
    (['--find', '--sweep', 'rain=0:10:5'], 'do not go together'),
    (['--at', '1', '--sweep', 'rain=0:10'], 'expected KEY=LOW:HIGH:STEP'),
    (['--at', '1', '--sweep', 'rain=0:10:0'], 'positive STEP'),
    (['--at', '1', '--sweep', 'fog=0:10:1'], "unknown key 'fog'"),
    (['--at', '1', '--sweep', 'rain=0:10:5', '--set', 'rain=3'], 'is in the settings too'),
    (['--at', '1', '--state', 'x=1'], 'expected an offset once'),
    (['--at', '1', '--state', 'cte=far'], 'expected a number'),
    (['--at', '1', '--state', 'cte_m=nan'], 'expected a number'),
    (['--at', '1', '--state', 'cte_m=1e6'], 'outside -15..15 m left of the line'),
    (['--at', '1', '--state', 'cte_m=1e308'], 'outside -15..15 m left of the line'),
    (['--at', '1', '--state', 'heading_deg=1e9'], 'outside -90..90 deg, left positive'),
    (['--at', '1', '--state', 'distance_m=-1e9'], 'outside 0..2600 m past the threshold'),
    (['--find', '--state', 'speed_mps=1e9'], 'outside 0..10 m/s'),
    (['--at', '1', '--set', 'rain'], 'expected key=value'),
    (['--at', '1', '--set', 'steering.heading_gain=x'], 'expected a number'),
    (['--at', '1', '--images', 'some'], 'known: all, none'),
    (['--at', '1', '--perception', 'external'], 'external'),
])
def test_given_bad_input_then_one_line_and_code_2(bag, words, error, taxinet, tmp_path):
    code, _, said = taxinet('fork', bag, *words, '--out', tmp_path / 'out')
    assert code == 2
    assert error in said
    assert said.count('\n') == 1
    assert not (tmp_path / 'out').exists()


def test_given_a_damaged_bag_then_it_is_refused_and_nothing_is_written(bag, tmp_path, taxinet):
    damaged = tmp_path / 'wet'
    shutil.copytree(bag, damaged)
    file = damaged / 'wet_0.mcap'
    content = bytearray(file.read_bytes())
    content[len(content) // 2] ^= 1
    file.write_bytes(content)
    code, _, said = taxinet('fork', damaged, '--at', '1', '--out', tmp_path / 'out')
    assert code in (2, 3)
    assert said.count('\n') == 1
    assert not (tmp_path / 'out').exists()

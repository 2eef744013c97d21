"""What is written and printed for a campaign makes its runs again: the same failures.

The very commands that are printed are run, on the campaign's own seed and number of scenes where
they ask for fresh ones, and the truth in place of a network that would first have to be trained.
"""

from __future__ import annotations

import json
import shlex
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import yaml
from own_place import OWN

from taxinet_ros.analysis.causes.causes import Cause, FoundRate
from taxinet_ros.analysis.causes.program import (
    cause_program,
    confirmation_command,
    program_name,
    write_scenes_program,
)
from taxinet_ros.analysis.causes.region import Interval, Region
from taxinet_ros.analysis.runs.campaign import read_runs
from taxinet_ros.bag.run.recording import open_recording
from taxinet_ros.scenes.source import sample_scenarios
from taxinet_ros.study.why.investigation import Investigation, _of_runs
from taxinet_ros.study.why.plan import Budget
from taxinet_ros.study.why.verdict import Blames, CauseEvidence, judge, todo_of
from taxinet_ros.training.data.dataset import draw_scenes
from taxinet_ros.training.data.photographs import photograph
from taxinet_ros.training.data.portions import parse_portion
from taxinet_ros.trials.past_runs.recorded_campaign import open_campaign

LIB = 'import math\ndef across(metres):\n    return metres * math.cos(0.3)\n'
MINE = """model runway_world
from lib.geometry import across
param clouds = Options({'clear': 2, 'cirrus': 1})
param time_of_day_h = Range(9, 12)
param traffic = 'others.yaml'
ego = new Plane at (across(2) * Range(-1, 1), Range(600, 700)), facing Range(5, 12) deg
"""
FILES = {
    'mine.scenic': MINE, 'lib/geometry.py': LIB,
    'others.yaml': 'objects:\n  - {kind: cone, x_m: 690, y_m: 2}\n',
    'own.yaml': yaml.safe_dump(OWN),
    'mine.py': 'def steer(estimate):\n    return -0.9 * estimate.he_rad, 4.0\n',
}
FAST = ('--engine', 'loop', '--audit', '0', '--quiet')
SEED = ('--runs', '2', '--seed', '4')
# How far off it is at the end, so that whatever decides a run decides the robustness.
SPEC = ('--spec', 'near=always[1:2](abs(cte) <= 0.01)')
DECIDES = {
    'scene': ('nominal', (
        '--set', 'clouds=stratus', '--set', 'time_of_day=6:30', '--set', 'cross_track=3',
        '--set', 'camera=nose', '--set', 'steering.heading_gain=0.2',
    ), 'nominal with duration_s=2, clouds=stratus, time_of_day_h=6.5, '),
    'place': ('nominal', (
        '--set', 'place=own.yaml', '--set', 'aircraft=c172p', '--set', 'distance=500', '--set',
        'heading=-20', '--latency', 'perception=0.4', '--rate', 'cte=30', '--set', 'rain=0',
    ), 'nominal with duration_s=2, place=own_16@'),
    'system': ('mine.scenic', (
        '--set', 'heading=-25', '--controller', 'mine.py:steer', '--monitor', 'original',
        '--fallback', 'slow',
    ), 'mine with duration_s=2, heading_deg=-25'),
}


def made(taxinet, folder, program, words):
    """A campaign of two runs that fail."""
    for name, text in FILES.items():
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_text(text)
    taxinet('run', program, *SEED, '--set', 'duration=2', *SPEC, *words, '--perception', 'original',
            *FAST, '--images', 'all', '--out', 'found')
    campaign = open_campaign(Path('found'))
    assert [row.outcome for row in campaign.rows] == ['FAIL', 'FAIL']
    for name in FILES:
        if name != 'mine.py':  # the controller is no part of the scenes
            (folder / name).unlink()
    return campaign


def again(command, **others):
    """A printed command with other values of some options or words."""
    words = shlex.split(command)[1:]
    for old, new in others.items():
        at = words.index(f'--{old}')
        words[at + 1] = new
    return words


def robustness(path):
    return pd.read_parquet(path)['rho_near'].tolist()


@pytest.mark.nightly
@pytest.mark.parametrize('name', DECIDES)
def test_the_commands_of_why_and_analyze_have_everything_that_decided_the_runs(
    tmp_path, taxinet, name,
):
    program, words, scenes_words = DECIDES[name]
    campaign = made(taxinet, tmp_path, program, words)
    runs = read_runs(Path('found'))
    expected = robustness('found/runs.parquet')
    (tmp_path / 'why').mkdir()
    work = Investigation(
        path=tmp_path / 'found', out=tmp_path / 'why', perception=None, budget=Budget(runs=24),
        workers=1, run_stages=lambda stages: {},
    )
    found = work._with_scenes(_of_runs(runs, subject='found'), runs)
    assert f'of the scenes of {scenes_words}' in found.rate
    cause = CauseEvidence(rank=0, words='all failures', program=found.scenes)
    found = replace(
        found, blames=Blames(network=2), causes=(cause,), base=work._base(runs.scenes))
    (train,), (compare,) = (
        one.commands for one in todo_of(found, judge(found), tmp_path / 'found', 'campaign'))

    # The pictures that are trained on are of the scenes that failed.
    added = parse_portion(again(train)[again(train).index('--add') + 1], 'program')
    failed = [campaign.scenario(row)[0] for row in campaign.rows]
    assert draw_scenes(added.name, seed=4, images=2) == failed
    bag = open_recording(Path('found') / campaign.rows[0].run_id)
    assert np.array_equal(photograph(failed[0])[0], next(iter(bag.frames())).image)
    base = again(train)[1]
    if name != 'system':
        (scene,) = draw_scenes(base, seed=1, images=1)
        assert (scene.camera, scene.aircraft) == (failed[0].camera, failed[0].aircraft)
    else:
        assert base == 'training_full'

    words = again(compare, seed='4')
    words[2] = 'truth'  # in place of the fixed network
    code, _, err = taxinet(*words, '--runs', '2', '--workers', '1', '--out', 'compared')
    assert (code, robustness('compared/before.parquet')) == (0, expected), err

    region = Region(parts=(Interval(feature='distance_m', low=0.0, high=None),))
    rate = FoundRate(2, 2, 1.0, 0.2, 1.0)
    cause = Cause(region=region, rank=1, inside=rate, outside=rate, whole=rate, share=1.0,
                  added=1.0, associated=(0.0, 0.0, 0.0), p=0.01, p_is_bound=False)
    folder = tmp_path / 'analysis'
    folder.mkdir()
    write_scenes_program(runs, cause_program(runs, cause), folder / program_name(cause))
    # The requirement changes what is drawn at which seed, but nothing of what was set.
    taxinet(*again(confirmation_command(runs, cause, folder), runs='2'), *FAST, '--out', 'tested')
    tested = open_campaign(Path('tested'))
    assert [row.outcome for row in tested.rows] == ['FAIL', 'FAIL']
    for fact in ('controller_sha256', 'gains', 'specs', 'bounds', 'rates', 'timing', 'world'):
        assert tested.facts[fact] == campaign.facts[fact]
    for key in campaign.facts['overrides']:
        assert {row.scene[key] for row in tested.rows} == {
            row.scene[key] for row in campaign.rows}


@pytest.mark.nightly
def test_the_command_of_shrink_makes_the_shrunk_run_again(tmp_path, taxinet):
    campaign = made(taxinet, tmp_path, *DECIDES['place'][:2])
    run = Path('found') / campaign.rows[0].run_id
    _, said, err = taxinet('shrink', run, '--runs', '4', *FAST[:-1], '--out', 'shrunk')
    command = said.partition('run it: ')[2].splitlines()[0]
    shrunk = json.loads(Path('shrunk/shrink.json').read_text())
    assert taxinet(*again(command), *FAST, '--out', 'again')[0] == 1, err
    rhos = [row.rho['near'] for row in open_campaign(Path('shrunk')).rows]
    assert robustness('again/runs.parquet')[0] in rhos, shrunk


@pytest.mark.nightly
def test_what_a_search_learned_runs_where_it_is_written(tmp_path, taxinet):
    for name, text in FILES.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(text)
    taxinet('falsify', 'mine.scenic', '--sampler', 'ce', '--runs', '16', '--perception', 'truth',
            '--set', 'duration=0.2', '--set', 'clouds=stratus', '--set', 'heading=20', '--spec',
            'left=always(cte >= 0)', '--images', 'none', *FAST, '--out', 'bags/found')
    for name in FILES:
        (tmp_path / name).unlink()
    scenes = sample_scenarios('bags/found/learned.scenic', 7, 8)
    for scene in scenes:
        human = scene.to_human()
        assert (human['clouds'], human['heading_deg'], human['duration_s']) == ('stratus', 20, 0.2)
        assert human['traffic'] != 'nobody'
    assert len({scene.distance_m for scene in scenes}) == 8

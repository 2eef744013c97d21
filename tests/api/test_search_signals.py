"""A search over control points finds what no constant value shows; shrinking makes it simpler."""

import dataclasses

import pytest

import taxinet_ros as tx
from taxinet_ros.trials.past_runs.recorded_campaign import find_run

SPEC = 'settled=always[5:15](abs(cte) <= 0.26)'
CONSTANT = """
model runway_world
ego = new Plane at (0, 400)
param wind_speed_mps = Range(15, 20)
param wind_direction_deg = 324
param duration_s = 15
"""
LULL = CONSTANT + """
param 'wind_speed_mps@form' = 'constant'
param 'wind_speed_mps@8' = Range(0, 20)
"""
ASKED = {'perception': 'truth', 'specs': SPEC, 'progress': False}


@pytest.mark.nightly
def test_given_a_lull_when_searched_then_it_fails_where_no_constant_wind_does(tmp_path):
    found = {}
    for name, text in (('constant', CONSTANT), ('lull', LULL)):
        program = tmp_path / f'{name}.scenic'
        program.write_text(text)
        found[name] = tx.falsify(
            program, runs=20, sampler='halton', out=tmp_path / name, **ASKED).rows
    assert found['constant']['outcome'].eq('PASS').all()
    failed = found['lull'][found['lull']['outcome'] == 'FAIL']
    assert 1 <= len(failed) < 20
    assert (failed['wind_speed_mps@8'] < 12).all()
    assert (failed['wind_speed_mps@form'] == 'constant').all()
    assert found['lull']['u_wind_speed_mps@8'].nunique() == 20
    assert '@' not in ''.join(found['constant'].columns)
    # The record alone gives the scene again.
    worst = failed.iloc[0]['run_id']
    scene = find_run(tmp_path / 'lull' / worst).scenario
    assert tx.run(scene, specs=SPEC).outcome == 'FAIL'
    steady = dataclasses.replace(scene, signals='')
    assert tx.run(steady, specs=SPEC).outcome == 'PASS'

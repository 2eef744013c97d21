"""``taxinet mine`` on a recorded campaign, and on those that cannot be mined."""

from __future__ import annotations

import itertools
import json
import math
import shutil
from pathlib import Path

import pytest
from taxinet_process import taxinet

import taxinet_ros as tx

RUNS = 6


def falsify(out: Path, *more: str) -> Path:
    done = taxinet(
        'falsify', 's_falsif', '--perception', 'truth', '--sampler', 'random', '--runs', str(RUNS),
        '--seed', '7', '--set', 'duration=2', '--images', 'none', '--engine', 'loop', '--audit',
        '0', '--spec', 'phi_always', '--out', out, *more,
    )
    assert done.returncode == 1, done.stderr
    return out


@pytest.fixture(scope='module')
def campaign(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return falsify(tmp_path_factory.mktemp('mine') / 'campaign')


def test_given_a_campaign_when_mined_then_the_value_is_the_order_statistic_of_its_bags(campaign):
    rows = tx.open_campaign(campaign).rows
    greatest = sorted(
        tx.open_recording(campaign / bag).trace['cte_m'].abs().max() for bag in rows['bag']
    )
    assert len(greatest) == RUNS
    done = taxinet('mine', 'always(abs(cte) <= A)', campaign, '--share', '0.5', '--json')
    assert (done.returncode, done.stderr) == (0, '')
    found = json.loads(done.stdout)
    assert (found['runs'], found['parameter'], found['rho_rises']) == (RUNS, 'A', True)
    (one,) = found['values']
    assert one['value'] == pytest.approx(greatest[2], abs=1e-7)
    # 1st and 6th of 6: they miss the median with 2 * 0.5 ** 6 = 3.1 %.
    assert one['tighter'] == pytest.approx(greatest[0], abs=1e-7)
    assert one['looser'] == pytest.approx(greatest[5], abs=1e-7)
    done = taxinet('mine', 'always(abs(cte) <= A)', campaign, '--share', '0.5')
    assert done.stdout.splitlines()[-1].startswith(f'A = {math.ceil(greatest[2] * 1e4) / 1e4:g}  [')
    # With the printed value it holds for the share, as taxinet monitor says.
    value = done.stdout.splitlines()[-1].split()[2]
    again = taxinet('monitor', campaign, '--spec', f'mined=always(abs(cte) <= {value})', '--json')
    verdicts = [bag['verdicts'][0]['verdict'] for bag in json.loads(again.stdout)['bags']]
    assert verdicts.count('SATISFIED') == RUNS // 2


def test_given_a_greatest_value_when_mined_then_its_interval_is_printed_from_low_to_high(campaign):
    least = sorted(
        tx.open_recording(campaign / bag).trace['cte_m'].abs().min()
        for bag in tx.open_campaign(campaign).rows['bag']
    )
    done = taxinet('mine', 'always(abs(cte) >= A)', campaign, '--share', '0.5')
    low, high = done.stdout.splitlines()[-1].partition('[')[2].rstrip(']').split(', ')
    assert (float(low), float(high)) == pytest.approx((least[0], least[5]), abs=1.1e-4)
    done = taxinet('mine', 'always(abs(cte) >= A)', campaign, '--share', '0.95')
    assert done.stdout.splitlines()[-1].partition('[')[2].startswith('not known, ')


def test_given_two_parameters_when_mined_then_each_time_has_a_tighter_number(campaign):
    done = taxinet('mine', 'always[T:2](abs(cte) <= A)', campaign, '--points', '5', '--json')
    values = json.loads(done.stdout)['values']
    assert [one['other'] for one in values] == sorted({one['other'] for one in values})
    assert len(values) > 1
    assert all(a['value'] > b['value'] for a, b in itertools.pairwise(values))
    assert values[-1]['looser'] == 'inf', 'six runs show no 95 %'


def test_given_runs_that_cannot_be_evaluated_then_one_line_says_why_and_what_to_do(
    campaign, tmp_path
):
    bare = tmp_path / 'bare'
    shutil.copytree(campaign, bare)
    run = tx.open_campaign(bare).rows['bag'].iloc[2]
    shutil.rmtree(bare / run)
    cases = {
        (bare, 'always(cte <= A)'): f'{run}: has no bag, and the table has no values over time',
        (falsify(tmp_path / 'stopped', '--stop-on', 'violated'), 'always(cte <= A)'):
            'was stopped early, so its end is not known; run the campaign again without stop_on',
        (campaign, 'always(cte * A <= 3)'): 'robustness is not monotone in A',
        (campaign, 'always(estimate_gap <= B)', '--share', '1'): '--share 1: needs to be between',
        (tmp_path / 'nothing', 'always(cte <= A)'): 'not a campaign',
    }
    for (folder, formula, *more), said in cases.items():
        done = taxinet('mine', formula, folder, *more)
        assert (done.returncode, done.stdout, done.stderr.count('\n')) == (2, '', 1)
        assert said in done.stderr

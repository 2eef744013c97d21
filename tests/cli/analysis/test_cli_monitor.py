"""``taxinet monitor``: recorded runs judged again and anew, whole, stopped, damaged and foreign."""

from __future__ import annotations

import dataclasses
import json
import math
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pandas as pd
import pytest
from taxinet_process import taxinet

from taxinet_ros.bag.check.judge import judge_bags, judge_runs
from taxinet_ros.bag.run.judging import BagVerdict, judge_spec
from taxinet_ros.bag.run.recording import open_recording
from taxinet_ros.bag.run.samples import run_samples
from taxinet_ros.cli.main import _exit_code, app
from taxinet_ros.core.mtl import parse_spec
from taxinet_ros.trials.record.row import WALL_CLOCK_COLUMNS
from taxinet_ros.trials.record.table import read_table

SOON = 'soon=F[0, 1] G abs(cte) <= 3'
WORDS = [
    'falsify', 's_falsif', '--perception', 'truth', '--sampler', 'random', '--seed', '7',
    '--set', 'duration=2', '--spec', SOON, '--stop-on', 'violated', '--images', 'none',
    '--engine', 'loop', '--audit', '0',
]

pytestmark = pytest.mark.ros


def call(capsys: pytest.CaptureFixture[str], *words: object) -> tuple[int, str, str]:
    """Exit code, standard output and error of ``taxinet monitor``."""
    capsys.readouterr()
    code = _exit_code(lambda: app(['monitor', *map(str, words)], standalone_mode=False))
    captured = capsys.readouterr()
    return code, captured.out, captured.err


def told(out: str, bag: Path) -> list[str]:
    """The lines about a bag."""
    return [line for line in out.splitlines() if line.startswith(bag.name)]


def falsify(out: Path, runs: int, *words: str) -> str:
    done = taxinet(*WORDS, '--runs', str(runs), '--out', out, *words)
    assert (done.returncode, done.stderr) == (1, ''), done.stderr
    return done.stdout


@pytest.fixture(scope='module')
def campaign(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Four runs; some were stopped, others not."""
    out = tmp_path_factory.mktemp('monitor') / 'campaign'
    assert 'stopped early, which saved' in falsify(out, 4)
    assert set(read_table(out)['stopped_early']) == {True, False}
    return out


@pytest.fixture
def whole(campaign: Path) -> Path:
    """The bag of a run that was not stopped."""
    table = read_table(campaign)
    return campaign / table.loc[~table['stopped_early'], 'bag'].iloc[0]


@pytest.fixture
def torn(campaign: Path, whole: Path, tmp_path: Path) -> Path:
    """The same, as a power cut would have left it."""
    data = (whole / f'{whole.name}_0.mcap').read_bytes()
    folder = tmp_path / 'torn'
    folder.mkdir()
    (folder / 'torn_0.mcap').write_bytes(data[:len(data) * 3 // 5])
    return folder


def test_given_a_campaign_when_judged_again_then_every_interval_is_the_recorded_one(
    campaign, capsys
):
    table = read_table(campaign)
    code, out, err = call(capsys, campaign, '--json')
    assert (code, err) == (1, '')
    bags = json.loads(out)['bags']
    assert [Path(bag['bag']).name for bag in bags] == list(table['bag'])
    for bag, (_, row) in zip(bags, table.iterrows(), strict=True):
        (one,) = bag['verdicts']
        assert one['as_recorded'] is True
        assert one['verdict'] == {'PASS': 'SATISFIED', 'FAIL': 'VIOLATED'}[row['outcome']]
        assert one['rho_upper'] == row['rho_upper.soon']
        assert bag['stopped_early'] == row['stopped_early']
        if row['stopped_early']:
            assert one['rho_lower'] is None
            assert bag['end_s'] == one['decided_s'] == row['stopped_s'] < 2
        else:
            assert one['rho_lower'] == row['rho']
    code, out, _ = call(capsys, campaign)
    assert f'{len(bags)} of {len(bags)} as recorded, to the bit' in out.splitlines()[-1]


def test_given_new_requirements_then_each_gets_a_verdict_that_the_bag_had_never_heard_of(
    whole, capsys, tmp_path
):
    file = tmp_path / 'new.yaml'
    file.write_text('predicates: {slow: speed <= 6}\nspecs:\n  slow_taxi: G slow\n')
    code, out, _ = call(capsys, whole, '--spec', file, '--spec', 'phi_always', '--spec', SOON)
    assert [line.split(':')[0] for line in out.splitlines()[:3]] == [
        'slow_taxi', 'phi_always', 'soon'
    ], 'how they are understood'
    lines = [line.split() for line in told(out, whole)]
    assert [line[1:3] for line in lines[:2]] == [
        ['slow_taxi', 'SATISFIED'], ['phi_always', lines[1][2]]
    ]
    assert lines[0][-2:] == ['not', 'recorded']
    assert lines[2][-2:] == ['as', 'recorded']
    assert code == (1 if 'VIOLATED' in out else 0)
    assert call(capsys, whole, '--spec', file)[0] == 0
    assert call(capsys, whole / f'{whole.name}_0.mcap', '--spec', 'fast=G speed > 9')[0] == 1


def test_given_explain_then_each_part_and_the_deciding_sample_are_told_and_nothing_else_changes(
    whole, capsys, tmp_path
):
    spec = 'both=always((abs(steering) <= 9) and (abs(cte) <= 0.1))'
    plain = call(capsys, whole, '--spec', spec)
    code, out, err = call(capsys, whole, '--spec', spec, '--explain')
    parts = [line for line in out.splitlines() if line.startswith('    ')]
    assert (code, out.replace(''.join(f'{line}\n' for line in parts), ''), err) == plain
    (samples,) = run_samples(open_recording(whole), ['cte'])
    cte = [abs(sample['cte']) for sample in samples.samples]
    at_s = samples.stamps_ns[cte.index(max(cte))] / 1e9
    worst = re.escape(f'rho {0.1 - max(cte):+.3f}  {at_s:5.1f} s  ')
    assert [re.match(worst, line.strip()) is not None for line in parts] == [
        at_s == 0, True, False, True
    ]
    assert parts[3].endswith('abs(cte) <= 0.1  <- decides')
    _, out, _ = call(capsys, whole, '--spec', spec, '--explain', '--json')
    (one,) = json.loads(out)['bags'][0]['verdicts']
    assert one['witness_s'] == at_s
    assert [clause['decides'] for clause in one['clauses']] == [True, True, False, True]
    low, high = one['clauses'][3]['columns']
    assert one['formula'][low - 1:high] == one['clauses'][3]['text'] == 'abs(cte) <= 0.1'
    _, out, _ = call(capsys, whole, '--spec', spec, '--json')
    assert 'clauses' not in json.loads(out)['bags'][0]['verdicts'][0]
    code, out, _ = call(capsys, whole, '--spec', spec, '--explain', '--plot', tmp_path / 'x.png')
    assert f'picture: {tmp_path / "x.png"}' in out
    found = open_recording(whole).judge(spec, explain=True).explanation
    assert found.witness_s == at_s
    assert open_recording(whole).judge(spec).explanation is None


def test_given_a_stopped_run_when_a_new_requirement_is_open_then_it_is_incomplete(
    campaign, capsys
):
    table = read_table(campaign)
    stopped = campaign / table.loc[table['stopped_early'], 'bag'].iloc[0]
    code, out, _ = call(capsys, stopped, '--spec', 'on_runway', '--spec', SOON)
    assert code == 3
    lines = told(out, stopped)
    assert [line.split()[1:3] for line in lines[:2]] == [
        ['on_runway', 'INCOMPLETE'], ['soon', 'VIOLATED']
    ]
    assert 'stopped early, at' in lines[2]


def test_given_a_torn_bag_then_there_is_an_interval_of_what_can_be_read_and_no_pass(
    whole, torn, capsys
):
    code, out, _ = call(capsys, torn, '--json')
    assert code == 3
    (bag,) = json.loads(out)['bags']
    (one,) = bag['verdicts']
    assert one['verdict'] == 'INCOMPLETE'
    assert one['rho_lower'] is None
    assert 0 < bag['end_s'] < 2
    assert one['as_recorded'] is True, 'the interval was recorded step by step'
    rho = judge_runs(whole)[0].verdicts[0].interval.upper
    assert rho <= one['rho_upper']
    assert 'torn_0.mcap' in bag['trouble']

    copy = torn.parent / 'copy'
    shutil.copytree(whole, copy)
    (copy / 'metadata.yaml').unlink()
    assert call(capsys, copy)[0] == call(capsys, whole)[0] == 0, 'by its content, as of a file'


def test_given_any_flipped_byte_then_a_bag_never_passes_as_sound(whole, tmp_path):
    data = bytearray((whole / f'{whole.name}_0.mcap').read_bytes())
    expected = judge_runs(whole)[0].verdicts[0]
    path = tmp_path / 'flipped.mcap'
    places = range(40, len(data) - 40, len(data) // 12)
    for place in places:
        damaged = data.copy()
        damaged[place] ^= 0x10
        path.write_bytes(damaged)
        (found,) = judge_runs(path)
        assert found.trouble
        for one in found.verdicts:
            assert one.verdict is BagVerdict.INCOMPLETE
            known = expected.interval
            assert one.interval.lower <= known.lower <= known.upper <= one.interval.upper


def test_given_a_bag_that_contradicts_itself_then_that_is_said(whole):
    (samples,) = run_samples(open_recording(whole))
    spec = parse_spec(samples.specs[0])
    assert judge_spec(samples, spec)[0].same is True
    newest = samples.recorded[spec.text]
    ends = newest.interval
    other = newest._replace(interval=ends._replace(upper=math.nextafter(ends.upper, 9)))
    forged = dataclasses.replace(samples, recorded={spec.text: other})
    assert judge_spec(forged, spec)[0].same is False


def test_given_a_sample_that_is_missing_or_not_finite_then_the_run_is_invalid(whole):
    (samples,) = run_samples(open_recording(whole))
    spec = parse_spec(samples.specs[0])
    values = [dict(sample) for sample in samples.samples]
    values[10]['cte'] = math.nan
    spoilt = dataclasses.replace(samples, samples=tuple(values))
    gap = dataclasses.replace(
        samples, samples=samples.samples[:9] + samples.samples[10:],
        stamps_ns=samples.stamps_ns[:9] + samples.stamps_ns[10:],
    )
    for broken in (spoilt, gap):
        one, _ = judge_spec(broken, spec)
        assert one.verdict is BagVerdict.INVALID
        assert one.interval.lower < one.interval.upper


def test_given_a_run_without_its_first_step_then_nothing_is_known(whole):
    (samples,) = run_samples(open_recording(whole))
    late = dataclasses.replace(
        samples, samples=samples.samples[1:], stamps_ns=samples.stamps_ns[1:],
        there=samples.there[1:],
    )
    for text in (*samples.specs, 'cte <= 99', 'always[0.1:inf](cte <= 99)'):
        one, readings = judge_spec(late, parse_spec(text))
        assert one.verdict is BagVerdict.INCOMPLETE
        assert (one.interval, one.decided_s) == ((-math.inf, math.inf), None)
        assert len(readings) == len(late.stamps_ns)


def test_given_new_requirements_when_added_then_the_table_keeps_them_for_good(campaign, capsys):
    before = read_table(campaign)
    code, out, _ = call(capsys, campaign, '--spec', 'phi_always', '--spec', SOON, '--add')
    assert code == 1
    assert out.splitlines()[-1] == f'{campaign}: rho_phi_always added for 4 runs'
    after = read_table(campaign)
    new = [name for name in after.columns if name.endswith('phi_always')]
    assert new == ['rho_phi_always', 'rho_lower.phi_always', 'rho_upper.phi_always']
    pd.testing.assert_frame_equal(after.drop(columns=new), before)
    whole = ~after['stopped_early']
    expected = 1.5 - after.loc[whole, 'max_cross_track_m']
    assert list(after.loc[whole, 'rho_phi_always']) == list(expected)
    assert after.loc[~whole, 'rho_upper.phi_always'].notna().all()

    falsify(campaign, 5, '--resume')
    resumed = read_table(campaign)
    assert len(resumed) == 5
    drop = list(WALL_CLOCK_COLUMNS)
    pd.testing.assert_frame_equal(resumed[:4].drop(columns=drop), after.drop(columns=drop))
    assert math.isnan(resumed['rho_upper.phi_always'][4])
    assert call(capsys, campaign, '--spec', 'phi_always', '--add')[0] in (1, 3)
    assert read_table(campaign)['rho_upper.phi_always'].notna().all()

    code, _, err = call(capsys, campaign, '--spec', 'soon=G cte < 1', '--add')
    assert code == 2
    assert 'soon is eventually[0:1](always(abs(cte) <= 3)); choose another name' in err


@pytest.mark.nightly
def test_given_a_plot_then_there_is_a_picture_of_each_bag(campaign, whole, torn, capsys, tmp_path):
    picture = tmp_path / 'one.png'
    specs = ['--spec', SOON, '--spec', 'both=G (abs(steering) <= 0.3 and 2*speed - 1 > he)']
    assert call(capsys, whole, *specs, '--plot', picture)[1].endswith(f'picture: {picture}\n')
    assert picture.read_bytes().startswith(b'\x89PNG')
    call(capsys, whole, torn, *specs, '--plot', tmp_path / 'all')
    drawn = {path.name: path.read_bytes() for path in (tmp_path / 'all').iterdir()}
    assert set(drawn) == {f'{whole.name}.png', 'torn.png'}
    assert drawn[f'{whole.name}.png'] == picture.read_bytes(), 'the same bytes every time'


def test_given_bounds_that_a_run_keeps_or_breaks_then_that_shows(whole, capsys):
    spec = 'wide=always(abs(cte) <= 40)'
    plain = json.loads(call(capsys, whole, '--spec', spec, '--json')[1])['bags'][0]['verdicts'][0]
    bounds = ['--bound', 'cte=-30:30', '--json']
    code, out, _ = call(capsys, whole, '--spec', spec, *bounds)
    kept = json.loads(out)['bags'][0]['verdicts'][0]
    assert (code, kept['decided_s'], kept['breach_s']) == (0, 0.0, None)
    assert plain['decided_s'] == json.loads(out)['bags'][0]['end_s'], 'without them at the end only'
    assert kept['rho_lower'] == kept['rho_upper'] == plain['rho_lower']
    code, out, _ = call(capsys, whole, '--spec', spec, '--rate', 'cte=0.001')
    assert code == 0
    assert told(out, whole)[1] == (
        f'{whole.name}  wide  assumption violated at 0.1 s'
    )


@pytest.mark.parametrize(('words', 'told'), [
    (('--bound', 'cte=3'), "bounds 'cte=3': expected LOW:HIGH with LOW <= HIGH [m], e.g. cte="),
    (('--rate', 'cta=3'), "rates 'cta=3': unknown signal 'cta'; known: cte, he"),
    (('--spec', 'phi_always', '--rate', 'he=1'),
     'rates he: has no effect: no requirement reads he'),
])
def test_given_bad_assumptions_then_one_line_names_the_option(whole, capsys, words, told):
    code, _, err = call(capsys, whole, *words)
    assert code == 2
    assert told in err
    assert len(err.splitlines()) == 1


def test_t17_given_a_window_beyond_a_recorded_run_then_it_is_unclear_and_no_pass(whole, capsys):
    for text in ('far=always[35:40](cte < 1)', 'far=cte < 99 or always[35:40](cte < 1)'):
        code, out, _ = call(capsys, whole, '--spec', text)
        assert code == 3
        assert told(out, whole)[0].split()[1:3] == ['far', 'UNCLEAR']
        assert 'begins 35 s into the run, which lasts 2 s; it cannot' in told(out, whole)[1]
        (one,) = json.loads(call(capsys, whole, '--spec', text, '--json')[1])['bags'][0]['verdicts']
        assert (one['verdict'], one['why_unclear'][:9]) == ('UNCLEAR', 'spec far:')


def test_people2_given_a_vacuous_requirement_then_monitor_warns_once(campaign, capsys):
    spec = 'gentle=always(abs(steering) <= 0.3)'
    warning = (
        'gentle: no run can violate it: |steering| <= 0.3 rad (17.19 deg) always holds '
        '(steering within ±0.261799 rad (15 deg))'
    )
    code, out, _ = call(capsys, campaign, '--spec', spec)
    assert code == 3, 'some runs were stopped'
    assert out.splitlines().count(f'warning: {warning}') == 1
    assert json.loads(call(capsys, campaign, '--spec', spec, '--json')[1])['warnings'] == [warning]


def test_ros10_given_a_bag_of_a_seeing_perception_then_usable_is_judged_and_nothing_warned_of(
    whole, capsys
):
    code, out, _ = call(capsys, whole, '--spec', 'usable')
    assert code == 0
    (line,) = told(out, whole)
    assert line.split()[1:5] == ['usable', 'SATISFIED', 'rho', '+0.050']
    (samples,) = run_samples(open_recording(whole), ['estimate_gap'])
    values = [dict(sample, estimate_gap=0.1 * row) for row, sample in enumerate(samples.samples)]
    blind = dataclasses.replace(samples, samples=tuple(values), unusable_estimates=20)
    assert judge_spec(blind, parse_spec('always(estimate_gap <= 500 ms)'))[0].interval.lower < 0


@pytest.mark.nightly
def test_given_several_processes_then_the_answers_are_the_same_and_in_order(campaign):
    bags = [campaign / name for name in read_table(campaign)['bag']][:4] * 4
    specs = [parse_spec(text) for text in ('phi_always', SOON)]
    assert list(judge_bags(bags, specs, 2)) == list(judge_bags(bags, specs, 1))


def test_given_no_ros_then_bags_are_judged_all_the_same(whole):
    code = (
        'import sys; sys.modules["rclpy"] = sys.modules["taxinet_msgs"] = None; '
        'from taxinet_ros.cli.main import main; main()'
    )
    done = subprocess.run(
        [sys.executable, '-c', code, 'monitor', str(whole), '--spec', 'on_runway'],
        capture_output=True, text=True,
    )
    assert (done.returncode, done.stderr) == (0, '')
    assert 'SATISFIED' in done.stdout


@pytest.mark.parametrize(('words', 'complaint'), [
    (['none'], 'none: no such bag'),
    (['{here}'], 'holds no bag'),
    (['{here}/notes.txt'], 'not an MCAP file'),
    (['{campaign}', '--spec', 'G cte <'], 'column 8: expected a signal'),
    (['{campaign}', '--plot', '{here}/a.png'], '[45] bags given; name a folder'),
    (['{campaign}', '--plot', '{here}/a.pdf'], 'write NAME.png'),
    (['{campaign}', '--add'], '--add: name the requirement to add with --spec'),
    (['{whole}', '--spec', 'phi_always', '--add'], 'no such file; not a campaign'),
    (['{campaign}', '--workers', '0'], '--workers'),
])
def test_given_bad_input_then_one_line_says_what_and_the_code_is_two(
    campaign, whole, capsys, tmp_path, words, complaint
):
    (tmp_path / 'notes.txt').write_text('not a bag, but long enough to be one')
    places = {'here': tmp_path, 'campaign': campaign, 'whole': whole}
    code, out, err = call(capsys, *(word.format(**places) for word in words))
    assert (code, out) == (2, '')
    assert err.count('\n') == 1
    assert re.search(complaint, err), err

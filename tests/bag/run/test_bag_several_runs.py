"""Bags of several runs, and of other recorders: each run is judged, none is mixed with another."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from bag_edits import GOLDEN
from recordings import heard, record

from taxinet_ros.bag.check.compare import compare_bags
from taxinet_ros.bag.check.judge import JudgedBag, judge_runs
from taxinet_ros.bag.errors import BagForeign
from taxinet_ros.bag.playback import open_bag
from taxinet_ros.bag.reader import stored_messages
from taxinet_ros.bag.run.judging import BagVerdict
from taxinet_ros.bag.run.recording import open_recording
from taxinet_ros.bag.run.topics import is_of_frames
from taxinet_ros.core.mtl import parse_spec
from taxinet_ros.errors import UsageError

GOOD, BAD = GOLDEN / 'taxinet-midday', GOLDEN / 'original-early-light'
RUNS = (GOOD.name, BAD.name)


@pytest.fixture(scope='module')
def both(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording of a run that satisfies its formula, and then of one that violates it."""
    return record(tmp_path_factory.mktemp('both') / 'rosbag2_all', heard([GOOD, BAD]))


def essence(judged: JudgedBag) -> list[tuple[Any, ...]]:
    """What is said of a run, whatever bag it lies in."""
    return [(one.spec, one.verdict, one.interval, one.decided_s, one.same)
            for one in judged.verdicts]


def test_ros1_given_two_runs_in_a_bag_when_judged_then_each_has_its_verdict_and_the_code_is_one(
    both, taxinet
):
    code, out, err = taxinet('monitor', both)
    assert (code, err) == (1, '')
    told = [line.split() for line in out.splitlines() if ' phi_eventually ' in line]
    assert [words[:4] for words in told] == [
        [both.name, GOOD.name, 'phi_eventually', 'SATISFIED'],
        [both.name, BAD.name, 'phi_eventually', 'VIOLATED'],
    ]
    assert '1 SATISFIED, 1 VIOLATED of 2 runs; 2 of 2 as recorded, to the bit' in out
    code, out, _ = taxinet('monitor', both, '--json')
    assert (code, [bag['run'] for bag in json.loads(out)['bags']]) == (1, list(RUNS))


@pytest.mark.parametrize('how', ['wall clock', 'simulated time', 'three files'])
def test_ros1_given_another_recorder_when_judged_then_it_is_as_from_our_own_bags(how, tmp_path):
    messages = heard([GOOD, BAD], sim_time=how == 'simulated time')
    bag = record(tmp_path / 'all', messages, files=3 if how == 'three files' else 1)
    specs = [one.spec for one in judge_runs(GOOD)[0].verdicts]
    found = judge_runs(bag, specs)
    assert [one.run for one in found] == list(RUNS)
    expected = [judge_runs(own, specs)[0] for own in (GOOD, BAD)]
    assert [essence(one) for one in found] == [essence(one) for one in expected]
    assert all(one.end_s == 12.0 and not one.trouble for one in found)


def test_ros1_given_a_formula_on_messages_that_name_no_run_then_none_is_mixed(both):
    spec = parse_spec('far=always(x >= 1 and speed <= 30)')
    expected = [essence(judge_runs(own, [spec])[0]) for own in (GOOD, BAD)]
    assert expected[0] != expected[1]
    assert [essence(one) for one in judge_runs(both, [spec])] == expected


def test_ros1_given_the_same_run_id_twice_then_these_are_two_runs(tmp_path):
    bag = record(tmp_path / 'all', heard([BAD, BAD]))
    found = judge_runs(bag)
    assert [one.run for one in found] == [BAD.name, f'{BAD.name}#2']
    assert essence(found[0]) == essence(found[1]) == essence(judge_runs(BAD)[0])


def test_ros1_given_one_run_by_name_then_it_alone_is_judged(both, taxinet):
    assert taxinet('monitor', both, '--run', GOOD.name)[0] == 0
    assert taxinet('monitor', both, '--run', BAD.name)[0] == 1
    code, _, err = taxinet('monitor', both, '--run', 'x')
    assert (code, len(err.splitlines())) == (2, 1)
    assert f'run x: no such run in {both}; it holds {GOOD.name}, {BAD.name}' in err


def test_ros1_given_interleaved_runs_then_what_names_no_run_is_not_guessed(tmp_path):
    one, other = heard([GOOD]), heard([BAD])
    mixed = [message for pair in zip(one, other, strict=True) for message in pair]
    bag = record(tmp_path / 'sorted', mixed)
    judged = judge_runs(bag)
    assert [essence(run) for run in judged] == [essence(judge_runs(b)[0]) for b in (GOOD, BAD)]
    for run in judge_runs(bag, [parse_spec('always(x >= 1)')]):
        assert not run.sound
        assert 'odometry and frames have no run_id' in run.trouble


def test_ros1_given_a_recorder_that_came_late_then_the_run_is_incomplete_and_said_to_be(
    tmp_path, taxinet
):
    late = heard([GOOD], keep=lambda m: m.stamp_ns >= 5 * 10**9 or m.topic.name == '/scenario')
    before = [m for m in heard([BAD]) if m.topic.name in ('/scenario', '/monitor/verdict')]
    # The latched messages come last: each topic is found when it is found.
    late.sort(key=lambda message: message.topic.name == '/scenario')
    bag = record(tmp_path / 'late', [*before, *late])
    code, out, _ = taxinet('monitor', bag)
    assert code == 3
    assert 'INCOMPLETE' in out
    assert 'begins at 5 s: earlier steps were not recorded' in out
    assert f'has the end, but no steps, of these runs: {BAD.name}' in out
    code, _, err = taxinet('monitor', bag, '--run', BAD.name)
    assert (code, len(err.splitlines())) == (2, 1)
    assert f'--run {BAD.name}: no step of it in {bag}' in err


def test_ros1_given_several_runs_then_every_other_command_names_them_and_how_to_choose(
    both, tmp_path, taxinet
):
    for words in (
        ('bag', 'export', both, '--out', tmp_path / 'trace.csv'), ('run', '--from', both),
        ('bag', 'render', both, '--out', tmp_path / 'new'), ('bag', 'compare', both, GOOD),
        ('bag', 'replay', both), ('explain', both),
    ):
        code, out, err = taxinet(*words)
        assert (code, out, len(err.splitlines())) == (2, '', 1), words
        assert f'holds 2 runs: {GOOD.name} (0-12 s), {BAD.name} (0-12 s); choose a run' in err
    code, out, err = taxinet('shrink', both)
    assert (code, out, len(err.splitlines())) == (2, '', 1)
    assert f'taxinet bag split {both} --out DIR' in err
    assert list(tmp_path.iterdir()) == []
    for name in ('run', 'columns', 'facts'):
        with pytest.raises(BagForeign, match='holds several runs, taxinet-midday and original'):
            getattr(open_recording(both), name)


def test_ros1_given_one_run_of_several_then_it_is_exported_and_compared_as_our_own_bag(
    both, tmp_path, taxinet
):
    for words in ((both, '--run', BAD.name), (BAD,)):
        out = tmp_path / f'{len(words)}.csv'
        assert taxinet('bag', 'export', *words, '--out', out)[0] == 0
    assert (tmp_path / '3.csv').read_text() == (tmp_path / '1.csv').read_text()
    for run, code in ((BAD, 0), (GOOD, 1)):
        assert taxinet('bag', 'compare', both, BAD, '--run', run.name)[0] == code
    other = tmp_path / 'rosout.csv'
    assert taxinet('bag', 'export', both, '--topics', 'rosout', '--out', other)[0] == 0


def transforms(bag: Path) -> list[tuple[str, int, bytes]]:
    return [(stored.topic.name, stored.stamp_ns, stored.cdr)
            for stored in stored_messages(bag, is_of_frames)]


def test_ros1_given_a_recording_when_split_then_every_bag_is_whole_and_the_same_as_ours(
    both, tmp_path, taxinet
):
    code, out, _ = taxinet('bag', 'split', both, '--out', tmp_path / 'runs')
    assert (code, len(out.splitlines())) == (0, 3)
    assert out.splitlines()[-1] == 'left out, as no run is judged by them: /rosout'
    for own in (GOOD, BAD):
        new = tmp_path / 'runs' / own.name
        assert all(topic.equal for topic in compare_bags(own, new))
        assert open_recording(new).plain
        assert open_recording(new).run == open_recording(own).run
        assert transforms(new) == transforms(own)
        assert taxinet('doctor', new)[0] == 0
    code, _, err = taxinet('bag', 'split', both, '--out', tmp_path / 'runs')
    assert (code, len(err.splitlines())) == (2, 1)


def test_ros1_given_two_runs_when_asked_for_information_then_both_are_told(both, taxinet):
    code, out, _ = taxinet('bag', 'info', both)
    assert code == 0
    told = [line for line in out.splitlines() if line.startswith(('run ', 'outcome'))]
    assert [line.split()[1] for line in told] == [GOOD.name, 'PASS,', BAD.name, 'FAIL,']
    assert "by the recorder's clock" in out
    values = json.loads(taxinet('bag', 'info', both, '--json')[1])
    assert [run['run_id'] for run in values['runs']] == list(RUNS)
    assert values['run'] is None


def test_ros14_given_a_recording_by_the_wall_clock_with_silent_topics_then_doctor_finds_nothing(
    both, taxinet
):
    code, out, _ = taxinet('doctor', both)
    assert code == 0, out
    assert out.splitlines()[-1] == 'nothing is wrong'
    assert f'{BAD.name}: 121 control steps, every topic in each' in out


@pytest.mark.parametrize(('lost', 'expected'), [
    (('/taxi_command', 7 * 10**8), 'step 7: without /taxi_command'),
    (('/scenario', 0), 'scenario: 0 messages, not 1; nothing tells what was run'),
])
def test_ros14_given_a_recording_that_lost_a_message_then_doctor_says_which(
    lost, expected, tmp_path, taxinet
):
    kept = heard([GOOD], keep=lambda m: (m.topic.name, m.stamp_ns) != lost)
    code, out, _ = taxinet('doctor', record(tmp_path / 'lossy', kept))
    assert code == 3
    assert expected in out


def test_ros14_given_a_namespace_then_the_run_is_judged_and_compared_as_without(tmp_path, taxinet):
    bag = record(tmp_path / 'named', heard([BAD]), namespace='/left')
    assert [essence(one) for one in judge_runs(bag)] == [essence(judge_runs(BAD)[0])]
    assert taxinet('bag', 'compare', bag, BAD)[0] == 0


def test_ros1_given_a_time_that_begins_anew_then_the_player_asks_for_a_bag_of_each(tmp_path):
    bag = record(tmp_path / 'all', heard([GOOD, BAD], sim_time=True))
    with pytest.raises(UsageError, match='jumps back by 12 s, so it holds several runs'):
        open_bag(str(bag))
    assert open_bag(str(record(tmp_path / 'wall', heard([GOOD, BAD])))).complete


def test_ros1_attack_given_two_runs_when_recovered_then_the_steps_of_each_are_told(
    both, tmp_path, taxinet
):
    code, out, err = taxinet('bag', 'recover', both, '--out', tmp_path / 'whole')
    assert (code, err) == (0, '')
    for own in (GOOD, BAD):
        assert f'{own.name}: 121 whole control steps of 121 planned, ended as' in out
    cut = record(tmp_path / 'cut', heard([GOOD, BAD]), files=3)
    last = cut / 'cut_2.mcap'
    last.write_bytes(last.read_bytes()[:-20])
    code, out, err = taxinet('bag', 'recover', cut, '--out', tmp_path / 'saved')
    assert (code, err) == (3, '')
    assert 'damage: ' in out
    assert 'lost no message except as stated above' in out


def without(topic: str, bag: Path) -> list[Any]:
    """What a recorder hears of a run that has no ear for one topic."""
    return heard([bag], keep=lambda message: message.topic.name != topic)


@pytest.mark.parametrize('runs', [1, 2])
def test_ros1_attack_given_a_topic_that_is_missing_then_other_formulas_are_judged_all_the_same(
    runs, tmp_path, taxinet
):
    lossy = without('/ground_truth/odom', BAD)
    bag = record(tmp_path / 'deaf', [*(heard([GOOD]) if runs == 2 else []), *lossy])
    own = judge_runs(BAD)[0].verdicts[0]
    specs = ['--spec', own.spec.text, '--spec', 'slow=always(speed <= 30)']
    for words in (specs[:2], specs, [*specs[2:], *specs[:2]]):
        code, out, _ = taxinet('monitor', bag, *words)
        assert code == 1
        assert 'DIFFERS' not in out
        assert ('ground_truth/odom: no messages' in out) is (len(words) > 2)
    judged = judge_runs(bag, [own.spec, parse_spec('slow=always(speed <= 30)')])[-1]
    assert judged.verdicts[0] == own
    assert judged.verdicts[1].verdict is BagVerdict.INCOMPLETE
    code, out, _ = taxinet('monitor', bag, *specs[2:], '--plot', tmp_path / 'pictures')
    assert code == 3
    assert out.count('picture: ') == runs


def test_ros1_attack_given_a_topic_that_ends_early_then_only_what_reads_it_is_incomplete(tmp_path):
    bag = record(tmp_path / 'half', heard([BAD], keep=lambda message: (
        message.topic.name != '/ground_truth/odom' or message.stamp_ns < 6 * 10**9
    )))
    own = judge_runs(BAD)[0].verdicts[0]
    judged = judge_runs(bag, [own.spec, parse_spec('slow=always(speed <= 30)')])[0]
    assert judged.verdicts[0] == own
    assert judged.verdicts[1].verdict is BagVerdict.INCOMPLETE
    assert 'ground_truth/odom: ends at 5.9 s, the run at 12 s' in judged.trouble


def test_ros1_attack_given_steps_that_come_twice_or_go_back_then_no_verdict_passes(
    tmp_path, taxinet
):
    messages = heard([GOOD])
    for name, logged, word in (
        ('twice', [one for message in messages for one in (message, message)], 'comes twice'),
        ('again', [*messages, *messages[400:500]], 'comes twice'),
        ('back', [*messages[:10], *messages[400:500], *messages[10:400], *messages[500:]],
         'comes behind'),
    ):
        bag = record(tmp_path / name, logged)
        code, out, _ = taxinet('monitor', bag)
        assert code == 3, name
        assert 'INCOMPLETE' in out
        assert word in out
        assert taxinet('doctor', bag)[0] == 3, name


def test_ros1_attack_given_absurd_stamps_then_info_names_them(tmp_path, taxinet):
    messages = heard([GOOD])
    odd = [*messages[:50], messages[50]._replace(stamp_ns=2 * 10**18), *messages[51:]]
    code, out, _ = taxinet('bag', 'info', record(tmp_path / 'odd', odd))
    assert code == 0
    assert 'more than a day: some stamps must be wrong' in out
    assert 'stamps go back by' in out


def test_ros1_attack_given_a_run_without_truth_then_doctor_calls_nothing_of_it_judged(
    tmp_path, taxinet
):
    keep = ('/scenario', '/run_status', '/monitor/verdict')
    bag = record(tmp_path / 'blind', heard([GOOD], keep=lambda m: m.topic.name in keep))
    _, out, _ = taxinet('doctor', bag)
    assert '0 steps, bit for bit' not in out


def test_ros1_attack_given_a_recording_cut_short_when_split_then_the_damage_is_said(
    both, tmp_path, taxinet
):
    file = tmp_path / 'cut.mcap'
    data = next(both.glob('*.mcap')).read_bytes()
    for size, expected, where in ((len(data) - 3000, 3, 1), (len(data) // 2, 2, 2)):
        file.write_bytes(data[:size])
        told = taxinet('bag', 'split', file, '--out', tmp_path / f'runs{size}')
        assert told[0] == expected
        assert 'at byte' in told[where]

"""The verdict: whose fault, where, how sure, what to do; and that it says no more than is known."""

import shlex
from dataclasses import replace
from pathlib import Path

import pytest
import typer

from taxinet_ros.cli.main import app
from taxinet_ros.core.verdict.judging import Judging
from taxinet_ros.study.why.verdict import (
    Blames,
    CauseEvidence,
    Evidence,
    Fault,
    Paired,
    actions,
    adjusted,
    fault_of,
    judge,
    trainable,
)
from taxinet_ros.trials.run_command import RunSettings

HELPS = Paired(words='dry', scenes=32, before=0, after=28, difference=0.875, low=0.69, high=0.95,
               p=7e-9)
HELPS_NOT = Paired(words='dry', scenes=20, before=9, after=10, difference=0.05, low=-0.1,
                   high=0.2, p=1.0)
WET = CauseEvidence(
    rank=1, words='rain of 37 % or more', inside='100 % of 18 runs, elsewhere 24 %', run_id='r1',
    bag=Path('found/r1'), blamed='dry', removed=0.69, without=HELPS,
    program=Path('why/cause-1.scenic'),
)
SETTINGS = RunSettings(
    perception='original', gains={'heading_gain': 1.1}, judging=Judging(specs=('phi_always',)))


def test_an_experiment_confirms_only_what_survives_holm_over_all_that_was_tested():
    by_chance = replace(HELPS_NOT, p=0.03, difference=0.2)
    causes = [CauseEvidence(rank=1, words='a', without=replace(HELPS_NOT, p=0.9), truth=HELPS),
              CauseEvidence(rank=2, words='b', without=replace(HELPS_NOT, p=0.5)),
              CauseEvidence(rank=3, words='c', without=by_chance)]
    found = adjusted(causes)
    assert [cause.without.p for cause in found] == pytest.approx([1.0, 1.0, 3 * 0.03])
    assert found[0].truth.p == pytest.approx(4 * HELPS.p)
    assert [cause.confirmed for cause in found] == [False, False, False]
    sentence = judge(evidence(blames=Blames(network=16), causes=found)).sentences[2]
    assert sentence.startswith('Not confirmed by an experiment')
    assert adjusted([CauseEvidence(rank=1, words='a')]) == (CauseEvidence(rank=1, words='a'),)


def evidence(**values) -> Evidence:
    usual = {
        'subject': 'found', 'network': 'original', 'controller': 'steering',
        'spec': 'phi', 'formula': 'always(abs(cte) <= 1.5)', 'judged': 60, 'failed': 28,
        'scenes': Path('why/scenes.scenic'), 'settings': SETTINGS, 'seed': 1_000_003,
    }
    return Evidence(**{**usual, **values})


@pytest.mark.parametrize(('values', 'fault'), [
    ({'judged': 0, 'failed': 0, 'others': {'INFRA_ERROR (timeout)': 3}}, Fault.BENCH),
    ({'failed': 0}, Fault.NOTHING),
    ({'blames': None}, Fault.UNCLEAR),
    ({'blames': Blames(unknown=4)}, Fault.UNCLEAR),
    ({'blames': Blames(network=2, unknown=3)}, Fault.UNCLEAR),
    ({'blames': Blames(network=3, unknown=3)}, Fault.NETWORK),
    ({'blames': Blames(network=16)}, Fault.NETWORK),
    ({'blames': Blames(controller=16)}, Fault.CONTROLLER),
    ({'blames': Blames(requirement=16)}, Fault.REQUIREMENT),
    ({'blames': Blames(network=8, controller=8)}, Fault.SEVERAL),
    ({'blames': Blames(network=16), 'unsatisfiable': 'no run can'}, Fault.REQUIREMENT),
])
def test_given_evidence_then_the_fault_is_what_it_shows(values, fault):
    found = evidence(**values)
    assert fault_of(found) is fault
    verdict = judge(found)
    assert verdict.fault is fault
    assert len(verdict.sentences) == 3
    assert all(sentence.endswith('.') and '  ' not in sentence for sentence in verdict.sentences)


def test_what_the_network_was_not_trained_in_is_said_first():
    outside = 'original was trained with camera wing; scenes here have camera nose'
    whose, *_ = judge(evidence(blames=Blames(network=16), outside=outside)).sentences
    assert whose.startswith(f'The network {outside}. The network original is at fault')
    passed, *_ = judge(evidence(failed=0, outside=outside)).sentences
    assert outside not in passed


def test_given_all_trials_pass_then_the_interval_is_that_of_clopper_and_pearson():
    whose, where, sure = judge(evidence(blames=Blames(network=16), causes=(WET,))).sentences
    # 1 - 0.025 ** (1 / 16) = 0.206 can be at fault otherwise.
    assert whose == (
        'The network original is at fault in the failures examined, not the controller: all 16 '
        'failed runs driven again '
        'with perfect estimates satisfy phi (95 % interval 79–100 %).'
    )
    assert 'rain of 37 % or more' in where
    assert '69 % of the error disappears in the same scene, dry' in where
    assert sure == (
        'Confirmed by an experiment: dry, 28 instead of 0 of 32 fresh scenes are satisfied: '
        '+88 points (+69 to +95, p < 0.001).'
    )


def test_given_an_experiment_without_effect_then_nothing_is_confirmed():
    cause = CauseEvidence(rank=1, words='rain', without=HELPS_NOT)
    assert cause.confirmed is False
    sure = judge(evidence(blames=Blames(network=16), causes=(cause,))).sentences[2]
    assert sure.startswith('Not confirmed by an experiment: dry, 10 instead of 9 of 20')
    same = replace(HELPS_NOT, after=HELPS_NOT.before)
    assert same.sentence().startswith('dry, still 9 of 20 fresh scenes are satisfied: ')


def test_given_no_experiment_then_the_reason_is_said():
    found = evidence(blames=Blames(network=2), troubles={'confirm': 'the runs had latencies'})
    assert judge(found).sentences[2] == 'No experiment confirms it: the runs had latencies.'


def test_given_several_faults_then_each_has_its_share():
    whose = judge(evidence(blames=Blames(network=6, controller=3, requirement=1))).sentences[0]
    assert 'Of 10 failed runs' in whose
    for part in ('6 satisfy phi then: the network', '3 violate it too: the controller',
                 '1 were violated at their first sample'):
        assert part in whose


def test_given_one_run_then_there_is_no_interval():
    whose = judge(evidence(judged=1, failed=1, single=True, blames=Blames(network=1))).sentences[0]
    assert 'the failed run, driven again with perfect estimates, satisfies phi.' in whose


def todo(found: Evidence, **options):
    usual = {'campaign': Path('found'), 'kept_bags': True}
    return tuple(actions(found, fault_of(found), **{**usual, **options}))


@pytest.mark.parametrize('found', [
    evidence(blames=Blames(network=4), causes=(WET,)),
    evidence(blames=Blames(network=4), causes=(WET,), network='my net.onnx'),
    evidence(blames=Blames(controller=4), causes=(WET,)),
    evidence(blames=Blames(controller=4), causes=(WET,), network='truth', controller='hold_short'),
    evidence(blames=Blames(requirement=4), causes=(WET,)),
    evidence(blames=Blames(network=1, controller=1, requirement=1), causes=(WET,)),
    evidence(failed=0),
    evidence(judged=0, failed=0),
])
def test_every_command_that_is_suggested_is_one_that_taxinet_takes(found):
    commands = [line for action in todo(found) for line in action.commands]
    assert commands
    for line in commands:
        program, *words = shlex.split(line)
        assert program == 'taxinet'
        name, *rest = words
        command = typer.main.get_command(app).commands[name]
        assert command.make_context(name, rest).params  # a UsageError of click if it does not


def test_given_the_networks_fault_then_it_is_trained_along_the_failed_runs():
    (train,), (compare,) = (
        action.commands for action in todo(evidence(blames=Blames(network=4), causes=(WET,))))
    assert train == (
        'taxinet train training_full --start original --add why/cause-1.scenic=2400 --add-runs '
        'found=4000 --epochs 8 --learning-rate 0.001 --out original-fixed.safetensors'
    )
    assert compare == (
        'taxinet compare original original-fixed.safetensors why/cause-1.scenic --seed 1000003 '
        '--spec phi_always --set steering.heading_gain=1.1'
    )


def test_given_scenes_for_another_shipped_network_then_that_one_is_tried_before_any_training():
    found = evidence(
        blames=Blames(network=4), outside='original was trained with place kmwh_04',
        elsewhere='anywhere')
    first, train, _ = steps = todo(found)
    assert [one.heading for one in steps] == ['What to do', 'Step 2', 'Step 3']
    assert 'The network anywhere was trained for such scenes' in first.sentences[0]
    assert first.commands == (
        'taxinet compare original anywhere why/scenes.scenic --seed 1000003 --spec phi_always '
        '--set steering.heading_gain=1.1',
    )
    assert train.commands[0].startswith('taxinet train ')
    camera = replace(SETTINGS, world='kmwh+sunny')
    assert 'anywhere' not in todo(replace(found, settings=camera))[0].sentences[0]


@pytest.mark.parametrize(('world', 'words', 'command'), [
    ('salt_lake', 'not of world salt_lake', None),
    ('kmwh+sunny', 'not those of camera sunny', 'taxinet dataset why/cause-1.scenic --count 2400 '
     '--camera sunny --out pictures-cause-1'),
])
def test_given_pictures_that_train_cannot_render_then_that_is_said(world, words, command):
    found = evidence(
        blames=Blames(network=4), causes=(WET,), settings=replace(SETTINGS, world=world))
    (action,) = todo(found)
    assert words in action.sentences[0]
    assert action.commands[:1] == (() if command is None else (command,))
    assert ['taxinet compare original original-fixed.safetensors why/cause-1.scenic' in one
            for one in action.commands[1:]] == [True] * (command is not None)


def test_given_no_bag_of_a_failed_run_then_no_picture_along_its_path_is_suggested():
    first = todo(evidence(blames=Blames(network=4), causes=(WET,)), kept_bags=False)[0]
    assert '--add-runs' not in first.commands[0]
    assert 'bags of the failed runs are gone' in first.sentences[0]


def test_given_the_controllers_fault_then_no_training_is_suggested():
    lines = [
        line for action in todo(evidence(blames=Blames(controller=4), causes=(WET,)))
        for line in action.commands
    ]
    assert not any(' train ' in line for line in lines)
    assert 'taxinet run --from found/r1 --perception truth' in lines


def test_given_runs_driven_by_the_truth_then_nothing_is_suggested_that_they_were():
    settings = replace(SETTINGS, perception='truth', controller='hold_short', gains={})
    change, = (
        action for action in todo(evidence(
            blames=Blames(controller=4), causes=(WET,), network='truth', controller='hold_short',
            settings=settings,
        )) if action.heading == 'What to do')
    assert change.sentences == ('Change the controller hold_short or what it has to resist.',)
    assert not change.commands


@pytest.mark.parametrize(('network', 'trained'), [
    ('original', True), ('a/net.safetensors', True), ('net.onnx', False),
    ('mine.py:look', False), ('cmd:ros2 run me it', False),
])
def test_only_networks_of_taxinets_own_format_are_trained_further(network, trained):
    assert trainable(network) is trained

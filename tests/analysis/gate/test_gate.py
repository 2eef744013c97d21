"""A campaign held against thresholds, by exact binomial reasoning where that is possible."""

from __future__ import annotations

import dataclasses
import math
import re
import shlex
from pathlib import Path
from xml.etree import ElementTree

import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import binom

from taxinet_ros.analysis.gate.criteria import (
    GateOptions,
    Look,
    Verdict,
    bounds,
    further_runs,
    gate_result,
)
from taxinet_ros.analysis.gate.report import junit_xml, rerun_command, rerun_documents
from taxinet_ros.core.mtl import exact_intervals
from taxinet_ros.core.place import catalogue
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.verdict.outcome import Outcome
from taxinet_ros.errors import UsageError
from taxinet_ros.trials.rates import ProgramRate
from taxinet_ros.trials.record.row import RunRow
from taxinet_ros.trials.sample_size import fewest_runs

ALPHA = 0.05
LOOK = ALPHA / 2
"""What the look at the planned number of runs may spend; the rest is for all other looks."""


def row(index: int, outcome: Outcome, *, left: bool | None = False, **changes) -> RunRow:
    rho = {Outcome.PASS: {'phi': 0.5}, Outcome.FAIL: {'phi': -2.25}}.get(outcome, {})
    values = {
        'run_id': f'run-{index}', 'index': index, 'program': 's_falsif', 'seed': 1,
        'perception': 'original', 'wall_s': 2.0, **Scenario(heading_rad=0.1).to_human(),
        'robustness': exact_intervals(rho), 'left_runway': left if rho else None, **changes,
    }
    return RunRow(outcome=outcome, **values)


def rows(passed: int, failed: int, *, off: int = 0, **changes) -> list[RunRow]:
    outcomes = [Outcome.PASS] * passed + [Outcome.FAIL] * failed
    return [
        row(index, outcome, left=len(outcomes) - index <= off, **changes)
        for index, outcome in enumerate(outcomes)
    ]


def verdict(passed: int, runs: int, threshold: float) -> Verdict:
    return gate_result(
        rows(passed, runs - passed), GateOptions(min_satisfaction=threshold)).verdict


def counted(good: int, runs: int, *, anytime: bool = False) -> ProgramRate:
    return ProgramRate(runs=runs, hits=good, drawn=runs, drawn_hits=good, anytime=anytime)


@pytest.mark.parametrize(('runs', 'threshold'), [(100, 0.9), (72, 0.95), (40, 0.5), (200, 0.86)])
def test_given_as_many_passes_as_chance_seldom_gives_then_pass_and_with_one_less_not(
    runs, threshold
):
    # The least number that a system at the threshold reaches with 2.5 % at most: from the
    # distribution itself, and not by way of any interval.
    least = next(k for k in range(runs + 1) if binom.sf(k - 1, runs, threshold) <= LOOK)
    assert verdict(least, runs, threshold) is Verdict.PASS
    assert verdict(least - 1, runs, threshold) is Verdict.INCONCLUSIVE
    most = next(k for k in range(runs, -1, -1) if binom.cdf(k, runs, threshold) < LOOK)
    assert verdict(most, runs, threshold) is Verdict.FAIL
    assert verdict(most + 1, runs, threshold) is Verdict.INCONCLUSIVE


def test_given_no_failure_at_all_then_it_takes_72_runs_to_prove_95_per_cent():
    # 0.95 ** 72 < 0.025 < 0.95 ** 71
    assert verdict(72, 72, 0.95) is Verdict.PASS
    assert verdict(71, 71, 0.95) is Verdict.INCONCLUSIVE


def test_given_the_runway_then_the_largest_share_counts_and_not_the_smallest():
    options = GateOptions(max_off_runway=0.05)
    assert gate_result(rows(72, 0), options).verdict is Verdict.PASS
    assert gate_result(rows(71, 0), options).verdict is Verdict.INCONCLUSIVE
    answer = gate_result(rows(20, 40, off=30), options)
    assert answer.verdict is Verdict.FAIL
    found = answer.criteria[0].bounds
    assert found is not None
    assert 0.36 < found.low < found.share == 0.5 < found.high < 0.64


def test_given_several_criteria_then_one_that_fails_is_enough_and_one_open_keeps_it_open():
    both = GateOptions(min_satisfaction=0.5, max_off_runway=0.05)
    assert gate_result(rows(90, 10), both).verdict is Verdict.PASS
    assert gate_result(rows(90, 10, off=4), both).verdict is Verdict.INCONCLUSIVE
    assert gate_result(rows(10, 90, off=4), both).verdict is Verdict.FAIL


def test_given_a_broken_bench_then_it_is_counted_and_neither_passes_nor_fails():
    broken = [row(100 + number, Outcome.INFRA_ERROR, kind='died') for number in range(2)]
    strict = gate_result([*rows(90, 10), *broken], GateOptions(min_satisfaction=0.5))
    assert (strict.verdict, strict.criteria[-1].verdict) == (Verdict.INCONCLUSIVE, Verdict.FAIL)
    assert strict.criteria[-1].name == 'runs broken by the bench: at most 0'
    assert (strict.judged, strict.counts[Outcome.INFRA_ERROR]) == (100, 2)
    assert '2 runs were broken by the bench and are in no share' in strict.criteria[-1].sentence
    nothing = gate_result(broken, GateOptions(min_satisfaction=0.95))
    assert nothing.verdict is nothing.criteria[0].verdict is Verdict.INCONCLUSIVE
    assert nothing.criteria[0].sentence == 'no run was judged: 72 runs, all good, would suffice'


def test_given_runs_without_a_result_then_the_reader_is_told():
    others = [row(7, Outcome.REJECTED), row(8, Outcome.INTERRUPTED)]
    answer = gate_result([*rows(5, 1), *others], GateOptions(min_satisfaction=0.5), planned=20)
    assert answer.notes == (
        '1 runs were rejected by the program and are in no share',
        '1 runs were interrupted and are in no share',
        '12 of 20 planned runs have no result',
        'the campaign has another number of runs than planned: its verdict and bounds hold at any '
        'number of runs; its share is biased, and no chance of passing can be claimed',
    )


def test_given_a_biased_sampler_then_only_what_the_program_itself_drew_counts():
    # A sampler that finds failures far more often than they are: 10 % of the draws fail, not half.
    chosen = rows(100, 100, sampler='ce')
    searched = [dataclasses.replace(one, drawn=one.index < 109) for one in chosen]
    answer = gate_result(searched, GateOptions(min_satisfaction=0.8))
    assert answer.verdict is Verdict.PASS
    assert answer.criteria[0].bounds is not None
    assert answer.criteria[0].bounds.share == pytest.approx(100 / 109)
    assert (answer.judged, answer.effective) == (200, 109)
    assert 'shares refer to the 109 of 200 runs drawn by the program itself' in answer.notes[0]


@pytest.mark.one_in(3)
@pytest.mark.parametrize('sampler', ['ce', 'mab', 'bo', 'halton', 'grid'])
def test_given_a_search_without_draws_then_it_is_inconclusive_and_never_a_pass(sampler):
    for drawn in (None, False):
        searched = rows(1000, 0, sampler=sampler, weight=1.0, drawn=drawn)
        answer = gate_result(searched, GateOptions(min_satisfaction=0.01, max_off_runway=0.99))
        assert answer.verdict is Verdict.INCONCLUSIVE
        for criterion in answer.criteria[:2]:
            assert criterion.verdict is Verdict.INCONCLUSIVE
            assert criterion.sentence.startswith('no rate from this search: ' + sampler)
            assert 'floor=0.3' in criterion.sentence


def test_given_more_runs_than_were_planned_at_first_then_the_bounds_hold_at_any_number():
    # 0.95 ** 72 < 0.025: enough if 72 were planned, not if one looked before and went on.
    options = GateOptions(min_satisfaction=0.95)
    assert gate_result(rows(72, 0), options, planned=72).verdict is Verdict.PASS
    assert gate_result(rows(72, 0), options, planned=40).verdict is Verdict.INCONCLUSIVE
    assert gate_result(rows(72, 0), options, planned=100).verdict is Verdict.INCONCLUSIVE
    assert gate_result(rows(110, 0), options, planned=40).verdict is Verdict.PASS


def test_given_runs_stopped_too_early_for_the_runway_then_one_line_refuses():
    stopped = [row(0, Outcome.FAIL, left=None)]
    with pytest.raises(UsageError, match='1 of 1 runs were stopped too early'):
        gate_result(stopped, GateOptions(max_off_runway=0.1))
    assert gate_result(stopped, GateOptions(min_satisfaction=0.5)).judged == 1


@pytest.mark.parametrize(
    ('options', 'words'),
    [
        ({'min_satisfaction': 86}, 'min_satisfaction 86: a share'),
        ({'max_off_runway': -0.1}, 'max_off_runway -0.1: a share'),
        ({'max_off_runway': math.nan}, 'max_off_runway nan'),
        ({'min_satisfaction': 0.5, 'confidence': 95}, 'confidence 95: needs'),
        ({}, 'give a threshold'),
        ({'margin': 1.5}, 'margin 1.5: a share'),
        ({'margin': 0.1, 'look': Look.SEQUENTIAL}, 'baseline: not with sequential'),
    ],
)
def test_given_options_that_make_no_sense_then_one_line_says_so(options, words):
    with pytest.raises(UsageError, match=words) as error:
        GateOptions(**options)
    assert '\n' not in str(error.value)


@given(st.integers(0, 60), st.integers(0, 60), st.floats(0.5, 0.999))
def test_given_any_counts_then_the_share_is_within_bounds_that_more_confidence_widens(
    passed, failed, confidence
):
    runs = passed + failed
    for anytime in (False, True):
        found = bounds(counted(passed, runs, anytime=anytime), confidence)
        if not runs:
            assert math.isnan(found.share)
            assert (found.low, found.high) == (0.0, 1.0)
            continue
        assert found.low <= found.share <= found.high
        wider = bounds(counted(passed, runs, anytime=anytime), (1 + confidence) / 2)
        assert wider.low <= found.low
        assert found.high <= wider.high
        mirrored = bounds(counted(failed, runs, anytime=anytime), confidence)
        assert mirrored.low == pytest.approx(1 - found.high, abs=1e-9)


def test_given_a_share_at_the_threshold_then_no_number_of_runs_decides():
    assert further_runs(counted(1, 2), 0.5, 0.95) is None
    answer = gate_result(rows(5, 5), GateOptions(min_satisfaction=0.5))
    assert 'any realistic number of runs' in answer.criteria[0].sentence


def test_given_the_runs_that_are_said_to_be_missing_then_they_decide_and_fewer_do_not():
    more = further_runs(counted(45, 50), 0.86, 0.95)
    assert more is not None
    for runs, expected in ((50 + more, Verdict.PASS), (50 + more // 2, Verdict.INCONCLUSIVE)):
        good = math.ceil(0.9 * runs)
        answer = gate_result(
            rows(good, runs - good), GateOptions(min_satisfaction=0.86), planned=50)
        assert answer.verdict is expected
    sentence = gate_result(rows(45, 5), GateOptions(min_satisfaction=0.86)).criteria[0].sentence
    number = int(re.search(r'about ([\d,]+) more runs', sentence)[1].replace(',', ''))
    assert number == pytest.approx(more, rel=0.06)


@pytest.mark.parametrize(('runs', 'threshold'), [(300, 0.86), (37, 0.995), (120, 0.5)])
def test_given_a_system_at_the_threshold_then_it_passes_or_fails_as_seldom_as_promised(
    runs, threshold
):
    counts = range(runs + 1)
    found = [bounds(counted(k, runs), 0.95) for k in counts]
    chance = binom.pmf(counts, runs, threshold)
    wrongly = [
        sum(p for p, one in zip(chance, found, strict=True) if one.low >= threshold),
        sum(p for p, one in zip(chance, found, strict=True) if one.high < threshold),
    ]
    assert max(wrongly) <= LOOK
    assert max(wrongly) > LOOK / 10


# JUnit -------------------------------------------------------------------------------------------


def document(all_rows, options, *, passes=False) -> ElementTree.Element:
    answer = gate_result(all_rows, options)
    facts = {'program': 's_falsif.scenic', 'seed': 1, 'specs': {'phi': 'always(cte <= 1)'},
             'gains': {'heading_gain': 1.5}}
    data = junit_xml(all_rows, answer, Path('c d'), facts, inconclusive_passes=passes)
    assert data == junit_xml(all_rows, answer, Path('c d'), facts, inconclusive_passes=passes)
    return ElementTree.fromstring(data)


def test_given_a_campaign_then_each_criterion_is_a_test_case_and_each_run_a_property():
    broken = row(3, Outcome.INFRA_ERROR, kind='timeout', who='perception',
                 detail='a <b> & "c" \x00\x1b\ud800 \U0001f6e9')
    some = [row(0, Outcome.PASS), row(1, Outcome.FAIL, left=True, bag='run-1'),
            row(2, Outcome.FAIL), broken, row(4, Outcome.REJECTED, detail='no draw'),
            row(5, Outcome.INTERRUPTED)]
    root = document(some, GateOptions(min_satisfaction=0.9, max_off_runway=0.01))
    (suite,) = root.findall('testsuite')
    assert suite.attrib == {'name': 'c d', 'tests': '3', 'failures': '3', 'errors': '0',
                            'skipped': '0', 'time': '12.000'}
    cases = {case.get('name'): case for case in suite.findall('testcase')}
    assert list(cases) == [
        'satisfied >= 0.9', 'off the runway <= 0.01', 'runs broken by the bench: at most 0']
    names = properties(suite)
    assert (names['gate'], names['judged'], names['INFRA_ERROR']) == ('INCONCLUSIVE', '3', '1')
    assert [value for name, value in names.items() if name.startswith('run ')] == [
        'PASS: phi: rho +0.500', 'FAIL: phi: rho -2.250, off the runway', 'FAIL: phi: rho -2.250',
        'INFRA_ERROR: timeout perception a <b> & "c" \ufffd\ufffd\ufffd \U0001f6e9',
        'REJECTED: no draw', 'INTERRUPTED',
    ]
    against = properties(cases['satisfied >= 0.9'])
    assert list(against) == ['run run-1', 'run run-2']
    assert "; run run-1 again: taxinet run --from 'c d/run-1'" in against['run run-1']
    assert '--set crossing=on' in against['run run-2']
    assert list(properties(cases['off the runway <= 0.01'])) == ['run run-1']
    assert list(properties(cases['runs broken by the bench: at most 0'])) == ['run run-3']


def properties(case: ElementTree.Element) -> dict[str, str]:
    return {one.get('name'): one.get('value') for one in case.findall('properties/property')}


def test_given_a_failed_criterion_then_its_text_has_figures_worst_run_and_the_next_command():
    found = [row(n, Outcome.FAIL, robustness=exact_intervals({'phi': -1.0 - n % 7}))
             for n in range(40)]
    data = junit_xml(
        found, gate_result(found, GateOptions(min_satisfaction=0.9), folder='c d'), Path('c d'), {},
        inconclusive_passes=False, table=Path('t.parquet'))
    suite = ElementTree.fromstring(data)[0]
    assert properties(suite)['table'] == 't.parquet'
    case = suite.find('testcase')
    first, *runs, again, after = case.find('failure').text.splitlines()
    assert first.startswith('FAIL: 0.00 % of 40 runs are satisfied: at least 0.00 % and at most')
    assert runs[0] == 'run-6: phi: rho -7.000', 'the worst first'
    assert runs[10:] == ['and 30 more, in the properties']
    assert again.startswith('run run-6 again: taxinet run nominal --perception original')
    assert after == "next: taxinet why 'c d'"
    assert len(properties(case)) == 40


@pytest.mark.parametrize(('runs', 'options', 'command'), [
    (rows(45, 5), GateOptions(min_satisfaction=0.86), 'taxinet plan c --min-satisfaction 0.86'),
    (rows(45, 5), GateOptions(max_off_runway=0.01), 'taxinet plan c --max-off-runway 0.01'),
    (rows(0, 50, off=50), GateOptions(max_off_runway=0.01), 'taxinet why c'),
    ([row(0, Outcome.INFRA_ERROR)], GateOptions(min_satisfaction=0.1), ''),
])
def test_given_an_answer_then_the_next_command_fits_it(runs, options, command):
    first, *_, last = gate_result(runs, options, folder='c').criteria
    if command:
        assert first.next == command
        assert last.next == ''
    else:
        assert (last.verdict, last.next) == (Verdict.FAIL, 'taxinet doctor c')


def test_given_an_open_criterion_then_it_is_skipped_only_where_that_passes():
    open_ = rows(45, 5)
    for passes, kind in ((False, 'failure'), (True, 'skipped')):
        root = document(open_, GateOptions(min_satisfaction=0.86), passes=passes)
        case = root.find("testsuite/testcase[@classname='gate']")
        assert case.get('name') == 'satisfied >= 0.86'
        assert case.find(kind).get('message').startswith('INCONCLUSIVE: 90.00 % of 50 runs')


def test_given_a_run_without_a_bag_then_what_to_type_holds_its_scene():
    scene = Scenario(heading_rad=0.25, clouds='broken', rain_fraction=0.5, crossing=False)
    one = row(0, Outcome.FAIL, **scene.to_human())
    words = rerun_command(one, Path('c'), {'specs': {'phi': 'always(abs(cte) <= 1)'}})
    assert words.startswith('taxinet run nominal --perception original --spec ')
    assert "'phi=always(abs(cte) <= 1)'" in words
    for setting in (
        'rain_percent=50.0', 'clouds=broken', 'crossing=off', 'heading_deg=14.323944878',
    ):
        assert f'--set {setting}' in words
    assert '--controller' not in words
    assert '--controller mine.py:steer' in rerun_command(
        one, Path('c'), {'controller': 'mine.py:steer'}
    )


def test_given_any_setting_then_what_to_type_for_a_run_without_a_bag_has_it(tmp_path):
    place = tmp_path / 'mine.yaml'
    place.write_text((Path(catalogue.__file__).parent / 'shipped' / 'bikf_10.yaml').read_text())
    mine = catalogue.typed_place(str(place))
    scene = {**Scenario(clouds='broken').to_human(), 'place': mine.reference}
    words = shlex.split(rerun_command(row(0, Outcome.FAIL, **scene), Path('c'), {
        'world': 'salt_lake', 'gains': {'heading_gain': 1.25}, 'stop_on': 'violated',
        'specs': {'a': 'always((abs(cte) <= 1))', 'b': 'always((speed <= 9))'},
        'bounds': ['cte=-25:25', 'speed=0:9'], 'rates': ['cte=3'],
    }, Path('docs')))
    pairs = list(zip(words[3::2], words[4::2], strict=True))
    for pair in (
        ('--world', 'salt_lake'), ('--set', 'steering.heading_gain=1.25'),
        ('--spec', 'a=always((abs(cte) <= 1))'), ('--spec', 'b=always((speed <= 9))'),
        ('--stop-on', 'violated'), ('--bound', 'cte=-25:25'), ('--bound', 'speed=0:9'),
        ('--rate', 'cte=3'), ('--set', 'clouds=broken'),
        ('--set', f'place=docs/place-{mine.reference}.json'),
    ):
        assert pair in pairs
    graph = row(0, Outcome.FAIL, **{**scene, 'perception': ''})
    assert rerun_command(graph, Path('c'), {}) == '', 'it was started before the campaign'
    (name, text), = rerun_documents([row(0, Outcome.FAIL, **scene)], {}).items()
    assert (name, text) == (f'place-{mine.reference}.json', mine.document)
    (tmp_path / name).write_text(text)
    assert catalogue.typed_place(str(tmp_path / name)) == mine


def sequential(found: list[RunRow], *, rules: tuple[str, ...] = (), planned: int = 0, **changes):
    options = GateOptions(**{'min_satisfaction': 0.9, 'look': Look.SEQUENTIAL, **changes})
    return gate_result(found, options, planned=planned, rules=rules)


def test_given_a_sequential_gate_then_it_stands_by_the_first_decision():
    answer = sequential([*rows(60, 0), *(row(60 + n, Outcome.FAIL) for n in range(60))])
    assert answer.verdict is Verdict.PASS
    (met, _) = answer.criteria
    assert met.name == 'satisfied >= 0.9, sequential'
    assert met.course is not None
    assert met.course.runs == met.course.index + 1 < 60
    assert f'decided by run {met.course.index}' in met.sentence
    assert f'{120 - met.course.runs} runs came after the decision' in answer.notes[0]
    # The same runs in another order: what came first decides.
    fails_first = [row(n, Outcome.FAIL if n < 60 else Outcome.PASS) for n in range(120)]
    assert sequential(fails_first).verdict is Verdict.FAIL


def test_given_a_sequential_gate_then_the_runway_counts_those_off_it():
    answer = sequential(rows(90, 0), min_satisfaction=None, max_off_runway=0.1)
    assert answer.verdict is Verdict.PASS
    assert answer.criteria[0].name == 'off the runway <= 0.1, sequential'
    assert '0 of ' in answer.criteria[0].sentence
    both = sequential(rows(90, 0, off=1), max_off_runway=0.1)
    assert both.verdict is Verdict.PASS
    assert len(both.criteria) == 3


def test_given_runs_between_threshold_and_design_then_it_is_inconclusive_and_says_so():
    found = [row(n, Outcome.FAIL if n % 14 == 0 else Outcome.PASS) for n in range(600)]
    answer = sequential(found, design=0.99)
    assert answer.verdict is Verdict.INCONCLUSIVE
    assert 'not as good as the design, 0.99; whether the threshold is met stays open' in (
        answer.criteria[0].sentence
    )


@pytest.mark.parametrize(('rules', 'words'), [
    ((), 'the campaign ended otherwise than planned, before this test decided'),
    (('failures=1',), 'the campaign ended by --until failures=1, before this test decided'),
    (('min-satisfaction=0.9', 'half-width=0.2'), 'ended by --until half-width=0.2, before'),
])
def test_given_a_campaign_that_another_rule_ended_then_the_gate_says_what_it_cannot_claim(
    rules, words
):
    answer = sequential(rows(10, 0), rules=rules, planned=400)
    assert answer.verdict is Verdict.INCONCLUSIVE
    assert 'not decided yet: 10 of 10 runs are satisfied' in answer.criteria[0].sentence
    assert words in answer.notes[-1]
    assert 'cannot be claimed' in answer.notes[-1]
    own = sequential(rows(10, 0), rules=('min-satisfaction=0.9',), planned=400)
    assert not any('cannot be claimed' in note for note in own.notes)
    plain = gate_result(
        rows(10, 0), GateOptions(min_satisfaction=0.9), planned=400, rules=rules)
    assert 'its share is biased, and no chance of passing can be claimed' in plain.notes[-1]


def test_given_a_biased_sampler_then_a_sequential_gate_counts_the_draws_alone():
    chosen = [dataclasses.replace(one, drawn=one.index % 4 == 0) for one in rows(
        400, 0, sampler='active')]
    answer = sequential(chosen)
    assert answer.verdict is Verdict.PASS
    assert answer.criteria[0].course.runs * 4 - 3 == answer.criteria[0].course.index + 1
    none = [dataclasses.replace(one, drawn=False) for one in chosen]
    answer = sequential(none)
    assert answer.verdict is Verdict.INCONCLUSIVE
    assert answer.criteria[0].sentence.startswith('no rate from this search: active')


def test_given_the_planned_look_then_it_takes_the_runs_of_taxinet_plan_and_no_other_number():
    options = GateOptions(min_satisfaction=0.95, look=Look.PLANNED)
    enough = fewest_runs(0.05, 0.95)
    assert gate_result(rows(enough, 0), options, planned=enough).verdict is Verdict.PASS
    less = gate_result(rows(enough - 1, 0), options, planned=enough - 1)
    assert less.verdict is Verdict.INCONCLUSIVE
    assert 'more runs would need another campaign' in less.criteria[0].sentence
    for planned in (enough - 1, enough + 1):  # extended, or unfinished
        other = gate_result(rows(enough, 0), options, planned=planned)
        assert other.verdict is Verdict.INCONCLUSIVE
        assert 'are not the number that was planned' in other.criteria[0].sentence
    assert gate_result([], options).verdict is Verdict.INCONCLUSIVE


def test_given_a_sequential_gate_then_its_junit_has_the_criterion():
    answer = sequential(rows(3, 0))
    root = ElementTree.fromstring(
        junit_xml(rows(3, 0), answer, Path('c'), {}, inconclusive_passes=False))
    case = root.find('testsuite/testcase')
    assert case.get('name') == 'satisfied >= 0.9, sequential'
    assert case.find('failure').get('type') == 'INCONCLUSIVE'


@pytest.mark.parametrize(('changes', 'words'), [
    ({'min_satisfaction': 1.0}, 'no number of runs can decide it'),
    ({'design': 0.8}, 'needs to be better than the threshold 0.9'),
    ({'design': 0.95, 'max_off_runway': 0.1}, 'with one threshold only'),
    ({'design': 0.95, 'look': Look.ANY}, 'design: only with sequential'),
])
def test_given_a_sequential_gate_that_cannot_be_then_it_is_refused_by_name(changes, words):
    with pytest.raises(UsageError) as refused:
        sequential(rows(3, 0), **changes)
    assert words in str(refused.value)

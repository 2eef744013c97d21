"""Whatever a name of the front door is given, it answers with one line that names the parameter."""

from __future__ import annotations

import ast
import inspect
import math
import re
import subprocess
import sys
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import taxinet_ros as tx
from taxinet_ros.core.scenario import scenario_from_human
from taxinet_ros.core.world import ChosenWorld, SimulatedWorld

GOLDEN = Path(__file__).resolve().parents[2] / 'bags' / 'golden'
SHORT = tx.Scenario(duration_s=0.1)
RUBBISH = [
    None, 3, -1, 'x', '', 'a\0b', b'', [], {}, (1,), [None], object(), math.nan, True,
    pd.DataFrame({'a': [1]}), int, Path('no', 'such', 'file'), lambda: None,
]
RUN = tx.run(SHORT, specs='phi_always')
RECORDING = tx.open_recording(GOLDEN / 'truth-nominal')
STATE = dict.fromkeys(tx.AircraftState.__dataclass_fields__, 0.0)
CALLS = {
    'run': (tx.run, {'scenario': SHORT, 'specs': 'phi_always'}),
    'render': (tx.render, {'scenario': SHORT}),
    'robustness': (tx.robustness, {'spec': 'phi_always', 'trace': RUN.trace}),
    'load_perception': (tx.load_perception, {}),
    'load_aircraft': (tx.load_aircraft, {}),
    'load_camera': (tx.load_camera, {}),
    'load_forecast': (tx.load_forecast, {}),
    'load_place': (tx.load_place, {}),
    'load_sensors': (tx.load_sensors, {}),
    'load_traffic': (tx.load_traffic, {}),
    'open_recording': (tx.open_recording, {}),
    'open_campaign': (tx.open_campaign, {}),
    # No search is begun here, whatever else is right.
    'falsify': (tx.falsify, {'program': 'no/such.scenic', 'out': 'never'}),
    'estimate': (tx.estimate, {'program': 'no/such.scenic', 'out': 'never'}),
    'Scenario': (tx.Scenario, {}),
    'Spec.parse': (tx.Spec.parse, {}),
    'SteeringGains': (tx.SteeringGains, {}),
    'SteeringLaw': (tx.SteeringLaw, {}),
    'TrackingError': (tx.TrackingError, {'cte_m': 0.0, 'he_rad': 0.0}),
    'TaxiCommand': (tx.TaxiCommand, {'steering_rad': 0.0, 'speed_mps': 5.0}),
    'AircraftState': (tx.AircraftState, STATE),
    'Run.frame': (RUN.frame, {}),
    'compare': (tx.compare, {'before': '.', 'after': '.'}),
    'odd_coverage': (tx.odd_coverage, {'campaigns': '.', 'odd': 's_falsif'}),
    'evidence': (tx.evidence, {'campaigns': '.', 'out': 'never'}),
    'verify_evidence': (tx.verify_evidence, {'folder': '.'}),
    'fork': (tx.fork, {'run': RUN, 'at_s': 0.1}),
    'Run.fork': (RUN.fork, {'at_s': 0.1}),
    'Run.save_bag': (RUN.save_bag, {'path': 'saved'}),
    'Recording.judge': (RECORDING.judge, {'spec': 'phi_always'}),
    'Recording.table': (RECORDING.table, {}),
}
MADE_FOR_YOU = {'Campaign', 'Counterexample', 'Recording', 'Run', 'Spec'}
"""Their values come from functions; their methods are above."""
PYTHONS_OWN = {
    'Outcome', 'BagError', 'InfraError', 'RecordError', 'UsageError', 'UserCodeError',
}
"""An enum, whose members are named, and errors, which are caught."""
PARAMETERS = [
    (name, parameter) for name, (call, _) in CALLS.items()
    for parameter in inspect.signature(call).parameters
]


@pytest.mark.filterwarnings('ignore::UserWarning')
@pytest.mark.parametrize(('name', 'parameter'), PARAMETERS)
def test_given_rubbish_then_it_is_taken_or_refused_in_one_line(
    name, parameter, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    call, others = CALLS[name]
    lines = []
    for number, value in enumerate(RUBBISH):
        given = {**others, parameter: value}
        if name == 'Run.save_bag' and parameter == 'images':
            given['path'] = f'saved-{number}'
        try:
            call(**given)
        except (tx.UsageError, tx.BagError) as error:
            lines.append(str(error))
    assert len(lines) >= len(RUBBISH) // 2
    assert all(0 < len(line) < 700 and '\n' not in line for line in lines)
    assert not Path('never').exists()


def test_given_every_name_of_the_package_then_it_is_among_those_tried():
    tried = {name.partition('.')[0] for name in CALLS}
    assert set(tx.__all__) <= tried | MADE_FOR_YOU | PYTHONS_OWN


@pytest.mark.parametrize(('call', 'words'), [
    (lambda: tx.run(None), 'scenario: got None; expected a tx.Scenario'),
    (lambda: tx.run(SHORT, bounds='cte'), "bounds 'cte': expected SIGNAL="),
    (lambda: tx.run(SHORT, perception=lambda frame: (True, False)), 'perception: answered (True'),
    (lambda: tx.robustness('x <= 1', RUN.trace.assign(x=0.0)),
     'trace: columns x and distance_m both'),
    (lambda: tx.run(SHORT, bounds='he=-1:1'), 'bounds he: has no effect: no requirement reads he'),
    (lambda: tx.run(SHORT, latency=0.3), 'latency: got 0.3; expected a text or a list of texts'),
    (lambda: tx.run(SHORT, perception=tx.SteeringLaw), 'perception: the class SteeringLaw is'),
    (lambda: tx.run(SHORT, perception=lambda: None), 'perception: a function cannot be called'),
    (lambda: tx.robustness(RUN.trace, 'phi_always'), 'spec: got a DataFrame; expected a text or a'),
    (lambda: tx.robustness('phi_always', RUN), 'trace: got a Run; expected a pandas DataFrame'),
    (lambda: tx.render(SHORT, (1.0, 2.0)), 'pose: got a tuple; expected None, (x_m, '),
    (lambda: tx.render(SHORT, (1.0, math.inf, 0.0)), 'pose: got a tuple; expected'),
    (lambda: tx.SteeringLaw(None), 'gains: got None; expected a tx.SteeringGains'),
    (lambda: tx.TaxiCommand(steering_rad='0', speed_mps=5.0), "TaxiCommand: steering_rad: got '0'"),
    (lambda: tx.open_recording(None), 'path: got None; expected a path'),
    (lambda: tx.falsify(tx.run), 'program: got a function; expected a path'),
    (lambda: tx.falsify('s_falsif', runs=2.0), 'runs: got 2.0; expected a whole number from 1'),
    (lambda: RUN.frame('0'), "seq: got '0'; expected a whole number"),
])
def test_given_a_wrong_kind_then_the_line_names_the_parameter_and_both(call, words):
    with pytest.raises(tx.UsageError) as caught:
        call()
    assert str(caught.value).startswith(words)


@pytest.mark.parametrize(('call', 'words'), [
    (lambda: tx.run('phi_always', SHORT), 'takes 1 positional argument'),
    (lambda: tx.run(SHORT, free=True), "unexpected keyword argument 'free'"),
    (lambda: tx.open_recording(), "missing 1 required positional argument: 'path'"),
])
def test_given_arguments_that_a_function_does_not_have_then_python_says_so(call, words):
    with pytest.raises(TypeError, match=words):
        call()


def test_given_an_object_of_ones_own_then_its_methods_answer():
    class Eyes:
        needs_image = False

        def estimate(self, image, truth):
            assert image is None
            return truth

    class Hands:
        def command(self, estimate):
            return 0.0, 5.0

    run = tx.run(SHORT, perception=Eyes(), controller=Hands())
    assert run.perception == 'python'
    assert run.trace['est_cte_m'].equals(run.trace['cte_m'])
    Eyes.estimate = lambda self, image, truth: 'left'
    with pytest.raises(tx.UsageError, match="perception: answered 'left'; expected"):
        tx.run(SHORT, perception=Eyes())


@pytest.mark.parametrize(('call', 'words'), [
    (lambda: tx.run(SHORT, stop_on='tired'), 'stop_on tired: unknown'),
    (lambda: tx.run(SHORT, specs=['usable', 'usable']), 'specs: usable is given twice'),
    (lambda: tx.run(SHORT, specs='no.yaml'), 'specs no.yaml: cannot be read'),
    (lambda: tx.falsify('s_falsif', resume=True), 'resume: name the campaign to continue as out'),
    (lambda: tx.falsify('s_falsif', until='tired'), 'until tired: expected'),
    (lambda: tx.falsify('s_falsif', workers=99), 'workers 99: needs to be within'),
    (lambda: tx.falsify('s_falsif', settings={'steering.x': 1}), 'steering.x: unknown'),
    (lambda: tx.falsify('s_falsif', out='no', resume=True), 'resume: no/campaign.db: no such'),
])
def test_given_what_cannot_be_then_the_line_speaks_of_parameters_not_of_options(
    call, words, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(tx.UsageError) as caught:
        call()
    assert str(caught.value).startswith(words)
    assert '--' not in str(caught.value)


SOURCES = [
    path for path in sorted(Path(tx.__file__).parent.rglob('*.py'))
    if 'cli' not in path.parts and path.name != 'commands.py'
]
COMMAND = re.compile(r'(taxinet|ros2|dask|{command}) [^;,]*')
OPTION = re.compile(r'(?<![\w-])--(?!ros-args|help)[a-z]')


def texts_with_options(source: str) -> list[str]:
    """Texts that speak of an option: sentences, and all that an error is made of."""
    tree = ast.parse(source)
    of_errors, aside = set(), set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Call) and ast.unparse(node.func).endswith('Error'):
            of_errors |= {*ast.walk(node)}
        if isinstance(node, ast.JoinedStr):
            aside |= {*node.values}
        if isinstance(node, ast.Expr):  # a docstring
            aside.add(node.value)
    found = []
    for node in ast.walk(tree):
        if node in aside or not isinstance(node, ast.Constant | ast.JoinedStr):
            continue
        text = ast.literal_eval(node) if isinstance(node, ast.Constant) else ''.join(
            one.value if isinstance(one, ast.Constant) else
            f'{{{one.value.id}}}' if isinstance(one.value, ast.Name) else '{}'
            for one in node.values
        )
        if not isinstance(text, str):
            continue
        words = COMMAND.sub('', text)
        blames = node in of_errors and ('--{' in words or OPTION.search(words))
        if blames or (' ' in text.strip() and OPTION.search(words)):
            found.append(text)
    return found


def test_given_the_source_below_the_command_line_then_its_lines_name_no_options():
    assert len(SOURCES) > 300
    texts = {str(path): texts_with_options(path.read_text()) for path in SOURCES}
    assert {path: found for path, found in texts.items() if found} == {}


@pytest.mark.parametrize(('line', 'found'), [
    ("raise UsageError(f'--out {out}: exists')", ['--out {out}: exists']),
    ("raise UsageError(f'--{error}')", ['--{error}']),
    ("say('name another --out')", ['name another --out']),
    ("say('taxinet dataset --resume, or add --overwrite')",
     ['taxinet dataset --resume, or add --overwrite']),
    ("say('continue it: taxinet dataset --resume')", []),
    ("words += ['--out', 'x']", []),
])
def test_given_a_line_then_an_option_is_found_in_words_and_not_in_commands(line, found):
    assert texts_with_options(line) == found


TRACE = pd.DataFrame({
    't_s': [0.0, 1.0], 'gap': [2.0, 3.0], 'light': ['dusk', 'day'], 'always': [1.0, 1.0],
    'not a word': [1.0, 1.0], 'cte_m': [0.1, 0.2],
})


def test_given_a_column_without_numbers_then_it_is_named_and_not_unknown():
    with pytest.raises(tx.UsageError, match=r"light, which 'light > 0' reads, holds \w+, no"):
        tx.robustness('light > 0', TRACE)
    with pytest.raises(tx.UsageError, match=r"unknown 'night'; known: cte, t_s, gap, cte_m$"):
        tx.robustness('night > 0', TRACE)


def test_given_the_signals_that_are_known_then_a_formula_can_read_each():
    for name in ('cte', 't_s', 'gap', 'cte_m'):
        assert math.isfinite(tx.robustness(f'always({name} <= 9)', TRACE))


def test_given_a_signals_column_in_another_unit_then_it_is_refused():
    trace = RUN.trace.copy()
    trace.attrs['units'] = {**trace.attrs['units'], 'he_rad': 'deg'}
    assert tx.robustness('always(abs(cte) <= 1)', trace) > 0
    with pytest.raises(tx.UsageError, match='column he_rad is in deg; signal he is in rad'):
        tx.robustness('always(abs(he) <= 1)', trace)


@pytest.mark.parametrize(('columns', 'units', 'formula', 'words'), [
    (['x_m'], {'x_m': 'ft'}, 'always(x <= 1000)', 'column x_m is in ft; signal x is in m'),
    (['distance_m', 'x_m'], {'distance_m': 'km'}, 'x <= 1', 'column distance_m is in km; signal x'),
    (['cte', 'cte_m'], {'cte': 'ft'}, 'cte <= 1', 'column cte is in ft; signal cte is in m'),
    (['cte'], {'cte': 'ft'}, 'on_runway', 'column cte is in ft; signal cte is in m'),
    (['clearance_m'], {'clearance_m': 'ft'}, 'no_collision', 'column clearance_m is in ft'),
    (['clearance_m'], {'clearance_m': 'ft'}, 'collision <= 0', 'column clearance_m is in ft'),
    (['cte_m'], {'t_s': 'ms'}, 'phi_always', 'column t_s is in ms; signal t_s is in s'),
    (['gap'], {'gap': 'ft'}, 'gap <= 3', 'column gap is in ft; signal gap is in m'),
    (['wind'], {'wind': 'kt'}, 'wind <= 10 kt', 'column wind is in kt; signal wind is in m/s'),
    (['gap'], {'gap': 'm'}, 'gap <= 3 deg', r'expected a length \(m, .*\) to go with gap'),
    (['cte_m'], {}, 'cte <= 3 deg', r'expected a length \(m, .*\) to go with cte'),
    (['cte_m'], {}, 'cte_m <= 3 deg', r'expected a length \(m, .*\) to go with cte_m'),
])
def test_given_a_trace_in_other_units_then_what_is_read_in_them_is_refused_by_name(
    columns, units, formula, words
):
    table = pd.DataFrame({'t_s': [0.0, 1.0], **{name: [0.5, 1.0] for name in columns}})
    table.attrs['units'] = units
    with pytest.raises(tx.UsageError, match=words):
        tx.robustness(formula, table)


def test_given_a_trace_in_other_units_then_what_is_not_read_does_not_matter():
    table = pd.DataFrame({'t_s': [0.0, 1.0], 'x_m': [1.0, 2.0], 'cte_m': 0.5, 'light': 9.0})
    table.attrs['units'] = {'x_m': 'ft', 'light': 'lx'}
    assert tx.robustness('phi_always', table) == 1.0
    assert tx.robustness('always(light <= 10)', table) == 1.0
    assert tx.robustness('always(x <= 3)', table.assign(distance_m=1.0)) == 2.0


@pytest.mark.parametrize('numbers', [(1.0, math.nan), (math.inf, 0.0)])
def test_given_a_valid_estimate_that_is_not_finite_then_a_trace_has_none_as_a_bag_has(
    tmp_path, numbers
):
    seen = tx.TrackingError(cte_m=numbers[0], he_rad=numbers[1], valid=True)
    run = replace(RUN, steps=tuple(
        replace(step, estimate=seen) for step in RUN.steps
    ))
    run.save_bag(tmp_path / 'bag', images=False)
    recording = tx.open_recording(tmp_path / 'bag')
    for trace in (run.trace, recording.trace):
        assert not trace['est_valid'].any()
        assert trace[['est_cte_m', 'est_he_rad']].isna().all(axis=None)
        with pytest.raises(tx.UsageError, match='cte_estimate'):
            tx.robustness('always(abs(cte_estimate) <= 3)', trace)
    assert recording.judge('always(abs(cte_estimate) <= 3)').verdict == 'INVALID'


def test_given_a_bag_or_a_campaign_then_the_other_function_is_named(campaign_folder):
    with pytest.raises(tx.UsageError, match=r'a campaign, no bag; open it with tx\.open_campaign'):
        tx.open_recording(campaign_folder)
    with pytest.raises(tx.UsageError, match=r'a bag, no campaign; open it with tx\.open_recording'):
        tx.open_campaign(GOLDEN / 'truth-nominal')
    for open_it in (tx.open_campaign, tx.open_recording):
        with pytest.raises(tx.UsageError, match='nowhere: no such'):
            open_it(GOLDEN / 'nowhere')


def test_given_a_function_in_a_file_that_fails_then_its_error_can_be_caught_by_name(tmp_path):
    file = tmp_path / 'eyes.py'
    file.write_text('def look(frame):\n    raise ValueError("blind")\n')
    with pytest.raises(tx.UserCodeError, match=r'eyes\.py:2.*ValueError: blind'):
        tx.run(SHORT, perception=f'{file}:look')


def test_given_a_world_with_a_nan_then_the_run_says_what_could_not_be_judged(monkeypatch):
    class Torn(SimulatedWorld):
        def observe(self, *, picture=True):
            now = super().observe(picture=picture)
            return replace(now, state=replace(now.state, y_m=math.nan)) if now.seq else now

    torn = ChosenWorld(name='torn', fingerprint='', make=Torn)
    monkeypatch.setattr('taxinet_ros.api.run.find_world', lambda name: torn)
    run = tx.run(SHORT, specs='phi_always', world='torn')
    assert (run.outcome, run.detail) == (
        'INFRA_ERROR', 'phi_always reads cte, which is nan at 0.1 s'
    )
    assert run.detail in repr(run)


@pytest.mark.parametrize('name', ['read_bag', 'read_campaign'])
def test_given_an_example_without_its_argument_then_it_says_how_to_call_it(name):
    file = GOLDEN.parents[1] / 'examples' / f'{name}.py'
    done = subprocess.run([sys.executable, file], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (2, '')
    assert done.stderr.startswith(f'usage: {name}.py')
    assert len(done.stderr.splitlines()) == 1


@pytest.mark.parametrize('kind', [np.float32, np.float16, np.int64, Fraction, int])
def test_given_numbers_of_another_kind_then_a_run_is_to_the_bit_that_of_pythons_own(kind):
    one, two = kind(3.1), kind(5.1)

    def steer(estimate):
        return tx.TaxiCommand(steering_rad=kind(0), speed_mps=kind(estimate.cte_m + 2))

    def look(frame):
        return tx.TrackingError(cte_m=kind(2.6), he_rad=kind(0))

    def plainly(estimate):
        return 0.0, float(kind(estimate.cte_m + 2))

    for given, own in (
        ({'scenario': replace(SHORT, cross_track_m=one)},
         {'scenario': replace(SHORT, cross_track_m=float(one))}),
        ({'controller': steer}, {'controller': plainly}),
        ({'perception': look}, {'perception': lambda frame: (float(kind(2.6)), 0.0)}),
        ({'controller': tx.SteeringLaw(tx.SteeringGains(speed_mps=two))},
         {'controller': tx.SteeringLaw(tx.SteeringGains(speed_mps=float(two)))}),
    ):
        usual = {'scenario': SHORT, 'specs': 'phi_always'}
        run, expected = tx.run(**{**usual, **given}), tx.run(**{**usual, **own})
        assert len(run.trace) > 1
        assert run.trace.equals(expected.trace)
        assert repr(run.scenario) == repr(expected.scenario)


def test_given_gains_of_numpy_then_the_bag_of_the_run_is_read(tmp_path):
    law = tx.SteeringLaw(tx.SteeringGains(speed_mps=np.float32(5.1)))
    run = tx.run(SHORT, controller=law, specs='phi_always')
    saved = tx.open_recording(run.save_bag(tmp_path / 'saved', images=False))
    assert saved.trace['cte_m'].equals(run.trace['cte_m'])


@pytest.mark.parametrize('digits', [400, 5000])
@pytest.mark.parametrize('make', [
    lambda number: tx.Scenario(cross_track_m=number),
    lambda number: scenario_from_human({'cross_track_m': number}),
    lambda number: tx.TaxiCommand(steering_rad=number, speed_mps=5.0),
    lambda number: tx.TrackingError(cte_m=number, he_rad=0.0),
    lambda number: tx.render(SHORT, t_s=number),
])
def test_given_a_number_that_no_float_can_hold_then_it_is_refused_in_one_line(make, digits):
    with pytest.raises(tx.UsageError, match='a number') as caught:
        make(10 ** digits)
    assert len(str(caught.value)) < 200

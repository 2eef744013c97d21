"""Whatever a name of the front door is given, it answers with one line that names the parameter."""

from __future__ import annotations

import inspect
import math
from pathlib import Path

import pandas as pd
import pytest

import taxinet_ros as tx

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
    'open_recording': (tx.open_recording, {}),
    'open_campaign': (tx.open_campaign, {}),
    # No search is begun here, whatever else is right.
    'falsify': (tx.falsify, {'program': 'no/such.scenic', 'out': 'never'}),
    'Scenario': (tx.Scenario, {}),
    'Spec.parse': (tx.Spec.parse, {}),
    'SteeringGains': (tx.SteeringGains, {}),
    'SteeringLaw': (tx.SteeringLaw, {}),
    'TrackingError': (tx.TrackingError, {'cte_m': 0.0, 'he_rad': 0.0}),
    'TaxiCommand': (tx.TaxiCommand, {'steering_rad': 0.0, 'speed_mps': 5.0}),
    'AircraftState': (tx.AircraftState, STATE),
    'Run.frame': (RUN.frame, {}),
    'Run.save_bag': (RUN.save_bag, {'path': 'saved'}),
    'Recording.judge': (RECORDING.judge, {}),
    'Recording.table': (RECORDING.table, {}),
}
MADE_FOR_YOU = {'Campaign', 'Counterexample', 'Recording', 'Run', 'Spec'}
"""Their values come from functions; their methods are above."""
PYTHONS_OWN = {
    'Outcome', 'BagError', 'InfraError', 'UsageError', 'UserCodeError',
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
    (lambda: tx.run('phi_always', SHORT), 'run: too many positional arguments'),
    (lambda: tx.run(SHORT, free=True), 'run: free: needs the graph of nodes; type taxinet run'),
    (lambda: tx.run(SHORT, spec='phi_always'), 'run: spec: unknown; it takes scenario, perception'),
    (lambda: tx.run(SHORT, bounds='cte'), "bound 'cte': expected SIGNAL="),
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

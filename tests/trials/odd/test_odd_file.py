"""ODD files: what is a cell, what is inside, which combinations are feasible, and mistakes."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from taxinet_ros.core.scenario import Scenario, scenario_from_human
from taxinet_ros.errors import UsageError
from taxinet_ros.trials.odd.odd_file import OUTSIDE, UNKNOWN, find_odd, known_odds, read_odd
from taxinet_ros.trials.odd.openodd import binding_path, openodd_texts, openodd_values

PARAMETERS: dict[str, Any] = {
    'time_of_day': {'range': ['6:00', '18:00'], 'cells': 6},
    'clouds': {'values': ['clear', 'broken']},
    'rain': {'values': [0], 'range': [25, 100], 'cells': 3},
}


def odd_of(folder: Path, parameters: Any = None, **top: Any):
    """The ODD of a file with these values."""
    path = folder / 'odd.yaml'
    values = {'name': 'test', 'parameters': parameters or PARAMETERS, **top}
    given = {key: one for key, one in values.items() if one != ''}
    path.write_text(yaml.safe_dump(given, sort_keys=False))
    return read_odd(path)


def test_given_each_shipped_odd_when_read_then_the_usual_scene_of_its_program_has_a_place():
    assert 's_falsif' in known_odds()
    for name in known_odds():
        odd = read_odd(find_odd(name))
        assert odd.name == name
        assert odd.source
        assert all(one.source for one in odd.parameters)
        assert UNKNOWN not in odd.place(Scenario().to_human())


def test_given_the_odd_of_s_falsif_then_its_combinations_are_those_counted_by_hand():
    odd = read_odd(find_odd('s_falsif'))
    assert odd.sizes == (6, 6, 4, 4, 5, 4)
    # 9 pairs are excluded (three skies, three rains), with each of the 19 cells of the other four.
    counts = {t: sum(int(mask.sum()) for mask in odd.feasible(t).values()) for t in (1, 2, 3)}
    assert counts == {1: 29, 2: 348 - 9, 3: 2212 - 9 * 19}


def test_given_numbers_when_placed_then_a_cell_has_its_lower_end_and_the_last_one_both(tmp_path):
    hours, _, rain = odd_of(tmp_path).parameters
    assert [cell.label for cell in hours.cells][:2] == ['06:00 to 08:00', '08:00 to 10:00']
    assert [hours.place(one) for one in (6, 7.99, 8, 17.9, 18, 18 + 1e-9)] == [0, 0, 1, 5, 5, 5]
    assert [hours.place(one) for one in (5.9, 18.1, float('nan'))] == [OUTSIDE, OUTSIDE, UNKNOWN]
    assert [cell.label for cell in rain.cells] == ['0 %', '25 to 50 %', '50 to 75 %', '75 to 100 %']
    assert [rain.place(one) for one in (0, 10, 25, 50, 100)] == [0, OUTSIDE, 1, 2, 3]


def test_given_units_when_read_then_numbers_are_converted_as_after_set(tmp_path):
    odd = odd_of(tmp_path, {
        'distance': {'range': [0, '1200 m'], 'unit': 'km', 'cells': 2},
        'wind_speed': {'edges': [0, 10, 20], 'unit': 'kt'},
        'heading_deg': {'range': ['-0.1 rad', '0.1 rad'], 'cells': 1},
        'crossing': {'values': [True, False]},
    })
    distance, wind, heading, crossing = odd.parameters
    assert [(cell.low, cell.high) for cell in distance.cells] == [(0, 600), (600, 1200)]
    assert wind.ends[1] == pytest.approx(20 * 1852 / 3600)
    assert heading.ends == pytest.approx((-5.729578, 5.729578))
    assert [crossing.place(one) for one in (True, 'False', '')] == [0, 1, UNKNOWN]
    assert [cell.label for cell in crossing.cells] == ['crossing on', 'crossing off']


def test_given_an_exclusion_then_its_scenes_are_outside_and_the_reason_is_there(tmp_path):
    odd = odd_of(tmp_path, exclude=[
        {'when': {'clouds': 'clear', 'rain': [25, 60]}, 'why': 'no rain from a clear sky'},
    ])
    scene = {'time_of_day_h': 7.0, 'clouds': 'clear', 'rain_percent': 30.0}
    assert odd.inside(scene) is None
    assert odd.excluded_by(scene).why == 'no rain from a clear sky'
    assert odd.excluded_by(scene).text == 'clouds clear, rain 25 to 60 %'
    assert odd.inside({**scene, 'clouds': 'broken'}) == (0, 1, 1)
    assert odd.inside({**scene, 'rain_percent': 61.0}) == (0, 0, 2)
    # 50 to 75 % is only partly excluded, and so feasible.
    assert odd.feasible(2)[1, 2].tolist() == [[True, False, True, True], [True] * 4]


@st.composite
def _boxes(draw) -> list[dict[str, Any]]:
    found = []
    for _ in range(draw(st.integers(0, 3))):
        when: dict[str, Any] = {}
        if draw(st.booleans()):
            when['time_of_day'] = draw(st.sampled_from([[6, 8], [6, 12], [7, 18], [10, 18]]))
        if draw(st.booleans()):
            when['clouds'] = draw(st.sampled_from(['clear', 'broken']))
        if draw(st.booleans()) or not when:
            when['rain'] = draw(st.sampled_from([0, [25, 50], [25, 100], [40, 90]]))
        found.append({'when': when, 'why': 'planted'})
    return found


@settings(max_examples=20)
@given(exclude=_boxes())
def test_given_any_exclusions_then_feasible_is_what_trying_all_cells_finds(
    tmp_path_factory, exclude
):
    try:
        odd = odd_of(tmp_path_factory.mktemp('odd'), exclude=exclude or '')
    except UsageError as error:
        words = str(error)
        assert 'is excluded with all else' in words or 'nothing of the ODD is left' in words
        return
    whole = []
    for cells in itertools.product(*map(range, odd.sizes)):
        named = {number: odd.parameters[number].cells[one] for number, one in enumerate(cells)}
        if not any(box.removes(named) for box in odd.exclusions):
            whole.append(cells)
    for t in (1, 2, 3):
        for each, mask in odd.feasible(t).items():
            brute = np.zeros(mask.shape, dtype=bool)
            for cells in whole:
                brute[tuple(cells[one] for one in each)] = True
            assert (mask == brute).all()


MISTAKES = [
    ({'rayn': {'values': [0]}}, {}, r'odd.yaml: parameters\.rayn: unknown key; known: cross_track'),
    ({'rain': {'range': [0, 50]}, 'rain_percent': {'values': [60]}}, {}, 'are the same'),
    ({'rain': {}}, {}, r'parameters\.rain: expected a range, edges or values'),
    ({'rain': {'range': [50, 50]}}, {}, r'rain\.range: 50 % does not lie above 50 %'),
    ({'rain': {'range': [50, 20]}}, {}, r'rain\.range: 20 % does not lie above 50 %'),
    ({'rain': {'range': [0, 120]}}, {}, r'rain\.range: rain_percent is 120, outside 0\.\.100 %'),
    ({'rain': {'range': [0, 5], 'unit': 'm'}}, {}, r"rain_percent needs a number in %, got '0 m'"),
    ({'rain': {'range': [0, 5], 'cells': 0}}, {}, r'rain\.cells: expected a whole number, 1 to 50'),
    ({'rain': {'values': [0], 'cells': 2}}, {}, r'rain\.cells: has no effect without a range'),
    ({'rain': {'range': [0, 9], 'edges': [0, 5, 8]}}, {}, 'do not begin and end with the range'),
    ({'rain': {'edges': [0, 5], 'cells': 2}}, {}, 'edges are the cells already'),
    ({'rain': {'values': [30], 'range': [0, 50]}}, {}, r'rain\.values: 30 % is in two cells'),
    ({'rain': {'range': [0, 1, 2]}}, {}, 'expected two numbers; edges may be more'),
    ({'time_of_day': {'range': [360, 1080]}}, {}, r"outside 0\.\.24.*put a time in '…' quotes"),
    ({'clouds': {'range': [0, 5]}}, {}, r'clouds\.range: clouds is no number; use values'),
    ({'clouds': {'values': ['blue']}}, {}, r"clouds\.values: clouds is 'blue', not one of clear"),
    ({'place': {'values': ['nowhere']}}, {}, r'place\.values: .*nowhere'),
    ({'rain': {'values': [0], 'colour': 'red'}}, {}, r'rain\.colour: unknown key; known: range'),
    ({}, {'name': ''}, r"odd.yaml: the key 'name' is missing"),
    ({}, {'exclude': [{'when': {'wind': 3}, 'why': 'x'}]},
     r'exclude\[0\]\.when\.wind: is no parameter of this ODD; known: time_of_day_h, clouds'),
    ({}, {'exclude': [{'when': {'clouds': 'overcast'}, 'why': 'x'}]},
     r'when\.clouds: overcast is none of its values'),
    ({}, {'exclude': [{'when': {'rain': [5, 20]}, 'why': 'x'}]}, 'is outside its cells already'),
    ({}, {'exclude': [{'when': {'rain': [90, 80]}, 'why': 'x'}]}, '90 to 80 is empty'),
    ({}, {'exclude': [{'when': {'rain': 0, 'rain_percent': 0}, 'why': 'x'}]}, 'is given twice'),
    ({}, {'exclude': [{'when': {}, 'why': 'x'}]}, r'exclude\[0\]\.when: has no condition'),
    ({}, {'exclude': [{'when': {'rain': 0}}]}, "the key 'why' is missing"),
    ({}, {'exclude': [{'when': {'clouds': 'clear'}, 'why': 'x'}]},
     'exclude: clear of clouds is excluded with all else; leave it out of the parameter'),
]


@pytest.mark.parametrize(('parameters', 'top', 'message'), MISTAKES)
def test_given_a_mistake_then_one_line_names_the_file_and_the_key(
    tmp_path, parameters, top, message
):
    with pytest.raises(UsageError, match=message) as caught:
        odd_of(tmp_path, parameters, **top)
    assert '\n' not in str(caught.value)
    assert str(tmp_path / 'odd.yaml') in str(caught.value)


def test_given_an_unknown_odd_then_the_shipped_ones_are_named():
    with pytest.raises(UsageError, match='odd mine: no such file, and no shipped ODD; known: '):
        find_odd('mine')


def test_given_too_many_combinations_then_it_says_what_to_do(tmp_path):
    wide = {key: {'range': [0, 1], 'cells': 50} for key in (
        'loop_delay', 'loop_jitter', 'camera_freeze', 'gust', 'lens_dirt', 'wind_speed',
    )}
    with pytest.raises(UsageError, match='2,500,000 combinations of 3 cells, more than 1,000,000'):
        odd_of(tmp_path, wide).feasible(3)


def test_given_an_odd_when_exported_then_modules_have_its_ranges_and_exclusions(tmp_path):
    """Read by openodd-py 0.13.0, such a file judges as we do (docs/odd.md)."""
    odd = odd_of(tmp_path, exclude=[{'when': {'clouds': 'clear', 'rain': [25, 60]}, 'why': 'dry'}])
    written, binding = openodd_values(odd, 'out.yaml')
    assert written['TAXONOMY'] == {
        'time_of_day_h': 'float time', 'clouds': ['clear', 'broken'], 'rain_percent': 'float ratio',
    }
    modules = written['MODULES']
    assert modules['inside_odd']['INCLUDE_AND'] == {
        'time_of_day_h': '[6 .. 18] h', 'clouds': ['clear', 'broken'], 'rain_percent_any': True,
    }
    assert modules['inside_odd']['EXCLUDE_OR'] == {'excluded_1': True}
    assert modules['excluded_1']['INCLUDE_AND'] == {
        'clouds': ['clear'], 'rain_percent': '[25 .. 60] %',
    }
    assert modules['rain_percent_any']['INCLUDE_OR'] == {
        'rain_percent_1': True, 'rain_percent_2': True,
    }
    assert binding['probes']['rain_percent'] == {
        'probe': 'rain_percent', 'unit': '%', 'buckets': [25.0, 50.0, 75.0, 100.0],
    }
    assert [yaml.safe_load(text) for text in openodd_texts(odd, 'out.yaml')] == [written, binding]
    assert binding_path(Path('a/out.yaml')) == Path('a/out.binding.yaml')


@pytest.mark.parametrize(('word', 'value'), [('on', True), ('off', False)])
def test_given_a_switch_when_exported_then_openodd_has_a_truth_value(tmp_path, word, value):
    odd = odd_of(tmp_path, {'shadows': {'values': [word]}})
    written, _ = openodd_values(odd, 'out.yaml')
    assert written['MODULES']['inside_odd']['INCLUDE_AND'] == {'shadows': value}


def test_given_a_unit_that_openodd_lacks_when_exported_then_it_is_refused_by_name(tmp_path):
    odd = odd_of(tmp_path, {'exposure_jump': {'range': [-1, 1]}})
    with pytest.raises(UsageError, match='exposure_jump_ev: its unit EV is none of OpenODD'):
        openodd_values(odd, 'out.yaml')


def test_given_a_value_that_changes_then_a_scene_is_in_a_cell_only_if_it_stays_there(tmp_path):
    odd = odd_of(
        tmp_path, {'wind_speed': {'range': [0, 10], 'cells': 2}},
        exclude=[{'when': {'wind_speed': [7, 8]}, 'why': 'no figures'}],
    )
    for later, cells in (({}, (0,)), ({'wind_speed@5': 4}, (0,)), ({'wind_speed@5': 7}, (OUTSIDE,)),
                         ({'wind_speed@5': 12}, (OUTSIDE,))):
        scene = scenario_from_human({'wind_speed': 3, **later}).to_human()
        assert odd.place(scene) == cells
        assert (odd.inside(scene) is None) == (cells == (OUTSIDE,))
    passing = scenario_from_human({'wind_speed': 6, 'wind_speed@5': 7.5, 'wind_speed@9': 6})
    assert odd.place(passing.to_human()) == (1,)
    assert odd.inside(passing.to_human()) is None
    with pytest.raises(UsageError, match='unknown key'):
        odd_of(tmp_path, {'wind_speed@5': {'range': [0, 10]}})

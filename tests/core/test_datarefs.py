"""Values of X-Plane's variables in scenarios: read, carried, and refused where they do nothing."""

from __future__ import annotations

from pathlib import Path

import pytest

from taxinet_ros.core.camera.camera import Camera
from taxinet_ros.core.datarefs import find_datarefs, make_datarefs, split_name
from taxinet_ros.core.scenario import Scenario, scenario_from_human
from taxinet_ros.core.world import find_world
from taxinet_ros.errors import UsageError

TEXT = '{"sim/weather/region/thermal_rate_ms":2,"sim/weather/region/cloud_type":[1,0,0]}'


def test_a_scenario_has_none_by_default():
    assert dict(Scenario().dataref_values) == {}


def test_names_and_numbers_are_kept():
    found = scenario_from_human({'datarefs': TEXT})
    assert dict(found.dataref_values) == {
        'sim/weather/region/cloud_type': (1.0, 0.0, 0.0), 'sim/weather/region/thermal_rate_ms': 2.0,
    }
    assert found == scenario_from_human({'datarefs': found.datarefs})
    assert found.to_human()['datarefs'].startswith('datarefs@')


def test_a_file_of_them(tmp_path):
    path = tmp_path / 'thermals.yaml'
    path.write_text('sim/weather/region/thermal_rate_ms: 2\n')
    found = scenario_from_human({'datarefs': str(path)})
    assert dict(found.dataref_values) == {'sim/weather/region/thermal_rate_ms': 2.0}


@pytest.mark.parametrize(('text', 'words'), [
    ('{}', 'expected 1 to 64 datarefs, got 0'), ('{"rain": 1}', "'rain' is no name of a dataref"),
    ('{"sim/a": "x"}', "sim/a is 'x'; expected a finite number"),
    ('{"sim/a": 1e300}', 'expected a finite number'),
    ('{"sim/a": []}', 'expected a finite number'), ('{"sim/a": null}', 'expected a finite number'),
    ('{"sim/a": NaN}', 'expected a finite number'), ('{"sim/a"', 'neither a name nor JSON'),
    ('some', 'not one of none, nor a YAML file'), ('[1]', 'not one of none'),
])
def test_what_is_none(text, words):
    with pytest.raises(UsageError, match=words):
        scenario_from_human({'datarefs': text})


@pytest.mark.parametrize('name', ['rain', '', 'sim//rain', 'sim/rain[x]', 'sim/a b', 'sim/ä/b',
                                  f'sim/{"x" * 300}', 'sim/rain\n'])
def test_what_is_no_name(name):
    with pytest.raises(UsageError, match='is no name of a dataref'):
        split_name(name)


def test_too_many():
    with pytest.raises(UsageError, match='expected 1 to 64 datarefs, got 65'):
        make_datarefs({f'sim/test/{number}': 1 for number in range(65)}, Path('datarefs'))


def test_where_they_have_no_effect_they_are_refused_by_name():
    scene = scenario_from_human({'datarefs': TEXT})
    with pytest.raises(UsageError, match='our camera: sim/weather/region/cloud_type, sim/weather'):
        Camera(scene)
    for pictures in (True, False):
        with pytest.raises(UsageError, match=r'world kmwh: sim/weather/region/cloud_t.* would'):
            find_world('kmwh').make(scene, pictures=pictures)
    renderer = find_world('kmwh+xplane').renderer
    assert renderer is not None
    renderer.check(scene)


def test_none_has_a_name():
    assert find_datarefs('none').text == 'none'

"""X-Plane's variables in Scenic programs, under their own names."""

import pytest

from taxinet_ros.errors import UsageError
from taxinet_ros.scenes.source import SceneSource, sample_scenarios

HEAD = 'model runway_world\nego = new Plane at (0, 400)\n'
REGION = 'sim/weather/region/'


def test_given_any_datarefs_then_the_scene_has_them_beside_those_of_the_paper(write):
    text = (
        f"param '{REGION}thermal_rate_ms' = 2\n"
        f"param '{REGION}visibility_reported_sm' = Range(1, 10)\n"
        "param 'sim/weather/rain_percent' = 0.5\nparam 'sim/weather/cloud_type[0]' = 4\n"
        "param 'sim/flightmodel2/misc/custom_slider_ratio[3]' = 1\n"
    )
    (scene,) = sample_scenarios(write(HEAD + text), 3, 1)
    values = dict(scene.dataref_values)
    assert 1 <= values.pop(f'{REGION}visibility_reported_sm') <= 10
    assert values == {
        f'{REGION}thermal_rate_ms': 2.0, 'sim/flightmodel2/misc/custom_slider_ratio[3]': 1.0,
    }
    assert (scene.clouds, scene.rain_fraction) == ('overcast', 0.5)


def test_given_random_datarefs_then_they_are_dimensions(write):
    text = f"param '{REGION}a' = Range(1, 3)\nparam '{REGION}b' = Uniform(0, 5)\n"
    with SceneSource(write(HEAD + text), seed=1) as source:
        names = [dimension.name for dimension in source.space()]
        assert names == [f'{REGION}a', f'{REGION}b']
        low, high = (dict(source.scene(0, (share, share)).dataref_values)
                     for share in (0.0, 0.999999))
    assert low == {f'{REGION}a': 1.0, f'{REGION}b': 0.0}
    assert high == {f'{REGION}a': pytest.approx(3, abs=1e-5), f'{REGION}b': 5.0}


def test_given_set_datarefs_then_it_replaces_those_of_the_program(write):
    path = write(HEAD + f"param '{REGION}a' = 1\n")
    with SceneSource(path, seed=1, overrides={'datarefs': '{"sim/b/c": 2}'}) as source:
        assert dict(source.scene(0).dataref_values) == {'sim/b/c': 2.0}


@pytest.mark.one_in(3)
@pytest.mark.parametrize(('text', 'said'), [
    ("param 'sim/a b' = 1", "'sim/a b' is no name of a dataref"),
    (f"param '{REGION}a' = 'much'", f"{REGION}a is 'much'; expected a number"),
    (f"param '{REGION}a' = True", f'{REGION}a is True; expected a number'),
    (f"param '{REGION}a' = [1, 2]", 'has to be a number or a word'),
    (f"param '{REGION}a' = 1\nparam datarefs = 'none'", 'are the same; leave one out'),
    ("param 'laminar/B738/axis' = 1", 'unknown, so it has no effect'),
])
def test_given_what_no_dataref_can_be_then_it_is_refused(write, text, said):
    with pytest.raises(UsageError) as error:
        sample_scenarios(write(HEAD + text), 3, 1)
    assert said in str(error.value)

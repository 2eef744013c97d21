"""A program's random choices as a search space: their names, their priors, scenes at a point."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator
from pathlib import Path
from statistics import NormalDist
from typing import Any

import numpy as np
import pytest
from scipy.stats import chisquare, kstest

from taxinet_ros.errors import UsageError
from taxinet_ros.samplers.registry import make_sampler
from taxinet_ros.samplers.space import Branch, Dimension, Point
from taxinet_ros.scenes.programs import known_programs, shipped_folder
from taxinet_ros.scenes.search_space import Choice, SearchSpace
from taxinet_ros.scenes.source import Refused, SceneSource
from taxinet_ros.trials.search_summary import space_lines

WORLD = 'model runway_world\n'
PLANE = WORLD + 'ego = new Plane at (0, 400)\n'
Compile = Callable[[str], SearchSpace]
S_FALSIF = ['time_of_day_h', 'weather', 'weather[0].clouds', 'weather[1].clouds',
            'weather[1].rain_percent', 'ego.position.x', 'ego.position.y', 'ego.heading']


@pytest.fixture
def space_of(client: Any, write: Any) -> Compile:
    """Compile a text or a shipped program; its space."""
    def compile_text(text: str) -> SearchSpace:
        path = write(text) if '\n' in text else shipped_folder() / f'{text}.scenic'
        assert client.ask(op='compile', program=str(path))['named'] == []
        return SearchSpace.from_json(client.ask(op='space'))

    return compile_text


@pytest.fixture(scope='module')
def s_falsif() -> Iterator[SceneSource]:
    with SceneSource('s_falsif', seed=3) as source:
        yield source


def names(space: SearchSpace) -> list[str]:
    return [choice.dimension.name for choice in space.choices]


def at(client: Any, *point: float | None) -> dict[str, Any]:
    values: dict[str, Any] = client.ask(op='scene', index=0, point=list(point))['values']
    return values


def test_given_s_falsif_when_its_space_is_asked_then_every_choice_has_a_name_and_its_prior(
    s_falsif: SceneSource,
) -> None:
    space = s_falsif.space()
    assert [dimension.name for dimension in space] == S_FALSIF
    assert space[1].prior == pytest.approx((2 / 3, 1 / 3))
    assert space[2].prior == pytest.approx((1 / 6,) * 6)
    assert (space[6].low, space[6].high, space[6].discrete) == (0, 2000, False)
    assert s_falsif.search_space().unsearched == ()
    # Six features of the paper: rain is one only where it rains.
    assert {dimension.name: dimension.when for dimension in space if dimension.when} == {
        'weather[0].clouds': (Branch('weather', (0,)),),
        'weather[1].clouds': (Branch('weather', (1,)),),
        'weather[1].rain_percent': (Branch('weather', (1,)),),
    }
    points = [space.point(point) for point in np.random.default_rng(1).random((50, 8))]
    assert {sum(each is not None for each in point) for point in points} == {6, 7}


def test_given_a_point_when_a_scene_is_drawn_then_every_choice_is_at_its_quantile(
    s_falsif: SceneSource,
) -> None:
    wet = s_falsif.scene(0, (0.25, 0.7, None, 0.99, 0.2, 0.75, 0.7, 0.5))
    assert wet.to_human() == {
        **wet.to_human(), 'time_of_day_h': 9, 'clouds': 'stratus', 'rain_percent': 40,
        'cross_track_m': -4, 'distance_m': 1400, 'heading_deg': 0,
    }
    dry = s_falsif.scene(0, (0.25, 0.66, 0.17, None, None, 0.75, 0.7, 0.5))
    assert (dry.clouds, dry.rain_fraction) == ('cirrus', 0)


def test_given_a_point_when_scenes_without_one_follow_then_these_are_as_ever(
    s_falsif: SceneSource,
) -> None:
    before = [s_falsif.scene(index) for index in range(4)]
    middle = s_falsif.space().point([0.5] * 8)
    placed = [s_falsif.scene(index, middle) for index in range(4)]
    assert [s_falsif.scene(index) for index in range(4)] == before
    assert len(set(before)) == 4
    assert set(placed) == {placed[0]}, 'every choice is searched: the index decides nothing'


def test_given_uniform_points_when_scenes_are_drawn_then_they_follow_the_prior(
    s_falsif: SceneSource,
) -> None:
    points = np.random.default_rng(5).random((600, 8))
    scenes = [s_falsif.scene(0, s_falsif.space().point(point)) for point in points]
    wet = [scene for scene in scenes if scene.rain_fraction > 0]
    assert len(wet) == np.sum(points[:, 1] >= 2 / 3)
    rain = [scene.rain_fraction for scene in wet]
    assert kstest(rain, 'uniform', (0.25, 0.75)).pvalue > 1e-4
    assert kstest([s.distance_m for s in scenes], 'uniform', (0, 2000)).pvalue > 1e-4


DRY = (0.5, 0.5, 0.5, None, None, 0.5, 0.5, 0.5)


@pytest.mark.parametrize('point', [
    DRY[1:], (*DRY, 0.5), (*DRY[:7], 1.0), (*DRY[:7], -0.1), (0.5,) * 8, (None, *DRY[1:]),
])
def test_given_a_point_of_another_space_when_drawn_then_it_is_refused(
    s_falsif: SceneSource, point: Point,
) -> None:
    with pytest.raises(ValueError, match=r'dimensions|within|is idle|has no quantile'):
        s_falsif.scene(0, point)


def test_given_overrides_when_the_space_is_asked_then_choices_that_no_longer_count_are_left_out(
) -> None:
    overrides = {'clouds': 'overcast', 'rain': '0', 'time_of_day': '7'}
    with SceneSource('s_falsif', seed=3, overrides=overrides) as source:
        assert [dimension.name for dimension in source.space()] == S_FALSIF[5:]
        assert 'time_of_day_h (overridden)' in source.search_space().unsearched
        scene = source.scene(4, (0.75, 0.7, 0.5))
        assert (scene.clouds, scene.distance_m, scene.time_of_day_s) == ('overcast', 1400, 25200)


@pytest.mark.one_in(4)
@pytest.mark.parametrize('program', known_programs())
def test_given_a_shipped_program_when_its_space_is_asked_then_all_of_it_is_searched(
    client: Any, space_of: Compile, program: str,
) -> None:
    space = space_of(program)
    assert space.unsearched == ()
    assert 1 <= len(space.dimensions) <= 8
    corners = [at(client, *[end] * len(space.choices)) for end in (0.0, 1 - 2**-53)]
    assert corners[0] != corners[1]


def test_given_options_of_ranges_when_searched_then_they_are_one_range_from_left_to_right(
    client: Any, space_of: Compile,
) -> None:
    space = space_of(
        WORLD + 'y = Options({Range(500, 600): 3, Range(0, 100): 1})\nego = new Plane at (0, y)\n'
    )
    assert names(space) == ['y']
    (dimension,) = space.dimensions
    assert (dimension.low, dimension.high, dimension.discrete) == (0, 600, False)
    distances = [at(client, quantile)['distance_m'] for quantile in (0, 0.125, 0.25, 0.625)]
    assert distances == pytest.approx([0, 50, 500, 550])


def test_given_a_range_used_elsewhere_too_when_searched_then_it_keeps_its_own_dimension(
    client: Any, space_of: Compile,
) -> None:
    space = space_of(
        WORLD + 'a = Range(0, 100)\ny = Uniform(a, Range(200, 300))\n'
        'param rain = a\nparam clouds = "stratus"\nego = new Plane at (0, y)\n'
    )
    assert names(space) == ['rain', 'y', 'y[1]']
    values = at(client, 0.4, 0.2, 0.9)
    assert values['distance_m'] == values['rain_percent'] == pytest.approx(40)


def test_given_distributions_of_every_kind_when_placed_then_each_is_inverted(
    client: Any, space_of: Compile,
) -> None:
    space = space_of(
        'r = Range(0, 8)\n'
        'param rain = Range(0, r)\nparam time_of_day = Normal(12, 2)\n'
        'param date = TruncatedNormal(0, 1, -1, 3)\nparam duration = DiscreteRange(3, 6)\n'
        'param shadows = DiscreteRange(0, 1000)\n'
        'param aircraft = Uniform(*Uniform([1, 2], [3, 4, 5, 6]))\n' + PLANE
    )
    assert names(space) == ['rain', 'r', 'time_of_day', 'date', 'duration', 'shadows',
                            'aircraft', 'aircraft.2']
    assert [len(dimension.weights) for dimension in space.dimensions] == [0, 0, 0, 0, 4, 0, 2, 0]
    values = at(client, 0.5, 0.25, 0.9, 0.5, 0.99, 0.5, 0.6, 0.99)
    assert values['rain_percent'] == pytest.approx(1)
    assert values['time_of_day_h'] == pytest.approx(NormalDist(12, 2).inv_cdf(0.9))
    unit = NormalDist()
    middle = (unit.cdf(-1) + unit.cdf(3)) / 2
    assert values['date'] == pytest.approx(unit.inv_cdf(middle))
    assert (values['duration_s'], values['shadows'], values['aircraft']) == (6, 500, 6)
    lowest = at(client, *[0.0] * 8)
    assert math.isfinite(lowest['time_of_day_h'])
    assert lowest['date'] == pytest.approx(-1)


def test_given_a_requirement_when_a_point_breaks_it_then_it_is_rejected_and_not_replaced(
    tmp_path: Path,
) -> None:
    path = tmp_path / 'mine.scenic'
    path.write_text(WORLD + 'ego = new Plane at (Range(-1, 1), Range(0, 9))\n'
                            'require ego.position.x > 0.5\n')
    with SceneSource(path, seed=1) as source:
        assert source.scene(0, (0.8, 0.5)).cross_track_m == pytest.approx(-0.6)
        with pytest.raises(Refused) as caught:
            source.scene(0, (0.7, 0.5))
        assert str(caught.value) == 'mine.scenic: scene 0: the point does not meet the requirements'
        assert source.scene(0).cross_track_m < -0.5, 'without a point it draws until it holds'


def test_given_randomness_without_quantiles_when_searched_then_it_is_named_and_drawn_by_the_seed(
    client: Any, space_of: Compile,
) -> None:
    space = space_of(
        WORLD + 'param rain = Range(0, 9)\nunused = Range(0, 1)\n'
        'Odd = type("Odd", (RectangularRegion,), {})\nego = new Plane in Odd((0, 500), 0, 8, 10), '
        'with name unused\nrequire[0.9] ego.position.y > 100\n'
    )
    assert names(space) == ['rain', 'unused']
    assert space.choices[1].feeds == {'requirements'}, 'it hangs on the ego, which is judged'
    assert space.unsearched == ('ego.position (a point in Odd)',
                                'requirement on line 6 (holds in 90% of scenes)')
    first, again = at(client, 0.5, 0.5), at(client, 0.5, 0.5)
    other = client.ask(op='scene', index=1, point=[0.5, 0.5])['values']
    assert first == again
    assert first['rain_percent'] == other['rain_percent'] == 4.5
    assert first['distance_m'] != other['distance_m']


def test_given_choices_without_effect_when_searched_then_they_are_no_dimensions(
    space_of: Compile,
) -> None:
    space = space_of(WORLD + 'param rain = Range(0, 9)\n'
                             'ego = new Plane at (0, 400), with name Range(0, 1)\n')
    assert names(space) == ['rain']
    assert space.unsearched == ('ego.name (without effect)',)


def test_given_no_choice_when_the_space_is_asked_then_there_is_nothing_to_search(
    space_of: Compile,
) -> None:
    with pytest.raises(UsageError, match='no random choice'):
        _ = space_of(PLANE).dimensions


def test_given_words_of_verifai_when_searched_then_only_they_are_dimensions(
    client: Any, space_of: Compile,
) -> None:
    space = space_of(
        WORLD + 'param verifaiSamplerType = "ce"\n'
        'param time_of_day = Range(6, 18)\n'
        'param clouds = VerifaiOptions({"clear": 3, "overcast": 1})\n'
        'param rain = VerifaiParameter.withPrior(Normal(50, 1), buckets=4)\n'
        'param duration = VerifaiDiscreteRange(1, 3)\n'
        'ego = new Plane at (VerifaiRange(-2, 2), VerifaiRange(0, 900, weights=[2, 1, 1]))\n'
    )
    assert names(space) == ['clouds', 'rain', 'duration', 'ego.position.x', 'ego.position.y']
    assert space.unsearched == ('time_of_day (not marked for search)',)
    dimensions = space.dimensions
    assert dimensions[0].prior == (0.75, 0.25)
    assert [dimension.buckets for dimension in dimensions] == [5, 4, 5, 5, 3], 'VerifAI has 5'
    values = at(client, 0.8, 0.5, 0.9, 0.75, 0.25)
    hour = values.pop('time_of_day_h')
    assert hour == pytest.approx(at(client, *[0.1] * 5)['time_of_day_h'])
    assert values == pytest.approx({
        'clouds': 'overcast', 'rain_percent': 50, 'duration_s': 3, 'cross_track_m': -1,
        'distance_m': 150, 'heading_deg': 0,
    })


def test_given_weights_of_verifai_when_drawn_without_a_point_then_they_are_the_prior(
    client: Any, space_of: Compile,
) -> None:
    space_of(WORLD + 'ego = new Plane at (0, VerifaiRange(0, 900, weights=[2, 1, 1]))\n')
    scenes = [client.ask(op='scene', index=index)['values'] for index in range(400)]
    distances = [scene['distance_m'] for scene in scenes]
    counts, _ = np.histogram(distances, bins=(0, 300, 600, 900))
    assert counts.sum() == 400
    assert chisquare(counts, (200, 100, 100)).pvalue > 1e-4


def test_given_a_wrong_verifai_call_when_compiled_then_its_line_is_named(refused: Any) -> None:
    refused(PLANE + 'x = VerifaiRange(0, 1, buckets=3, weights=[1, 2])\n', 3,
            'ValueError: VerifaiRange has 2 weights, but 3 buckets')


def test_given_the_halton_program_when_searched_then_the_time_is_all_there_is(
    client: Any, space_of: Compile,
) -> None:
    assert names(space_of('halton_time_of_day')) == ['time_of_day_h']
    first, last = at(client, 0.0), at(client, 0.75)
    assert (first.pop('time_of_day_h'), last.pop('time_of_day_h')) == (6, 15)
    assert first == last
    assert first['clouds'] == 'clear'


def test_given_the_programs_after_s_falsif_when_placed_then_they_differ_where_they_say(
    client: Any, space_of: Compile,
) -> None:
    scenes = {}
    for program in ('s_falsif', 'crossing', 's_falsif_ce'):
        space_of(program)
        scenes[program] = at(client, 0.1, 0.9, 0.3, 0.4, 0.6, 0.7, 0.5, 0.8)
    assert scenes['s_falsif_ce'] == scenes['s_falsif']
    assert scenes['crossing'] == {**scenes['s_falsif'], 'distance_m': 1450}


def test_given_one_line_that_makes_several_choices_when_named_then_no_two_are_alike(
    space_of: Compile,
) -> None:
    space = space_of(PLANE + 'param rain = Range(0, 1) + Range(0, 2) + Range(0, 3)\n')
    assert names(space) == ['rain', 'rain.2', 'rain.3']
    places = [choice.place for choice in space.choices if choice.place]
    assert len(places) == 3
    assert all(a.end_column < b.column for a, b in itertools.pairwise(places))


def test_s9_given_choices_under_several_options_when_asked_then_each_way_there_is_known(
    client: Any, space_of: Compile,
) -> None:
    space = space_of(
        'from scenic.core.distributions import distributionFunction\n'
        '@distributionFunction\ndef dry(choice):\n    return 0\n'
        + WORLD + 'shared = Range(0, 9)\nonly = Range(0, 9)\nboth = Range(0, 9)\n'
        'inner = Uniform((only, 1), (shared, 2), 7)\n'
        'outer = Uniform((both, inner), (shared, 0), (0, 0))\n'
        'param rain = dry(outer)\nparam time_of_day = both\n'
        'ego = new Plane at (0, 400)\n'
    )
    when = {choice.dimension.name: choice.dimension.when for choice in space.choices}
    assert when == {
        'outer': (), 'inner': (Branch('outer', (0,)),),
        'only': (Branch('inner', (0,)),),
        'shared': (Branch('outer', (1,)), Branch('inner', (1,))),
        'time_of_day': (),
    }


def test_s9_given_a_choice_that_decides_but_is_not_searched_when_asked_then_its_options_count(
    space_of: Compile,
) -> None:
    space = space_of(
        WORLD + 'param rain = Uniform(VerifaiRange(0, 1), VerifaiRange(2, 3))\n'
        'ego = new Plane at (0, VerifaiRange(0, 100))\n'
    )
    assert [(name, choice.dimension.when) for name, choice in
            zip(names(space), space.choices, strict=True)] == [
        ('rain[0]', ()), ('rain[1]', ()), ('ego.position.y', ()),
    ]
    assert space.unsearched == ('rain (not marked for search)',)


def test_s9_given_an_override_when_a_choice_has_one_branch_left_then_it_hangs_on_that(
) -> None:
    def choice(name: str, feeds: set[str], **changes: Any) -> dict[str, Any]:
        dimension = {'name': name, 'weights': [], 'low': 0, 'high': 1, 'buckets': 10, **changes}
        return {'dimension': dimension, 'feeds': sorted(feeds), 'place': None, 'pieces': [],
                'options': None}

    answer = {'unsearched': [], 'drawn': [], 'soft': False, 'choices': [
        choice('a', {'clouds'}, weights=[1, 1]), choice('b', {'rain'}, weights=[1, 1]),
        choice('both', {'clouds', 'rain'}, when=[['a', [0]], ['b', [1]]]),
        choice('of a', {'clouds'}, when=[['a', [0]]]),
    ]}
    space = SearchSpace.from_json(answer, {'clouds'}).dimensions
    assert [(each.name, each.when) for each in space] == [
        ('b', ()), ('both', (Branch('b', (1,)),)),
    ]
    assert len(SearchSpace.from_json(answer).dimensions) == 4
    assert SearchSpace.from_json(answer).choices[2].dimension.when == (
        Branch('a', (0,)), Branch('b', (1,)),
    )


def test_s9_given_a_space_when_shown_then_conditions_and_what_is_not_searched_are_plain(
    s_falsif: SceneSource, space_of: Compile,
) -> None:
    assert space_lines(s_falsif.search_space()) == [
        'searched: time_of_day_h, weather, ego.position.x, ego.position.y, ego.heading; '
        'where weather is option 1: weather[0].clouds; '
        'where weather is option 2: weather[1].clouds, weather[1].rain_percent',
    ]
    sky = ('clear', 'cirrus', 'rain')
    a = Choice(dimension=Dimension(name='a', weights=(1, 1, 1)), options=sky)
    b = Choice(dimension=Dimension(name='b', when=(Branch('a', (0, 2)),)))
    assert space_lines(SearchSpace(choices=(a, b), unsearched=('c (Lottery)', 'd (fixed)'))) == [
        'searched: a; where a is clear or rain: b', 'drawn, not searched: c (Lottery), d (fixed)',
    ]


REGIONS = {
    'RectangularRegion((1, 500), 0, 6, 300)': (['across', 'along'], (0.25, 0.5), (-0.5, 500)),
    'CircularRegion((0, 400), 8)': (['radius', 'angle'], (0.25, 0.5), (4, 400)),
    'SectorRegion(0 @ 400, 8, 0, 1)': (['radius', 'angle'], (0.25, 0.5), (0, 404)),
    'PolygonalRegion([(0, 100), (8, 100), (8, 300), (0, 300)])': (
        ['x', 'y'], (0.25, 0.5), (2, 200)),
    'PolygonalRegion([(0, 0), (8, 0), (0, 800)])': (['x', 'y'], (0.75, 0.5), (4, 200)),
    'PolylineRegion([(0, 0), (0, 300), (4, 303)])': (['way'], (200 / 305,), (0, 200)),
    'PathRegion(points=[(0, 0, 0), (0, 300, 0), (4, 303, 0)])': (
        ['way'], (302.5 / 305,), (2, 301.5)),
    'PointSetRegion("p", [(1, 2, 0), (3, 4, 0)])': (['which'], (0.6,), (3, 4)),
}


@pytest.mark.parametrize('region', REGIONS)
def test_s7_given_a_region_when_searched_then_its_points_are_at_quantiles_of_its_own_sampling(
    client: Any, space_of: Compile, region: str,
) -> None:
    parts, quantiles, (x, y) = REGIONS[region]
    space = space_of(WORLD + f'ego = new Plane in {region}\n')
    assert names(space) == [f'ego.position.{part}' for part in parts]
    assert space.unsearched == ()
    values = at(client, *quantiles)
    assert (-values['cross_track_m'], values['distance_m']) == pytest.approx((x, y), abs=1e-9)
    for corner in itertools.product((0.0, 1 - 2**-53), repeat=len(parts)):
        assert math.isfinite(at(client, *corner)['distance_m'])


def test_s7_given_a_rectangle_along_the_runway_when_asked_then_its_values_are_known(
    space_of: Compile,
) -> None:
    space = space_of(WORLD + 'ego = new Plane in RectangularRegion((1, 500), 0, 6, 300)\n')
    across, along = space.choices
    assert (across.dimension.low, across.dimension.high) == (-2, 4)
    assert along.probability_within(350, 380) == pytest.approx(0.1)


def test_s7_given_a_region_without_quantiles_when_searched_then_random_draws_and_it_is_named(
    client: Any, space_of: Compile,
) -> None:
    space = space_of(
        WORLD + 'Odd = type("Odd", (RectangularRegion,), {})\n'
        'ego = new Plane in Odd((0, 500), 0, 8, 600)\n'
    )
    assert space_lines(space) == [
        'searched: nothing', 'drawn, not searched: ego.position (a point in Odd)',
    ]
    with pytest.raises(UsageError, match='ce: nothing that the program draws can be searched; '
                                         'sampler random draws as it does'):
        make_sampler('ce', space.dimensions, 0, 10)
    sampler = make_sampler('random', space.dimensions, 0, 10)
    points = [sampler.next() for _ in range(5)]
    assert {point for _, point in points} == {()}
    scenes = {client.ask(op='scene', index=index, point=space.spread(point))['values']['distance_m']
              for index, point in points}
    assert len(scenes) == 5

"""Learned probabilities as a Scenic program: it compiles, and it draws in these proportions."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from statistics import NormalDist
from typing import Any

import numpy as np
import pytest
from scenic_client import scenic_child
from scipy.stats import chisquare

from taxinet_ros.errors import UsageError
from taxinet_ros.scenes.programs import shipped_folder
from taxinet_ros.scenes.search_space import SearchSpace
from taxinet_ros.trials.learned_program import learned_program

WORLD = 'model runway_world\n'
N = 2000
Learn = Callable[..., str]


@pytest.fixture(scope='module')
def client() -> Iterator[Any]:
    with scenic_child() as started:
        yield started


@pytest.fixture
def learn(client: Any, tmp_path: Path) -> Learn:
    """Compiles a text, and writes it anew with probabilities."""
    def learn_text(text: str, probabilities: dict[str, list[float]], origin: str = 'Me.') -> str:
        path = tmp_path / 'mine.scenic'
        path.write_text(text)
        assert client.ask(op='compile', program=str(path))['named'] == []
        space = SearchSpace.from_json(client.ask(op='space'))
        return learned_program(path, space, probabilities, origin)[0]

    return learn_text


@pytest.fixture
def draw(client: Any, tmp_path: Path) -> Callable[..., list[dict[str, Any]]]:
    """Compiles a text and draws scenes of it."""
    def draw_text(text: str, n: int = N) -> list[dict[str, Any]]:
        path = tmp_path / 'learned.scenic'
        path.write_text(text)
        assert client.ask(op='compile', program=str(path))['named'] == []
        return [client.ask(op='scene', index=index)['values'] for index in range(n)]

    return draw_text


def assert_shares(counts: list[int], shares: list[float]) -> None:
    assert sum(counts) == N, 'a value lies outside'
    expected = np.array(shares) / sum(shares) * N
    assert [count for count, share in zip(counts, expected, strict=True) if not share] == \
        [0] * int(np.sum(expected == 0))
    seen = expected > 0
    assert chisquare(np.array(counts)[seen], expected[seen]).pvalue > 1e-4


@pytest.mark.nightly
def test_given_a_learned_s_falsif_when_drawn_then_its_histograms_are_the_learned_ones(
    learn: Learn, draw: Callable[..., list[dict[str, Any]]],
) -> None:
    paper = [.05, 0, 0, 0, 0, 0, .16, .78, .005, .005]  # as in section 3.4, 200 m each
    clouds, rain = [3.0, 1, 0, 0, 1, 1], [1.0] * 9 + [11]
    text = learn((shipped_folder() / 's_falsif.scenic').read_text(), {
        'ego.position.y': paper, 'weather': [.25, .75], 'weather[0].clouds': clouds,
        'weather[1].rain_percent': rain, 'ego.heading': [4, 1] * 5,
        'time_of_day_h': [0] * 9 + [1],
    })
    scenes = draw(text)
    distances = [scene['distance_m'] for scene in scenes]
    assert_shares(np.histogram(distances, 10, (0, 2000))[0].tolist(), paper)
    headings = [scene['heading_deg'] for scene in scenes]
    assert_shares(np.histogram(headings, 10, (-30, 30))[0].tolist(), [4, 1] * 5)
    dry = Counter(scene['clouds'] for scene in scenes if scene['rain_percent'] == 0)
    kinds = ('clear', 'cirrus', 'scattered', 'broken', 'overcast', 'stratus')
    wet_scenes = [s['rain_percent'] for s in scenes if s['rain_percent'] > 0]
    wet = np.histogram(wet_scenes, 10, (25, 100))[0].tolist()
    assert_shares([*(dry[kind] for kind in kinds), *wet],
                  [*(.25 * share / 6 for share in clouds), *(.75 * share / 20 for share in rain)])
    assert all(16.8 <= scene['time_of_day_h'] <= 18 for scene in scenes)
    offsets = [s['cross_track_m'] for s in scenes]
    assert_shares(np.histogram(offsets, 8, (-8, 8))[0].tolist(), [1] * 8)


def test_given_a_learned_program_when_read_then_it_is_the_old_one_with_other_numbers(
    learn: Learn,
) -> None:
    source = (shipped_folder() / 's_falsif.scenic').read_text()
    text = learn(source, {'ego.position.y': [1, 0, 0, 0, 0, 0, 0, 0, 0, 3]},
                 'Cross-entropy, 1200 runs.')
    head, _, rest = text.partition('\n"""\n')
    assert head.startswith('"""Cross-entropy, 1200 runs.\n\nLearned from mine.scenic, which says')
    assert 'The generic falsification scenario' in head
    old = source.partition('\n"""\n')[2]
    new = 'Options({Range(0, 200): 0.25, Range(1800, 2000): 0.75})'
    assert rest == old.replace('Range(0, 2000)', new)


def test_given_a_learned_program_when_learned_from_again_then_its_choices_have_their_names(
    client: Any, learn: Learn, draw: Callable[..., list[dict[str, Any]]],
) -> None:
    source = (shipped_folder() / 'runway_position.scenic').read_text()
    draw(learn(source, {'distance_m': [0, 1] * 5, 'time_of_day_h': [1, 2] * 5}), 1)
    again = [choice['dimension']['name'] for choice in client.ask(op='space')['choices']]
    learn(source, {})
    assert again == [choice['dimension']['name'] for choice in client.ask(op='space')['choices']]
    assert 'distance_m' in again


def test_given_weighted_ranges_when_learned_then_the_slices_of_the_prior_are_kept_apart(
    learn: Learn,
) -> None:
    # Quantile 0.5 lies in the middle of the second range; its two halves get different shares.
    text = learn(
        WORLD + 'y = Options({Range(0, 100): 1, Range(200, 400): 2, Range(500, 600): 1})\n'
        'ego = new Plane at (0, y)\n', {'y': [1, 0, 0, 0, 0, 0, 0, 0, 0, 0]},
    )
    assert 'y = Options({Range(0, 40): 1})\n' in text
    text = learn(WORLD + 'ego = new Plane at (0, VerifaiRange(0, 90, weights=[2, 1, 1]))\n',
                 {'ego.position.y': [1, 0, 3]})
    learned = 'Options({Range(0, 20): 0.25, Range(50, 60): 0.1875, Range(60, 90): 0.5625})'
    assert text.endswith(f'ego = new Plane at (0, {learned})\n')
    text = learn(WORLD + 'param rain = DiscreteRange(1, 130)\nego = new Plane at (0, 400)\n',
                 {'rain': [3] * 5 + [1] * 5})
    assert 'rain = Options({DiscreteRange(1, 65): 0.75, DiscreteRange(66, 130): 0.25})\n' in text


@pytest.mark.one_in(3)
@pytest.mark.parametrize(('text', 'probabilities', 'message'), [
    ('param rain = Range(0, Range(1, 2))', {'rain': [1] * 10},
     'mine.scenic:3: cannot be written back: rain has a call as its argument; give that a name'),
    ('r = Range(0, 1)\nparam rain = TruncatedNormal(r, 1, 0, 2)', {'rain': [1] * 10},
     'mine.scenic:4: cannot be written back: rain is a TruncatedNormal of what is drawn itself'),
    ('n = DiscreteRange(0, 9)\nparam rain = DiscreteRange(0, n)', {'rain': [1] * 10},
     'mine.scenic:4: cannot be written back: rain is a DiscreteRange of what is drawn itself'),
    ('def f(): return Range(0, 1)\nparam rain = f() + f()', {'rain': [1] * 10},
     'mine.scenic:3: cannot be written back: rain is not the only choice made there'),
    ('w = Range\nparam rain = w(0, 1)', {'rain': [1] * 10},
     'mine.scenic:4: cannot be written back: rain is not made by Range, Normal, Uniform or Opt'),
    ('x = Normal(4, 1)\nparam time_of_day = x\nparam rain = resample(x)',
     {'time_of_day': [1] * 10},
     'mine.scenic:3: cannot be written back: time_of_day is drawn again by resample'),
    ('param rain = Uniform(1, 1)', {'rain': [1, 2]},
     'mine.scenic:3: cannot be written back: rain has the same option twice'),
    ('x = [(Range(0, 1), 1), (2, 3)]\nparam rain = Uniform(*x)[0]', {'rain': [1, 2]},
     'mine.scenic:4: cannot be written back: the options of rain do not stand there one by one'),
    ('param rain = Range(0, 1)', {'rain': [1, 2]},
     'mine.scenic: cannot be written back: rain has 10 bins, got 2 probabilities'),
    ('param rain = Range(0, 1)', {'rain': [0] * 10},
     'mine.scenic: cannot be written back: rain: probabilities have to be 0 or more, and one'),
    ('param rain = Range(0, 1)', {'snow': [1]}, 'mine.scenic: has no choice named snow'),
], ids=lambda case: case.splitlines()[-1] if isinstance(case, str) else '')
def test_given_a_choice_that_cannot_be_written_back_when_learned_then_one_line_says_which(
    learn: Learn, text: str, probabilities: dict[str, list[float]], message: str,
) -> None:
    with pytest.raises(UsageError) as caught:
        learn(f'{WORLD}ego = new Plane at (0, 400)\n{text}\n', probabilities)
    assert str(caught.value).startswith(message)
    assert '\n' not in str(caught.value)


def test_given_a_choice_of_an_imported_file_when_learned_then_it_is_refused(
    learn: Learn, tmp_path: Path,
) -> None:
    (tmp_path / 'wet.scenic').write_text('soaked = Range(0, 1)\n')
    with pytest.raises(UsageError, match='rain is not made in this file'):
        learn(f'from wet import soaked\n{WORLD}ego = new Plane at (0, 400)\nparam rain = soaked\n',
              {'rain': [1] * 10})


def test_given_no_docstring_and_signs_beyond_ascii_when_learned_then_the_columns_still_fit(
    learn: Learn, draw: Callable[..., list[dict[str, Any]]],
) -> None:
    text = learn(
        f'{WORLD}param clouds = "stratus"\n'
        'x = Uniform(("Ä", Uniform(3, 7)), ("é", 1))\nparam rain = x[1]\n'
        'y = "Ä"; z = Range(-1, 1)  # ±1 m\nego = new Plane at (z, 4)\n',
        {'x': [3, 1], 'x[0].rain': [1, 0], 'z': [1, *[0] * 9]}, r'From a\b "here".',
    )
    assert text.endswith(
        'x = Options({("Ä", Options({3: 1})): 0.75, ("é", 1): 0.25})\nparam rain = x[1]\n'
        'y = "Ä"; z = Options({Range(-1, -0.8): 1})  # ±1 m\nego = new Plane at (z, 4)\n'
    )
    assert 0.8 <= draw(text, 1)[0]['cross_track_m'] <= 1


LEARNED = [.4, .02, .02, .02, .1, .02, .02, .1, .2, .1]
UNIT = NormalDist()
ROUND_TRIPS: dict[str, tuple[str, Callable[[dict[str, float]], float]]] = {
    'normal': (
        'param rain = Normal(30, 5)', lambda scene: UNIT.cdf((scene['rain_percent'] - 30) / 5)
    ),
    'truncated normal': (
        'param rain = TruncatedNormal(20, 30, 0, 100)',
        lambda scene: (UNIT.cdf((scene['rain_percent'] - 20) / 30) - UNIT.cdf(-2 / 3))
        / (UNIT.cdf(8 / 3) - UNIT.cdf(-2 / 3))),
    'range to a drawn end': (
        'r = Range(20, 90)\nparam time_of_day = r / 10\nparam rain = Range(0, r)',
        lambda scene: scene['rain_percent'] / scene['time_of_day_h'] / 10),
    'normal of a drawn mean': (
        'm = Range(20, 60)\nparam time_of_day = m / 10\nparam rain = Normal(m, 4)',
        lambda scene: UNIT.cdf((scene['rain_percent'] - 10 * scene['time_of_day_h']) / 4)),
    'many whole numbers': (
        'param rain = DiscreteRange(1, 130)', lambda scene: (scene['rain_percent'] - 0.5) / 130),
    'derived': (
        'x = Normal(2, 1)\nparam time_of_day = x\nparam rain = 20 + 3 * x ** 2',
        lambda scene: UNIT.cdf(scene['time_of_day_h'] - 2)),
    'under an option': (
        'x = Normal(0, 1)\nparam rain = x\nparam clouds = "broken"',
        lambda scene: UNIT.cdf(scene['rain_percent'])),
}


@pytest.mark.nightly
@pytest.mark.parametrize('kind', ROUND_TRIPS)
def test_s8_given_a_choice_that_is_not_uniform_when_learned_then_draws_have_its_histogram(
    client: Any, learn: Learn, draw: Callable[..., list[dict[str, Any]]], kind: str,
) -> None:
    """By the quantile of each draw under the old program, given what else was drawn."""
    text, quantile = ROUND_TRIPS[kind]
    source = f'{WORLD}ego = new Plane at (0, 400)\n{text}\n'
    learn(source, {})
    names = [choice['dimension']['name'] for choice in client.ask(op='space')['choices']]
    name = 'rain' if 'rain' in names else names[0]
    quantiles = [quantile(scene) for scene in draw(learn(source, {name: LEARNED}))]
    counts = np.histogram(quantiles, 10, (0, 1))[0]
    assert_shares(counts.tolist(), LEARNED)


def test_s8_given_a_choice_that_cannot_be_written_then_the_others_are_and_it_is_named(
    client: Any, tmp_path: Path,
) -> None:
    path = tmp_path / 'mine.scenic'
    path.write_text(f'{WORLD}param rain = Range(0, Range(1, 2))\nego = new Plane in '
                    'CircularRegion((0, 400), 5), facing Normal(0, 3) deg\n')
    assert client.ask(op='compile', program=str(path))['named'] == []
    space = SearchSpace.from_json(client.ask(op='space'))
    text, left = learned_program(
        path, space, {choice.dimension.name: LEARNED for choice in space.choices}, 'Me.'
    )
    assert [line.partition('back: ')[2] for line in left] == [
        'rain has a call as its argument; give that a name of its own first',
        'ego.position.radius is made by no call that could be written anew',
        'ego.position.angle is made by no call that could be written anew',
    ]
    assert 'Left as the program has them:' in text
    assert all(line in text for line in left)
    assert 'Range(1, 1.1): 0.4,' in text, 'the inner choice is written within the outer call'
    assert "TruncatedNormal(0, 3, float('-inf'), -3.844654" in text

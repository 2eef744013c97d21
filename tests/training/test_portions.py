import numpy as np
import pytest

from taxinet_ros.core.errors import UsageError
from taxinet_ros.training.portions import Portion, parse_portion, portion_seed


def test_given_a_word_and_a_count_then_they_are_taken_apart():
    assert parse_portion('crossing=2400', 'program') == Portion(
        kind='program', name='crossing', count=2400
    )
    odd = parse_portion('runs/a=b=7', 'runs')
    assert (odd.name, odd.count, str(odd)) == ('runs/a=b', 7, 'runs/a=b=7')


@pytest.mark.parametrize('text', ['crossing', '=3', 'crossing=', 'crossing=-1', 'crossing=many'])
def test_given_no_portion_then_the_message_shows_one(text):
    with pytest.raises(UsageError, match=r'--add .*PROGRAM=COUNT, such as crossing=2400'):
        parse_portion(text, 'program')


@pytest.mark.parametrize('count', ['0', '1000001'])
def test_given_a_count_out_of_range_then_it_is_refused(count):
    with pytest.raises(UsageError, match=r'--add-runs .*outside 1\.\.1000000'):
        parse_portion(f'folder={count}', 'runs')


def test_given_the_same_program_twice_then_its_scenes_are_not_the_same():
    seeds = {portion_seed(1, number) for number in range(20)} | {1}
    assert len(seeds) == 21
    assert all(0 <= seed < 2**63 for seed in seeds)


def test_given_a_program_then_its_portion_is_of_it_and_of_no_other():
    portion = parse_portion('crossing=20', 'program')
    scenes = portion.scenes(20, 5, lambda *told: None)
    distances = np.array([scene.distance_m for scene in scenes])
    assert len(scenes) == 20
    assert ((distances >= 1350) & (distances <= 1550)).all()
    assert portion.source().name == 'crossing'

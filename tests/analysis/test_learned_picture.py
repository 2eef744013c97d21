"""The picture of what a search has learned."""

from pathlib import Path

import pytest

from taxinet_ros.analysis.learned_picture import learned_picture
from taxinet_ros.campaign.samplers.space import Dimension
from taxinet_ros.campaign.search_space import Choice, Piece

CHOICES = (
    Choice(dimension=Dimension(name='x', buckets=2),
           pieces=(Piece(start=0.0, end=1.0, low=-8.0, high=8.0),)),
    Choice(dimension=Dimension(name='kind', weights=(2.0, 1.0)), options=('clear', 'stratus')),
    Choice(dimension=Dimension(name='weather', weights=(1.0, 1.0, 1.0))),
    Choice(dimension=Dimension(name='curved', buckets=4)),
)
LEARNED = {'x': (0.25, 0.75), 'kind': (0.5, 0.5), 'weather': (0.2, 0.3, 0.5),
           'curved': (0.1, 0.2, 0.3, 0.4)}


def test_given_any_kind_of_choice_when_drawn_then_there_is_a_picture_the_same_each_time(
    tmp_path: Path,
) -> None:
    for name in ('one.png', 'two.png'):
        learned_picture(CHOICES, LEARNED, tmp_path / name, 'found')
    one, two = ((tmp_path / name).read_bytes() for name in ('one.png', 'two.png'))
    assert one.startswith(b'\x89PNG')
    assert one == two
    learned_picture(CHOICES, {**LEARNED, 'x': (0.3, 0.7)}, tmp_path / 'two.png', 'found')
    assert (tmp_path / 'two.png').read_bytes() != one


def test_given_nothing_learned_when_drawn_then_it_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match='no probabilities'):
        learned_picture(CHOICES, {}, tmp_path / 'one.png', 'found')

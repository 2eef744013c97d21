"""Pictures of what a search has learned and of what shrinking has left."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import pytest
from matplotlib.image import imread

from taxinet_ros.analysis.one_run.trajectories import Trajectory
from taxinet_ros.analysis.report.pictures import LIGHT, png_bytes
from taxinet_ros.analysis.search.learned_picture import learned_picture
from taxinet_ros.analysis.search.shrinking import shrink_picture
from taxinet_ros.samplers.space import Dimension
from taxinet_ros.scenes.search_space import Choice, Piece

CHOICES = (
    Choice(dimension=Dimension(name='x', buckets=2),
           pieces=(Piece(start=0.0, end=1.0, low=-8.0, high=8.0),)),
    Choice(dimension=Dimension(name='kind', weights=(2.0, 1.0)), options=('clear', 'stratus')),
    Choice(dimension=Dimension(name='weather', weights=(1.0, 1.0, 1.0))),
    Choice(dimension=Dimension(name='curved', buckets=4)),
)
LEARNED = {'x': (0.25, 0.75), 'kind': (0.5, 0.5), 'weather': (0.2, 0.3, 0.5),
           'curved': (0.1, 0.2, 0.3, 0.4)}


@pytest.mark.nightly
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


def run(label: str, cte_m: float) -> Trajectory:
    t = np.linspace(0, 30, 301)
    return Trajectory(label=label, t_s=t, x_m=5 * t, cte_m=cte_m * t / 30, ok=abs(cte_m) < 1.5)


def test_given_three_runs_then_the_same_picture_is_drawn_each_time():
    runs = [run('original', -90.0), run('shrunk', 1.7), run('nominal', 0.1)]
    one, two, other = (
        png_bytes(shrink_picture(some, 'title'), LIGHT) for some in (runs, runs, runs[1:])
    )
    assert one == two
    far, near = imread(io.BytesIO(one)), imread(io.BytesIO(other))
    assert far.shape == near.shape
    assert not np.array_equal(far, near), 'the view follows the runs'

"""The picture of a failed run, of the shrunk one, and of plain taxiing."""

from __future__ import annotations

import numpy as np
import pytest
from matplotlib.image import imread

from taxinet_ros.analysis.shrink_picture import shrink_picture
from taxinet_ros.analysis.trajectories import Trajectory


def run(label: str, cte_m: float) -> Trajectory:
    t = np.linspace(0, 30, 301)
    return Trajectory(label=label, t_s=t, x_m=5 * t, cte_m=cte_m * t / 30, ok=abs(cte_m) < 1.5)


def test_given_three_runs_then_the_same_picture_is_drawn_each_time(tmp_path):
    runs = [run('original', -90.0), run('shrunk', 1.7), run('nominal', 0.1)]
    for name in ('a.png', 'b.png'):
        shrink_picture(runs, tmp_path / name, 'title')
    assert (tmp_path / 'a.png').read_bytes() == (tmp_path / 'b.png').read_bytes()
    shrink_picture(runs[1:], tmp_path / 'c.png', 'title')
    far, near = imread(tmp_path / 'a.png'), imread(tmp_path / 'c.png')
    assert far.shape == near.shape
    assert not np.array_equal(far, near), 'the view follows the runs'


@pytest.mark.parametrize('number', [0, 4])
def test_given_no_run_or_too_many_then_it_is_refused(tmp_path, number):
    with pytest.raises(ValueError, match=f'{number} runs to draw'):
        shrink_picture([run('one', 1.0)] * number, tmp_path / 'a.png', 'title')

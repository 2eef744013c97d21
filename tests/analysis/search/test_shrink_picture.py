"""The picture of what shrinking has left."""

from __future__ import annotations

import io

import numpy as np
from matplotlib.image import imread

from taxinet_ros.analysis.one_run.trajectories import Trajectory
from taxinet_ros.analysis.report.pictures import LIGHT, png_bytes
from taxinet_ros.analysis.search.shrinking import shrink_picture


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

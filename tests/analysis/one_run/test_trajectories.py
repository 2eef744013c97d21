"""The picture of the paths."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image

from taxinet_ros.analysis.one_run.trajectories import Trajectory, plot_trajectories

BLUE, VERMILION = (0, 114, 178), (213, 94, 0)


def path_of(label: str, cte_m: float, ok: bool | None) -> Trajectory:
    t = np.arange(0, 30, 0.1)
    return Trajectory(label=label, t_s=t, x_m=400 + 5 * t, cte_m=np.full_like(t, cte_m), ok=ok)


def count(path: Path, colour: tuple[int, int, int]) -> tuple[int, int]:
    """Pixels of ``colour`` in the left and in the right column of axes, above the legend."""
    match = (np.asarray(Image.open(path).convert('RGB')) == colour).all(axis=2)
    height, width = match.shape
    above = match[: int(height * 0.92)]
    return int(above[:, : int(width * 0.5)].sum()), int(above[:, int(width * 0.53):].sum())


def test_given_two_perceptions_when_drawn_then_each_has_its_side_and_the_verdicts_their_colour(
    tmp_path: Path,
) -> None:
    picture = tmp_path / 'both.png'
    plot_trajectories([path_of('truth', 3, True), path_of('taxinet', 5, False)], picture)
    passed_left, passed_right = count(picture, BLUE)
    failed_left, failed_right = count(picture, VERMILION)
    assert min(passed_left, failed_right) > 500
    assert (passed_right, failed_left) == (0, 0)


def test_given_the_same_paths_when_drawn_twice_then_the_bytes_are_the_same(tmp_path: Path) -> None:
    paths = [path_of('truth', 0.5, True), path_of('truth', -4, None)]
    for name in ('a.png', 'b.png'):
        plot_trajectories(paths, tmp_path / name, 'title')
    data = (tmp_path / 'a.png').read_bytes()
    assert data == (tmp_path / 'b.png').read_bytes()
    assert b'Matplotlib' not in data
    plot_trajectories(paths[:1], tmp_path / 'c.png', 'title')
    assert data != (tmp_path / 'c.png').read_bytes()


def test_given_a_path_to_the_left_when_drawn_then_it_lies_in_the_upper_half(tmp_path: Path) -> None:
    rows = []
    for cte_m in (8.0, -8.0):
        picture = tmp_path / 'one.png'
        plot_trajectories([path_of('truth', cte_m, True)], picture)
        pixels = np.asarray(Image.open(picture).convert('RGB'))
        upper_axes = (pixels == BLUE).all(axis=2)[: pixels.shape[0] // 2]
        rows.append(np.nonzero(upper_axes)[0].mean())
    assert rows[0] < rows[1]

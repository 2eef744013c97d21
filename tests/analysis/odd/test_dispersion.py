"""Dispersion: what is known of lattices, of single points, and of holes that were made."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from taxinet_ros.analysis.odd.dispersion import largest_hole


@pytest.mark.parametrize(('width', 'side'), [(1, 4), (2, 3), (3, 4), (5, 2)])
def test_given_a_lattice_of_centres_then_the_dispersion_is_half_a_step_and_the_least_there_is(
    width, side
):
    centres = (np.arange(side) + 0.5) / side
    hole = largest_hole(np.array(list(itertools.product(centres, repeat=width))))
    assert hole.radius == pytest.approx(1 / (2 * side), abs=1e-6)
    assert hole.least == pytest.approx(1 / (2 * side))


def test_given_one_point_then_the_farthest_corner_is_found():
    hole = largest_hole(np.array([[0.3, 0.2, 0.4]]))
    assert hole.radius == pytest.approx(0.8)
    assert hole.centre[1] == pytest.approx(1.0)
    assert hole.least == 0.5


def test_given_a_hole_among_many_points_then_its_centre_and_size_are_found():
    points = np.random.default_rng(1).random((4000, 2))
    outside = np.abs(points - [0.6, 0.3]).max(axis=1) > 0.2
    hole = largest_hole(points[outside])
    assert hole.radius == pytest.approx(0.2, abs=0.02)
    assert hole.centre == pytest.approx([0.6, 0.3], abs=0.03)


def test_given_places_that_do_not_belong_then_no_hole_is_sought_there():
    points = np.random.default_rng(2).random((500, 2)) * [0.5, 1.0]
    assert largest_hole(points).centre[0] == pytest.approx(1.0)
    hole = largest_hole(points, lambda places: places[:, 0] <= 0.5)
    assert hole.centre[0] <= 0.5
    assert 0.02 < hole.radius < 0.12
    assert hole.least == pytest.approx(0.5 * (0.5 / 500) ** 0.5, rel=0.01)
    with pytest.raises(ValueError, match='no place'):
        largest_hole(points, lambda places: places[:, 0] > 2)


def test_given_the_same_points_then_the_same_hole():
    points = np.random.default_rng(3).random((60, 4))
    one, other = largest_hole(points), largest_hole(points)
    assert one.radius == other.radius
    assert one.centre.tolist() == other.centre.tolist()

"""Pavements and painted lines of an airport in the ground's texture."""

from __future__ import annotations

import numpy as np
import pytest

from taxinet_ros.core.camera.ground.atlas import SIDE_COLUMNS, ground_atlas, ground_layout
from taxinet_ros.core.camera.ground.pavement import STANDARD, Grid, coverage, with_surface
from taxinet_ros.core.camera.ground.taxiway import lay_airport
from taxinet_ros.core.place.catalogue import default_runway
from taxinet_ros.core.place.place import AirportGround, PaintedLine, Pavement

KMWH = default_runway()
BARE = (40, 90, 40)
GRID = Grid(rows=400, columns=400, x0_m=500.0, dx_m=0.1, y0_m=30.0, dy_m=0.1)
SQUARE = ((505.0, 35.0), (535.0, 35.0), (535.0, 65.0), (505.0, 65.0))
HOLE = ((515.0, 45.0), (525.0, 45.0), (525.0, 55.0), (515.0, 55.0))


def laid(*, pavements=(), lines=(), grid=GRID):
    block = np.empty((*grid.shape, 3), np.uint8)
    block[:] = BARE
    ground = AirportGround(pavements=tuple(pavements), lines=tuple(lines))
    lay_airport(block, grid, STANDARD, KMWH, ground)
    return block.astype(int)


def texel(block, x_m, y_m, grid=GRID):
    return block[int(grid.row(x_m)), int(grid.column(y_m))]


def stripes(style, at_m):
    """Middle and width of the yellow stripes across a line that leads ahead at y = 50 [m]."""
    grid = Grid(rows=400, columns=160, x0_m=500.0, dx_m=0.1, y0_m=48.0, dy_m=0.025)
    line = PaintedLine(style=style, points=((502.0, 50.0), (538.0, 50.0)))
    row = laid(lines=[line], grid=grid)[int(grid.row(at_m))]
    yellow = (row[:, 0] > 115) & (row[:, 2] < 90)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], yellow, [0]]))) * grid.dy_m - 2
    return [((a + b) / 2, b - a) for a, b in edges.reshape(-1, 2)]


def test_given_a_pavement_with_a_hole_then_it_is_paved_around_the_hole():
    block = laid(pavements=[Pavement(surface='asphalt', outline=SQUARE, holes=(HOLE,))])
    assert abs(texel(block, 510, 40).mean() - STANDARD.asphalt) < 15
    for x_m, y_m in ((520, 50), (503, 50), (520, 67)):
        assert tuple(texel(block, x_m, y_m)) == BARE
    concrete = laid(pavements=[Pavement(surface='concrete', outline=SQUARE)])
    assert texel(concrete, 510, 40).mean() > texel(block, 510, 40).mean() + 10
    assert (laid(pavements=[Pavement(surface='other', outline=SQUARE)]) == BARE).all()


def test_given_pavement_that_reaches_far_beyond_the_texture_then_the_part_in_it_is_the_same():
    far = tuple((x if x < 520 else 49_000.0, y if y < 50 else 49_000.0) for x, y in SQUARE)
    wide = laid(pavements=[Pavement(surface='asphalt', outline=far)])
    near = laid(pavements=[Pavement(surface='asphalt', outline=SQUARE)])
    assert (wide[:340, :340] == near[:340, :340]).all()


def test_given_runways_then_no_pavement_is_laid_on_them_but_paint_is():
    everywhere = ((-1e3, -1e3), (6e3, -1e3), (6e3, 1e3), (-1e3, 1e3))
    (crossing,) = KMWH.crossings
    line = PaintedLine(style=1, points=((1300.0, 0.0), (1700.0, 0.0)))
    for x_m in (1000.0, crossing.x_m):
        grid = Grid(rows=100, columns=300, x0_m=x_m - 5, dx_m=0.1, y0_m=-15.0, dy_m=0.1)
        pavement = Pavement(surface='asphalt', outline=everywhere)
        assert (laid(pavements=[pavement], grid=grid) == BARE).all()
        assert (laid(lines=[line], grid=grid) != BARE).any() == (x_m > 1300)
    beside = Grid(rows=10, columns=10, x0_m=1000.0, dx_m=0.1, y0_m=40.0, dy_m=0.1)
    assert (laid(pavements=[pavement], grid=beside) != BARE).all()


@pytest.mark.parametrize(('style', 'dashed', 'between'), [
    (1, [(0, 0.3)], [(0, 0.3)]),
    (2, [(0, 0.15)], []),
    (3, [(-0.15, 0.15), (0.15, 0.15)], [(-0.15, 0.15), (0.15, 0.15)]),
    (4, [(-0.9, 0.3), (-0.3, 0.3), (0.3, 0.3), (0.9, 0.3)], [(0.3, 0.3), (0.9, 0.3)]),
    (5, [(-0.15, 0.15), (0.15, 0.15)], [(0.15, 0.15)]),
    (20, [], []),
    (30, [], []),
])
def test_given_a_type_of_line_then_its_stripes_are_where_they_should_be(style, dashed, between):
    # Dashes and gaps of 0.9 m begin with the line, at 502 m.
    for at_m, expected in ((511.45, dashed), (512.35, between)):
        found = stripes(style, at_m)
        assert len(found) == len(expected)
        for one, other in zip(found, expected, strict=True):
            assert one == pytest.approx(other, abs=0.05)


def test_given_a_type_from_51_on_then_a_black_border_is_around_the_yellow():
    row = laid(lines=[PaintedLine(style=51, points=((502.0, 50.0), (538.0, 50.0)))])[200]
    beside, middle = (row[int(GRID.column(y))] for y in (50.22, 50.0))
    assert beside.max() < 60 < middle[0]
    white = laid(lines=[PaintedLine(style=20, points=((502.0, 50.0), (538.0, 50.0)))])[200, 200]
    assert white.min() > 130


def test_given_a_line_with_a_corner_then_the_stripes_beside_it_keep_their_distance():
    line = PaintedLine(style=3, points=((502.0, 40.0), (520.0, 40.0), (520.0, 60.0)))
    block = laid(lines=[line])
    yellow = np.argwhere(block[:, :, 0] > 150)
    x, y = GRID.x0_m + yellow[:, 0] / 10 + 0.05, GRID.y0_m + yellow[:, 1] / 10 + 0.05
    aside = np.where(x < 519.5, np.abs(y - 40), np.where(y > 40.5, np.abs(x - 520), 0.15))
    assert aside.max() < 0.3
    assert (aside > 0.04).all()


@pytest.mark.parametrize('style', [1, 2, 3, 4, 21])
def test_given_a_line_without_length_then_nothing_is_painted(style):
    nowhere = PaintedLine(style=style, points=((510.0, 50.0), (510.0, 50.0)))
    assert (laid(lines=[nowhere]) == BARE).all()


def test_given_a_runway_with_an_airport_then_only_its_ground_differs():
    apron = tuple((x, y - 10) for x, y in SQUARE)
    airport = AirportGround(pavements=(Pavement(surface='asphalt', outline=apron),), lines=())
    layout = ground_layout(KMWH)
    plain, paved = (
        ground_atlas(KMWH, None, one)[:layout.rows, :layout.columns] for one in (None, airport)
    )
    rows, columns = np.nonzero((plain != paved).any(axis=2))
    assert 500 < layout.start_x_m + rows.min() * layout.row_m < 510
    assert 530 < layout.start_x_m + rows.max() * layout.row_m < 536
    assert columns.min() >= layout.columns - SIDE_COLUMNS


def test_given_concrete_beside_asphalt_then_shades_are_relative_to_the_runways():
    assert with_surface(STANDARD, 'asphalt', 'asphalt') == STANDARD
    there = with_surface(STANDARD, 'asphalt', 'concrete')
    back = with_surface(there, 'concrete', 'asphalt')
    assert back.asphalt == pytest.approx(STANDARD.asphalt)
    assert there.asphalt > STANDARD.asphalt + 10


def test_given_a_hole_then_coverage_is_that_of_the_rest():
    rows, columns, share = coverage(SQUARE, GRID, (HOLE,))
    assert share.sum() / 100 == pytest.approx(30 * 30 - 10 * 10, rel=0.01)
    assert (rows.start, columns.start) == (50, 50)

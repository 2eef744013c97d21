from __future__ import annotations

import numpy as np

from taxinet_ros.core.row_colours import RowColours


def test_given_row_colours_when_spread_then_every_pixel_of_a_row_has_its_rounded_colour() -> None:
    rows = RowColours(5, 7)
    codes = np.array([[0.4, 99.6, 300.0], [-3.0, 20.0, 254.5]])
    picture = rows.spread(codes)

    assert picture.shape == (2, 7, 3)
    np.testing.assert_array_equal(picture[0], [[0, 100, 255]] * 7)
    np.testing.assert_array_equal(picture[1], [[0, 20, 254]] * 7)

"""The crossing runway, which a scene may leave out."""

from __future__ import annotations

import numpy as np

from taxinet_ros.core import ground, runway
from taxinet_ros.core.aircraft import Aircraft
from taxinet_ros.core.camera import Camera
from taxinet_ros.core.scenario import Scenario


def picture(distance_m: float, *, crossing: bool) -> np.ndarray:
    scene = Scenario(distance_m=distance_m, crossing=crossing, shadows=False)
    return Camera(scene).render(Aircraft(scene).state, 0)


def test_given_no_crossing_then_our_stripes_go_through_and_nothing_else_is_painted_otherwise():
    with_it, without = (runway.markings(crossing=there) for there in (True, False))
    def length(markings, kind):
        return sum(m.polygon[1][0] - m.polygon[0][0] for m in markings if m.kind == kind)

    assert length(without, 'edge') == 2 * runway.LENGTH_M
    assert length(with_it, 'edge') < length(without, 'edge') - 4 * runway.CROSSING_CLEAR_HALF_M + 1
    kinds = {m.kind for m in with_it} - {'edge', 'centreline'}
    assert len(kinds) == 4
    for kind in kinds:
        assert [m for m in with_it if m.kind == kind] == [m for m in without if m.kind == kind]


def test_given_no_crossing_then_the_ground_differs_there_and_nowhere_else():
    with_it, without = (
        atlas[: ground.ROWS, : ground.COLUMNS]
        for atlas in (ground.ground_atlas(), ground.uncrossed_atlas())
    )
    x = ground.START_X_M + (np.arange(ground.ROWS) + 0.5) * ground.ROW_M
    differs = (with_it != without).any(axis=(1, 2))
    assert differs[(x > 1420) & (x < 1470)].all()
    assert not differs[(x < 1150) | (x > 1750)].any()


def test_given_a_scene_without_it_then_the_camera_sees_the_centreline_go_on():
    there, gone = (picture(1420.0, crossing=crossing) for crossing in (True, False))
    assert (there != gone).mean() > 0.3
    # The nearest dash is the brightest thing on the pavement; at the crossing there is none.
    middle = slice(100, 260)
    assert gone[20:60, middle].max() > there[60:150, middle].max() + 20
    assert np.array_equal(picture(400.0, crossing=True)[60:], picture(400.0, crossing=False)[60:])

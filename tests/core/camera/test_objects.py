"""Others on the ground in the picture: where they are by geometry, in the scene's light."""


import numpy as np
import pytest
from picture_samples import at

from taxinet_ros.core.camera.camera import Camera, project
from taxinet_ros.core.camera.light import LUMINANCE
from taxinet_ros.core.rig.catalogue import find_camera
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.traffic.traffic import KINDS
from taxinet_ros.core.traffic.traffic_file import load_traffic

STATE = at(400.0)
NOON = {'time_of_day_s': 11 * 3600.0, 'shadows': False}
DULL = {'clouds': 'overcast', 'shadows': False}


def picture(*objects, stamp_ns=0, state=STATE, **light):
    traffic = load_traffic(objects) if objects else 'nobody'
    camera = Camera(Scenario(traffic=traffic, **{**NOON, **light}))
    return camera.render(state, stamp_ns).astype(float)


def changed(*objects, **others):
    """Rows and columns of the pixels that the objects change, and the brightness there."""
    before, after = picture(**others), picture(*objects, **others)
    rows, columns = np.nonzero(np.abs(after - before).max(axis=2) > 6)
    return rows, columns, (after @ LUMINANCE)[rows, columns], (before @ LUMINANCE)[rows, columns]


def there(kind, ahead_m, left_m, **values):
    return {'kind': kind, 'x_m': 400 + ahead_m, 'y_m': left_m, **values}


def test_given_nobody_then_the_picture_is_that_of_before_to_the_bit():
    alone = Camera(Scenario(**NOON)).render(STATE, 0)
    far = load_traffic([there('cone', -50, 0), there('patch', -60, 0), there('person', 4000, 0)])
    seen = Camera(Scenario(traffic=far, **NOON)).render(STATE, 0)
    np.testing.assert_array_equal(seen, alone)


@pytest.mark.parametrize(('kind', 'ahead_m', 'left_m'), [
    ('cone', 8, -3), ('person', 12, 1), ('vehicle', 25, -6), ('aircraft', 60, -15),
    ('closed_marking', 30, -3), ('patch', 14, -5), ('painted_over', 40, 0),
    ('hold_line', 20, -2),
])
def test_given_an_object_then_it_is_where_it_projects_and_nowhere_else(kind, ahead_m, left_m):
    rows, columns, *_ = changed(there(kind, ahead_m, left_m), **DULL)
    length, width, height = KINDS[kind].size
    corners = np.array([
        (400 + ahead_m + x * length / 2, left_m + y * width / 2, z * height)
        for x in (-1, 1) for y in (-1, 1) for z in (0, 1)
    ])
    pixels, depth = project(STATE, corners)
    assert (depth > 0).all()
    assert len(rows) > 20
    (left, top), (right, bottom) = pixels.min(axis=0), pixels.max(axis=0)
    margin = 2 if height == 0 else 3 + 0.3 * (bottom - top)  # soft shade of the sky below it
    assert left - margin <= columns.min()
    assert columns.max() <= right + margin
    assert top - margin <= rows.min()
    assert rows.max() <= bottom + margin
    seen_px = min(right, 359) - max(left, 0)
    share = 0.2 if kind == 'aircraft' else 0.6  # the wing is above the picture
    assert columns.max() - columns.min() > share * seen_px


def test_given_a_low_sun_from_the_left_then_the_shadow_falls_to_the_right_and_is_darker():
    evening = {'time_of_day_s': 16.5 * 3600.0}
    _, columns, now, before = changed(there('person', 12, 1), **evening)
    dull = changed(there('person', 12, 1), **DULL)[1]
    assert columns.max() - columns.min() > 3 * (dull.max() - dull.min())
    shade = (columns > dull.max() + 4) | (columns < dull.min() - 4)
    assert shade.sum() > 30
    assert (now[shade] < before[shade]).all()


def test_given_two_in_a_row_then_the_nearer_one_covers_the_farther_one():
    van, person = there('vehicle', 30, -4, heading_deg=90), there('person', 15, -3)
    both = picture(van, person, **DULL)
    np.testing.assert_array_equal(both, picture(person, van, **DULL))
    (u, v), = project(STATE, np.array([(415.0, -3.0, 1.1)]))[0].round().astype(int)
    np.testing.assert_allclose(both[v, u], picture(person, **DULL)[v, u], atol=8)


def test_given_haze_then_a_far_black_object_is_brighter_than_a_near_one():
    stratus = {'clouds': 'stratus', 'rain_fraction': 0.6, 'shadows': False}
    darkest = []
    for away in (20, 200):
        black = there('vehicle', away, -3, colour='black', width_m=0.15 * away)
        darkest.append(changed(black, **stratus)[2].min())
    assert darkest[1] > darkest[0] + 15


def test_given_a_moving_object_then_each_moment_has_its_own_place():
    van = there('vehicle', 25, -12, heading_deg=90)
    van['path'] = [{'x_m': 425, 'y_m': 12, 'speed_mps': 5}]
    centres = []
    for time_s in (0, 1, 2):
        moved = picture(van, stamp_ns=time_s * 10**9, **DULL) - picture(**DULL)
        centres.append(np.nonzero(np.abs(moved).max(axis=2) > 6)[1].mean())
    (u0, _), (u1, _), (u2, _) = project(
        STATE, np.array([(425.0, y, 1.0) for y in (-12.0, -7.0, -2.0)])
    )[0]
    assert centres == pytest.approx([u0, u1, u2], abs=6)


def test_given_the_own_parts_then_objects_are_behind_them():
    before, after = picture(**DULL), picture(there('vehicle', 6, 4, height_m=4), **DULL)
    np.testing.assert_array_equal(after[60:120, :20], before[60:120, :20])


def test_given_an_object_around_the_camera_then_the_picture_is_finite_and_whole():
    for ahead in (-3, 0, 2, 4):
        image = picture(there('aircraft', ahead, -2), there('patch', ahead, -2, length_m=30))
        assert image.shape == (200, 360, 3)


@pytest.mark.parametrize('width_m', [6, 20, 60])
def test_given_a_mark_that_begins_behind_the_camera_then_its_edges_are_where_they_project(width_m):
    mark = there('painted_over', 20, 0, width_m=width_m, length_m=100, colour='red')
    camera = find_camera('nose')
    looks = {'traffic': load_traffic([mark]), 'shadows': False, 'camera': 'nose'}
    frame = Camera(Scenario(**looks)).render(STATE, 0).astype(float)
    red = frame[..., 0] > 2 * frame[..., 1]
    for left_m in (-width_m / 2, width_m / 2):
        for ahead_m in (10, 15, 25, 40):
            for beside_m in (-0.1, 0.1):
                point = (400 + ahead_m, left_m * (1 + beside_m), 0)
                [(u, v)], _ = project(STATE, np.array([point]), camera)
                if 2 < u < 637 and 2 < v < 397:
                    assert red[round(v), round(u)] == (beside_m < 0), point


def test_given_equal_scenes_then_equal_bytes_whatever_was_rendered_before():
    objects = [there('aircraft', 40, -12), there('vehicle', 20, 0), there('tyre_marks', 20, -3)]
    scene = Scenario(traffic=load_traffic(objects), clouds='broken')
    one = Camera(scene)
    first = one.render(STATE, 0)
    one.render(STATE, 7 * 10**9)
    np.testing.assert_array_equal(one.render(STATE, 0), first)
    np.testing.assert_array_equal(Camera(scene).render(STATE, 0), first)


def test_given_a_van_then_what_is_on_its_other_side_is_not_seen_through_it():
    def counts(heading_deg):
        near_van = changed(there('vehicle', 14, 0, heading_deg=heading_deg), **DULL)[:2]
        red, green, blue = picture(
            there('vehicle', 14, 0, heading_deg=heading_deg), **DULL
        )[near_van].T
        tail_lights = (red > 2 * green) & (red > 60) & (green < blue + 15)
        headlights = (blue > 150) & (red < 1.15 * blue)
        return tail_lights.sum(), headlights.sum()

    (rear_red, rear_white), (front_red, front_white) = counts(0), counts(180)
    assert rear_red > 10
    assert rear_white == 0
    assert front_white > 10
    assert front_red == 0

"""Random places: valid, distinct, the same for the same number; splits that do not overlap."""

from __future__ import annotations

import hashlib
import math
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest

from taxinet_ros.core.camera.camera import Camera
from taxinet_ros.core.motion.aircraft import Aircraft
from taxinet_ros.core.place.catalogue import find_place, typed_place
from taxinet_ros.core.place.place import Place
from taxinet_ros.core.place.place_file import make_place
from taxinet_ros.core.place.random_place import SPLITS, _document, random_place
from taxinet_ros.core.place.runway import Condition
from taxinet_ros.core.scenario import Scenario, scenario_from_human
from taxinet_ros.errors import UsageError

TEST_DIGEST = '4792e589451e183fb6628d8a6128b6f6ace88b4dd7f80e8c391b91fe0509329c'
"""Of the test split, on which nothing may be tuned and which therefore may not change."""


@pytest.fixture(scope='module')
def places() -> dict[str, list[Place]]:
    return {split: [random_place(number) for number in SPLITS[split]] for split in SPLITS}


def test_given_the_splits_when_compared_then_they_are_large_and_do_not_overlap(places) -> None:
    assert {split: len(numbers) for split, numbers in SPLITS.items()} == {
        'train': 600, 'validation': 60, 'selection': 40, 'test': 100,
    }
    for one, other in combinations(SPLITS.values(), 2):
        assert not set(one) & set(other)
    # Not even by chance: no two runways have the same pavement or paint.
    runways = [place.runway for split in places.values() for place in split]
    assert len({(r.length_m, r.width_m, r.bearing_rad) for r in runways}) == 800


def test_given_the_test_places_when_made_again_then_they_are_the_same_bytes(places) -> None:
    found = hashlib.sha256()
    for number, place in zip(SPLITS['test'], places['test'], strict=True):
        assert random_place(number).document == place.document
        found.update(place.document.encode())
    assert found.hexdigest() == TEST_DIGEST


def test_given_many_places_when_looked_at_then_they_are_within_the_standards(places) -> None:
    for place in (place for split in places.values() for place in split):
        runway = place.runway
        assert 18 <= runway.width_m <= 60
        assert 700 <= round(runway.length_m, 0) <= 3600
        assert runway.category != 'precision' or (runway.width_m >= 30 and runway.edge_stripes)
        assert 0 <= runway.shoulder_m <= max((60 - runway.width_m) / 2, 5)
        first, second = (int(one[:2]) for one in runway.designations)
        assert abs(first - second) == 18
        # The number is the magnetic bearing's, within the largest variation.
        off = math.remainder(math.degrees(runway.bearing_rad) - 10 * first, 360)
        assert abs(off) <= 25
        assert all(shift <= 0.2 * runway.length_m for shift in runway.displaced_m)
        assert find_place(place.text).digest == place.digest
        assert runway.last_start_m > 200


def test_given_many_places_when_counted_then_every_kind_is_among_them(places) -> None:
    runways = [place.runway for place in places['train']]
    for key in ('category', 'surface', 'surroundings', 'edge_stripes'):
        shares = dict.fromkeys((getattr(one, key) for one in runways), 0)
        for one in runways:
            shares[getattr(one, key)] += 1
        assert min(shares.values()) > 30
        assert len(shares) == (2 if key == 'edge_stripes' else 3)
    assert {len(one.crossings) for one in runways} == {0, 1, 2}
    for share in (
        np.mean([bool(one.crossings) for one in runways]),
        np.mean([one.shoulder_m > 0 for one in runways]),
        np.mean([any(one.displaced_m) for one in runways]),
        np.mean([one.threshold_deg[0] < 0 for one in runways]),
        np.mean([one.width_m < 30 for one in runways]),
    ):
        assert 0.15 < share < 0.7


@pytest.mark.nightly
def test_given_random_places_when_rendered_then_each_looks_different() -> None:
    frames = []
    for number in (3, 12, 10_001, 90_000):
        scene = scenario_from_human({
            'place': f'random:{number}', 'distance_m': 120.0, 'cross_track_m': 2.0,
        })
        frames.append(Camera(scene).render(Aircraft(scene).state, 0).astype(int))
    for one, other in combinations(frames, 2):
        assert np.abs(one - other).mean() > 3


def test_given_a_number_beyond_the_range_when_named_then_it_is_refused() -> None:
    with pytest.raises(UsageError, match=r'outside 0\.\.2147483647'):
        typed_place('random:9999999999')
    with pytest.raises(UsageError, match='not one of'):
        typed_place('random:x')


def changed(**runway: object) -> Place:
    values = _document(5)
    for key in ('shoulder_m', 'condition', 'crossings'):
        values['runway'].pop(key, None)
    values.pop('pavements', None)
    values.pop('lines', None)
    values['runway'] |= {'width_m': 30.0, **runway}
    return make_place(values, Path('own.yaml'))


def test_given_no_condition_when_read_then_it_is_that_of_kmwh() -> None:
    assert changed().runway.condition == Condition() == find_place('kmwh_04').runway.condition
    with pytest.raises(UsageError, match='wear'):
        changed(condition={'wear': 9.0})
    with pytest.raises(UsageError, match='shoulder_m'):
        changed(shoulder_m=50.0)


@pytest.mark.nightly
def test_given_a_paved_shoulder_when_rendered_then_it_is_dark_beyond_the_edge() -> None:
    def beside(place: Place) -> float:
        """Brightness of the ground 2 m beyond the right edge, 9 m ahead."""
        scene = Scenario(place=place.text, distance_m=150.0, cross_track_m=-12.0)
        frame = Camera(scene).render(Aircraft(scene).state, 0)
        return float(frame[66:70, 230:250].mean())

    bare, paved = beside(changed(surroundings='sand')), beside(
        changed(surroundings='sand', shoulder_m=8.0)
    )
    assert paved < 0.85 * bare

"""Training place by place, through the eye: its scenes, its card, and going on with it."""

from __future__ import annotations

import dataclasses
import math
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from training_samples import foreign_folder

from taxinet_ros.core.camera.light import sun_position
from taxinet_ros.core.perception.eye import find_eye
from taxinet_ros.core.perception.perception import make_perception
from taxinet_ros.core.perception.weights import load_model
from taxinet_ros.core.place.random_place import SPLITS
from taxinet_ros.core.rig.catalogue import find_camera
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.errors import UsageError
from taxinet_ros.training.data import dataset as datasets
from taxinet_ros.training.data.dataset import no_progress
from taxinet_ros.training.data.image_folder import load_folders
from taxinet_ros.training.data.photographs import photograph
from taxinet_ros.training.data.places import named_places, places_scenes
from taxinet_ros.training.options import TrainOptions
from taxinet_ros.training.train import IMAGES, get_training_data, train


def options(out: Path, **changes: object) -> TrainOptions:
    tiny = TrainOptions(
        places=('random:2', 'kmwh_04'), view='ahead', out=out, images=8, validation=1, epochs=2,
        batch=4, workers=1, seed=7,
    )
    return dataclasses.replace(tiny, **changes)


def drawn(words: tuple[str, ...], count: int, *, cameras: bool = True) -> list[Scenario]:
    return places_scenes(words, count, 7, cameras=cameras, progress=no_progress)


def test_given_words_when_named_then_ranges_and_splits_are_their_places() -> None:
    assert named_places(['random:3-5', 'kmwh_04']) == (
        'random:3', 'random:4', 'random:5', 'kmwh_04',
    )
    assert len(named_places(['random:train'])) == len(SPLITS['train'])


@pytest.mark.parametrize(('words', 'why'), [
    (['random:test'], 'is of the test places'),
    (['random:89999-90000'], 'random:90000: is of the test places'),
    (['random:20005'], 'is of the selection places'),
    (['random:5-4'], 'expected 1 to 10000 places'),
    (['random:0-20000'], 'expected 1 to 10000 places'),
    (['random:1-3', 'random:2'], 'random:2: is given twice'),
])
def test_given_places_that_no_training_may_see_when_named_then_they_are_refused(
    words: list[str], why: str
) -> None:
    with pytest.raises(UsageError, match=why):
        named_places(words)


def test_given_places_when_scenes_are_drawn_then_they_are_by_place_all_around_and_by_day() -> None:
    scenes = drawn(('random:2', 'random:7', 'kmwh_04'), 601)
    places = [scene.place for scene in scenes]
    assert [places.count(place) for place in dict.fromkeys(places)] == [201, 200, 200]
    assert sum(one != other for one, other in pairwise(places)) == 2
    for place in dict.fromkeys(places):
        own = [scene for scene in scenes if scene.place == place]
        assert len({scene.camera_model.digest for scene in own}) <= 3
        near = [abs(one.cross_track_m) <= 2.5 and abs(one.heading_rad) <= math.radians(10)
                for one in own]
        assert 0.3 < np.mean(near) < 0.6, 'where an aircraft is that follows the line'
        assert min(scene.heading_rad for scene in own) < math.radians(-30)
        assert max(scene.heading_rad for scene in own) > math.radians(30)
        assert abs(np.mean([scene.cross_track_m for scene in own])) < 1.5
        assert len({scene.date for scene in own}) > 80
        assert 0.15 < np.mean([scene.rain_fraction > 0 for scene in own]) < 0.5
        assert all(
            sun_position(scene.date, scene.time_of_day_s, scene.runway)[1] > math.radians(-1)
            for scene in own
        )
    assert len({scene.camera_model.digest for scene in scenes}) >= 4
    # A place's scenes do not depend on the others.
    assert drawn(('random:7',), 200) == scenes[201:401]
    assert {scene.camera for scene in drawn(('random:7',), 50, cameras=False)} == {'wing'}


@pytest.mark.nightly
def test_given_a_training_on_places_when_interrupted_and_resumed_then_the_weights_are_the_same(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = tmp_path / 'whole.safetensors'
    card = train(options(whole))
    assert (card.view, card.images, card.validation) == ('ahead', 8, 1)
    assert [(one.kind, one.name) for one in card.training_data] == [
        ('places', 'random:2'), ('places', 'kmwh_04'),
    ]
    assert [one.name for one in card.validation_data] == ['random:validation']
    assert not {'place', 'camera'} & set(card.domain)
    assert card.domain['track'] == ('runway',)
    assert card.command_line == (
        'taxinet train --place random:2 --place kmwh_04 --view ahead --images 8 --validation 1 '
        '--epochs 2 --batch 4 --learning-rate 0.003 --seed 7 --out whole.safetensors'
    )
    perception = make_perception(str(whole))
    scene = Scenario(camera='nose')
    perception.begin(scene.rig)
    assert perception.estimate(photograph(scene)[0], None).usable

    def stop(stage: str, done: int, total: int) -> None:
        if (stage, done) == (IMAGES, 6):
            raise KeyboardInterrupt

    out, rendered = tmp_path / 'net.safetensors', []
    with pytest.raises(KeyboardInterrupt):
        train(options(out), stop)
    take = datasets._shrunk
    monkeypatch.setattr(datasets, '_shrunk', lambda *one: (rendered.append(1), take(*one))[1])
    train(options(out, resume=True))
    assert out.read_bytes() == whole.read_bytes()
    assert len(rendered) == 3
    more = options(tmp_path / 'more.safetensors', view=None, start=str(whole), epochs=1)
    assert train(more).view == 'ahead', 'that of the network it starts from'


@pytest.mark.parametrize(('changes', 'why'), [
    ({}, 'sees through the view none, not ahead'),
    ({'view': None, 'architecture': 'cnn5w-64x192'},
     'is of architecture cnn5-64x192, not cnn5w-64x192'),
    ({'architecture': 'resnet'}, "architecture 'resnet' is unknown; known: cnn5-64x192, cnn5w"),
])
def test_given_a_start_of_another_kind_then_it_is_refused_by_name(
    tmp_path: Path, changes: dict[str, Any], why: str
) -> None:
    with pytest.raises(UsageError, match=why):
        train(options(tmp_path / 'x.safetensors', start='taxinet', **changes))


def test_given_a_view_when_pictures_are_made_then_they_are_those_of_the_eye(
    tmp_path: Path
) -> None:
    asked = options(tmp_path / 'net.safetensors', places=('kmwh_04',), images=4, workers=2)
    training = get_training_data(asked, no_progress).training
    for row, scene in enumerate(drawn(('kmwh_04',), 4)):
        frame, truth = photograph(scene)
        np.testing.assert_array_equal(
            training.pictures[row], find_eye('ahead', scene.rig).see(frame)
        )
        assert training.cte_m[row] == truth.cte_m


@pytest.mark.nightly
def test_given_folders_that_name_their_cameras_when_trained_on_with_a_view_then_the_card_says_it(
    tmp_path: Path,
) -> None:
    folder = foreign_folder(tmp_path / 'drive', images=6, camera='nose', aircraft='caravan',
                            shape=find_camera('nose').shape)
    out = tmp_path / 'net.safetensors'
    data = {'places': (), 'data': (folder,), 'validation': 2}
    card = train(options(out, **data))
    assert (card.view, card.images, card.validation, card.domain) == ('ahead', 4, 2, None)
    assert card.command_line.startswith(f'taxinet train {folder} --view ahead ')
    added = options(tmp_path / 'more.safetensors', places=('kmwh_04',), add_data=(folder,),
                    view=None, start=str(out), images=4)
    card = train(added)
    assert (card.view, card.images) == ('ahead', 4 + 6)
    assert [(one.kind, one.name) for one in card.training_data] == [
        ('places', 'kmwh_04'), ('folder', 'drive')]
    assert card.start_sha256 == load_model(out).fingerprint
    material = get_training_data(dataclasses.replace(added, view='ahead'), no_progress)
    np.testing.assert_array_equal(
        material.training.pictures[4:], load_folders([folder], workers=1, view='ahead')[0].pictures)
    unnamed = foreign_folder(tmp_path / 'unnamed')
    for changes in ({'places': (), 'data': (unnamed,)}, {'add_data': (unnamed,)},
                    {**data, 'validation_data': unnamed}):
        with pytest.raises(UsageError, match=r'labels.csv line 2: names no camera and no aircraft'):
            train(options(tmp_path / 'refused.safetensors', **changes))


@pytest.mark.parametrize(('changes', 'why'), [
    ({'images': 1, 'batch': 1}, '1 images are fewer than 2 places'),
    ({'sampler': 'halton'}, 'sampler goes with a program'),
    ({'validation_program': 'nominal'}, 'validation_program goes with a program'),
    ({'view': 'behind'}, "view 'behind' is unknown; known: ahead"),
])
def test_given_options_that_do_not_go_together_when_stated_then_one_line_says_so(
    changes: dict[str, object], why: str, tmp_path: Path
) -> None:
    with pytest.raises(UsageError, match=why):
        train(options(tmp_path / 'net.safetensors', **changes))

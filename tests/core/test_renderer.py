"""Who takes the pictures of a run: found by name, checked, and asked whether it can do so again."""

from __future__ import annotations

import dataclasses
import itertools
from pathlib import Path

import numpy as np
import pytest

import taxinet_ros as tx
from taxinet_ros.bag.run.recording import open_recording
from taxinet_ros.bag.run.resimulation import WorldDiffers
from taxinet_ros.core.camera.camera import Camera
from taxinet_ros.core.motion.aircraft import Aircraft
from taxinet_ros.core.renderer import find_renderer
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.traffic.traffic_file import load_traffic
from taxinet_ros.core.types import TaxiCommand
from taxinet_ros.core.world import (
    SimulatedWorld,
    closing,
    find_world,
    world_and_camera,
    world_options,
    world_word,
)
from taxinet_ros.errors import InfraError, UsageError
from taxinet_ros.training.data.dataset_folder import DatasetOptions
from taxinet_ros.training.data.photographs import photograph
from taxinet_ros.trials.options import make_options
from taxinet_ros.trials.record.facts import facts_of_runs, recorded_world

AHEAD = TaxiCommand(steering_rad=0.0, speed_mps=5.0)

THEIRS = '''
import itertools
import numpy as np
from taxinet_ros.core.camera.camera import Camera
from taxinet_ros.errors import InfraError

CLOSED, TAKEN = [], itertools.count()

class Ours:
    reproducible = True
    shows = ('clouds', 'rain_percent', 'time_of_day_h', 'date', 'shadows', 'crossing', 'traffic',
             'camera', 'place', 'aircraft')
    def __init__(self, scenario):
        self.camera = Camera(scenario)
    def render(self, state, stamp_ns):
        return self.camera.render(state, stamp_ns)
    def close(self):
        CLOSED.append(self)

class Film:
    """Never the same picture twice."""
    reproducible = False
    shows = ()
    def __init__(self, scenario):
        self.camera = Camera(scenario)
    def render(self, state, stamp_ns):
        image = self.camera.render(state, stamp_ns)
        image[0, 0] = next(TAKEN) % 256
        return image

class Small(Film):
    def render(self, state, stamp_ns):
        return np.zeros((20, 36, 3), np.uint8)

class Broken(Film):
    def render(self, state, stamp_ns):
        raise RuntimeError('lens cap')

class Away(Film):
    def render(self, state, stamp_ns):
        raise InfraError('timeout', 'simulator', -1, 'nobody answers')

class Odd(Film):
    shows = ('weather',)

class Unsure(Film):
    reproducible = 'mostly'

nothing = 3
'''


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / 'theirs.py'
    path.write_text(THEIRS)
    return path


def test_given_ours_when_found_then_the_world_is_the_plain_one() -> None:
    assert find_renderer('ours') is None
    assert find_world('kmwh+ours').name == 'kmwh'
    assert find_world('kmwh+ours').make is SimulatedWorld


@pytest.mark.parametrize(('name', 'said'), [
    ('{file}:Nobody', r'no Nobody in it'),
    ('{file}:nothing', r'nothing is int'),
    ('{file}:Odd', r'shows weather; known: clouds, rain_percent'),
    ('{file}:Unsure', r"reproducible is 'mostly', not True or False"),
    ('polaroid', r"camera: 'polaroid' is unknown; known: ours.*taxinet_ros.cameras"),
])
def test_given_a_word_that_makes_no_camera_when_found_then_one_line_says_why(
    name: str, said: str, file: Path
) -> None:
    with pytest.raises(UsageError, match=said):
        find_world(f'kmwh+{name.format(file=file)}')


def test_given_world_and_camera_when_put_into_one_word_then_it_is_taken_apart_again() -> None:
    for world, camera in itertools.product(('kmwh', 'bicycle'), ('flightgear', 'a b/c.py:Eye')):
        word = world_word(world, camera)
        assert world_and_camera(word) == (world, camera)
        options = world_options(word)
        assert ('--world' in options) is (world != 'kmwh')
        assert options[-2:] == ['--camera', camera]
        assert world_word(word, None) == world_word(word, camera) == word
    assert world_word('kmwh', 'ours') == 'kmwh'
    assert world_options('kmwh') == []
    with pytest.raises(UsageError, match='names another; leave one out'):
        world_word('kmwh+flightgear', 'xplane')


def test_given_others_that_react_then_only_runs_and_our_camera_show_them(file: Path) -> None:
    van = {
        'kind': 'vehicle', 'x_m': 430, 'y_m': -9, 'starts_within_m': 20,
        'path': [{'x_m': 430, 'y_m': 9, 'speed_mps': 5}],
    }
    shy = Scenario(traffic=load_traffic([{'kind': 'cone', 'x_m': 420, 'y_m': 3}, van]))
    still = Scenario(traffic=load_traffic([{'kind': 'cone', 'x_m': 420, 'y_m': 3}]))
    found = find_renderer(f'{file}:Ours')
    assert found is not None
    found.check(still)
    with pytest.raises(UsageError, match=r'theirs.py:Ours: objects\[1\] of traffic reacts to the'):
        found.check(shy)
    first = next(iter(tx.run(dataclasses.replace(shy, duration_s=0.1)).frames()))
    assert (tx.render(shy) == first).all()
    tx.render(still, t_s=2.0)
    with pytest.raises(UsageError, match=r'render: t_s: objects\[1\] of traffic reacts'):
        tx.render(shy, t_s=2.0)


def test_given_a_camera_that_is_ours_when_a_run_is_made_then_pictures_and_faults_are_the_same(
    file: Path,
) -> None:
    scene = Scenario(
        camera_freeze_s=0.4, fault_onset_s=0.3, lens_dirt_fraction=0.3,
        camera_dropout_fraction=0.3, duration_s=1.0,
    )
    ours, theirs = SimulatedWorld(scene), find_world(f'kmwh+{file}:Ours').make(scene)
    for _ in range(ours.last_seq + 1):
        one, other = ours.observe(), theirs.observe()
        assert (one.seq, one.stamp_ns, one.state) == (other.seq, other.stamp_ns, other.state)
        assert one.image is not None
        assert np.array_equal(one.image, other.image)
        assert theirs.observe(picture=False).image is None
        ours.advance(AHEAD)
        theirs.advance(AHEAD)


def test_given_a_camera_when_a_step_is_observed_twice_then_its_picture_is_taken_once(
    file: Path,
) -> None:
    world = find_world(f'kmwh+{file}:Film').make(Scenario())
    first = world.observe().image
    assert first is not None
    assert np.array_equal(first, world.observe().image)
    world.advance(AHEAD)
    assert not np.array_equal(first, world.observe().image)


@pytest.mark.parametrize(('name', 'said'), [
    ('Small', r'^sim: simulator at step 1: .*\(20, 36, 3\) uint8, not \(200, 360, 3\)'),
    ('Broken', r'^sim: simulator at step 1: .*theirs.py:\d+: RuntimeError: lens cap'),
    ('Away', r'^timeout: simulator at step 1: nobody answers'),
])
def test_given_a_camera_that_fails_when_a_picture_is_taken_then_the_step_has_none(
    name: str, said: str, file: Path
) -> None:
    world = find_world(f'kmwh+{file}:{name}').make(Scenario())
    assert world.observe(picture=False).image is None
    world.advance(AHEAD)
    with pytest.raises(InfraError, match=said):
        world.observe()


def test_given_a_value_that_a_camera_does_not_show_when_a_run_is_made_then_it_is_refused(
    file: Path,
) -> None:
    rainy = Scenario(rain_fraction=0.5, clouds='stratus', shadows=False)
    with pytest.raises(UsageError, match=r'does not show clouds, rain_percent, shadows, which'):
        find_world(f'kmwh+{file}:Film').make(rainy)
    assert find_world(f'kmwh+{file}:Ours').make(rainy).last_seq == rainy.duration_ns // 100_000_000


def test_given_a_run_when_it_ends_then_its_camera_is_closed_once(file: Path) -> None:
    chosen = find_world(f'kmwh+{file}:Ours')
    world = chosen.make(Scenario())
    with closing(world):
        world.observe()
    with closing(chosen.make(Scenario())):
        pass  # which took no picture
    assert chosen.renderer is not None
    maker = chosen.renderer._make
    assert len(maker.__init__.__globals__['CLOSED']) == 1  # type: ignore[misc]


@pytest.fixture
def film(file: Path) -> str:
    return f'kmwh+{file}:Film'


def test_given_pictures_that_cannot_be_taken_again_when_a_run_is_kept_then_they_are_too(
    film: str, tmp_path: Path
) -> None:
    run = tx.run(Scenario(duration_s=0.5), perception='taxinet', world=film)
    frames = list(run.frames())
    assert len(frames) == 6
    assert np.array_equal(run.frame(3), frames[3])
    whole = open_recording(run.save_bag(tmp_path / 'whole'))
    assert all(
        np.array_equal(one.image, other) for one, other in zip(whole.frames(), frames, strict=True)
    )
    assert whole.run.world == film
    bare = open_recording(run.save_bag(tmp_path / 'bare', images=False))
    with pytest.raises(WorldDiffers, match=r'step 0 has no recorded frame: camera .* does'):
        list(bare.frames())
    assert [now.seq for now in bare.observations(lambda seq: False)] == list(range(6))


def test_given_pictures_that_cannot_be_taken_again_when_runs_are_asked_for_then_all_are_recorded(
    film: str, tmp_path: Path
) -> None:
    options = make_options(
        program='nominal', runs=1, seed=0, perception='taxinet', settings=(), specs=(),
        out=tmp_path / 'c', processes=False, images='none', world=film,
    )
    assert options.images == 'all'
    told = options.check(Scenario(), tuple).warnings
    assert any('every frame is recorded' in line for line in told)
    facts = facts_of_runs(options, {})
    assert recorded_world(facts) == (film, find_world(film).fingerprint)


def test_given_a_changed_file_when_its_world_is_found_again_then_it_is_refused(
    film: str, file: Path
) -> None:
    before = find_world(film).fingerprint
    assert len(before) == 64
    file.write_text(THEIRS + '# changed\n')
    with pytest.raises(UsageError, match=r'is [0-9a-f]{12} now, it was'):
        find_world(film, before)


def test_given_another_camera_when_a_dataset_is_made_then_it_takes_the_pictures(
    file: Path, tmp_path: Path
) -> None:
    scene, name = Scenario(cross_track_m=2.0), f'{file}:Ours'
    image, truth = photograph(scene, camera=name)
    assert np.array_equal(image, Camera(scene).render(Aircraft(scene).state, 0))
    assert truth.cte_m == pytest.approx(2.0, abs=0.01)
    options = DatasetOptions(program='nominal', out=tmp_path, count=1, camera=name)
    assert options.request()['camera'] == name
    assert 'camera' not in dataclasses.replace(options, camera='ours').request()
    with pytest.raises(UsageError, match='varied: no effect with camera'):
        dataclasses.replace(options, varied=True)

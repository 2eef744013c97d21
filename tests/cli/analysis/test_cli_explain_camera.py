"""``taxinet explain --camera``: modified scenes by the camera that took the run's pictures."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Iterator
from pathlib import Path

import pytest

import taxinet_ros as tx
from taxinet_ros.analysis.report import pictures as picture_files
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.extras.flightgear import camera as flightgear_camera
from taxinet_ros.extras.flightgear import client
from taxinet_ros.extras.flightgear.scene import weather_of
from tests.extras.flightgear.flightgear_peer import FlightGearPeer, serving

SCENE = Scenario(
    place='bikf_10', time_of_day_s=13 * 3600.0, clouds='broken', cross_track_m=4.0,
    distance_m=600.0, duration_s=0.2,
)


class Peer(FlightGearPeer):
    """Its sun is where that of the time is which was set; clouds turn its pictures grey."""

    other = 0

    def step(self) -> None:
        time_s = self.properties['/sim/time/cur-time-override']
        for hour in (10, 13):
            weather = weather_of(dataclasses.replace(SCENE, time_of_day_s=hour * 3600.0))
            if weather.time_s == time_s:
                self.properties['/sun'] = weather.sun_angle_rad
        super().step()

    def picture(self):
        clear = self.shown['/environment/clouds/layer[0]/coverage'] == 'clear'
        return super().picture() // (1 if clear else 6) + self.other


@pytest.fixture(scope='module')
def served() -> Iterator[Peer]:
    peer = Peer()
    with serving(peer) as (host, port), pytest.MonkeyPatch.context() as patch:
        patch.setenv(client.ADDRESS, f'{host}:{port}')
        patch.setattr(flightgear_camera, '_POLLS', 12)
        patch.setattr(picture_files, 'DOTS_PER_INCH', 30)
        yield peer
        flightgear_camera._connection((host, port)).close()


@pytest.fixture
def peer(served: Peer) -> Peer:
    served.other = 0
    return served


@pytest.fixture(scope='module')
def bag(served: Peer, tmp_path_factory: pytest.TempPathFactory) -> Path:
    run = tx.run(SCENE, perception='taxinet', world='kmwh+flightgear')
    return run.save_bag(tmp_path_factory.mktemp('bags') / 'theirs')


@pytest.mark.nightly
def test_given_the_runs_camera_then_it_takes_the_moments_again_in_other_scenes(
    bag, peer, taxinet, tmp_path
):
    before = len(peer.requests)
    code, out, err = taxinet(
        'explain', bag, '--camera', 'flightgear', '--frames', 1, '--out', 'x'
    )
    assert (code, err) == (0, '')
    assert len(peer.requests) > before
    found = json.loads((tmp_path / 'x' / 'explain.json').read_text())
    assert found['recomputed']['equal'] is True
    assert [one['name'] for one in found['factors']] == ['overcast', 'clear', 'ten', 'easy']
    by_name = {one['name']: one['removed'] for one in found['factors']}
    # The peer's pictures depend on its clouds, and not on the hour.
    assert by_name['overcast'] == by_name['ten'] == 0.0
    assert by_name['clear'] == by_name['easy'] != 0.0
    assert found['taken_again'] == {'removed': 0.0, 'pictures_changed': [0.0]}
    assert found['not_changed'] == ['shadows', 'crossing', 'traffic']
    assert 'Not changed, as the camera flightgear does not show it: shadows, crossing, traf' in out
    assert 'Taken again unchanged by the camera flightgear, at most 0.0 % of the pixels' in out
    assert 'Not changed, as the camera' in (tmp_path / 'x' / 'explain.html').read_text()


@pytest.mark.nightly
def test_given_no_camera_then_recorded_frames_are_used_and_the_line_says_how_to_ask_it(
    bag, peer, taxinet, tmp_path
):
    before = len(peer.requests)
    code, out, err = taxinet('explain', bag, '--frames', 1, '--out', 'x', '--json')
    assert (code, err) == (0, '')
    assert len(peer.requests) == before, 'nobody is asked'
    found = json.loads(out)
    assert found['recomputed']['equal'] is True
    assert (found['factors'], found['taken_again'], found['not_changed']) == ([], None, [])
    assert any(
        'its pictures are of the camera flightgear, which takes others if named as camera'
        in one for one in found['sentences']
    ), found['sentences']
    assert 'Not available: its pictures are of' in (tmp_path / 'x' / 'explain.html').read_text()


@pytest.mark.nightly
def test_given_a_camera_whose_pictures_have_changed_since_then_no_cause_is_named(
    bag, peer, taxinet
):
    peer.other = 120
    code, out, err = taxinet(
        'explain', bag, '--camera', 'flightgear', '--frames', 1, '--out', 'x', '--json'
    )
    assert (code, err) == (0, '')
    found = json.loads(out)
    assert found['blamed'] is None
    assert found['factors'] == []
    assert found['taken_again']['pictures_changed'][0] > 0.9
    assert any(
        'the camera flightgear does not take the recorded pictures again: one differs by ' in one
        for one in found['sentences']
    ), found['sentences']


@pytest.mark.one_in(3)
@pytest.mark.parametrize(('camera', 'said'), [
    ('ours', 'are of the camera flightgear, and pictures of another one would differ in everyth'),
    ('xplane', 'leave it out, or take --camera flightgear'),
    ('nikon', "camera: 'nikon' is unknown; known: "),
])
def test_given_another_camera_then_it_is_refused_by_name(bag, taxinet, tmp_path, camera, said):
    code, out, err = taxinet('explain', bag, '--camera', camera, '--out', 'x')
    assert (code, out, err.count('\n')) == (2, '', 1)
    assert said in err
    assert not (tmp_path / 'x').exists()


def test_given_a_camera_that_is_gone_then_one_line_and_no_page(bag, taxinet, tmp_path, monkeypatch):
    monkeypatch.setenv(client.ADDRESS, '127.0.0.1:1')
    code, out, err = taxinet('explain', bag, '--camera', 'flightgear', '--out', 'x')
    assert (code, out, err.count('\n')) == (4, '', 1)
    assert 'not_ready: ' in err
    assert 'nobody answers at 127.0.0.1:1' in err
    assert not (tmp_path / 'x').exists()


def test_given_a_run_of_our_camera_then_flightgear_is_refused(taxinet, tmp_path):
    ours = tx.run(Scenario(duration_s=0.1), perception='taxinet').save_bag(tmp_path / 'ours')
    code, out, err = taxinet('explain', ours, '--camera', 'flightgear')
    assert (code, out, err.count('\n')) == (2, '', 1)
    assert 'are of the camera ours' in err

"""The Scenic child: scenes that depend on nothing else, and every way a program can be wrong."""

from __future__ import annotations

import math
import os
import random
import select
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from taxinet_ros.core.scenario_fields import by_key
from taxinet_ros.errors import InfraError, UsageError
from taxinet_ros.scenes import source as scene_source
from taxinet_ros.scenes.overrides import (
    apply_overrides,
    check_overrides,
    overrides_statement,
    without_idle,
)
from taxinet_ros.scenes.source import Rejected, SceneSource, sample_scenarios
from taxinet_ros.trials.campaign import exit_code
from taxinet_ros.trials.options import CampaignOptions
from taxinet_ros.trials.record.book import rejected_row
from taxinet_ros.trials.summary import Summary

PLANE = 'model runway_world\nego = new Plane at (Range(-1, 1), 400)\n'


def test_given_scenes_when_drawn_in_another_order_and_process_then_they_are_the_same() -> None:
    with SceneSource('s_falsif', seed=7) as source:
        forward = [source.scene(index) for index in range(12)]
        again = [source.scene(index) for index in (11, 0, 5)]
    assert again == [forward[11], forward[0], forward[5]]
    assert len(set(forward)) == 12
    random.seed(1)
    assert sample_scenarios('s_falsif', 7, 12) == forward
    assert not set(sample_scenarios('s_falsif', 8, 12)) & set(forward)


@pytest.mark.one_in(3)
@pytest.mark.parametrize('cause', [
    # (program, what is said of it after its name)
    ('model runway_world\nego = new Plane at (0,\nparam x = 1\n', ':3: invalid syntax'),
    ('import os\nmodel runway_world\nprint("{}")\nos._exit(3)\n',
     ': the Scenic process ended with status 3'),
    ('import os\nos.abort()\n', ': the Scenic process was ended by SIGABRT'),
    (PLANE + 'param fog = 3\n', ':3: param fog: unknown, so it has no effect; known: clouds'),
    (PLANE + 'param wind_direction = 90\n',
     ': scene 0: wind_direction_deg has no effect without wind_speed_mps'),
    (PLANE + 'param rain = 30\n', ': scene 0: rain needs clouds'),
], ids=lambda cause: cause[1][:30])
def test_given_a_bad_program_when_used_then_one_line_says_what_and_where(
    cause: tuple[str, str], write: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    path = write(cause[0])
    with pytest.raises(UsageError) as caught, SceneSource(path, seed=1) as source:
        source.scene(0)
    assert str(caught.value).startswith(f'mine.scenic{cause[1]}')
    assert '\n' not in str(caught.value)


def test_given_a_loop_that_swallows_everything_when_compiled_then_it_is_killed(
    write: Any, monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(scene_source, 'GRACE_S', 0.5)
    stubborn = 'while True:\n    try:\n        while True:\n            pass\n' \
               '    except BaseException:\n        pass\n'
    path = write(PLANE + stubborn)
    # Still running: the interrupt met it just outside its `try`, as it may on a busy machine.
    with pytest.raises(UsageError, match=r'hung for|ended by SIGXCPU|still running after'), \
            SceneSource(path, seed=1, timeout_s=0.5):
        pass


def test_given_two_programs_then_one_server_has_imported_scenic_and_nothing_of_the_first_stays(
    write: Any,
) -> None:
    with SceneSource(write(f'import math\nmath.pi = 3.0\n{PLANE}'), seed=1) as first:
        assert first._child is not None
        server = first._child._server
        text = 'import math\nmodel runway_world\nego = new Plane at (math.pi, 400)\n'
        with SceneSource(write(text), seed=1) as other:
            assert other._child is not None
            assert other._child._server is server
            assert other._child.pid != first._child.pid
            assert other.scene(0).cross_track_m == -math.pi
            first.scene(0)
    assert not server.process.dead


@pytest.mark.parametrize('victim', ['server', 'child'])
def test_f10_given_a_process_that_somebody_kills_then_the_bench_is_broken_and_not_the_program(
    victim: str,
) -> None:
    with SceneSource('nominal', seed=1) as source:
        before, child = source.scene(0), source._child
        assert child is not None
        process = child._server.process if victim == 'server' else child
        process.kill()
        process.wait()
        with pytest.raises(InfraError, match='killed by SIGKILL'):
            [source.scene(index) for index in range(1, 1000)]
    with SceneSource('nominal', seed=1) as source:
        assert source.scene(0) == before


def test_f6_given_closed_standard_streams_then_scenes_are_drawn_all_the_same(
    tmp_path: Path,
) -> None:
    script = (
        'import os\nos.closerange(0, 3)\n'
        'from taxinet_ros.scenes.source import sample_scenarios\n'
        f'open({str(tmp_path / "drawn")!r}, "w").write(str(sample_scenarios("nominal", 3, 2)))\n'
    )
    done = subprocess.run([sys.executable, '-c', script])
    assert done.returncode == 0
    assert (tmp_path / 'drawn').read_text() == str(sample_scenarios('nominal', 3, 2))


def test_given_a_requirement_that_cannot_hold_when_drawn_then_it_is_rejected_not_an_error(
    write: Any,
) -> None:
    path = write(PLANE + 'require ego.position.x > 2\n')
    with SceneSource(path, seed=1) as source:
        for index in (0, 1):  # the source stays usable
            with pytest.raises(Rejected) as caught:
                source.scene(index)
            assert caught.value.refused == 2000
            assert str(caught.value) == (
                f'mine.scenic: scene {index}: no draw met the requirements in 2000 tries'
            )


def test_given_a_parent_that_is_killed_when_its_child_is_in_a_loop_then_the_child_ends_too(
    write: Any,
) -> None:
    text = 'import os, sys\nprint(os.getpid(), flush=True)\nwhile True:\n    pass\n'
    script = 'import sys\nfrom taxinet_ros.scenes.source import SceneSource\n' \
             'SceneSource(sys.argv[1], seed=1).__enter__()\n'
    parent = subprocess.Popen(
        [sys.executable, '-c', script, str(write(text))], stderr=subprocess.PIPE,
        env={**os.environ, 'PYTHONPATH': str(Path(__file__).parents[3])},
    )
    with parent:
        assert parent.stderr is not None
        child = os.pidfd_open(int(parent.stderr.readline()))
        assert not select.select([child], [], [], 0)[0], 'the child has to be alive first'
        parent.kill()
        ended = select.select([child], [], [])[0]
    os.close(child)
    assert ended


def test_given_a_track_when_drawn_then_the_plane_stands_along_it(write: Any) -> None:
    path = write(
        'model runway_world\nparam track = "exit_left"\n'
        'ego = new Plane at (Range(-2, -1), 300), facing 10 deg\n'
    )
    for one in sample_scenarios(path, 1, 3):
        assert (one.track, one.distance_m) == ('exit_left', 300)
        assert 1 <= one.cross_track_m <= 2
    with pytest.raises(UsageError, match="scene 0: track is 'exit', not one of runway, exit_left"):
        sample_scenarios(path, 1, 1, {'track': 'exit'})
    with pytest.raises(UsageError, match=r'outside 0\.\.417 m along exit_left, at track exit_left'):
        sample_scenarios(path, 1, 1, {'distance': '418'})


def test_given_tracks_by_chance_when_a_start_lies_beyond_one_then_only_that_scene_is_rejected(
    write: Any,
) -> None:
    path = write(
        'model runway_world\nparam track = Uniform("runway", "exit_left")\n'
        'ego = new Plane at (0, Range(300, 900))\n'
    )
    drawn, rejected = [], 0
    with SceneSource(path, seed=1) as source:
        for index in range(12):
            try:
                drawn.append(source.scene(index))
            except Rejected:
                rejected += 1
    assert {one.track for one in drawn} == {'runway', 'exit_left'}
    assert max(one.distance_m for one in drawn if one.track == 'exit_left') <= 417
    assert len(drawn) + rejected == 12


def test_given_overrides_that_need_others_when_all_are_there_then_the_scenes_have_them() -> None:
    wind = {'wind_speed': '6', 'wind_direction': '324', 'gust': '1', 'gust_seed': '4'}
    for one in sample_scenarios('nominal', 1, 2, {**wind, 'slope': '-1', 'runway_state': 'icy'}):
        assert (one.wind_speed_mps, one.gust_mps, one.gust_seed) == (6.0, 1.0, 4.0)
        assert (one.wind_direction_rad, one.slope_fraction) == (np.radians(324), -0.01)
        assert one.surface == 'icy'
    for alone in ('wind_direction', 'gust_seed'):
        with pytest.raises(UsageError, match=rf'scene 0: {alone}.* has no effect without'):
            sample_scenarios('nominal', 1, 1, {alone: wind[alone]})


def test_a_programs_own_overrides_have_exactly_the_effect_of_set(
    write: Any, tmp_path: Path
) -> None:
    (tmp_path / 'others.yaml').write_text('objects:\n  - {kind: cone, x_m: 690, y_m: 2}\n')
    overrides = {
        'clouds': 'stratus', 'rain': '40', 'cross_track': '3',
        'traffic': str(tmp_path / 'others.yaml'),
    }
    text = (
        'model runway_world\nparam zulu_time = Range(50000, 60000)\n'
        "param clouds = Uniform('clear', 'cirrus')\nspot = Range(300, 400)\n"
        'ego = new Plane at (Range(-5, 0), spot), facing Range(-9, 9) deg\n'
        'new Cone at (2, spot + 40)\nrequire ego.cross_track_m > 2\n'
    )
    plain, own = write(text), tmp_path / 'own.scenic'
    own.write_text(f"{text}{overrides_statement(overrides)}param overrides = {{'rain': 60}}\n")
    with (
        SceneSource(plain, seed=3, overrides={**overrides, 'rain': '60'}) as one,
        SceneSource(own, seed=3) as other,
        SceneSource(own, seed=3, overrides={'rain': '5'}) as more,
    ):
        assert one.space() == other.space()
        assert one.search_space().fixed == other.search_space().fixed != frozenset()
        assert [one.scene(index) for index in range(4)] == [
            other.scene(index) for index in range(4)]
        assert {source.scene(0).rain_fraction for source in (other, more)} == {0.6, 0.05}


def test_given_overrides_when_drawn_then_only_they_differ() -> None:
    overrides = {'heading': '12.5', 'shadows': 'off', 'clouds': 'stratus', 'duration': '5'}
    plain = sample_scenarios('s_falsif', 3, 6)
    changed = sample_scenarios('s_falsif', 3, 6, overrides)
    assert [scene.cross_track_m for scene in changed] == [scene.cross_track_m for scene in plain]
    assert [scene.rain_fraction for scene in changed] == [scene.rain_fraction for scene in plain]
    assert {scene.heading_rad for scene in changed} == {np.radians(12.5)}
    assert {(s.shadows, s.clouds, s.duration_s) for s in changed} == {(False, 'stratus', 5.0)}


@pytest.mark.parametrize(('overrides', 'remedy'), [
    ({'clouds': 'clear'}, 'set rain_percent=0 as well'),
    ({'rain': '50'}, 'set clouds=broken (or overcast/stratus) as well'),
])
def test_given_half_of_the_weather_when_overridden_then_both_keys_are_named_at_the_start(
    overrides: dict[str, str], remedy: str,
) -> None:
    with pytest.raises(UsageError) as caught, \
            SceneSource('s_falsif', seed=1, overrides=overrides):
        pytest.fail('the contradiction has to show before the first run')
    key, value = next(iter(by_key(overrides).items()))
    assert str(caught.value).startswith(f'override {key}={value}: s_falsif.scenic: scene ')
    assert str(caught.value).endswith(remedy)


def test_given_both_halves_of_the_weather_when_overridden_then_all_scenes_have_them() -> None:
    scenes = sample_scenarios('s_falsif', 1, 30, {'clouds': 'clear', 'rain': '0'})
    assert {(scene.clouds, scene.rain_fraction) for scene in scenes} == {('clear', 0.0)}


@pytest.mark.parametrize(('overrides', 'message'), [
    ({'fog': '1'}, "override fog=1: unknown key 'fog'; known: cross_track_m"),
    ({'heading': 'left'}, "override heading_deg=left: heading_deg needs a number, got 'left'"),
    ({'cross_track': '99'}, 'override cross_track_m=99: cross_track_m is 99, outside -40..40 m'),
    ({'rain': '120'}, 'override rain_percent=120: rain_percent is 120, outside 0..100 %'),
    ({'rain': '0', 'rain_percent': '0'}, 'scenario: rain and rain_percent are the same'),
    ({'rain': '50', 'clouds': 'clear'}, 'override clouds=clear rain_percent=50: rain needs'),
    ({'distance': 'nan'}, 'override distance_m=nan: distance_m is nan'),
])
def test_given_a_bad_override_when_checked_then_one_line_names_it(
    overrides: dict[str, str], message: str,
) -> None:
    with pytest.raises(UsageError) as caught:
        check_overrides(overrides)
    assert str(caught.value).startswith(message)


def test_given_rain_words_when_overridden_over_dry_draw_then_the_sum_is_checked() -> None:
    scene = apply_overrides({'clouds': 'overcast'}, {'rain_percent': '40'}, 'x')
    assert (scene.clouds, scene.rain_fraction) == ('overcast', pytest.approx(0.4))


@pytest.mark.parametrize('seed', [-1, 1 << 63])
def test_given_an_impossible_seed_when_made_then_it_is_refused(seed: int) -> None:
    with pytest.raises(UsageError, match='seed is'):
        SceneSource('s_falsif', seed=seed)


def test_given_no_with_statement_when_asked_then_it_says_so() -> None:
    with pytest.raises(RuntimeError, match='with statement'):
        SceneSource('s_falsif', seed=1).scene(0)


WORLD = 'model runway_world\n'
OFF_CENTRE = WORLD + 'ego = new Plane at (Normal(0, 8), 400)\n'
INDEPENDENT = (WORLD + 'param clouds = Uniform("clear", "broken")\nparam rain = Range(20, 30)\n'
               'ego = new Plane at (0, 400)\n')


@pytest.mark.one_in(3)
@pytest.mark.parametrize(('text', 'reason', 'share'), [
    (OFF_CENTRE, 'cross_track_m is', 0.06),
    (INDEPENDENT, "rain needs clouds broken/overcast/stratus, got 'clear'", 0.5),
    (PLANE + 'param duration = Uniform(3, 3.01)\n', 'is not a multiple of the control period', 0.5),
], ids=['beside the runway', 'rain from a clear sky', 'broken step'])
def test_s6_given_a_draw_that_is_no_scenario_then_that_scene_alone_is_rejected(
    write: Any, text: str, reason: str, share: float,
) -> None:
    path = write(text)
    chance = np.random.default_rng(0)
    with SceneSource(path, seed=0) as source:
        space = source.space()
        points = [space.point(chance.random(len(space))) for _ in range(100)]
        for where in ([None] * 100, points):  # drawn, and searched
            rejected = []
            for index, point in enumerate(where):
                try:
                    source.scene(index, point)
                except Rejected as error:
                    rejected.append((index, error))
            assert abs(len(rejected) - 100 * share) < 18
            assert len(rejected) >= 1
            for index, error in rejected:
                assert type(error) is Rejected, 'no other point is to be tried'
                assert reason in str(error)
                assert str(error).startswith(f'mine.scenic: scene {index}: ')


def test_values_that_have_no_effect_in_some_scenes_reject_none_of_them(write: Any) -> None:
    text = PLANE + (
        'param wind_direction = Range(10, 350)\nparam wind_speed = Uniform(0, 5)\n'
        'param gust = Uniform(0, 1)\nparam gust_seed = DiscreteRange(1, 99)\n'
        'param lens_dirt = Uniform(0, 20)\nparam fault_seed = 7\nparam fault_onset = 3\n'
    )
    with SceneSource(write(text), seed=0) as source:
        scenes = [source.scene(index) for index in range(24)]
    for attribute, needs in (
        ('wind_direction_rad', 'wind_speed_mps'), ('gust_seed', 'gust_mps'),
        ('fault_seed', 'lens_dirt_fraction'), ('fault_onset_s', 'lens_dirt_fraction'),
    ):
        effects = {(getattr(scene, attribute) > 0, getattr(scene, needs) > 0) for scene in scenes}
        assert effects == {(True, True), (False, False)}


@pytest.mark.parametrize(('overrides', 'changing', 'kept'), [
    ({}, {'wind_speed_mps'}, False),
    ({'wind_speed_mps': '0'}, {'wind_direction_deg'}, False),
    ({'wind_speed_mps': '0.0'}, {'wind_direction_deg'}, False),
    ({'wind_speed_mps': '5'}, {'wind_direction_deg'}, True),
    ({}, {'wind_direction_deg'}, True),
    ({'wind_direction_deg': '90'}, {'wind_speed_mps'}, True),
])
def test_a_wind_direction_that_has_no_effect_in_any_scene_or_is_typed_stays_to_be_refused(
    overrides: dict[str, str], changing: set[str], kept: bool,
) -> None:
    drawn = {'wind_direction_deg': 40.0, 'wind_speed_mps': 0.0, 'rain_percent': 3.0}
    found = without_idle(drawn, overrides, changing)
    assert found == {key: value for key, value in drawn.items()
                     if kept or key != 'wind_direction_deg'}


@pytest.mark.one_in(3)
@pytest.mark.parametrize(('text', 'message'), [
    (WORLD + 'ego = new Plane at (16, Range(0, 9))\n', 'cross_track_m is -16'),
    (INDEPENDENT.replace('Uniform("clear", "broken")', '"clear"').replace('Range(20, 30)', '20'),
     'rain needs clouds'),
    (PLANE + 'param clouds = "purple"\nparam rain = Range(0, 90)\n', "clouds is 'purple'"),
    (PLANE + 'param duration = 1.01\n', 'not a multiple'),
    (PLANE + 'param wind = Range(0, 1)\n', 'wind'),
    (PLANE + 'param clouds = Uniform("clear", "purple")\n', "clouds is 'purple', not one of"),
])
def test_s6_given_what_is_wrong_in_every_scene_then_it_is_an_error_at_once(
    write: Any, text: str, message: str,
) -> None:
    with pytest.raises(UsageError, match=message), \
            SceneSource(write(text), seed=0) as source:
        source.scene(0)


def test_s6_given_an_override_of_what_is_drawn_out_of_range_then_nothing_is_rejected(
    write: Any,
) -> None:
    path = write(OFF_CENTRE + 'param rain = Range(500, 900)\nparam clouds = "broken"\n')
    with SceneSource(path, seed=0, overrides={'rain': '20', 'cross_track': '3'}) as source:
        assert {(scene.rain_fraction, scene.cross_track_m)
                for scene in (source.scene(index) for index in range(50))} == {(0.2, 3.0)}


@pytest.mark.parametrize(('duration', 'overrides', 'length_s'), [
    ('1', {}, 1.0), ('Range(3, 9)', {'duration': '2'}, 2.0),
])
def test_s5_attack_the_length_is_known_where_the_first_scene_is_rejected(
    write: Any, duration: str, overrides: dict[str, str], length_s: float,
) -> None:
    text = (f'{WORLD}param duration = {duration}\n'
            'ego = new Plane at (Options({0: 1, 300: 1}), 400)\n')
    for seed in range(40):
        with SceneSource(write(text), seed=seed, overrides=overrides) as source:
            try:
                source.scene(0)
            except Rejected:
                assert scene_source.first_scene(source).duration_s == length_s
                return
    pytest.fail('no first scene was rejected')


def test_s5_attack_given_no_run_could_be_judged_then_the_first_reason_is_said(
    tmp_path: Path,
) -> None:
    options = CampaignOptions(
        program='nominal', out=tmp_path, runs=2, seed=0, perception='none',
    )
    rows = [rejected_row(options, index, f'scene {index}: beside the runway') for index in (0, 1)]
    with pytest.raises(UsageError, match='was rejected; the first: scene 0: beside the runway'):
        exit_code(Summary(rows))


_LOW = 'camera_dz_m: the camera low.yaml has an offset of its own; leave one out'


@pytest.mark.one_in(3)
@pytest.mark.parametrize(('camera', 'lines', 'overrides'), [
    ("'low.yaml'", '', {'camera_dz_m': '0'}), ("'low.yaml'", '', {'camera_dz_m': '0.05'}),
    ("'low.yaml'", 'param camera_dz_m = 0\n', {}),
    ("'low.yaml'", 'param camera_dz_m = Range(0, 0.1)\n', {}),
    ("'low.yaml'", "param overrides = {'camera_dz_m': 0}\n", {}),
    ("Uniform('wing', 'low.yaml')", '', {'camera_dz_m': '0'}),
])
def test_an_offset_that_a_moved_camera_of_the_program_has_itself_is_refused_by_name(
    write: Any, tmp_path: Path, camera: str, lines: str, overrides: dict[str, str],
) -> None:
    (tmp_path / 'low.yaml').write_text('{base: wing, dz_m: -0.1}')
    path = write(PLANE + (
        f'param camera = {camera}\nparam camera_dpitch_deg = Range(-2, 2)\n{lines}'))
    with pytest.raises(UsageError, match=rf'^mine.scenic: scene \d+: {_LOW}'):
        sample_scenarios(path, 1, 1, overrides)


def test_offsets_that_a_moved_camera_of_the_program_has_not_are_added_to_its_own(
    write: Any, tmp_path: Path,
) -> None:
    (tmp_path / 'low.yaml').write_text('{base: wing, dz_m: -0.1}')
    path = write(PLANE + (
        "param camera = 'low.yaml'\nparam camera_dpitch_deg = Range(-2, 2)\n"))
    (scene,) = sample_scenarios(path, 1, 1, {'camera_dx_m': '0.05'})
    assert (scene.camera_dx_m, scene.camera_dz_m) == (0.05, -0.1)
    assert scene.camera_dpitch_rad != 0

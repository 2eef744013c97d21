"""The Scenic child: scenes that depend on nothing else, and every way a program can be wrong."""

from __future__ import annotations

import os
import random
import select
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from taxinet_ros.campaign import scene_source
from taxinet_ros.campaign.overrides import apply_overrides, check_overrides
from taxinet_ros.campaign.scene_source import Rejected, SceneSource, sample_scenarios
from taxinet_ros.core.errors import UsageError

PLANE = 'model runway_world\nego = new Plane at (Range(-1, 1), 400)\n'


def write(folder: Path, text: str) -> Path:
    path = folder / 'mine.scenic'
    path.write_text(text)
    return path


def test_given_scenes_when_drawn_in_another_order_and_process_then_they_are_the_same() -> None:
    with SceneSource('s_falsif', seed=7) as source:
        forward = [source.scene(index) for index in range(12)]
        again = [source.scene(index) for index in (11, 0, 5)]
    assert again == [forward[11], forward[0], forward[5]]
    assert len(set(forward)) == 12
    random.seed(1)
    assert sample_scenarios('s_falsif', 7, 12) == forward
    assert not set(sample_scenarios('s_falsif', 8, 12)) & set(forward)


@pytest.mark.parametrize('cause', [
    # (program, what is said of it after its name)
    ('model runway_world\nego = new Plane at (0,\nparam x = 1\n', ':3: invalid syntax'),
    ('import os\nmodel runway_world\nprint("{}")\nos._exit(3)\n',
     ': the Scenic process ended with status 3'),
    (PLANE + 'param wind = 3\n', ':3: param wind: unknown, so it has no effect; known: clouds'),
    (PLANE + 'param rain = 30\n', ': scene 0: rain needs clouds'),
], ids=lambda cause: cause[1][:30])
def test_given_a_bad_program_when_used_then_one_line_says_what_and_where(
    cause: tuple[str, str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    path = write(tmp_path, cause[0])
    with pytest.raises(UsageError) as caught, SceneSource(path, seed=1) as source:
        source.scene(0)
    assert str(caught.value).startswith(f'mine.scenic{cause[1]}')
    assert '\n' not in str(caught.value)


def test_given_a_loop_that_swallows_everything_when_compiled_then_it_is_killed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(scene_source, 'GRACE_S', 0.5)
    stubborn = 'while True:\n    try:\n        while True:\n            pass\n' \
               '    except BaseException:\n        pass\n'
    path = write(tmp_path, PLANE + stubborn)
    with pytest.raises(UsageError, match=r'hung for|ended by SIGXCPU'), \
            SceneSource(path, seed=1, timeout_s=0.5):
        pass


def test_given_a_requirement_that_cannot_hold_when_drawn_then_it_is_rejected_not_an_error(
    tmp_path: Path,
) -> None:
    path = write(tmp_path, PLANE + 'require ego.position.x > 2\n')
    with SceneSource(path, seed=1) as source:
        for index in (0, 1):  # the source stays usable
            with pytest.raises(Rejected) as caught:
                source.scene(index)
            assert (caught.value.index, caught.value.iterations) == (index, 2000)


def test_given_a_requirement_that_may_hold_when_drawn_then_it_holds(tmp_path: Path) -> None:
    path = write(tmp_path, PLANE + 'require ego.position.x > 0.5\n')
    scenes = sample_scenarios(path, 1, 20)
    assert len(scenes) == 20
    assert all(-1 <= scene.cross_track_m < -0.5 for scene in scenes)


def test_given_a_parent_that_is_killed_when_its_child_is_in_a_loop_then_the_child_ends_too(
    tmp_path: Path,
) -> None:
    text = 'import os, sys\nprint(os.getpid(), flush=True)\nwhile True:\n    pass\n'
    script = 'import sys\nfrom taxinet_ros.campaign.scene_source import SceneSource\n' \
             'SceneSource(sys.argv[1], seed=1).__enter__()\n'
    parent = subprocess.Popen(
        [sys.executable, '-c', script, str(write(tmp_path, text))], stderr=subprocess.PIPE,
        env={**os.environ, 'PYTHONPATH': str(Path(__file__).parents[2])},
    )
    with parent:
        assert parent.stderr is not None
        child = os.pidfd_open(int(parent.stderr.readline()))
        assert not select.select([child], [], [], 0)[0], 'the child has to be alive first'
        parent.kill()
        ended = select.select([child], [], [], 30)[0]
    os.close(child)
    assert ended


def test_given_overrides_when_drawn_then_only_they_differ() -> None:
    overrides = {'heading': '12.5', 'shadows': 'off', 'clouds': 'stratus', 'duration': '5'}
    plain = sample_scenarios('s_falsif', 3, 6)
    changed = sample_scenarios('s_falsif', 3, 6, overrides)
    assert [scene.cross_track_m for scene in changed] == [scene.cross_track_m for scene in plain]
    assert [scene.rain for scene in changed] == [scene.rain for scene in plain]
    assert {scene.heading_rad for scene in changed} == {np.radians(12.5)}
    assert {(s.shadows, s.clouds, s.duration_s) for s in changed} == {(False, 'stratus', 5.0)}


@pytest.mark.parametrize(('overrides', 'remedy'), [
    ({'clouds': 'clear'}, 'set rain=0 as well'),
    ({'rain': '50'}, 'set clouds=broken (or overcast/stratus) as well'),
])
def test_given_half_of_the_weather_when_overridden_then_both_keys_are_named_at_the_start(
    overrides: dict[str, str], remedy: str,
) -> None:
    with pytest.raises(UsageError) as caught, \
            SceneSource('s_falsif', seed=1, overrides=overrides):
        pytest.fail('the contradiction has to show before the first run')
    key, value = next(iter(overrides.items()))
    assert str(caught.value).startswith(f'override {key}={value}: s_falsif.scenic: scene ')
    assert str(caught.value).endswith(remedy)


def test_given_both_halves_of_the_weather_when_overridden_then_all_scenes_have_them() -> None:
    scenes = sample_scenarios('s_falsif', 1, 30, {'clouds': 'clear', 'rain': '0'})
    assert {(scene.clouds, scene.rain) for scene in scenes} == {('clear', 0.0)}


@pytest.mark.parametrize(('overrides', 'message'), [
    ({'fog': '1'}, "override fog=1: unknown key 'fog'; known: cross_track"),
    ({'heading': 'left'}, "override heading=left: heading needs a number, got 'left'"),
    ({'cross_track': '99'}, 'override cross_track=99: cross_track_m is 99, outside -15..15'),
    ({'rain': '120'}, 'override rain=120: rain is 1.2, outside 0..1'),
    ({'rain': '50', 'clouds': 'clear'}, 'override clouds=clear rain=50: rain needs clouds'),
    ({'distance': 'nan'}, 'override distance=nan: distance_m is nan'),
])
def test_given_a_bad_override_when_checked_then_one_line_names_it(
    overrides: dict[str, str], message: str,
) -> None:
    with pytest.raises(UsageError) as caught:
        check_overrides(overrides)
    assert str(caught.value).startswith(message)


def test_given_rain_words_when_overridden_over_dry_draw_then_the_sum_is_checked() -> None:
    scene = apply_overrides({'clouds': 'overcast'}, {'rain': '40'}, 'x')
    assert (scene.clouds, scene.rain) == ('overcast', pytest.approx(0.4))


@pytest.mark.parametrize('seed', [-1, 1 << 63])
def test_given_an_impossible_seed_when_made_then_it_is_refused(seed: int) -> None:
    with pytest.raises(UsageError, match='seed is'):
        SceneSource('s_falsif', seed=seed)


def test_given_no_with_statement_when_asked_then_it_says_so() -> None:
    with pytest.raises(RuntimeError, match='with statement'):
        SceneSource('s_falsif', seed=1).scene(0)

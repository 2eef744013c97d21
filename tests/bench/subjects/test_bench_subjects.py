from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from pathlib import Path

import cv2
import pytest

from taxinet_ros.bench import run as bench_run
from taxinet_ros.bench.run import SUBJECTS, WITH_ROS, run_subjects
from taxinet_ros.bench.subjects import monitor
from taxinet_ros.bench.subjects.components import SCENES, SUM
from taxinet_ros.campaign.samplers.registry import SAMPLERS
from taxinet_ros.core.camera.camera import STAGES
from taxinet_ros.core.mtl.specs import SHIPPED
from taxinet_ros.errors import UsageError

pytestmark = pytest.mark.nightly


@pytest.fixture(autouse=True)
def threads() -> Iterator[None]:
    """The bench takes OpenCV's threads away from the process that runs it."""
    before = cv2.getNumThreads()
    yield
    cv2.setNumThreads(before)


def figures(*words: str, repeats: int = 3) -> dict[str, dict[str, float]]:
    return run_subjects(words, repeats, lambda done, total: None)['figures']


def test_given_the_camera_when_measured_then_every_scene_has_its_stages_and_their_sum() -> None:
    found = figures('camera', repeats=5)

    stages: set[str] = set()
    for name in SCENES:
        whole = f'camera/{name}'
        of_it = {key.removeprefix(f'{whole}/') for key in found if key.startswith(f'{whole}/')}
        assert of_it <= {*STAGES, SUM}
        assert {'ground', 'atmosphere', SUM} <= of_it
        stages |= of_it - {SUM}
        assert found[f'{whole}/{SUM}']['min_s'] > 0
    assert stages == set(STAGES)
    assert found['camera/textures']['repeats'] <= 3
    assert found['camera/new, dry']['repeats'] == 5


def test_given_physics_and_monitor_when_measured_then_each_has_its_figures(monkeypatch) -> None:
    for word in ('10k', '100k'):
        monkeypatch.setitem(monitor.LENGTHS, word, 1_000)
    found = figures('monitor', 'physics')

    names = [f'monitor/{spec} {kind}' for spec in SHIPPED for kind in ('sample', 'offline')]
    physics = [f'physics/{what}{pushed}' for what in ('control step', 'new')
               for pushed in ('', ', wind', ', gusts', ', wet, uphill')]
    assert list(found)[: len(physics) + len(names)] == [*physics, *names]
    longer = {f'monitor/{spec} {kind} of {length}' for spec in ('phi_always', 'phi_eventually')
              for kind in ('sample', 'offline') for length in ('1k', '10k', '100k')}  # fmt: skip
    wider = {f'monitor/window of {seconds} s sample of 10k' for seconds in (10, 100, 1000)}
    nested = {f'monitor/{name} sample of {length}'
              for name in ('G F', 'G or F', 'F G F', '12 until')
              for length in ('1k', '10k')}  # fmt: skip
    assert set(found) == {*physics, *names} | longer | wider | nested
    assert all(figure['median_s'] > 0 for figure in found.values())
    step = found['physics/control step']
    assert step['real_time_factor'] == pytest.approx(0.1 / step['median_s'])


def test_given_network_and_loop_when_measured_then_there_are_halves_and_real_time_factors() -> None:
    found = figures('inference', 'loop', repeats=1)

    assert list(found) == [
        'inference/estimate', 'inference/preprocessing', 'inference/network',
        'loop/truth', 'loop/network',
    ]  # fmt: skip
    assert found['loop/truth']['real_time_factor'] == pytest.approx(
        30 / found['loop/truth']['median_s']
    )
    assert found['loop/network']['median_s'] > found['loop/truth']['median_s']


def test_given_the_samplers_when_measured_then_each_has_its_figure() -> None:
    found = figures('samplers', repeats=1)

    assert list(found) == [f'samplers/{word}' for word in SAMPLERS]
    assert all(figure['median_s'] > 0 for figure in found.values())


def test_given_no_word_when_measured_then_every_subject_is_asked(monkeypatch) -> None:
    asked: list[str] = []
    for word in SUBJECTS:
        monkeypatch.setitem(SUBJECTS, word, lambda word=word: asked.append(word) or [])
    for word in WITH_ROS:
        monkeypatch.setitem(
            WITH_ROS, word, lambda stack, amounts, word=word: asked.append(word) or []
        )
    for words in ((), ('all',), ('all', 'physics')):
        asked.clear()
        assert figures(*words) == {}
        assert asked == [*SUBJECTS, 'graph', 'start-up']
    asked.clear()
    assert figures('campaign', 'graph') == {}
    assert asked == ['loop', 'graph', 'campaign']


def test_given_no_ros_when_measured_then_all_leaves_out_what_needs_it_and_says_so(
    monkeypatch
) -> None:
    monkeypatch.setattr(bench_run, 'find_spec', lambda name: None)
    for word in SUBJECTS:
        monkeypatch.setitem(SUBJECTS, word, list)
    report = run_subjects([], 1, lambda done, total: None)
    assert report['left_out'] == {'graph': 'no rclpy', 'start-up': 'no rclpy'}
    with pytest.raises(UsageError, match='start-up needs ROS 2, and this Python has no rclpy'):
        run_subjects(['start-up'], 1, lambda done, total: None)


@pytest.mark.parametrize(
    ('words', 'repeats', 'message'),
    [
        (['camera', 'cameras'], 3, r"'cameras' is unknown; known: camera, .*, campaign, all"),
        ([], 0, r'--repeats is 0, needs to be 1 or more'),
    ],
)
def test_given_bad_options_when_run_then_they_are_refused(
    words: list[str], repeats: int, message: str
) -> None:
    with pytest.raises(UsageError, match=message):
        run_subjects(words, repeats, lambda done, total: None)


@pytest.fixture
def peer_python(tmp_path: Path, monkeypatch) -> str:
    """A Python that has two other monitors, which do nothing."""
    (tmp_path / 'rtamt.py').write_text(
        'class StlDiscreteTimeSpecification:\n'
        '    def __getattr__(self, name):\n'
        '        return lambda *args: None\n'
    )
    (tmp_path / 'mtl.py').write_text('def parse(text):\n    return lambda *args, **words: 0.0\n')
    monkeypatch.setenv('PYTHONPATH', os.fspath(tmp_path))
    return sys.executable


def test_given_a_python_with_other_monitors_when_measured_then_they_stand_beside_ours(
    peer_python: str, monkeypatch
) -> None:
    monkeypatch.setitem(SUBJECTS, 'monitor', list)
    found = run_subjects(['monitor'], 4, lambda done, total: None, peer_python)['figures']

    formulas = ('phi_always', 'phi_eventually')
    expected = {f'monitor/rtamt {name} offline': 4 for name in formulas}
    expected |= {f'monitor/py-mtl {name} offline': 3 for name in formulas}
    assert {name: figure['repeats'] for name, figure in found.items()} == expected
    assert all(figure['cpu_s'] is None for figure in found.values())


@pytest.mark.parametrize(
    ('python', 'message'),
    [
        ('/nowhere/python', '--peers: cannot run /nowhere/python: No such file'),
        ('/bin/false', '/bin/false has no rtamt, sentil or metric-temporal-logic; tests/core'),
    ],
)
def test_given_no_such_python_when_measured_then_it_is_refused(
    python: str, message: str, monkeypatch
) -> None:
    monkeypatch.setitem(SUBJECTS, 'monitor', list)
    with pytest.raises(UsageError, match=message):
        run_subjects(['monitor'], 1, lambda done, total: None, python)

"""``taxinet bench`` of camera and loop, and the choice of subjects."""

from __future__ import annotations

from collections.abc import Iterator

import cv2
import pytest

from taxinet_ros.bench import run as bench_run
from taxinet_ros.bench.run import SUBJECTS, run_subjects
from taxinet_ros.bench.subjects import SCENES, SUM
from taxinet_ros.core.camera.camera import STAGES
from taxinet_ros.errors import UsageError


@pytest.fixture(autouse=True)
def threads() -> Iterator[None]:
    """The bench takes OpenCV's threads away from the process that runs it."""
    before = cv2.getNumThreads()
    yield
    cv2.setNumThreads(before)


def figures(*words: str, repeats: int = 3) -> dict[str, dict[str, float]]:
    return run_subjects(words, repeats, lambda done, total: None)['figures']


@pytest.mark.nightly
def test_given_the_camera_when_measured_then_every_scene_has_its_stages_and_their_sum() -> None:
    found = figures('camera', repeats=2)

    stages: set[str] = set()
    for name in SCENES:
        whole = f'camera/{name}'
        of_it = {key.removeprefix(f'{whole}/') for key in found if key.startswith(f'{whole}/')}
        assert of_it <= {*STAGES, SUM}
        assert {'ground', 'atmosphere', SUM} <= of_it
        stages |= of_it - {SUM}
        assert found[f'{whole}/{SUM}']['min_s'] > 0
    assert stages == set(STAGES)


@pytest.mark.nightly
def test_given_the_loop_when_measured_then_there_are_real_time_factors() -> None:
    found = figures('loop', repeats=1)

    assert set(found) == {'loop/truth', 'loop/network'}
    assert found['loop/truth']['real_time_factor'] == pytest.approx(
        30 / found['loop/truth']['median_s']
    )
    assert found['loop/network']['median_s'] > found['loop/truth']['median_s']


def test_given_words_when_measured_then_these_are_asked_and_the_loop_beside_the_graph(
    monkeypatch
) -> None:
    asked: list[str] = []
    for word in SUBJECTS:
        monkeypatch.setitem(SUBJECTS, word, lambda stack, word=word: asked.append(word) or [])
    for words, expected in (
        ((), ['camera', 'loop', 'graph']), (('graph',), ['loop', 'graph']), (('loop',), ['loop']),
    ):
        asked.clear()
        assert figures(*words) == {}
        assert asked == expected


def test_given_no_ros_when_measured_then_the_graph_is_refused(monkeypatch) -> None:
    monkeypatch.setattr(bench_run, 'find_spec', lambda name: None)
    with pytest.raises(UsageError, match='graph needs ROS 2, and this Python has no rclpy'):
        run_subjects(['graph'], 1, lambda done, total: None)


@pytest.mark.parametrize(
    ('words', 'repeats', 'message'),
    [
        (['camera', 'cameras'], 3, r"'cameras' is unknown; known: camera, loop, graph"),
        ([], 0, r'repeats is 0, needs to be 1 or more'),
    ],
)
def test_given_bad_options_when_run_then_they_are_refused(
    words: list[str], repeats: int, message: str
) -> None:
    with pytest.raises(UsageError, match=message):
        run_subjects(words, repeats, lambda done, total: None)

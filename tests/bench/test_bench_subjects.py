from __future__ import annotations

from collections.abc import Iterator

import cv2
import pytest

from taxinet_ros.bench.camera import SUM
from taxinet_ros.bench.run import SUBJECTS, run_subjects
from taxinet_ros.bench.scenes import SCENES
from taxinet_ros.campaign.samplers.make import SAMPLERS
from taxinet_ros.core.camera import STAGES
from taxinet_ros.core.errors import UsageError
from taxinet_ros.core.mtl.specs import SHIPPED


@pytest.fixture(autouse=True)
def threads() -> Iterator[None]:
    """The bench takes OpenCV's threads away from the process that runs it."""
    before = cv2.getNumThreads()
    yield
    cv2.setNumThreads(before)


def figures(*words: str, repeats: int = 3) -> dict[str, dict[str, float]]:
    return run_subjects(words, repeats, lambda done, total: None)['figures']


def test_given_the_camera_when_measured_then_every_scenes_stages_add_up_to_its_frame() -> None:
    found = figures('camera', repeats=5)

    stages: set[str] = set()
    for name in SCENES:
        whole = f'camera/{name}'
        of_it = {key.removeprefix(f'{whole}/') for key in found if key.startswith(f'{whole}/')}
        assert of_it <= {*STAGES, SUM}
        assert {'ray-ground', 'ground lookup', 'grain', SUM} <= of_it
        stages |= of_it - {SUM}
        ratio = found[f'{whole}/{SUM}']['min_s'] / found[whole]['min_s']
        assert 0.3 < ratio < 3
    assert stages == set(STAGES)
    assert found['camera/textures']['repeats'] <= 3
    assert found['camera/new, dry']['repeats'] == 5


def test_given_physics_and_monitor_when_measured_then_each_has_its_figures() -> None:
    found = figures('monitor', 'physics')

    names = [f'monitor/{spec} sample' for spec in SHIPPED]
    assert list(found) == ['physics/control step', 'physics/new', *names]
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
    for words in ((), ('all',), ('all', 'physics')):
        asked.clear()
        assert figures(*words) == {}
        assert asked == list(SUBJECTS)


@pytest.mark.parametrize(
    ('words', 'repeats', 'message'),
    [
        (['camera', 'cameras'], 3, r"'cameras' is unknown; known: camera, .*, loop, all"),
        ([], 0, r'--repeats is 0, needs to be 1 or more'),
    ],
)
def test_given_bad_options_when_run_then_they_are_refused(
    words: list[str], repeats: int, message: str
) -> None:
    with pytest.raises(UsageError, match=message):
        run_subjects(words, repeats, lambda done, total: None)

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
import json
import random
import sqlite3
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pandas as pd
import pytest
from numpy.typing import NDArray
from training_samples import SCENES

from taxinet_ros.core.loop import Step, run_closed_loop
from taxinet_ros.core.perception.eye import find_eye
from taxinet_ros.core.perception.perception import make_perception
from taxinet_ros.core.rig.catalogue import CAMERAS, find_camera, load_camera
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.scenario_fields import HUMAN_KEYS
from taxinet_ros.core.types import TrackingError
from taxinet_ros.errors import RecordError, UsageError
from taxinet_ros.scenes.programs import find_program
from taxinet_ros.scenes.source import program_digest
from taxinet_ros.training.data import dataset_folder as folder
from taxinet_ros.training.data import photographs as rendering
from taxinet_ros.training.data import unfinished
from taxinet_ros.training.data.dataset import make_dataset
from taxinet_ros.training.data.dataset_folder import DatasetOptions, write_dataset
from taxinet_ros.training.data.image_folder import load_folders
from taxinet_ros.training.data.photographs import photograph
from taxinet_ros.training.data.unfinished import NAME
from taxinet_ros.trials.doctor import examine

OWN_CAMERA = """
name: own
offset_m: [0.5, 0.2, 0.9]
pitch_deg: 6
size_px: [320, 240]
field_of_view_deg: 80
distortion: [-0.1, 0.01, 0, 0, 0]
"""


@pytest.fixture(autouse=True)
def _no_scenic(monkeypatch: pytest.MonkeyPatch) -> None:
    def draw(
        program: str, *, seed: int, images: int, sampler: str, progress: Callable[..., None]
    ) -> list[Scenario]:
        return (SCENES * images)[:images]

    monkeypatch.setattr(folder, 'draw_scenes', draw)


def options(out: Path, **changes: object) -> DatasetOptions:
    tiny = DatasetOptions(program='nominal', out=out, count=6, seed=4, workers=1)
    return dataclasses.replace(tiny, **changes)


def contents(out: Path) -> dict[str, bytes]:
    return {str(p.relative_to(out)): p.read_bytes() for p in out.rglob('*') if p.is_file()}


def interrupt_after(images: int) -> Callable[[str, int, int], None]:
    def progress(stage: str, done: int, total: int) -> None:
        if (stage, done) == ('images', images):
            raise KeyboardInterrupt

    return progress


def test_given_scenes_when_written_then_images_and_labels_are_theirs_and_checksums_agree(
    tmp_path: Path,
) -> None:
    out = tmp_path / 'deep' / 'set'
    assert write_dataset(options(out)) == 6
    assert sorted(path.name for path in out.iterdir()) == [
        'dataset.json', 'images', 'labels.parquet']
    table = pd.read_parquet(out / 'labels.parquet')
    assert list(table.columns) == [
        'image', 'cte_m', 'heading_error_deg', *HUMAN_KEYS, 'sha256',
    ]  # fmt: skip
    assert list(table['image']) == [f'images/00000{i}.png' for i in range(6)]
    assert len(list((out / 'images').iterdir())) == 6
    for (_, row), scene in zip(table.iterrows(), SCENES * 2, strict=True):
        image, truth = photograph(scene)
        data = (out / row['image']).read_bytes()
        assert hashlib.sha256(data).hexdigest() == row['sha256']
        assert np.array_equal(cv2.imread(str(out / row['image']))[..., ::-1], image)
        assert row['cte_m'] == truth.cte_m
        assert np.radians(row['heading_error_deg']) == pytest.approx(truth.he_rad)
        assert {key: row[key] for key in HUMAN_KEYS} == scene.to_human()
    facts = json.loads((out / 'dataset.json').read_text())
    labels = (out / 'labels.parquet').read_bytes()
    assert facts['labels_sha256'] == hashlib.sha256(labels).hexdigest()
    assert facts['program_sha256'] == program_digest(find_program('nominal'))
    assert 'Plane' in facts['program_text']
    assert (facts['seed'], facts['count'], facts['sampler'], facts['varied']) == (
        4, 6, 'random', False,
    )  # fmt: skip


def test_given_varied_looks_when_resumed_then_seed_and_number_go_into_every_photograph(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[tuple[int, Scenario, bool, int]] = []

    def spy(
        scene: Scenario, *, varied: bool, seed: int, index: int, camera: str
    ) -> tuple[NDArray[np.uint8], TrackingError]:
        asked.append((index, scene, varied, seed))
        return photograph(scene, camera=camera)

    monkeypatch.setattr(rendering, 'photograph', spy)
    asked_for = options(tmp_path / 'set', count=3, seed=9, varied=True)
    with pytest.raises(KeyboardInterrupt):
        write_dataset(asked_for, interrupt_after(1))
    write_dataset(dataclasses.replace(asked_for, resume=True))
    assert asked == [(index, scene, True, 9) for index, scene in enumerate(SCENES)]
    asked.clear()
    make_dataset(SCENES, workers=1, varied=True, seed=9)
    assert asked == [(index, scene, True, 9) for index, scene in enumerate(SCENES)]


def test_given_cameras_of_any_kind_when_loaded_with_a_view_then_it_is_what_the_eye_sees_in_a_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / 'own.yaml').write_text(OWN_CAMERA)
    own = load_camera(str(tmp_path / 'own.yaml'))
    scenes = [
        Scenario(camera='nose', camera_dx_m=0.2, camera_dyaw_rad=0.05),
        Scenario(camera_dz_m=0.1, cross_track_m=3.0), Scenario(camera=own, aircraft='c172p'),
    ]
    monkeypatch.setattr(folder, 'draw_scenes', lambda *_, **__: scenes)
    out = tmp_path / 'set'
    write_dataset(options(out, count=3))
    assert list(pd.read_parquet(out / 'labels.parquet')['camera']) == [
        'nose', 'wing', find_camera(own).reference]
    CAMERAS._known.clear()  # as in another process
    CAMERAS.find.cache_clear()
    loaded, _ = load_folders([out], workers=2, view='ahead')
    assert len(loaded) == 3
    for scene, picture in zip(scenes, loaded.pictures, strict=True):
        steps = list[Step]()
        run_closed_loop(
            dataclasses.replace(scene, duration_s=0.1), make_perception('anywhere'), specs=[],
            on_step=steps.append)
        seen = find_eye('ahead', scene.rig).see(steps[0].observation.image)
        np.testing.assert_array_equal(picture, seen)
    assert len({picture.tobytes() for picture in loaded.pictures}) == 3


@pytest.mark.parametrize('stop', [1, 6])
def test_given_an_interruption_when_resumed_then_every_byte_is_as_without(
    stop: int, tmp_path: Path
) -> None:
    whole, parts = tmp_path / 'whole', tmp_path / 'parts'
    write_dataset(options(whole))
    with pytest.raises(KeyboardInterrupt):
        write_dataset(options(parts), interrupt_after(stop))
    assert not (parts / 'dataset.json').exists()
    assert len(list((parts / 'images').iterdir())) == stop
    # As a kill or a flipped bit may leave it: an entry damaged, and a draft beside an image that is
    # on no record.
    with contextlib.closing(sqlite3.connect(parts / NAME)) as file, file:
        file.execute('UPDATE entries SET value = "{}" WHERE key = ?', [f'{stop - 1:08}'])
    (parts / 'images' / f'.00000{stop - 1}.part.png').write_bytes(b'\x89PN')
    (parts / 'images' / f'00000{stop - 1}.png').unlink()
    assert write_dataset(options(parts, resume=True)) == 6 - stop + 1
    (parts / f'{NAME}.damaged-1').unlink()
    assert contents(parts) == contents(whole)
    assert write_dataset(options(parts, resume=True)) == 0
    with pytest.raises(UsageError, match='begun with seed 4, not 5'):
        write_dataset(options(parts, resume=True, seed=5))


@pytest.mark.nightly
def test_given_worker_processes_when_interrupted_and_resumed_then_every_byte_is_as_without(
    tmp_path: Path,
) -> None:
    whole, parts = tmp_path / 'whole', tmp_path / 'parts'
    write_dataset(options(whole, count=20))
    with pytest.raises(KeyboardInterrupt):
        write_dataset(options(parts, count=20, workers=2), interrupt_after(3))
    assert 3 <= len(list((parts / 'images').iterdir())) <= 20
    assert write_dataset(options(parts, count=20, resume=True)) == 17
    assert contents(parts) == contents(whole)


def test_given_an_image_lost_after_a_stop_when_resumed_then_it_is_made_again(
    tmp_path: Path,
) -> None:
    out = tmp_path / 'set'
    with pytest.raises(KeyboardInterrupt):
        write_dataset(options(out), interrupt_after(4))
    lost = out / 'images' / '000001.png'
    before = lost.read_bytes()
    lost.unlink()
    assert write_dataset(options(out, resume=True)) == 3
    assert lost.read_bytes() == before


@pytest.mark.parametrize('name', ['000001.png', '000005.png'])
def test_given_a_strange_file_among_the_images_when_resumed_then_it_is_refused_and_kept(
    name: str, tmp_path: Path
) -> None:
    out = tmp_path / 'set'
    with pytest.raises(KeyboardInterrupt):
        write_dataset(options(out), interrupt_after(4))
    (out / 'images' / name).write_text('mine')
    with pytest.raises(UsageError, match=f'{name}: differs from what') as caught:
        write_dataset(options(out, resume=True))
    assert '\n' not in str(caught.value)
    assert (out / 'images' / name).read_text() == 'mine'


@pytest.mark.parametrize(
    ('change', 'reason'),
    [
        ({'resume': False}, 'resume it'),
        ({'seed': 5}, 'begun with seed 4, not 5'),
        ({'count': 7}, 'begun with count 6, not 7'),
        ({'varied': True}, 'begun with varied False, not True'),
        ({'program': 's_falsif'}, 'begun with program nominal, not s_falsif'),
    ],
)
def test_given_a_dataset_begun_when_another_is_asked_for_then_it_is_refused_and_kept(
    change: dict[str, object], reason: str, tmp_path: Path
) -> None:
    out = tmp_path / 'set'
    with pytest.raises(KeyboardInterrupt):
        write_dataset(options(out), interrupt_after(1))
    before = contents(out)
    with pytest.raises(UsageError) as caught:
        write_dataset(options(out, **{'resume': True, **change}))
    assert reason in str(caught.value)
    assert '\n' not in str(caught.value)
    assert contents(out) == before


def test_given_a_record_that_lost_its_request_when_resumed_then_it_is_refused(
    tmp_path: Path,
) -> None:
    out = tmp_path / 'set'
    with pytest.raises(KeyboardInterrupt):
        write_dataset(options(out), interrupt_after(1))
    with contextlib.closing(sqlite3.connect(out / NAME)) as file, file:
        file.execute('UPDATE entries SET value = "{}" WHERE kind = "request"')
    for _ in range(2):
        with pytest.raises(UsageError, match='its request is lost; choose another out'):
            write_dataset(options(out, resume=True))


def test_given_a_folder_with_other_things_when_made_then_it_is_refused_and_kept(
    tmp_path: Path,
) -> None:
    (tmp_path / 'notes.txt').write_text('mine')
    with pytest.raises(UsageError, match='not empty; choose another'):
        write_dataset(options(tmp_path))
    with pytest.raises(UsageError, match='nothing to resume'):
        write_dataset(options(tmp_path, resume=True))
    with pytest.raises(UsageError, match='not empty'):
        write_dataset(options(tmp_path / 'notes.txt'))
    assert contents(tmp_path) == {'notes.txt': b'mine'}


def test_given_a_full_disk_when_written_then_one_line_says_so_and_it_can_go_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / 'set'
    with monkeypatch.context() as full:
        put = folder._write_once

        def put_or_fail(path: Path, data: bytes) -> None:
            if path.name == '000003.png':
                raise OSError(28, 'No space left on device')
            put(path, data)

        full.setattr(folder, '_write_once', put_or_fail)
        with pytest.raises(RecordError, match='No space left on device') as caught:
            write_dataset(options(out))
        assert '\n' not in str(caught.value)
    assert write_dataset(options(out, resume=True)) == 3


def test_f1_given_a_full_disk_before_anything_is_begun_then_the_same_command_begins(
    tmp_path: Path,
) -> None:
    write_dataset(options(tmp_path / 'whole'))
    out = tmp_path / 'set'
    out.mkdir()
    (out / NAME).touch()
    (out / f'{NAME}-journal').write_bytes(b'half')
    assert write_dataset(options(out)) == 6
    assert contents(out) == contents(tmp_path / 'whole')


def test_f9_given_a_folder_that_is_moved_then_the_dataset_ends_with_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(unfinished, 'FLUSH_S', 0.0)
    write_dataset(options(tmp_path / 'whole'))
    for act in ('moved', 'replaced'):
        out, moved = tmp_path / act, tmp_path / f'{act}-elsewhere'

        def progress(stage: str, done: int, total: int, out=out, moved=moved, act=act) -> None:
            if (stage, done) == ('images', 3):
                out.rename(moved)
                if act == 'replaced':
                    (out / 'images').mkdir(parents=True)

        with pytest.raises(RecordError) as caught:
            write_dataset(options(out), progress)
        assert '\n' not in str(caught.value)
        assert not (out / 'labels.parquet').exists()
        assert write_dataset(options(moved, resume=True)) <= 3
        assert contents(moved) == contents(tmp_path / 'whole')


def test_given_two_commands_when_they_write_to_one_folder_then_the_second_is_refused(
    tmp_path: Path,
) -> None:
    out = tmp_path / 'set'

    def meanwhile(stage: str, done: int, total: int) -> None:
        if (stage, done) == ('images', 2):
            write_dataset(options(out, resume=True))

    with pytest.raises(UsageError, match='another command is writing'):
        write_dataset(options(out), meanwhile)


@pytest.mark.parametrize(
    ('change', 'reason'),
    [
        ({'count': 0}, 'count is 0'),
        ({'seed': -1}, 'seed is -1'),
        ({'workers': 0}, 'workers is 0'),
        ({'sampler': 'haltom'}, 'known: random, halton, sobol, grid'),
    ],
)
def test_given_an_option_that_cannot_be_when_stated_then_one_line_names_it(
    change: dict[str, object], reason: str, tmp_path: Path
) -> None:
    with pytest.raises(UsageError, match=r'^dataset: ') as caught:
        options(tmp_path / 'set', **change)
    assert reason in str(caught.value)
    assert '\n' not in str(caught.value)


def test_f2_given_any_damage_to_a_dataset_then_it_is_refused_and_the_doctor_names_it(
    tmp_path: Path,
) -> None:
    out = tmp_path / 'set'
    write_dataset(options(out))
    assert examine(out).looked_at == {'indices': 1, 'pictures': 6}
    assert not examine(out).findings
    load_folders([out], workers=1)
    rng = random.Random(1)
    for name in ('dataset.json', 'labels.parquet', 'images/000003.png'):
        data = (out / name).read_bytes()
        for bit in rng.sample(range(8 * len(data)), 40):
            changed = bytearray(data)
            changed[bit // 8] ^= 1 << bit % 8
            (out / name).write_bytes(changed)
            with pytest.raises(UsageError):
                load_folders([out], workers=1)
            assert str(out / name) in {one.where for one in examine(out).findings}
        (out / name).write_bytes(data)
    facts = (out / 'dataset.json').rename(tmp_path / 'dataset.json')
    assert [one.what for one in examine(out).findings] == [
        'cannot be verified: dataset.json is not there'
    ]
    facts.rename(out / 'dataset.json')

"""A program is all that it runs: its modules, data files and documents, however they are named."""

from __future__ import annotations

import compileall
import hashlib
import re
from pathlib import Path

import numpy as np
import pytest

from taxinet_ros.core.rig.catalogue import find_camera
from taxinet_ros.errors import UsageError
from taxinet_ros.scenes.programs import (
    MODEL,
    check_same_files,
    find_program,
    known_programs,
    stored_files,
    stored_text,
    write_program,
)
from taxinet_ros.scenes.source import (
    SceneSource,
    program_text,
    sample_scenarios,
)
from taxinet_ros.trials.options import make_options
from taxinet_ros.trials.record.content import CampaignContent
from taxinet_ros.trials.record.facts import campaign_facts
from taxinet_ros.trials.record.resumption import check_same_campaign

BYTE_ORDER_MARK = '\ufeff'
_WORLD = f'{MODEL}.scenic'
_CAMERA = (
    'name: {name}\ntitle: a camera\noffset_m: [4.1, 0.0, -0.70]\npitch_deg: {pitch}\n'
    'size_px: [64, 40]\nfocal_px: [38.0, 38.0]\n'
)


def write(folder: Path, **files: str) -> Path:
    """Write files (``lib__init`` is ``lib/init``) and return the program."""
    for name, text in files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    return folder / 'main.scenic'


MANY_WAYS = {
    'main.scenic': (
        'model runway_world\n'
        'from lib import MOST\n'
        'from lib import places\n'
        'from one import A; from two import B\n'
        'import three, \\\n'
        '    four\n'
        'import importlib, skies\n'
        "five = importlib.import_module('five')\n"
        "param clouds = Options(skies.DRY)\n"
        "param wind_speed_mps = skies.TABLE[0]\n"
        'ego = new Plane at (Range(0, MOST), places.FAR + A + B + three.C + four.D + five.E)\n'
    ),
    'skies.scenic': (
        'import json, pathlib\nimport numpy as np\n'
        'here = pathlib.Path(__file__).resolve().parent\n'
        "DRY = json.load(open(here / 'data' / 'dry.json'))\n"
        "TABLE = np.load(here / 'data' / 'table.npy')\n"
    ),
    'lib/__init__.py': 'MOST = 3\n',
    'lib/places.py': 'from .more import SCALE\nFAR = 500 * SCALE\n',
    'lib/more.py': 'SCALE = 1\n',
    'one.py': 'A = 1\n', 'two.py': 'B = 2\n', 'three.py': 'C = 3\n', 'four.py': 'D = 4\n',
    'five.py': 'E = 5\n', 'data/dry.json': '{"clear": 2, "cirrus": 1}\n', 'unused.py': 'no = 1\n',
}


@pytest.fixture(scope='module')
def many(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """A program that imports and opens in every way, and its text."""
    folder = tmp_path_factory.mktemp('many')
    program = write(folder, **MANY_WAYS)
    np.save(folder / 'data' / 'table.npy', [3.0, 13 / 2**1074])  # one has the byte of a line end
    return program, program_text(program)


def test_every_module_and_data_file_is_of_the_program_however_it_was_loaded(
    many: tuple[Path, str]
) -> None:
    program, text = many
    others = {*MANY_WAYS, 'data/table.npy', _WORLD} - {'main.scenic', 'unused.py'}
    assert list(stored_files(text)) == ['main.scenic', *sorted(others)]
    assert stored_files(text)['data/table.npy'] == (program.parent / 'data/table.npy').read_bytes()


def test_bytecode_instead_of_the_source_gives_the_same_text(many: tuple[Path, str]) -> None:
    program, text = many
    assert compileall.compile_dir(program.parent, quiet=2)
    assert list(program.parent.glob('lib/__pycache__/more.*.pyc'))
    assert program_text(program) == text


@pytest.mark.parametrize('changed', sorted({*MANY_WAYS} - {'unused.py'}))
def test_a_resume_after_a_change_of_any_file_is_refused_by_its_name(
    changed: str, many: tuple[Path, str]
) -> None:
    text = many[1]
    body = f'# --- {changed} ---\n'
    assert body in text
    facts = {'program': 'main.scenic', 'program_text': text}
    now = {**facts, 'program_text': text.replace(body, f'{body}# changed\n')}
    with pytest.raises(UsageError) as caught:
        check_same_files('resume: out', facts, now)
    assert str(caught.value) == (
        f'resume: out was begun with another text of {changed}; put that back, or choose another '
        'folder'
    )
    check_same_files('resume: out', facts, facts)


def test_a_resumed_campaign_compares_the_modules_of_its_program(
    many: tuple[Path, str], tmp_path: Path
) -> None:
    program, text = many
    options = make_options(
        program=str(program), runs=2, seed=1, perception='truth', settings=(),
        specs=('phi_always',), out=tmp_path, processes=False,
    )
    before = CampaignContent(facts=campaign_facts(options, program, text))
    now = campaign_facts(options, program, text.replace('MOST = 3', 'MOST = 9'))
    with pytest.raises(UsageError, match=r'begun with another text of lib/__init__\.py; put'):
        check_same_campaign(tmp_path, before, now)


def test_a_written_program_runs_the_modules_and_files_of_the_stored_one(
    many: tuple[Path, str], tmp_path: Path
) -> None:
    program, text = many
    source = program.read_text()
    write_program(tmp_path / 'cause-1.scenic', source, text)
    assert not (tmp_path / _WORLD).exists(), 'the shipped world model is found without a copy'
    assert sample_scenarios(tmp_path / 'cause-1.scenic', 5, 3) == sample_scenarios(program, 5, 3)
    write_program(tmp_path / 'cause-2.scenic', source, text)  # the same files again
    (tmp_path / 'one.py').write_text('A = 2\n')
    with pytest.raises(UsageError, match=r'beside it, one\.py is another file'):
        write_program(tmp_path / 'cause-3.scenic', source, text)
    assert not (tmp_path / 'cause-3.scenic').exists()


def test_a_file_too_large_to_be_stored_is_of_the_program_by_its_digest(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr('taxinet_ros.scenes.programs._STORED_BYTES', 8)
    program = write(tmp_path, **{
        'main.scenic': "model runway_world\nfar = float(open(localPath('far.txt')).read())\n"
                       'ego = new Plane at (0, far)\n',
        'far.txt': '400.0000000000\n',
    })
    text = program_text(program)
    assert stored_files(text)['far.txt'] is None
    facts, digest = {'program': 'main.scenic', 'program_text': text}, f'{1:064x}'
    stored = hashlib.sha256(b'400.0000000000\n').hexdigest()
    assert stored in text
    with pytest.raises(UsageError, match=r'another text of far\.txt'):
        check_same_files('x', facts, {**facts, 'program_text': text.replace(stored, digest)})
    (tmp_path / 'out').mkdir()
    with pytest.raises(UsageError, match=r'far\.txt is too large to be stored'):
        write_program(tmp_path / 'out' / 'cause-1.scenic', program.read_text(), text)


def test_a_shipped_program_is_recorded_as_compiling_it_would() -> None:
    with SceneSource('s_falsif_ce', seed=0) as source:
        assert source.text == program_text('s_falsif_ce')
        assert list(stored_files(source.text)) == ['s_falsif_ce.scenic', _WORLD]
    assert len(known_programs()) > 5
    for word in known_programs():  # so the others are alike
        assert not re.search(r'\b(import|open|localPath)\b|\.yaml', find_program(word).read_text())


def test_a_byte_order_mark_compiles_in_programs_and_modules(tmp_path: Path) -> None:
    program = write(tmp_path, **{
        'main.scenic': f'{BYTE_ORDER_MARK}model runway_world\nfrom own import FAR\n'
                       'from py import X\nego = new Plane at (X, FAR)\n',
        'own.scenic': f'{BYTE_ORDER_MARK}FAR = 400\n', 'py.py': f'{BYTE_ORDER_MARK}X = 2\n',
    })
    with SceneSource(program, seed=0) as source:
        assert source.scene(0).distance_m == 400
        assert BYTE_ORDER_MARK not in source.text


def test_a_document_is_found_beside_the_program_then_in_the_current_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / 'here').mkdir()
    monkeypatch.chdir(tmp_path / 'here')
    program = write(tmp_path / 'there', **{
        'main.scenic': "model runway_world\nparam camera = Uniform('own.yaml', 'other.yaml')\n"
                       'ego = new Plane at (0, 400)\n',
        'own.yaml': _CAMERA.format(name='own', pitch=-3),
    })
    write(tmp_path / 'here', **{
        'own.yaml': _CAMERA.format(name='wrong', pitch=-4),
        'other.yaml': _CAMERA.format(name='other', pitch=-5),
    })
    with SceneSource(Path('..', 'there', 'main.scenic'), seed=3) as source:
        names = {find_camera(source.scene(index).camera).name for index in range(12)}
        assert names == {'own', 'other'}
        assert list(stored_files(source.text)) == [
            'main.scenic', 'other.yaml', 'own.yaml', _WORLD
        ]
        text = source.text
    (tmp_path / 'here' / 'other.yaml').rename(tmp_path / 'there' / 'other.yaml')
    monkeypatch.chdir(tmp_path)
    assert program_text(program) == text, 'another folder, but the same files'
    (tmp_path / 'there' / 'own.yaml').unlink()
    with pytest.raises(UsageError, match=r'main\.scenic:2: .*own\.yaml.*cannot be read'):
        program_text(program)


def test_a_document_whose_name_is_put_together_by_chance_is_refused(tmp_path: Path) -> None:
    program = write(tmp_path, **{
        'main.scenic': "model runway_world\nparam camera = Uniform('a', 'b') + '.yaml'\n"
                       'ego = new Plane at (0, 400)\n',
        'a.yaml': _CAMERA.format(name='a', pitch=-3), 'b.yaml': _CAMERA.format(name='b', pitch=-4),
    })
    with pytest.raises(UsageError, match=r'camera [ab]\.yaml: this name is put together by chance'):
        sample_scenarios(program, 1, 1)


SECTIONS = '# --- world ---\nA = 1\n#\\ --- pose ---\nB = 2\n# --- far.txt (base64) ---\nC = 3\n'


@pytest.mark.parametrize('name', ['main.scenic', 'lib.py', 'notes.txt'])
def test_a_line_of_a_file_that_looks_like_the_head_of_one_is_none(
    name: str, tmp_path: Path
) -> None:
    bodies = {'main.scenic': 'model runway_world\n', 'lib.py': 'A = 0\n', 'notes.txt': 'no\n'}
    write(tmp_path, **{**bodies, name: SECTIONS})
    files = {file: tmp_path / file for file in bodies}
    text = stored_text(files)
    assert stored_files(text) == {
        file: path.read_bytes() for file, path in files.items()
    }, 'each file whole, and no other'
    (tmp_path / name).write_text(SECTIONS.replace('B = 2', 'B = 4'))
    with pytest.raises(UsageError, match=rf'another text of {re.escape(name)}; put'):
        check_same_files('x', *(
            {'program': 'main.scenic', 'program_text': one} for one in (text, stored_text(files))))


@pytest.mark.parametrize('data', [
    b'overcast', b'overcast\n', b'overcast\n\n', b'overcast \n', b'', b'\n', b'a\r\nb\r\n',
    b'\xef\xbb\xbfa\n',
])
def test_a_data_file_is_kept_to_the_byte(data: bytes, tmp_path: Path) -> None:
    (tmp_path / 'sky.txt').write_bytes(data)
    assert stored_files(stored_text({'sky.txt': tmp_path / 'sky.txt'})) == {'sky.txt': data}


def test_a_source_without_its_last_line_end_is_stored_as_with_it(tmp_path: Path) -> None:
    program = write(tmp_path, **{'main.scenic': 'model runway_world'})
    text = stored_text({'main.scenic': program})
    assert text == '# --- main.scenic ---\nmodel runway_world\n'


@pytest.mark.nightly
def test_documents_of_one_name_from_outside_are_not_written(tmp_path: Path) -> None:
    (tmp_path / 'out').mkdir()
    program = write(tmp_path / 'there', **{
        'main.scenic': 'model runway_world\nfrom lib import SECOND, THIRD\n'
                       "param camera = Uniform(SECOND, THIRD, '../A/cam.yaml')\n"
                       'ego = new Plane at (0, 400)\n',
        'lib.py': "SECOND, THIRD = '../B/cam.yaml', '../there/../B/cam.yaml'\n",
        '../A/cam.yaml': _CAMERA.format(name='one', pitch=-3),
        '../B/cam.yaml': _CAMERA.format(name='two', pitch=-4),
    })
    copy, text = tmp_path / 'out' / 'scenes.scenic', program_text(program)
    with pytest.raises(UsageError, match=r'beside it, cam\.yaml is another file'):
        write_program(copy, program.read_text(), text)
    assert not list(copy.parent.iterdir())
    program.write_text(program.read_text().replace(", '../A/cam.yaml'", ''))
    with SceneSource(program, seed=3) as source:
        cameras, text = [source.scene(index).camera for index in range(8)], source.text
    write_program(copy, program.read_text(), text)
    for name in 'AB':
        (tmp_path / name / 'cam.yaml').unlink()
    with SceneSource(copy, seed=3) as source:
        assert [source.scene(index).camera for index in range(8)] == cameras


def test_a_document_whose_name_no_source_has_is_not_written(tmp_path: Path) -> None:
    text = '# --- main.scenic ---\nx = 1\n# --- ../A/cam.yaml ---\nname: one\n'
    source = "FOLDER = '../A'\nparam camera = FOLDER + '/cam.yaml'\n"
    with pytest.raises(UsageError, match=r'no source has the name \.\./A/cam\.yaml as it is'):
        write_program(tmp_path / 'scenes.scenic', source, text)
    assert not list(tmp_path.iterdir())


MOVED = 'base: {base}\ndz_m: -0.1\n'
MOVED_ONES = {
    'beside': ('moved.yaml', 'base.yaml', 'base.yaml'),
    'in a folder': ('rig/moved.yaml', '../base.yaml', 'base.yaml'),
    'outside': ('../A/moved.yaml', 'base.yaml', '../A/base.yaml'),
}


@pytest.mark.one_in(2)
@pytest.mark.parametrize('case', MOVED_ONES)
def test_the_camera_that_a_document_moves_is_of_the_program(case: str, tmp_path: Path) -> None:
    document, base, stored = MOVED_ONES[case]
    (tmp_path / 'out').mkdir()
    program = write(tmp_path / 'there', **{
        'main.scenic': f"model runway_world\nparam camera = '{document}'\n"
                       'ego = new Plane at (0, 400)\n',
        document: MOVED.format(base=base),
        stored: _CAMERA.format(name='mine', pitch=-3),
    })
    with SceneSource(program, seed=0) as source:
        text, camera = source.text, source.scene(0).camera
    assert {*stored_files(text)} == {'main.scenic', document, stored, _WORLD}
    copy = tmp_path / 'out' / 'scenes.scenic'
    write_program(copy, program.read_text(), text)
    (program.parent / document).unlink()
    (program.parent / stored).unlink()
    (scene,) = sample_scenarios(copy, 0, 1)
    assert scene.camera == camera
    assert find_camera(camera).name == 'mine'


def test_a_document_that_moves_a_camera_of_another_folder_is_not_written(tmp_path: Path) -> None:
    text = ('# --- main.scenic ---\nx = 1\n# --- rig/moved.yaml ---\nbase: ../../A/base.yaml\n'
            '# --- ../A/base.yaml ---\nname: one\n')
    with pytest.raises(UsageError, match=r'\.\./\.\./A/base\.yaml, base of rig/moved\.yaml, is in'):
        write_program(tmp_path / 'scenes.scenic', "camera = 'rig/moved.yaml'\n", text)
    assert not list(tmp_path.iterdir())

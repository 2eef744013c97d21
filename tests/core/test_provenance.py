"""What a result was made on: told truly, compared in words, and cheap."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from importlib.metadata import version

import numpy as np

from taxinet_ros.core.camera import pixels
from taxinet_ros.core.provenance import (
    COMMIT,
    LIBRARIES,
    NAMES,
    _commit,
    differences,
    known,
    library_versions,
    provenance,
    stack_id,
    without_commit,
    words,
)
from taxinet_ros.version import __version__


def test_provenance_names_processor_instructions_libraries_and_code():
    facts = provenance()
    assert set(facts) <= set(NAMES)
    assert all(facts.values())
    assert facts['taxinet_ros'] == __version__
    assert facts['pixels'].split() == pixels.instruction_sets() or 'pixels' not in facts
    assert set(np.show_config(mode='dicts')['SIMD Extensions']['found']) <= set(
        facts['numpy_features'].split())
    assert {'processor', 'machine', 'libc', 'python', 'numpy', 'scenic', 'rclpy'} <= set(facts)
    assert words(facts).startswith(facts['processor'])


def test_provenance_versions_are_those_that_the_packages_tell():
    found = library_versions()
    assert found == {name: version(name) for name in found}
    assert {'numpy', 'opencv-python-headless', 'onnxruntime', 'jsbsim', 'torch'} <= set(found)
    assert set(found) <= set(LIBRARIES)


def test_provenance_notes_what_keeps_a_library_from_its_instructions():
    program = (
        'import json; from taxinet_ros.core.provenance import provenance; '
        'print(json.dumps(dict(provenance())))'
    )
    held = {'NPY_DISABLE_CPU_FEATURES': 'X86_V3', 'OPENBLAS_CORETYPE': 'Nehalem'}
    done = subprocess.run(
        [sys.executable, '-c', program], env={**os.environ, **held}, capture_output=True,
        text=True, check=True,
    )
    other = json.loads(done.stdout)
    assert 'NPY_DISABLE_CPU_FEATURES=X86_V3' in other['environment']
    assert 'X86_V3' not in other['numpy_features'].split()
    assert 'environment' in differences(provenance() | {'environment': 'none'}, other)


def test_provenance_differences_name_what_both_tell_and_nothing_else():
    one = {'processor': 'A', 'numpy': '2.4', 'libc': 'glibc 2.36'}
    assert differences(one, {'processor': 'B', 'numpy': '2.4', 'torch': '2'}) == 'processor A | B'
    assert differences(one, one) == differences(one) == differences() == ''
    assert differences(one, {**one, 'numpy': '2.5'}, {**one, 'numpy': '3'}) == (
        'numpy 2.4 | 2.5 | 3')


def test_provenance_ids_tell_commits_apart_and_stacks_without_commit_do_not():
    one, other = {'numpy': '2', COMMIT: 'a'}, {'numpy': '2', COMMIT: 'b'}
    assert stack_id(one) != stack_id(other)
    assert stack_id(one) == stack_id(dict(reversed(one.items())))
    assert without_commit(one) == without_commit(other) == {'numpy': '2'}
    assert known({'numpy': '2', 'cores': 3}) == {'numpy': '2'}
    assert known(['numpy']) == {}


def test_provenance_commit_is_the_checkouts_and_says_where_code_was_changed(tmp_path):
    def git(*words: str) -> str:
        who = ['-c', 'user.name=x', '-c', 'user.email=x@example.org']
        done = subprocess.run(
            ['git', *who, *words], cwd=tmp_path, capture_output=True, text=True, check=True
        )
        return done.stdout.strip()

    assert _commit(tmp_path) == '', 'no checkout and no installation'
    (tmp_path / 'taxinet_ros').mkdir()
    (tmp_path / 'taxinet_ros' / 'a.py').write_text('x = 1\n')
    (tmp_path / 'notes.md').write_text('one\n')
    git('init', '-q')
    git('add', '.')
    git('commit', '-qm', 'first')
    head = git('rev-parse', 'HEAD')
    assert _commit(tmp_path) == head
    (tmp_path / 'notes.md').write_text('two\n')
    assert _commit(tmp_path) == head, 'no result depends on it'
    (tmp_path / 'taxinet_ros' / 'a.py').write_text('x = 2\n')
    assert _commit(tmp_path) == f'{head}+changes'


def test_provenance_commit_of_an_installation_is_what_pip_noted(tmp_path):
    folder = tmp_path / 'taxinet_ros-0.1.0.dist-info'
    folder.mkdir()
    url = {'url': 'git+https://example.org', 'vcs_info': {'vcs': 'git', 'commit_id': 'c0ffee'}}
    (folder / 'direct_url.json').write_text(json.dumps(url))
    assert _commit(tmp_path) == 'c0ffee'
    (folder / 'direct_url.json').write_text('{"url": "file:///x", "dir_info": {}}')
    assert _commit(tmp_path) == ''

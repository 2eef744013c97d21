"""Libraries use the same instructions on every processor of the class x86-64-v3."""

from __future__ import annotations

import os
import subprocess
import sys
import warnings

import pytest

from taxinet_ros import instructions

TELL = """
import taxinet_ros
import numpy, cv2, threadpoolctl
found = numpy.show_config(mode='dicts')['SIMD Extensions'].get('found', [])
blas = [pool['architecture'] for pool in threadpoolctl.threadpool_info() if 'numpy' in
        pool['filepath']]
newest = '*AVX512-SKX ' in cv2.getCPUFeaturesLine() + ' '
print(found[-1:], blas, newest, cv2.ipp.getIppVersion()[:10])
"""
AVX2 = 'X86_V3' if 'X86_V4' in instructions.PINS['NPY_DISABLE_CPU_FEATURES'] else 'AVX2'
"""What numpy calls it, from 2.4 on and before."""
here = pytest.mark.skipif(bool(instructions.lacking()), reason='processor without AVX2 and FMA')


def tell(**environment: str) -> subprocess.CompletedProcess[str]:
    kept = {name: value for name, value in os.environ.items() if name not in instructions.PINS}
    return subprocess.run(
        [sys.executable, '-W', 'error', '-c', TELL], env={**kept, **environment},
        capture_output=True, text=True, check=True,
    )


@here
def test_given_the_package_then_libraries_loaded_after_it_use_avx2_and_nothing_newer() -> None:
    done = tell()
    assert done.stdout.strip() == f"['{AVX2}'] ['Haswell'] False ippIP AVX2"
    assert not done.stderr


@here
def test_given_a_users_own_restriction_then_it_is_kept() -> None:
    assert f"['{AVX2}']" not in tell(NPY_DISABLE_CPU_FEATURES=AVX2).stdout


def test_given_numpy_loaded_before_the_package_then_the_importing_line_is_warned(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    newest = frozenset({'fma', 'avx2', 'avx512f', 'avx512cd', 'avx512bw', 'avx512dq', 'avx512vl'})
    monkeypatch.setattr(instructions, 'processor_flags', lambda: newest)
    monkeypatch.setattr(instructions, 'machine', lambda: 'x86_64')
    monkeypatch.setattr(sys, 'modules', {**sys.modules, 'numpy': os, 'cv2': os})
    monkeypatch.setattr(os, 'environ', {'OPENCV_CPU_DISABLE': 'AVX2'})
    with pytest.warns(UserWarning, match=r'^imported before taxinet_ros, so with AVX-512: numpy; '):
        instructions.pin()
    with warnings.catch_warnings():
        warnings.simplefilter('error')
        instructions.pin()  # the environment is told: as in a child process


@pytest.mark.skipif(
    'avx512f' not in instructions.processor_flags(), reason='processor without AVX-512')
def test_given_a_script_that_imports_numpy_first_then_its_own_line_is_named(tmp_path) -> None:
    script = tmp_path / 'mine.py'
    script.write_text('import numpy\n\nimport taxinet_ros\n')
    kept = {name: value for name, value in os.environ.items() if name not in instructions.PINS}
    done = subprocess.run(
        [sys.executable, script], env=kept, capture_output=True, text=True, check=True)
    said = f'{script}:3: UserWarning: imported before taxinet_ros, so with AVX-512: numpy'
    assert said in done.stderr


def test_given_a_processor_without_avx2_then_nothing_is_asked_of_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(instructions, 'processor_flags', lambda: frozenset({'fma', 'sse4_2'}))
    monkeypatch.setattr(instructions, 'machine', lambda: 'x86_64')
    monkeypatch.setattr(os, 'environ', {})
    instructions.pin()
    assert instructions.lacking() == 'AVX2'
    assert os.environ == {}


def test_given_a_processor_without_avx512_then_opencv_is_not_told_to_leave_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(instructions, 'processor_flags', lambda: frozenset({'fma', 'avx2'}))
    monkeypatch.setattr(instructions, 'machine', lambda: 'x86_64')
    monkeypatch.setattr(os, 'environ', {'OPENBLAS_CORETYPE': 'Zen'})
    instructions.pin()
    assert instructions.lacking() == ''
    assert set(os.environ) == set(instructions.PINS) - {'OPENCV_CPU_DISABLE'}
    assert os.environ['OPENBLAS_CORETYPE'] == 'Zen'


def test_given_another_architecture_then_it_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(instructions, 'machine', lambda: 'aarch64')
    assert instructions.lacking() == 'x86-64 (this is aarch64)'

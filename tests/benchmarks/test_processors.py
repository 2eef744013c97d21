"""Runs are the same to the bit with other instructions (``benchmarks/processors.py`` in short)."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import processors
import pytest
from processors import NETWORKS, differing_runs, fixed_scenes, measure_processors

from taxinet_ros.core.scenario import scenario_from_human
from taxinet_ros.errors import UsageError
from taxinet_ros.instructions import PINS, lacking

pytestmark = pytest.mark.nightly
SCENES, DURATION_S = 2, 0.5
CHILD = f"""
import json, sys
sys.path.insert(0, {str(Path(processors.__file__).parent)!r})
from processors import measure_processors
print(json.dumps(measure_processors(int(sys.argv[1]), {DURATION_S})['runs']))
"""
LESS = {
    'numpy': {'NPY_DISABLE_CPU_FEATURES': 'X86_V3 X86_V4 AVX512_ICL AVX512_SPR'},
    'BLAS': {'OPENBLAS_CORETYPE': 'Nehalem', 'OPENBLAS_NUM_THREADS': '1'},
    'C library': {'GLIBC_TUNABLES': 'glibc.cpu.hwcaps=-AVX512F,-AVX512VL'},
}
"""Less than the class has, where even that changes no bit of these runs."""


@pytest.fixture(scope='module')
def here() -> list[dict[str, str]]:
    return list(measure_processors(SCENES, DURATION_S)['runs'])


def elsewhere(
    scenes: int, environment: dict[str, str], *before: str
) -> list[dict[str, str]]:
    """The same runs in another process."""
    kept = {name: value for name, value in os.environ.items() if name not in PINS}
    done = subprocess.run(
        [*before, sys.executable, '-c', CHILD, str(scenes)], env={**kept, **environment},
        capture_output=True, text=True, check=False,
    )
    assert done.returncode == 0, done.stderr
    return list(json.loads(done.stdout.splitlines()[-1]))


def test_given_the_runs_then_they_differ_from_each_other(here: list[dict[str, str]]) -> None:
    assert [run['network'] for run in here] == [*NETWORKS] * SCENES
    assert len({run['bag'] for run in here}) == len(here)


@pytest.mark.skipif(bool(lacking()), reason='processor without AVX2 and FMA')
@pytest.mark.parametrize('library', LESS)
def test_given_fewer_instructions_for_a_library_then_no_bit_changes(
    library: str, here: list[dict[str, str]]
) -> None:
    assert differing_runs(here, elsewhere(SCENES, LESS[library])) == []


@pytest.mark.skipif(shutil.which('qemu-x86_64') is None, reason='qemu-x86_64 is not installed '
                    '(package qemu-user)')
def test_given_an_emulated_processor_without_avx512_then_no_bit_changes(
    here: list[dict[str, str]],
) -> None:
    # The ROS wheels' start-up would execute Python anew, on the processor itself.
    native = {'_ROS_WHEELS_BOOTSTRAP_COMPLETE': '1'}
    runs = elsewhere(1, native, 'qemu-x86_64', '-cpu', 'Haswell')
    assert differing_runs(here[: len(NETWORKS)], runs) == []


def test_given_the_scenes_then_they_are_possible_and_more_of_them_begin_with_the_same() -> None:
    scenes = list(fixed_scenes(40))
    assert list(fixed_scenes(7)) == scenes[:7]
    assert len({scenario_from_human(values) for values in scenes}) == 40
    assert {'traffic', 'camera', 'place', 'gust', 'lens_drops'} <= {
        key for values in scenes for key in values}


def test_given_a_report_of_another_machine_then_what_differs_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str],
) -> None:
    assert processors.main(['--scenes', '1', '--duration', '0.2', '--json']) == 0
    out = capsys.readouterr().out
    report = json.loads(out)
    file = tmp_path / 'there.json'
    file.write_text(out)
    assert processors.main(['--compare', str(file)]) == 0
    out = capsys.readouterr().out
    assert '2 of 2 runs equal' in out
    assert report['digest'] in out
    report['runs'][1]['rho'] = '0x1.8p+0'
    file.write_text(json.dumps(report))
    assert processors.main(['--compare', str(file)]) == 1
    assert 'differs: scene 0, original: rho\n1 of 2 runs equal' in capsys.readouterr().out
    with pytest.raises(UsageError, match=r'has 1 scenes of 0\.2 s'):
        processors.main(['--compare', str(file), '--scenes', '2'])


@pytest.mark.parametrize(('file', 'message'), [
    ('nowhere.json', 'cannot read nowhere.json'), (__file__, 'is no report'),
])
def test_given_no_report_to_compare_with_then_it_is_refused(
    file: str, message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(UsageError, match=message):
        processors.main(['--compare', file])

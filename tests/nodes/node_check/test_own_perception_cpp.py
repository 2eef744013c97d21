"""``examples/own_perception_cpp``: its estimate, always; its node, where rclcpp is at hand."""

from __future__ import annotations

import dataclasses
import os
import shutil
import subprocess
import sys
import sysconfig
from pathlib import Path

import numpy as np
import pytest

from taxinet_ros.core.camera.camera import Camera
from taxinet_ros.core.motion.aircraft import Aircraft
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.testing.clauses import Status
from taxinet_ros.testing.stage import check_node

pytestmark = pytest.mark.nightly

PACKAGE = Path(__file__).parents[3] / 'examples' / 'own_perception_cpp'
CXX = os.environ.get('CXX', 'c++')
SCENE = Scenario(distance_m=1000.0, time_of_day_s=10 * 3600.0)
PLACES = [(cte, he) for cte in (-5.0, -2.0, 0.0, 2.0, 5.0) for he in (-0.15, 0.0, 0.15)]
PREFIXES = [sys.prefix, *os.environ.get('AMENT_PREFIX_PATH', '').split(os.pathsep)]
RCLCPP = any((Path(prefix) / 'share' / 'rclcpp').is_dir() for prefix in PREFIXES if prefix)


@pytest.fixture(scope='module')
def estimate(tmp_path_factory) -> Path:
    """The program that reads frames and prints estimates."""
    program = tmp_path_factory.mktemp('cpp') / 'estimate'
    sources = [str(PACKAGE / name) for name in ('src/centreline.cpp', 'test/estimate.cpp')]
    flags = ['-std=c++17', '-O2', '-Wall', '-Wextra', '-Wpedantic', '-Werror']
    subprocess.run([CXX, *flags, '-o', str(program), *sources], check=True)
    return program


def estimates(program: Path, frames: list[np.ndarray]) -> np.ndarray:
    """One row of valid, cross-track error [m] and heading error [rad] for each frame."""
    sent = b''.join(frame.tobytes() for frame in frames)
    done = subprocess.run([str(program)], input=sent, capture_output=True, check=True)
    return np.array([line.split() for line in done.stdout.decode().splitlines()], float)


@pytest.mark.parametrize('clouds', ['clear', 'overcast'])
def test_given_frames_by_day_then_it_is_right_to_a_quarter_of_a_metre_and_a_degree(
    estimate, clouds
):
    camera, begin = Camera(dataclasses.replace(SCENE, clouds=clouds)), Aircraft(SCENE).state
    said = estimates(estimate, [
        camera.render(dataclasses.replace(begin, y_m=cte, yaw_rad=he), 0) for cte, he in PLACES
    ])
    assert said.shape == (len(PLACES), 3)
    assert said[:, 0].all()
    wrong = np.abs(said[:, 1:] - np.array(PLACES))
    assert (wrong.max(axis=0) < (0.25, np.radians(1.0))).all(), wrong.max(axis=0)


def test_given_frames_without_paint_then_none_is_valid(estimate):
    frames = [np.full((200, 360, 3), grey, np.uint8) for grey in (0, 128, 255)]
    assert estimates(estimate, frames)[:, 0].tolist() == [0, 0, 0]


@pytest.mark.ros
@pytest.mark.skipif(not RCLCPP, reason='rclcpp is not installed: the wheels lack it')
def test_given_rclcpp_then_the_package_builds_and_its_node_keeps_the_contract(tmp_path):
    cmake = shutil.which('cmake', path=f'{sys.prefix}/bin{os.pathsep}{os.environ["PATH"]}')
    build = tmp_path / 'build'
    prefixes = os.pathsep.join(prefix for prefix in PREFIXES if prefix)
    environment = {**os.environ, 'CMAKE_PREFIX_PATH': prefixes, 'AMENT_PREFIX_PATH': prefixes}
    # The wheels' libraries find each other beside themselves, not on the linker's path; their
    # librcl needs messages for Python, which leave it to the process to bring Python's library.
    folder, library = map(sysconfig.get_config_var, ('LIBDIR', 'LDLIBRARY'))
    bring = f'-Wl,--no-as-needed,-rpath,{folder} {folder}/{library}'
    lenient = f'-DCMAKE_EXE_LINKER_FLAGS=-Wl,--allow-shlib-undefined {bring}'
    for words in (
        ['-S', str(PACKAGE), '-B', str(build), lenient, f'-DPython3_EXECUTABLE={sys.executable}'],
        ['--build', str(build)],
    ):
        subprocess.run([cmake, *words], check=True, env=environment)
    log = tmp_path / 'node.log'
    log.touch()
    _, findings = check_node(
        [str(build / 'own_perception')], 'perception', patience_s=600.0, log=log,
    )
    found = {one.clause: one for one in findings}
    assert {one.status for one in found.values()} == {Status.PASS}, found
    assert 'CTE 0.0' in found['accuracy'].came

"""The compiled parts without what is written for one kind of processor: the same bytes."""

from __future__ import annotations

import hashlib
import shutil
import subprocess
import sys
import sysconfig
from pathlib import Path

import pybind11
import pytest
from picture_samples import at

from taxinet_ros.core.camera import pixels
from taxinet_ros.core.camera.camera import Camera
from taxinet_ros.core.perception.eye import find_eye
from taxinet_ros.core.perception.network import shrink
from taxinet_ros.core.perception.perception import make_perception
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.traffic.traffic_file import load_traffic

pytestmark = pytest.mark.nightly

OTHERS = load_traffic([
    {'kind': 'vehicle', 'x_m': 353, 'y_m': 6, 'heading_deg': 30},
    {'kind': 'patch', 'x_m': 345, 'y_m': 2}, {'kind': 'cone', 'x_m': 1410, 'y_m': -9},
])
NATIVE = Path(pixels.__file__).parent / 'native'
TESTS = Path(__file__).parent
INSTEAD = """
import importlib.util, sys
import taxinet_ros.core.camera
spec = importlib.util.spec_from_file_location('taxinet_ros.core.camera.pixels', sys.argv[1])
plain = importlib.util.module_from_spec(spec)
spec.loader.exec_module(plain)
sys.modules[spec.name] = taxinet_ros.core.camera.pixels = plain
from test_pixels_portable import digest
from taxinet_ros.core.camera.ground import view as ground_view
assert ground_view.pixels.__file__ == sys.argv[1]
print(digest())
"""


def digest() -> str:
    """Of pictures in all weathers, what the network gets of them, and its answers."""
    found = hashlib.sha256()
    network = make_perception('taxinet')
    for number, clouds in enumerate(('clear', 'cirrus', 'scattered', 'broken', 'stratus')):
        rain = 0.6 if clouds == 'stratus' else 0.0
        camera = Camera(Scenario(
            time_of_day_s=3600.0 * (7 + 2 * number), clouds=clouds, rain_fraction=rain,
            traffic=OTHERS,
        ))
        for x, y, heading, pitch in ((333.3, 2.0, 9.0, 0.1), (1400.0, -5.0, -20.0, -4.0)):
            picture = camera.render(at(x, y, heading, pitch), number)
            found.update(picture.tobytes() + shrink(picture).tobytes())
            found.update(find_eye('ahead', Scenario().rig).see(picture).tobytes())
            found.update(repr(network.estimate(picture, None)).encode())
    return found.hexdigest()


@pytest.fixture(scope='module')
def plain(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The module, compiled for any processor."""
    compiler = shutil.which('c++')
    assert compiler, 'the package was compiled with one'
    folder = tmp_path_factory.mktemp('plain')
    module = folder / f'pixels{sysconfig.get_config_var("EXT_SUFFIX")}'
    include = [f'-I{path}' for path in (pybind11.get_include(), sysconfig.get_path('include'))]
    subprocess.run(
        [compiler, '-O0', '-DPLAIN', '-std=c++20', '-shared', '-fPIC', '-fvisibility=hidden',
         '-ffp-contract=off', *include, str(NATIVE / 'pixels.cpp'), '-o', str(module)],
        check=True,
    )
    return module


def test_given_code_for_any_processor_when_pictures_are_made_then_they_are_the_same_bytes(
    plain: Path,
) -> None:
    done = subprocess.run(
        [sys.executable, '-c', INSTEAD, str(plain)],
        capture_output=True, text=True, cwd=TESTS,
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == digest()

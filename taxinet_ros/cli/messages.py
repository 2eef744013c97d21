"""``taxinet setup-messages``: build the ROS 2 messages where taxinet_ros came as a wheel."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path
from typing import Annotated

import typer

import taxinet_ros
from taxinet_ros.errors import ExitCode, UsageError

_BUILDER = 'build_with_wheels.py'


def setup_messages(
    packages: Annotated[list[Path] | None, typer.Argument(
        metavar='[FOLDER]...', show_default=False,
        help='more interface packages to build, such as a checkout of simulation_interfaces',
    )] = None,
) -> int:
    """Build the ROS 2 messages into this virtual environment, once after pip install.

    Needs the extra ros and a C++ compiler; make does it by itself. Without messages, --engine loop,
    import taxinet_ros and the analysis of recordings work all the same. Exit code 4 if the build
    failed.
    """
    prefix = Path(sys.prefix)
    builder = message_sources(prefix) / _BUILDER
    if sys.prefix == sys.base_prefix:
        raise UsageError(
            f'setup-messages: {sys.executable} is not in a virtual environment; make one with '
            'python3 -m venv, or with a ROS 2 installation build msg_defs with colcon'
        )
    for program, fix in (
        (prefix / 'bin' / 'cmake', "pip install 'taxinet_ros[ros]'"),
        (prefix / 'bin' / 'ninja', "pip install 'taxinet_ros[ros]'"),
        (Path('c++'), 'on Debian and Ubuntu: apt install g++'),
    ):
        if shutil.which(program) is None:
            raise UsageError(f'setup-messages: no {program}, which builds them; {fix}')
    for folder in packages or ():
        if not (folder / 'package.xml').is_file():
            raise UsageError(f'setup-messages: {folder}: no package of ROS 2, without package.xml')
    done = subprocess.run([sys.executable, str(builder), *map(str, packages or ())], check=False)
    return ExitCode.OK if done.returncode == 0 else ExitCode.INFRA


def message_sources(prefix: Path) -> Path:
    """Folder of the message definitions: of the checkout that is in use, else of the wheel.

    Args:
        prefix: environment that a wheel was installed into.

    Raises:
        UsageError: there is none.
    """
    checkout = Path(taxinet_ros.__file__).resolve().parents[1] / 'msg_defs'
    installed = prefix / 'share' / 'taxinet_ros' / 'msg_defs'
    for folder in (checkout, installed):
        if (folder / _BUILDER).is_file():
            return folder
    raise UsageError(f'setup-messages: no {installed}; install taxinet_ros anew, from its wheel')

"""Whether a machine of a cluster would make the very runs that this one makes.

A machine is described by facts: processor class, versions, code, and the perception, controller and
world that it has under the campaign's names. Equal facts mean equal rows.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import subprocess
import sys
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path

import taxinet_ros
from taxinet_ros.core.assurance.switch import check_controller
from taxinet_ros.core.perception.onnx.network import ONNX_SUFFIX
from taxinet_ros.core.perception.perception import check_perception
from taxinet_ros.core.provenance import COMMIT, provenance
from taxinet_ros.core.user_code import names_user_code
from taxinet_ros.core.world import find_world
from taxinet_ros.errors import UsageError
from taxinet_ros.files.sealed_json import file_sha256
from taxinet_ros.instructions import lacking
from taxinet_ros.processes.child import child_environment, module_command
from taxinet_ros.registry import PERCEPTIONS, find
from taxinet_ros.trials.options import CampaignOptions

PYTHON, OUT = '@PYTHON@', '@OUT@'
"""Words in the command of a child for a machine's Python, and for the folder of its bags."""
_START_S = 180.0
_NOT_CODE = ('.pyc', '.so', '.cpp', '.hpp', '.pyi')
"""Files of the package that say nothing about its code, or that an installation may lack."""


def describe(parts: Sequence[str], folder: Path | None) -> dict[str, str]:
    """Facts of this machine by name, from a child process that starts as runs do.

    Args:
        parts: perception, controller, its gains as JSON, and world.
        folder: working directory of the child.

    Raises:
        UsageError: it lacks a part, or the child failed.
    """
    try:
        done = subprocess.run(
            module_command(__spec__.name, *parts), env=child_environment(), cwd=folder,
            capture_output=True, text=True, timeout=_START_S,
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        raise UsageError(f'cannot be described: {error}') from error
    if done.returncode:
        raise UsageError((done.stderr.strip() or f'exit code {done.returncode}').splitlines()[-1])
    return dict(json.loads(done.stdout))


def ignored_facts(campaign: CampaignOptions) -> set[str]:
    """Facts in which machines may differ without effect on the results of a campaign."""
    ignored = {'processor', 'pixels', COMMIT}  # in place of the commit, files are compared
    if not campaign.runs_graphs:
        ignored |= {'rclpy', 'ros-fastrtps'}
    word = campaign.perception
    if not (names_user_code(word) or word.endswith(ONNX_SUFFIX)):
        with contextlib.suppress(UsageError):
            extension = find(PERCEPTIONS, word)
            if extension is None or extension.shipped:  # equal bits on all processors of the class
                ignored.add('processor_features')
    return ignored


def difference(
    here: Mapping[str, str], there: Mapping[str, str], ignored: Collection[str]
) -> str:
    """The first fact in which another machine differs, in words; '' if there is none."""
    for name in {**here, **there}:
        one, other = (facts.get(name) or 'missing' for facts in (here, there))
        if one != other and name not in ignored:
            return f'{name} {other}, here {one}'
    return ''


def code_digest(package: Path) -> str:
    """SHA-256 of the names and contents of a package's files, compiled ones and C++ left out."""
    digest = hashlib.sha256()
    files = [  # a checkout has a link where an installation has a folder
        Path(folder, name) for folder, _, names in os.walk(package, followlinks=True)
        for name in names if not name.endswith(_NOT_CODE)
    ]
    for path in sorted(files):
        name = path.relative_to(package).as_posix()
        digest.update(f'{name} {file_sha256(path)}\n'.encode())
    return digest.hexdigest()


def main(perception: str, controller: str, gains: str, world: str) -> None:
    """Print the facts of this machine, for :func:`describe`."""
    print(json.dumps({
        'instructions': f'without {lacking()}' if lacking() else 'x86-64-v3',
        **provenance(),
        'files of taxinet_ros': code_digest(Path(taxinet_ros.__file__).parent),
        f'perception {perception}': check_perception(perception, graph=True),
        f'controller {controller}': check_controller(controller, json.loads(gains), graph=True),
        f'world {world}': find_world(world).fingerprint,
    }))


if __name__ == '__main__':
    try:
        main(*sys.argv[1:])
    except UsageError as error:
        sys.exit(str(error))

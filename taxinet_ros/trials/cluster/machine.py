"""Whether a machine of a cluster would make the very runs that this one makes.

A machine is described by a child process that starts as its runs do: processor class, versions,
code, and the perception, controller and world that it finds under the campaign's names. Equal
descriptions mean equal rows; what differs is named, and the machine gets no runs.
"""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import hashlib
import json
import os
import subprocess
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import taxinet_ros
from taxinet_ros.core.assurance.switch import check_controller
from taxinet_ros.core.perception.onnx.network import ONNX_SUFFIX
from taxinet_ros.core.perception.perception import check_perception
from taxinet_ros.core.provenance import COMMIT, NAMES, provenance
from taxinet_ros.core.user_code import names_user_code
from taxinet_ros.core.world import find_world
from taxinet_ros.errors import UsageError
from taxinet_ros.instructions import lacking
from taxinet_ros.processes.child import child_environment, module_command
from taxinet_ros.registry import PERCEPTIONS, find

_START_S = 180.0
_NOT_CODE = ('.pyc', '.so', '.cpp', '.hpp', '.pyi')
"""Files of the package that say nothing about its code, or that an installation may lack."""
_OF_PROCESSOR = ('processor', 'processor_features', 'pixels')
"""Facts in which machines of one class may differ without effect on our own networks."""
_OF_GRAPH = ('rclpy', 'ros-fastrtps')
_COMPARED = tuple(name for name in NAMES if name not in (*_OF_PROCESSOR, COMMIT))
"""Facts that must be equal; in place of the commit, the files themselves are compared."""


@dataclass(frozen=True, kw_only=True)
class Needs:
    """What a machine needs for the runs of a campaign.

    Attributes:
        perception, controller, gains, world: as in :class:`.CampaignOptions`.
        graph: whether runs, or their audits, need ROS.
        folder: working directory of the campaign, which relative names refer to.
    """

    perception: str
    controller: str
    gains: Mapping[str, float]
    world: str
    graph: bool
    folder: str

    @property
    def any_processor(self) -> bool:
        """Whether the perception gives the same bits on every processor of the class."""
        if names_user_code(self.perception) or self.perception.endswith(ONNX_SUFFIX):
            return False
        with contextlib.suppress(UsageError):
            extension = find(PERCEPTIONS, self.perception)
            return extension is None or extension.shipped
        return False


@dataclass(frozen=True, kw_only=True)
class Machine:
    """A machine on which runs may be made.

    Attributes:
        record: its provenance, see :mod:`taxinet_ros.core.provenance`.
        code: SHA-256 of the files of this package.
        lacking: what its processor lacks of the class for which bits are equal, or ''.
        parts: SHA-256 of the perception, controller and world, by role.
    """

    record: Mapping[str, str]
    code: str
    lacking: str
    parts: Mapping[str, str]


def to_json(described: Needs | Machine) -> str:
    """Text of a description; the same for equal ones."""
    return json.dumps(dataclasses.asdict(described), sort_keys=True)


@functools.cache
def describe(needs: str) -> Machine:
    """Describe this machine, once per process.

    Args:
        needs: text of :class:`Needs`.

    Raises:
        UsageError: it lacks a part, or the describing process failed.
    """
    folder = str(json.loads(needs)['folder'])
    try:
        done = subprocess.run(
            module_command(__spec__.name, needs), env=child_environment(), capture_output=True,
            text=True, timeout=_START_S, cwd=folder if os.path.isdir(folder) else None,
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        raise UsageError(f'cannot be described: {error}') from error
    if done.returncode:
        last = (done.stderr.strip().splitlines() or [f'exit code {done.returncode}'])[-1]
        raise UsageError(f'cannot be described: {last}')
    values = json.loads(done.stdout)
    if 'error' in values:
        raise UsageError(str(values['error']))
    return Machine(**values)


def difference(here: Machine, there: Machine, needs: Needs) -> str:
    """The first thing in which another machine differs so that its runs may differ; '' if none."""
    if here.lacking != there.lacking:
        lacks = [f'its processor lacks {each.lacking}' if each.lacking else 'has all of x86-64-v3'
                 for each in (there, here)]
        return f'processor class: {lacks[0]}, the one here {lacks[1]}'
    names = [name for name in _COMPARED if needs.graph or name not in _OF_GRAPH]
    if not needs.any_processor:
        names = ['processor_features', *names]
    for name in names:
        one, other = here.record.get(name, ''), there.record.get(name, '')
        if one != other:
            return f'{name} {other or "missing"}, here {one or "missing"}'
    if here.code != there.code:
        return f'taxinet_ros of other files ({there.code[:12]}…, here {here.code[:12]}…)'
    for role, sha256 in here.parts.items():
        found = there.parts.get(role, '')
        if found != sha256:
            word = getattr(needs, role)
            return f'{role} {word} is {found[:12] or "missing"}…, here {sha256[:12] or "none"}…'
    return ''


def code_digest(package: Path) -> str:
    """SHA-256 of the names and contents of a package's files, compiled ones and C++ left out."""
    digest = hashlib.sha256()
    found = [
        Path(folder, name) for folder, _, names in os.walk(package, followlinks=True)
        for name in names if not name.endswith(_NOT_CODE)
    ]
    for path in sorted(found):
        content = hashlib.sha256(path.read_bytes()).hexdigest()
        digest.update(f'{path.relative_to(package).as_posix()} {content}\n'.encode())
    return digest.hexdigest()


def main(words: Sequence[str]) -> int:
    """Print the description of this machine, for :func:`describe`."""
    needs = Needs(**json.loads(words[0]))
    try:
        parts = {
            'perception': check_perception(needs.perception, graph=True),
            'controller': check_controller(needs.controller, dict(needs.gains), graph=True),
            'world': find_world(needs.world).fingerprint,
        }
    except UsageError as error:
        told: dict[str, Any] = {'error': str(error)}
    else:
        told = dataclasses.asdict(Machine(
            record=dict(provenance()), lacking=lacking(), parts=parts,
            code=code_digest(Path(taxinet_ros.__file__).parent),
        ))
    print(json.dumps(told))
    return 0


if __name__ == '__main__':
    sys.exit(main(sys.argv[1:]))

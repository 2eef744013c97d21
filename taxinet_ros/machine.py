"""Whether this machine has what taxinet_ros needs: ``taxinet doctor`` without a folder.

Each check is a line: what was found, or what is missing and how to fix it. What only some commands
need is told as missing without being counted as broken.
"""

from __future__ import annotations

import importlib
import os
import platform
import re
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import Any

import psutil

from taxinet_ros.errors import InfraError, UsageError
from taxinet_ros.instructions import lacking

_PYTHONS = ((3, 11), (3, 13))
_CXX_STANDARD = b'#include <bit>\nstatic_assert(std::bit_cast<int>(0.0F) == 0);\n'
_FILES_OF_A_GRAPH = 256
_MEMORY_OF_A_GRAPH, _SHARED_OF_A_GRAPH = 1.5e9, 64e6
_BAG_BYTES, _ROOM_BYTES = 35e6, 2e9
_DISCOVERY_S = 10.0
_EXTRAS = {
    'distributed': 'a cluster', 'mss': 'camera xplane from a window',
}
"""Optional distributions, and what needs them."""


@dataclass(frozen=True, slots=True)
class Check:
    """Outcome of one check.

    Attributes:
        name: what was checked.
        state: ``ok``; ``missing``, what only some commands need; or ``broken``.
        found: what is there, or what is wrong.
        fix: what to do about it, '' if nothing.
    """

    name: str
    state: str
    found: str
    fix: str = ''


def system_checks() -> Iterator[Check]:
    """Every check, in the order in which one needs another."""
    for name, check in _CHECKS.items():
        try:
            yield from check(name)
        except (UsageError, InfraError, OSError) as error:
            yield Check(name, 'broken', str(error))
        except ImportError as error:
            yield Check(name, 'broken', f'cannot be imported: {error}', 'install again: make')


def _python(name: str) -> Iterator[Check]:
    now, words = sys.version_info[:2], f'{platform.python_version()}, {sys.executable}'
    if _PYTHONS[0] <= now <= _PYTHONS[1]:
        yield Check(name, 'ok', words)
    else:
        yield Check(name, 'broken', words, 'needs Python 3.11 to 3.13: make PYTHON=python3.12')


def _processor(name: str) -> Iterator[Check]:
    cores = len(os.sched_getaffinity(0))
    if lacking():
        yield Check(
            name, 'missing', f'{cores} cores without {lacking()}',
            'results may differ from those of other machines in the last bits',
        )
    else:
        yield Check(name, 'ok', f'{cores} cores with AVX2 and FMA')


def _compiled(name: str) -> Iterator[Check]:
    pixels = importlib.import_module('taxinet_ros.core.camera.pixels')
    yield Check(name, 'ok', f'drawn with {" ".join(pixels.instruction_sets())}')


def _compiler(name: str) -> Iterator[Check]:
    found = shutil.which('c++')
    if found is None:
        yield Check(name, 'missing', 'no c++', 'to build messages or an update: apt install g++')
        return
    done = subprocess.run(
        [found, '-std=c++20', '-fsyntax-only', '-x', 'c++', '-'], input=_CXX_STANDARD,
        capture_output=True, check=False,
    )
    if done.returncode:
        yield Check(name, 'missing', f'{found} knows no C++20', 'GCC 11, Clang 14 and newer do')
    else:
        yield Check(name, 'ok', f'{found} with C++20')


def _packages(name: str) -> Iterator[Check]:
    absent = []
    for line in metadata.requires('taxinet_ros') or ():
        if 'extra ==' in line:
            continue
        wanted = re.match(r'[\w.-]+', line)
        try:
            metadata.version(wanted[0] if wanted else line)
        except metadata.PackageNotFoundError:
            absent.append(wanted[0] if wanted else line)
    if absent:
        yield Check(name, 'broken', f'missing: {", ".join(absent)}', 'install again: make')
    else:
        known = ('numpy', 'torch', 'jsbsim', 'scenic')
        yield Check(name, 'ok', ', '.join(f'{word} {metadata.version(word)}' for word in known))
    for word, use in _EXTRAS.items():
        try:
            yield Check(name, 'ok', f'{word} {metadata.version(word)}, for {use}')
        except metadata.PackageNotFoundError:
            yield Check(name, 'missing', f'{word}, for {use}', f'pip install {word}')


def _ros(name: str) -> Iterator[Check]:
    try:
        importlib.import_module('taxinet_ros.nodes')  # asks for what would end this process
        rclpy: Any = importlib.import_module('rclpy')
        utilities: Any = importlib.import_module('rclpy.utilities')
    except ImportError as error:
        yield Check(
            name, 'broken', f'no ROS 2 in this Python: {error}',
            'make installs it as wheels, or source a Jazzy installation; engine loop with audit '
            '0 and import taxinet_ros need none',
        )
        return
    middleware = utilities.get_rmw_implementation_identifier()
    place = Path(rclpy.__file__).parent
    yield Check(name, 'ok', f'rclpy of {place}, {middleware}')
    others = [
        path for variable in ('AMENT_PREFIX_PATH', 'PYTHONPATH')
        for path in os.environ.get(variable, '').split(':') if path.startswith('/opt/ros')
    ]
    if others and sys.prefix in str(place):
        yield Check(
            name, 'broken', f'{others[0]} is sourced too: two ROS installations in one process',
            'open a shell where it is not sourced',
        )


def _messages(name: str) -> Iterator[Check]:
    from taxinet_ros.core.scenario_fields import MESSAGE_FIELDS

    try:
        messages: Any = importlib.import_module('taxinet_msgs.msg')
    except ImportError as error:
        fix = 'make, taxinet setup-messages, or colcon build with msg_defs'
        yield Check(name, 'broken', f'not built: {error}', fix)
        return
    fields = messages.Scenario.get_fields_and_field_types()
    lost = [field.attribute for field in MESSAGE_FIELDS if field.attribute not in fields]
    if lost:
        yield Check(name, 'broken', f'built from older sources, without {lost[0]}', 'make')
    else:
        yield Check(name, 'ok', f'taxinet_msgs {_version("taxinet_msgs")}, {messages.__file__}')


def _version(distribution: str) -> str:
    try:
        return metadata.version(distribution)
    except metadata.PackageNotFoundError:
        return 'without a version'


def _domain(name: str) -> Iterator[Check]:
    from taxinet_ros.nodes.running.domain import (
        BY_HAND,
        DISCOVERY_RANGE,
        own_domain,
        require_discovery,
    )

    require_discovery()
    with own_domain() as domain:
        why = f'by {BY_HAND}' if os.environ.get(BY_HAND) else 'free; each graph takes its own'
        yield Check(name, 'ok', f'{domain}, {why}')
        yield _heard(domain)
    far = os.environ.get(DISCOVERY_RANGE, '')
    if far not in ('', 'LOCALHOST'):
        yield Check(
            name, 'missing', f'{DISCOVERY_RANGE}={far}: graphs look for nodes on other machines, '
            'and start more slowly', f'unset {DISCOVERY_RANGE}',
        )


def _heard(domain: int) -> Check:
    """Whether a message of one participant reaches another on this machine."""
    import rclpy
    from rclpy.context import Context
    from rclpy.executors import SingleThreadedExecutor
    from rclpy.node import Node
    from std_msgs.msg import String

    from taxinet_ros.nodes.running.leave import leave_graph

    heard: list[Any] = []
    contexts = [Context(), Context()]
    begun = time.monotonic()
    try:
        nodes = []
        for number, context in enumerate(contexts):
            rclpy.init(context=context, domain_id=domain)
            nodes.append(Node(
                f'taxinet_doctor_{os.getpid()}_{number}', context=context, enable_rosout=False,
                start_parameter_services=False,
            ))
        topic = f'taxinet_doctor_{os.getpid()}'
        speaker = nodes[0].create_publisher(String, topic, 1)
        nodes[1].create_subscription(String, topic, heard.append, 1)
        executor = SingleThreadedExecutor(context=contexts[1])
        executor.add_node(nodes[1])
        while not heard and time.monotonic() - begun < _DISCOVERY_S:
            speaker.publish(String(data='here'))
            executor.spin_once(timeout_sec=0.05)
        for node in nodes:
            leave_graph(node)
    finally:
        for context in contexts:
            rclpy.try_shutdown(context=context)
    waited_s = time.monotonic() - begun
    if heard:
        return Check('discovery', 'ok', f'two participants heard each other after {waited_s:.1f} s')
    return Check(
        'discovery', 'broken', f'two participants did not hear each other within {waited_s:.0f} s',
        'let UDP pass on the loopback interface (firewall, container), and unset '
        'FASTRTPS_DEFAULT_PROFILES_FILE',
    )


def _memory(name: str) -> Iterator[Check]:
    free = psutil.virtual_memory().available
    state = 'ok' if free >= _MEMORY_OF_A_GRAPH else 'broken'
    yield Check(
        name, state, f'{free / 1e9:.1f} GB free',
        '' if state == 'ok' else f'a graph needs {_MEMORY_OF_A_GRAPH / 1e9:.1f} GB',
    )
    place = Path('/dev/shm')
    if not os.access(place, os.W_OK):
        yield Check('shared memory', 'broken', f'{place} cannot be written', 'mount it as tmpfs')
        return
    room = shutil.disk_usage(place).free
    if room < _SHARED_OF_A_GRAPH:
        yield Check(
            'shared memory', 'broken', f'{room / 1e6:.0f} MB free in {place}',
            'end other graphs, remove leftover fastrtps_* there, or give the container a larger '
            'shm-size',
        )
    else:
        yield Check('shared memory', 'ok', f'{room / 1e6:,.0f} MB free in {place}')


def _limits(name: str) -> Iterator[Check]:
    files = resource.getrlimit(resource.RLIMIT_NOFILE)[0]
    if files != resource.RLIM_INFINITY and files < _FILES_OF_A_GRAPH:
        yield Check(name, 'broken', f'{files} open files', 'ulimit -n 4096')
    else:
        yield Check(name, 'ok', f'{files:,} open files')
    threads, limit = psutil.Process().num_threads(), resource.getrlimit(resource.RLIMIT_NPROC)[0]
    if 0 <= limit < 200 + threads:
        yield Check(name, 'broken', f'{limit} processes and threads of this user', 'ulimit -u 4096')


def _disk(name: str) -> Iterator[Check]:
    for what, place in (('here', Path.cwd()), ('temporary', Path(tempfile.gettempdir()))):
        room = shutil.disk_usage(place).free
        if not os.access(place, os.W_OK | os.X_OK):
            yield Check(name, 'broken', f'{place} ({what}) cannot be written', 'go elsewhere')
        elif room < _ROOM_BYTES:
            yield Check(
                name, 'broken', f'{room / 1e9:.1f} GB free in {place} ({what})',
                f'a run with pictures has {_BAG_BYTES / 1e6:.0f} MB',
            )
        else:
            yield Check(name, 'ok', f'{room / 1e9:,.0f} GB free in {place} ({what})')


def _run(name: str) -> Iterator[Check]:
    import taxinet_ros as tx

    begun = time.monotonic()
    run = tx.run(tx.Scenario(duration_s=1.0, cross_track_m=1.0), specs=['phi_always'])
    seconds = time.monotonic() - begun
    yield Check(
        name, 'ok', f'a second of taxiing with the network, without ROS, took {seconds:.2f} s of '
        f'{len(run.trace)} steps',
    )


_CHECKS: dict[str, Callable[[str], Iterator[Check]]] = {
    'python': _python, 'processor': _processor, 'camera': _compiled, 'compiler': _compiler,
    'packages': _packages, 'ros': _ros, 'messages': _messages, 'domain': _domain,
    'memory': _memory, 'limits': _limits, 'disk': _disk, 'run': _run,
}

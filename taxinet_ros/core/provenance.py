"""Provenance of a result: the machine, libraries and code that determine its exact bits.

Equal records guarantee equal bytes. Choices that a library does not report (onnxruntime's kernels)
depend on the processor features, which are recorded.
"""

from __future__ import annotations

import hashlib
import json
import os
import platform
import re
import subprocess
import sys
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

from taxinet_ros.instructions import PINS, cpuinfo, processor_flags
from taxinet_ros.registry import plugins
from taxinet_ros.version import __version__

Provenance = Mapping[str, str]
"""Facts by name, as returned by :func:`provenance`."""

COMMIT = 'commit'
"""The only fact that may differ between two checkouts of the same code."""

LIBRARIES = (
    'numpy', 'opencv-python-headless', 'onnxruntime', 'jsbsim', 'astral', 'pymap3d', 'scenic',
    'torch', 'scipy', 'optuna', 'pandas', 'rclpy', 'ros-fastrtps', 'zstandard',
)
"""Names of installed packages. Some affect only trained or learned parts of a result; the last
affects only the bytes of a bag."""

NAMES = (
    'processor', 'machine', 'processor_features', 'pixels', 'numpy_features', 'blas', 'environment',
    'libc', 'python', *LIBRARIES, 'plugins', 'taxinet_ros', COMMIT,
)
"""All possible facts, in the order of a record."""

_FEATURES = ('avx2', 'fma', 'avx512f', 'avx512_vnni', 'asimd')
_SWITCHES = (
    'NPY_DISABLE_CPU_FEATURES', 'OPENBLAS_CORETYPE', 'OPENCV_CPU_DISABLE', 'OPENCV_IPP',
    'GLIBC_TUNABLES', 'ATEN_CPU_CAPABILITY',
)
"""Environment variables that stop libraries from using processor features; our own values of them
are not recorded."""

_INSTALLED = re.compile(r'(?P<name>.+?)-(?P<version>\d[^-]*)(-py[\d.]+)?\.(dist|egg)-info')
_GIT_S = 5.0


def provenance() -> Provenance:
    """Collect processor, instruction sets, libraries, version and commit of this process.

    Returns:
        Non-empty facts by name: ``processor`` (model), ``machine`` (architecture),
        ``processor_features`` (the relevant ones), ``pixels``, ``numpy_features``, ``blas``
        (features used by our compiled code, numpy and its BLAS), ``environment`` (variables that
        disable features), ``libc``, ``python``, each installed package of :data:`LIBRARIES`,
        ``plugins`` (packages that add extensions, with their versions), ``taxinet_ros`` (version)
        and ``commit``, which ends with ``+changes`` if the checkout's code has uncommitted changes.
    """
    return _collected(plugins())  # which change with Python's path, and nothing else does


@cache
def _collected(added: str) -> Provenance:
    facts = {
        'processor': processor(),
        'machine': platform.machine(),
        'processor_features': ' '.join(name for name in _FEATURES if name in processor_flags()),
        **_in_use(),
        'environment': ' '.join(
            f'{name}={value}' for name in _SWITCHES for value in [os.environ.get(name)]
            if value and value != PINS.get(name)
        ),
        'libc': ' '.join(platform.libc_ver()).strip(),
        'python': platform.python_version(),
        **library_versions(),
        'plugins': added,
        'taxinet_ros': __version__,
        COMMIT: _commit(Path(__file__).parents[2]),
    }
    return {name: value for name, value in facts.items() if value}


def without_commit(facts: Provenance) -> dict[str, str]:
    """Facts that are equal for two checkouts of the same code on one machine."""
    return {name: value for name, value in facts.items() if name != COMMIT}


def stack_id(facts: Provenance) -> str:
    """Short identifier of a record, for tables: 8 hexadecimal digits."""
    text = json.dumps(dict(facts), sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:8]


def differences(*records: Provenance) -> str:
    """Describe how records differ: ``numpy 2.4.6 | 2.5.0, …``; '' if they do not.

    A fact in only one record is not a difference: older versions recorded fewer.
    """
    told: dict[str, dict[str, None]] = {}
    for record in records:
        for name, value in record.items():
            told.setdefault(name, {})[_short(value)] = None
    return ', '.join(f'{name} {" | ".join(values)}' for name, values in told.items()
                     if len(values) > 1)


def begun_elsewhere(before: Sequence[Provenance], now: Provenance, what: str) -> str:
    """One-line warning if earlier records are of another machine or version; else ''.

    Args:
        before: earlier records; an empty one means that nothing was recorded.
        now: record of this process.
        what: what was made on them, for the message: ``all the runs so far``.
    """
    if not all(before):
        return f'nothing tells on which machine and versions {what} were made'
    found = differences(*before, now)
    return f'begun on another machine or version: {found}; see docs/determinism.md' if found else ''


def words(facts: Provenance) -> str:
    """One-line description of a record."""
    return ', '.join(
        value if name == 'processor' else f'{name} {_short(value)}'
        for name, value in facts.items() if name not in ('processor_features', 'numpy_features')
    )


def known(values: Any) -> dict[str, str]:
    """Read a record from an untrusted file; anything but names and texts is dropped."""
    if not isinstance(values, Mapping):
        return {}
    return {str(name): value for name, value in values.items() if isinstance(value, str)}


def processor() -> str:
    """Processor model, as reported by the kernel."""
    return cpuinfo('model name') or platform.machine()


def library_versions() -> dict[str, str]:
    """Versions of the installed packages of :data:`LIBRARIES`.

    Read from the names of metadata folders: ``importlib.metadata`` opens and parses each, which
    takes longer than everything else here.
    """
    found: dict[str, str] = {}
    for folder in sys.path:
        try:
            names = os.listdir(folder or '.')
        except OSError:
            continue
        for match in filter(None, map(_INSTALLED.fullmatch, names)):
            name = re.sub(r'[-_.]+', '-', match['name']).lower()
            found.setdefault(name, match['version'])
    return {name: found[name] for name in LIBRARIES if name in found}


def _in_use() -> dict[str, str]:
    # Imported here, so that commands that record nothing do not load them.
    import numpy as np
    import threadpoolctl

    from taxinet_ros.core.camera import pixels

    simd = np.show_config(mode='dicts')['SIMD Extensions']
    blas = [
        str(pool.get('architecture') or '') for pool in threadpoolctl.threadpool_info()
        if pool['user_api'] == 'blas' and 'numpy' in pool['filepath']
    ]
    return {
        'pixels': ' '.join(pixels.instruction_sets()),
        'numpy_features': ' '.join([*simd['baseline'], *simd.get('found', ())]),
        'blas': blas[0] if blas else '',
    }


def _commit(root: Path) -> str:
    """Commit of a checkout, or from which an installation was made; '' if unknown."""
    if not (root / '.git').exists():
        return _installed_commit(root)
    asked = ['git', '-C', str(root), 'status', '--porcelain=v2', '--branch',
             '--untracked-files=no', '--', 'taxinet_ros', 'msg_defs', 'setup.py']
    environment = {**os.environ, 'GIT_OPTIONAL_LOCKS': '0'}
    try:
        told = subprocess.run(
            asked, capture_output=True, text=True, timeout=_GIT_S, check=True, env=environment
        ).stdout.splitlines()
    except (OSError, subprocess.SubprocessError):
        return ''
    head = next((line.split()[-1] for line in told if line.startswith('# branch.oid')), '')
    changed = any(not line.startswith('#') for line in told)
    return f'{head}+changes' if head and changed else head


def _installed_commit(site: Path) -> str:
    """Commit recorded by pip when it installed from a repository (PEP 610)."""
    for file in site.glob('taxinet_ros-*.dist-info/direct_url.json'):
        try:
            return str(json.loads(file.read_text(encoding='utf-8'))['vcs_info']['commit_id'])
        except (OSError, ValueError, KeyError, TypeError):
            return ''
    return ''


def _short(value: str) -> str:
    return value if len(value) <= 60 else value[:59] + '…'

"""Message definitions and type hashes of the installed interface packages, read as files.

Nothing is imported: a package's ``share/<package>/msg/`` holds the ``.msg`` text and, from Iron on,
the ``.json`` type description with the REP-2016 hashes.
"""

from __future__ import annotations

import json
import os
import re
import sys
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path

from taxinet_ros.bag.topics import TopicInfo, is_type_name
from taxinet_ros.core.errors import UsageError

_BUILTIN = frozenset({
    'bool', 'byte', 'char', 'float32', 'float64', 'int8', 'uint8', 'int16', 'uint16', 'int32',
    'uint32', 'int64', 'uint64', 'string', 'wstring',
})
_FIELD = re.compile(r'\s*([A-Za-z][A-Za-z0-9_/]*)(?:<=\d+)?(?:\[[^\]]*\])?\s+[A-Za-z]')
_SEPARATOR = '\n' + '=' * 80 + '\nMSG: '


def describe_topic(*, name: str, type_name: str, qos: str) -> TopicInfo:
    """A topic with the definition and hash that are installed for its type."""
    return TopicInfo(
        name=name, type=type_name, qos=qos,
        definition=message_definition(type_name), type_hash=type_hash(type_name),
    )


def message_definition(type_name: str, prefixes: Sequence[Path] | None = None) -> str:
    """The definition of ``type_name`` and of all types within it, as MCAP's ``ros2msg`` wants it.

    The order is that of rosbag2: depth first, the types within one definition by name.

    Args:
        type_name: e.g. ``sensor_msgs/msg/Image``.
        prefixes: install prefixes to search; default ``AMENT_PREFIX_PATH``, then ``sys.prefix``.

    Raises:
        UsageError: the type, or one within it, is not installed.
    """
    return _definition(type_name, _search_path(prefixes))


def type_hash(type_name: str, prefixes: Sequence[Path] | None = None) -> str:
    """The REP-2016 hash of ``type_name``, ``RIHS01_…``; arguments and errors as above."""
    return _hash(type_name, _search_path(prefixes))


def _search_path(prefixes: Sequence[Path] | None) -> tuple[Path, ...]:
    if prefixes is not None:
        return tuple(prefixes)
    named = os.environ.get('AMENT_PREFIX_PATH', '').split(os.pathsep)
    return tuple(Path(text) for text in [*filter(None, named), sys.prefix])


@lru_cache(maxsize=256)
def _definition(type_name: str, prefixes: tuple[Path, ...]) -> str:
    seen = {type_name.replace('/msg/', '/')}

    def expand(name: str) -> str:
        text = _read(name, '.msg', prefixes)
        parts = [text]
        for inner in sorted(_inner_types(text, name.split('/')[0])):
            if inner not in seen:
                seen.add(inner)
                package, short = inner.split('/')
                parts += [_SEPARATOR, inner, '\n', expand(f'{package}/msg/{short}')]
        return ''.join(parts)

    return expand(type_name)


@lru_cache(maxsize=256)
def _hash(type_name: str, prefixes: tuple[Path, ...]) -> str:
    try:
        entries = json.loads(_read(type_name, '.json', prefixes))['type_hashes']
        return next(str(e['hash_string']) for e in entries if e['type_name'] == type_name)
    except (ValueError, KeyError, TypeError, StopIteration):
        raise UsageError(
            f'{type_name}: the installed .json names no type hash; reinstall its package'
        ) from None


def _inner_types(text: str, package: str) -> set[str]:
    """Types that a definition refers to, each as ``package/Name``."""
    inner: set[str] = set()
    for line in text.splitlines():
        match = _FIELD.match(line.partition('#')[0])
        if match is None or match.group(1) in _BUILTIN:
            continue
        parts = match.group(1).split('/')
        inner.add(f'{parts[0]}/{parts[-1]}' if len(parts) > 1 else f'{package}/{parts[0]}')
    return inner


def _read(type_name: str, suffix: str, prefixes: tuple[Path, ...]) -> str:
    if not is_type_name(type_name):
        raise UsageError(f'{type_name!r} is not of the form package/msg/Name')
    package, _, name = type_name.split('/')
    for prefix in prefixes:
        file = prefix / 'share' / package / 'msg' / (name + suffix)
        if file.is_file():
            return file.read_text(encoding='utf-8')
    raise UsageError(
        f'{type_name}: share/{package}/msg/{name}{suffix} is under none of '
        f'{os.pathsep.join(map(str, prefixes))}; install package {package} or source its workspace'
    )

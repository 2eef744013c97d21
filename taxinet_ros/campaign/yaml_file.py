"""YAML files that people write, read safely and with one line where something is wrong."""

from __future__ import annotations

from pathlib import Path

import yaml

from taxinet_ros.core.errors import UsageError
from taxinet_ros.core.plain_values import YAML_TROUBLES, load_strict_yaml

MAX_BYTES = 1 << 20
"""Longer files are not read: YAML takes a second for some ten thousand characters."""


def read_yaml(path: Path, *, option: str = '', mend: str = '') -> object:
    """What a file holds, as plain values.

    Args:
        path: the file, UTF-8.
        option: heads the line if the file cannot be read, as in ``--spec``.
        mend: what to say of a mistake in the syntax, on how it may be mended.

    Raises:
        UsageError: it cannot be read, is not YAML, or gives a key twice.
    """
    try:
        if path.stat().st_size > MAX_BYTES:
            raise UsageError(f'{path}: has more than {MAX_BYTES >> 20} MiB; is it the right file?')
        return load_strict_yaml(path.read_bytes().decode('utf-8-sig'))
    except OSError as error:
        where = f'{option} {path}'.strip()
        raise UsageError(f'{where}: cannot be read: {error.strerror}') from error
    except UnicodeDecodeError:
        raise UsageError(f'{path}: is not text in UTF-8; write it as YAML') from None
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark
        place = f'line {mark.line + 1}, column {mark.column + 1}: ' if mark else ''
        syntax = not isinstance(error, yaml.constructor.ConstructorError)
        raise UsageError(f'{path}: {place}{error.problem}{mend if syntax else ""}') from None
    except YAML_TROUBLES as error:
        raise UsageError(f'{path}: is not YAML: {" ".join(str(error).split())[:120]}') from None


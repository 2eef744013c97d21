"""YAML files that people write, read safely and with one line where something is wrong."""

from __future__ import annotations

from collections.abc import Hashable
from pathlib import Path
from typing import Any

import yaml

from taxinet_ros.core.errors import UsageError


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
        return yaml.load(path.read_bytes().decode('utf-8-sig'), _Loader)  # safe: a SafeLoader
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
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        raise UsageError(f'{path}: is not YAML: {" ".join(str(error).split())[:120]}') from None


class _Loader(yaml.SafeLoader):
    """Refuses a key that is given twice, of which YAML would keep the last."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Hashable, Any]:
        """The mapping, or an error that names the key."""
        keys = [key.value for key, _ in node.value if isinstance(key, yaml.ScalarNode)]
        for number, (key, _) in enumerate(node.value):
            if isinstance(key, yaml.ScalarNode) and key.value in keys[:number]:
                raise yaml.constructor.ConstructorError(
                    None, None, f'{key.value} is given twice', key.start_mark)
        return super().construct_mapping(node, deep)

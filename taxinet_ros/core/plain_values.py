"""Plain values out of texts that may come from anywhere: JSON, and YAML that people write.

What such a text can do beyond being wrong is to grow when it is read (YAML's aliases and merge
keys), to be nested deeper than Python's stack, or to take minutes. None of it gets so far here.
"""

from __future__ import annotations

import json
from collections.abc import Hashable
from typing import Any

import yaml

MAX_DEPTH = 100
"""Brackets within brackets; PyYAML takes seconds for a thousand."""

YAML_TROUBLES = (
    yaml.YAMLError, ValueError, TypeError, LookupError, AttributeError, OverflowError,
    RecursionError,
)
"""What PyYAML raises: its own errors, and whatever its constructors run into."""


def load_json(data: bytes | str) -> Any:
    """The values that a JSON text stands for.

    Raises:
        ValueError: it is no JSON, or nested too deeply to be read.
    """
    try:
        return json.loads(data)
    except RecursionError:
        raise ValueError('nested too deeply') from None


def load_strict_yaml(text: str) -> Any:
    """The plain values that a YAML text of a person's stands for.

    Raises:
        yaml.MarkedYAMLError: it is no YAML, gives a key twice, or has aliases or merge keys; for
            what is YAML and refused all the same, its ConstructorError.
        YAML_TROUBLES: it is no YAML of plain values.
    """
    check_depth(text)
    return yaml.load(text, _StrictLoader)  # safe: a SafeLoader


def check_depth(text: str) -> None:
    """Refuse brackets within brackets without end, of whatever they are part.

    Raises:
        ValueError: there are more than :data:`MAX_DEPTH`.
    """
    depth = 0
    for sign in text:
        if sign in '[{':
            depth += 1
            if depth > MAX_DEPTH:
                raise ValueError('nested too deeply')
        elif sign in ']}':
            depth = max(depth - 1, 0)


class _StrictLoader(yaml.SafeLoader):
    """Plain values, each where it stands."""

    def compose_node(self, parent: Any, index: Any) -> Any:
        """The next part, unless it is one from elsewhere."""
        if self.check_event(yaml.events.AliasEvent):
            problem = 'an alias (*) is not read; write it out'
            raise yaml.constructor.ConstructorError(None, None, problem, self.get_mark())
        return super().compose_node(parent, index)

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Hashable, Any]:
        """The mapping, unless it gives a key twice, of which YAML would keep the last."""
        seen = set()
        for key, _ in node.value:
            if not isinstance(key, yaml.ScalarNode):
                continue
            if key.tag == 'tag:yaml.org,2002:merge':
                problem = 'a merge key (<<) is not read; write it out'
            elif key.value in seen:
                problem = f'{key.value[:60]} is given twice'
            else:
                seen.add(key.value)
                continue
            raise yaml.constructor.ConstructorError(None, None, problem, key.start_mark)
        return super().construct_mapping(node, deep)

"""YAML as bags hold it, written plainly and read with suspicion."""

from __future__ import annotations

from typing import Any

import yaml

from taxinet_ros.files.plain_values import YAML_TROUBLES, check_depth

MAX_CHARS = 2**22
"""Longer texts are not read: YAML costs a millisecond for every few hundred characters."""


def dump_yaml(value: Any) -> str:
    """YAML of ``value`` in the order given and without aliases, which rosbag2's readers dislike."""
    return yaml.dump(value, Dumper=_PlainDumper, sort_keys=False, allow_unicode=True)


def load_yaml(text: str, *, aliases: bool = True) -> Any:
    """The plain values that ``text`` stands for.

    Args:
        text: from anywhere.
        aliases: whether one part may stand in several places. Written out again, few lines with
            aliases of aliases could be many gigabytes.

    Raises:
        ValueError: it is no YAML of plain values, or has merge keys, or is too long or too deep.
    """
    if len(text) > MAX_CHARS:
        raise ValueError(f'{len(text)} characters, more than the {MAX_CHARS} allowed')
    try:
        check_depth(text)
        loader = _Loader(text)
        loader.aliases = aliases
        return loader.get_single_data()
    except YAML_TROUBLES as error:
        raise ValueError(f'not YAML of plain values: {text[:60]!r}') from error


class _Loader(yaml.SafeLoader):
    """Plain values only, and nothing that grows when it is read."""

    aliases = True

    def compose_node(self, parent: Any, index: Any) -> Any:
        """The next part, unless it is a forbidden alias."""
        if not self.aliases and self.check_event(yaml.events.AliasEvent):
            raise yaml.YAMLError('alias')
        return super().compose_node(parent, index)

    def flatten_mapping(self, node: Any) -> None:
        """No merge keys: merged merges double with every line."""
        if any(key.tag == 'tag:yaml.org,2002:merge' for key, _ in node.value):
            raise yaml.YAMLError('merge key')
        super().flatten_mapping(node)


# A base class that is chosen at run time has no type that mypy could know.
class _PlainDumper(getattr(yaml, 'CSafeDumper', yaml.SafeDumper)):  # type: ignore[misc]
    """YAML without anchors and aliases; libyaml, where it is there, writes the same text sooner."""

    def ignore_aliases(self, data: Any) -> bool:
        """Spell every value out, however often it occurs."""
        return True

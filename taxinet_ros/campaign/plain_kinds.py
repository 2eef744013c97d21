"""Whether plain values out of a file are of the kinds that the fields of a dataclass want."""

from __future__ import annotations

_OPTIONAL = ' | None'
_MOST = 2**63
"""Whole numbers beyond it fit into no table."""


def check_kind(name: str, kind: str, value: object) -> None:
    """See that a value is of a kind.

    Args:
        name: of the field, for the message.
        kind: the field's annotation as it is written: ``str``, ``int``, ``float`` (whole numbers
            too), ``bool``, one of these ``| None``, or ``Mapping[str, float]``; others pass.
        value: what JSON has given.

    Raises:
        ValueError: it is of another kind.
    """
    if not _fits(kind, value):
        raise ValueError(f'{name} is {str(value)[:40]!r}, not {kind}')


def _fits(kind: str, value: object) -> bool:
    if kind.endswith(_OPTIONAL):
        return value is None or _fits(kind.removesuffix(_OPTIONAL), value)
    if kind == 'Mapping[str, float]':
        return isinstance(value, dict) and all(
            _fits('str', name) and _fits('float', number) for name, number in value.items()
        )
    if kind == 'str':
        return isinstance(value, str) and _is_text(value)
    if kind == 'bool':
        return isinstance(value, bool)
    if kind == 'float' and isinstance(value, float):
        return True
    if kind in ('int', 'float'):
        return isinstance(value, int) and not isinstance(value, bool) and -_MOST <= value < _MOST
    return True


def _is_text(value: str) -> bool:
    """JSON may escape halves of characters, which no file takes."""
    try:
        value.encode()
    except UnicodeEncodeError:
        return False
    return True

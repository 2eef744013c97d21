"""Findings as values that JSON has a word for."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np


def plain_values(values: Mapping[str, Any]) -> dict[str, Any]:
    """The same in JSON's own types; None where a number is not finite."""
    return {str(key): _plain(one) for key, one in values.items()}


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return plain_values(value)
    if isinstance(value, (list, tuple)):
        return [_plain(one) for one in value]
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value

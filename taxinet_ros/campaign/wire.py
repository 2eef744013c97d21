"""How runs and their results travel between a campaign and its workers: a JSON object a line."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping
from typing import Any

from taxinet_ros.core.outcome import Outcome, RunRequest, RunResult
from taxinet_ros.core.run_statistics import ErrorStatistics, RunStatistics
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.stop_on import StopOn


def line_of(message: Mapping[str, Any]) -> bytes:
    """One line. Floats come back as they were, NaN and infinities too."""
    return json.dumps(message, separators=(',', ':')).encode() + b'\n'


def request_to_json(request: RunRequest) -> dict[str, Any]:
    """Plain values; the inverse of :func:`request_from_json`."""
    return dataclasses.asdict(request)


def request_from_json(values: Mapping[str, Any]) -> RunRequest:
    """Read back what :func:`request_to_json` gave.

    Raises:
        UsageError: the scenario is out of range.
        KeyError, TypeError, ValueError: a field is missing or unknown.
    """
    return RunRequest(**{
        **values,
        'scenario': Scenario(**values['scenario']),
        'specs': tuple(values['specs']),
        'participants': tuple(values['participants']),
        'bounds': tuple(values['bounds']),
        'rates': tuple(values['rates']),
        'stop_on': StopOn(values['stop_on']),
    })


def result_to_json(result: RunResult) -> dict[str, Any]:
    """Plain values; the inverse of :func:`result_from_json`."""
    return dataclasses.asdict(result)


def result_from_json(values: Mapping[str, Any]) -> RunResult:
    """Read back what :func:`result_to_json` gave.

    Raises:
        KeyError, TypeError, ValueError: a field is missing or unknown, or the outcome is none of
            the five.
    """
    return RunResult(**{
        **values,
        'outcome': Outcome(values['outcome']),
        'statistics': _statistics_from_json(values.get('statistics')),
    })


def _statistics_from_json(values: Mapping[str, Any] | None) -> RunStatistics | None:
    if values is None:
        return None
    errors = {name: ErrorStatistics(**values[name]) for name in ('cte_error', 'he_error')}
    return RunStatistics(**{**values, **errors})

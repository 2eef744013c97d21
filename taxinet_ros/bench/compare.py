"""Reports of the bench, and how a newer one compares with an older one."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from taxinet_ros.bench.machine import LOAD
from taxinet_ros.bench.measure import Figure
from taxinet_ros.core.errors import UsageError
from taxinet_ros.core.plain_values import load_json
from taxinet_ros.core.provenance import COMMIT

Report = dict[str, Any]
"""``machine``: facts; ``figures``: what was measured, by name; both ready for JSON."""


_APART = (LOAD, COMMIT)
"""Facts that are never the same twice, or whose comparison is what a report is for."""


def make_report(machine: Mapping[str, Any], figures: Mapping[str, Figure]) -> Report:
    """What ``taxinet bench --json`` prints."""
    return {
        'machine': dict(machine),
        'figures': {name: asdict(figure) for name, figure in figures.items()},
    }


def load_report(path: Path) -> Report:
    """Read an older report.

    Raises:
        UsageError: no such file, or not a report.
    """
    try:
        report = load_json(path.read_bytes())
    except OSError as error:
        raise UsageError(f'bench: cannot read {path}: {error.strerror}') from error
    except ValueError:
        report = None
    if not _is_report(report):
        raise UsageError(f'bench: {path} is no report; taxinet bench --json > {path} makes one')
    return dict(report)


def _is_report(report: object) -> bool:
    if not isinstance(report, dict):
        return False
    machine, figures = report.get('machine'), report.get('figures')
    if not (isinstance(machine, dict) and isinstance(figures, dict)):
        return False
    return all(isinstance(figure, dict) and _median(figure) > 0 for figure in figures.values())


def _median(figure: Mapping[str, Any]) -> float:
    """Median of a figure [s]; 0 where there is none to divide by."""
    value: Any = figure.get('median_s')
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        return 0.0
    return float(value)


def compare(new: Report, old: Report) -> dict[str, Any]:
    """How a report compares with an older one.

    Returns:
        ``ratios``: new median over old median for every figure that both have; ``differences``:
        the facts of the machine that are not the same, as [old, new] by name.
    """
    before = old['figures']
    facts = {**old['machine'], **new['machine']}
    pairs = {fact: [old['machine'].get(fact), new['machine'].get(fact)] for fact in facts}
    return {
        'ratios': {
            name: _median(figure) / _median(before[name])
            for name, figure in new['figures'].items()
            if name in before
        },
        'differences': {
            fact: pair for fact, pair in pairs.items() if fact not in _APART and pair[0] != pair[1]
        },
    }

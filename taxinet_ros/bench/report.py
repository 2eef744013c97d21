"""Benchmark reports: comparison with an older report, and ratios of figures within one."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from taxinet_ros.bench.measure import LOAD, Figure
from taxinet_ros.core.provenance import COMMIT
from taxinet_ros.errors import UsageError
from taxinet_ros.files.plain_values import load_json
from taxinet_ros.files.reading import MAX_TEXT_BYTES, read_file

Report = dict[str, Any]
"""``machine``: facts; ``figures``: measurements by name; both ready for JSON."""

_APART = (LOAD, COMMIT)
"""Facts that differ in every report, or whose comparison is the purpose of a report."""


def make_report(machine: Mapping[str, Any], figures: Mapping[str, Figure]) -> Report:
    """Report that ``taxinet bench --json`` prints."""
    return {
        'machine': dict(machine),
        'figures': {name: asdict(figure) for name, figure in figures.items()},
    }


def load_report(path: Path) -> Report:
    """Read an older report.

    Raises:
        UsageError: there is no such file, or it is not a report.
    """
    try:
        report: Any = load_json(read_file(path, MAX_TEXT_BYTES))
        sound = isinstance(report['machine'], dict) and all(
            _median(figure) > 0 for figure in report['figures'].values()
        )
    except OSError as error:
        raise UsageError(f'bench: cannot read {path}: {error.strerror}') from error
    except (ValueError, TypeError, LookupError, AttributeError):
        sound = False
    if not sound:
        raise UsageError(f'bench: {path} is no report; taxinet bench --json > {path} makes one')
    return dict(report)


def _median(figure: Mapping[str, Any]) -> float:
    """Median of a figure [s]; 0 if there is none to divide by."""
    value = figure['median_s']
    return value if isinstance(value, float) and math.isfinite(value) else 0.0


def compare_reports(new: Report, old: Report) -> dict[str, Any]:
    """Compare a report with an older one, of another commit.

    Returns:
        ``ratios``: new median over old median for every figure that both have; ``differences``:
        the facts of the machine that differ, as [old, new] by name.
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


@dataclass(frozen=True, kw_only=True, slots=True)
class Ratio:
    """Ratio of the processor times of two figures.

    Attributes:
        name: display name of the ratio.
        over, under: names of the numerator and the denominator.
        most: loose bound that holds on any machine unless performance regresses.
    """

    name: str
    over: str
    under: str
    most: float | None = None


# Bounds leave a margin of about the value measured in benchmarks/RESULTS.md: they should detect a
# change that makes the graph expensive, not a busy machine.
RATIOS = (
    Ratio(
        name='composed graph / loop without ROS, network',
        over='graph/composed, network', under='loop/network', most=3.0,
    ),
    # Without pictures a run is little more than messages, so both figures are small.
    Ratio(
        name='composed graph / loop without ROS, truth',
        over='graph/composed, truth', under='loop/truth', most=25.0,
    ),
    Ratio(
        name='separate processes / composed graph, network',
        over='graph/processes, network', under='graph/composed, network', most=3.0,
    ),
    Ratio(
        name='separate processes / composed graph, truth',
        over='graph/processes, truth', under='graph/composed, truth',
    ),
)
"""Ratios computed whenever both figures exist."""


def find_ratios(
    figures: Mapping[str, Figure], ratios: Sequence[Ratio] = RATIOS
) -> dict[str, dict[str, Any]]:
    """Ratios of the measured figures, by name.

    Returns:
        ``value``: ratio of the medians; ``low``, ``high``: of opposite quartiles; ``most``: bound,
        if any.
    """
    found = {}
    for ratio in ratios:
        if ratio.over in figures and ratio.under in figures:
            over, under = _quartiles(figures[ratio.over]), _quartiles(figures[ratio.under])
            found[ratio.name] = {
                'value': over[1] / under[1], 'low': over[0] / under[2], 'high': over[2] / under[0],
                'most': ratio.most,
            }
    return found


def ratio_violations(ratios: Mapping[str, Mapping[str, Any]]) -> list[str]:
    """One line for each ratio beyond its bound."""
    return [
        f'bench: {name} is {ratio["value"]:.2f}, guarded at {ratio["most"]:g} or less'
        for name, ratio in ratios.items()
        if ratio['most'] is not None and ratio['value'] > ratio['most']
    ]


def _quartiles(figure: Figure) -> tuple[float, float, float]:
    quartiles = (figure.cpu_q1_s, figure.cpu_s, figure.cpu_q3_s)
    q1, median, q3 = (math.nan if time_s is None else time_s for time_s in quartiles)
    return q1, median, q3

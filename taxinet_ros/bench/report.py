"""Benchmark reports: comparison with an older report, and ratios of figures, some with bounds."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from taxinet_ros.bench.measure import LOAD, Figure
from taxinet_ros.bench.subjects.campaign import WORKERS, figure_name
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
    return read_report(path, _is_report, 'taxinet bench')


def read_report(
    path: Path, is_report: Callable[[object], bool], command: str
) -> dict[str, Any]:
    """Read a JSON file of a command's ``--json``.

    Args:
        path: the file.
        is_report: whether its content is a report of this kind.
        command: that writes such reports, for the error.

    Raises:
        UsageError: there is no such file, or it is not a report.
    """
    try:
        report = load_json(read_file(path, MAX_TEXT_BYTES))
    except OSError as error:
        raise UsageError(f'bench: cannot read {path}: {error.strerror}') from error
    except ValueError:
        report = None
    if not is_report(report):
        raise UsageError(f'bench: {path} is no report; {command} --json > {path} makes one')
    return dict(report)


def _is_report(report: object) -> bool:
    if not isinstance(report, dict):
        return False
    machine, figures = report.get('machine'), report.get('figures')
    if not (isinstance(machine, dict) and isinstance(figures, dict)):
        return False
    return all(isinstance(figure, dict) and _median(figure) > 0 for figure in figures.values())


def _median(figure: Mapping[str, Any]) -> float:
    """Median of a figure [s]; 0 if there is none to divide by."""
    value: Any = figure.get('median_s')
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        return 0.0
    return float(value)


def compare_reports(new: Report, old: Report) -> dict[str, Any]:
    """Compare a report with an older one.

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
    """Ratio of two figures.

    Attributes:
        name: display name of the ratio.
        over, under: names of the numerator and the denominator.
        cpu: whether it is of processor time; else of wall time.
        least, most: loose bounds that hold on any machine unless performance regresses.
    """

    name: str
    over: str
    under: str
    cpu: bool = True
    least: float | None = None
    most: float | None = None

# Bounds leave a margin of about the value measured in docs/performance.md: they should detect a
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
    # Below 1 there would be no reason to prefer an experimental executor.
    Ratio(
        name='default executor / ours, network',
        over='graph/default executor, network', under='graph/composed, network', least=1.0,
    ),
    Ratio(
        name='default executor / ours, truth',
        over='graph/default executor, truth', under='graph/composed, truth', least=1.0,
    ),
    Ratio(
        name='recorder without pictures / no recorder, network',
        over='graph/composed, network', under='graph/no recorder, network', most=2.0,
    ),
    Ratio(
        name='recorder with pictures / no recorder, network',
        over='graph/with pictures, network', under='graph/no recorder, network', most=2.5,
    ),
    *(
        Ratio(
            name=f'time per run, 1 worker / {workers} workers', over=figure_name(1),
            under=figure_name(workers), cpu=False,
        )
        for workers in WORKERS[1:]
    ),
)  # fmt: skip
"""Ratios computed whenever both figures exist."""


def find_ratios(figures: Mapping[str, Figure]) -> dict[str, dict[str, Any]]:
    """Ratios of the measured figures, by name.

    Returns:
        ``value``: ratio of the medians; ``low``, ``high``: of opposite quartiles; ``clock``;
        ``least``, ``most``: bounds, if any; ``kept``: whether the value is within them.
    """
    return {
        ratio.name: _ratio_facts(ratio, figures[ratio.over], figures[ratio.under])
        for ratio in RATIOS
        if ratio.over in figures and ratio.under in figures
    }


def ratio_violations(ratios: Mapping[str, Mapping[str, Any]]) -> list[str]:
    """One line for each ratio outside its bounds."""
    lines = []
    for name, ratio in ratios.items():
        value, least, most = ratio['value'], ratio['least'], ratio['most']
        if most is not None and value > most:
            lines.append(f'bench: {name} is {value:.2f}, guarded at {most:g} or less')
        if least is not None and value < least:
            lines.append(f'bench: {name} is {value:.2f}, guarded at {least:g} or more')
    return lines


def bounds_text(ratio: Mapping[str, Any]) -> str:
    """Display text of a ratio's bounds, '' if it has none."""
    signs = (('>=', ratio['least']), ('<=', ratio['most']))
    return ', '.join(f'{sign} {bound:g}' for sign, bound in signs if bound is not None)


def _ratio_facts(ratio: Ratio, over: Figure, under: Figure) -> dict[str, Any]:
    (q1, median, q3), (other_q1, other, other_q3) = (
        _quartiles(figure, ratio.cpu) for figure in (over, under)
    )
    found = {
        'value': median / other, 'low': q1 / other_q3, 'high': q3 / other_q1,
        'clock': 'processor' if ratio.cpu else 'wall', 'least': ratio.least, 'most': ratio.most,
    }
    return {**found, 'kept': not ratio_violations({ratio.name: found})}


def _quartiles(figure: Figure, cpu: bool) -> tuple[float, float, float]:
    if not cpu:
        return figure.q1_s, figure.median_s, figure.q3_s
    quartiles = (figure.cpu_q1_s, figure.cpu_s, figure.cpu_q3_s)
    q1, median, q3 = (math.nan if time_s is None else time_s for time_s in quartiles)
    return q1, median, q3

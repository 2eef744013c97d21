"""A recorded run as the page's viewer shows it: facts, curves and camera frames, as plain data."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from taxinet_ros.analysis.report_text import plain_number
from taxinet_ros.analysis.run_view_frames import Frames, read_frames
from taxinet_ros.analysis.run_view_ground import ground_name
from taxinet_ros.bag.facts import RunFacts, read_facts
from taxinet_ros.bag.trace import Column, read_trace
from taxinet_ros.core.types import NS_PER_S

_UNITS = {
    'cross_track': ' m', 'distance': ' m', 'heading': '°', 'rain': ' %', 'time_of_day': ' h',
    'duration': ' s',
}
"""Units in which people read a scenario's values."""

_COLUMNS = {
    'x': ('x_m', 1.0), 'y': ('y_m', 1.0), 'speed': ('speed_mps', 1.0), 'cte': ('cte_m', 1.0),
    'cteEstimate': ('est_cte_m', 1.0), 'he': ('he_rad', 180 / math.pi),
    'heEstimate': ('est_he_rad', 180 / math.pi), 'steering': ('steering_rad', 180 / math.pi),
}
"""Curves by their name on the page: column of the trace, and factor to metres and degrees."""

_DECIMALS = 3
_TELLING = ('cross track', 'heading', 'distance', 'clouds', 'rain', 'time of day')


@dataclass(frozen=True, kw_only=True, slots=True)
class RunView:
    """What the viewer of one run needs.

    Attributes:
        run_id: names it.
        outcome: one of the five words, or ''.
        crossing: whether the crossing runway was there.
        facts: what was asked and what came of it, for people.
        t_s: time of each control step since the start [s].
        curves: by name, a value for each step: metres, m/s, degrees; left positive.
        intervals: robust satisfaction interval by formula: lower and upper end for each step.
        frames: what the camera saw, thinned out.
    """

    run_id: str
    outcome: str
    crossing: bool
    facts: Mapping[str, str]
    t_s: Column
    curves: Mapping[str, Column]
    intervals: Mapping[str, tuple[Column, Column]]
    frames: Frames

    @property
    def summary(self) -> str:
        """Where and in what weather it was, on one line."""
        return ', '.join(f'{name} {self.facts[name]}' for name in _TELLING if name in self.facts)

    def data(self) -> dict[str, Any]:
        """All of it as JSON values, rounded."""
        return {
            'id': self.run_id,
            'outcome': self.outcome,
            'ground': ground_name(crossing=self.crossing),
            'facts': list(self.facts.items()),
            't': _rounded(self.t_s),
            **{name: _rounded(values) for name, values in self.curves.items()},
            'formulas': [
                {'name': name, 'lower': _rounded(lower), 'upper': _rounded(upper)}
                for name, (lower, upper) in self.intervals.items()
            ],
            'frames': self.frames.data(),
        }


def read_run_view(run_id: str, bag: Path) -> RunView:
    """Read a run for its viewer.

    Args:
        run_id: what the page calls it.
        bag: a run folder or an ``.mcap`` file.

    Raises:
        BagError, UsageError: the bag cannot be read; that frames cannot be had again is no error.
    """
    trace = read_trace(bag)
    facts = read_facts(bag)
    specs = [name.removeprefix('rho_lower.') for name in trace if name.startswith('rho_lower.')]
    return RunView(
        run_id=run_id, outcome='' if facts is None else facts.outcome,
        crossing=facts is None or bool(facts.scene.get('crossing', True)),
        facts={} if facts is None else _words(facts),
        t_s=np.asarray(trace['t_ns'], dtype=np.int64) / NS_PER_S,
        curves={
            name: np.asarray(trace[column], dtype=np.float64) * factor
            for name, (column, factor) in _COLUMNS.items()
        },
        intervals={
            spec: (trace[f'rho_lower.{spec}'], trace[f'rho_upper.{spec}']) for spec in specs
        },
        frames=read_frames(bag, [int(stamp) for stamp in trace['t_ns']]),
    )


def _rounded(values: Column) -> list[float | int | str | None]:
    return [plain_number(float(value), _DECIMALS) for value in values]


def _words(facts: RunFacts) -> dict[str, str]:
    """What a person wants to know of a run, in the order in which they ask."""
    words = {'outcome': ' '.join(w for w in (facts.outcome, facts.kind, facts.detail) if w)}
    for name, judged in facts.judged.items():
        ends = f'{judged.lower:.2f} … {judged.upper:.2f}'
        words[f'ρ of {name}'] = f'{judged.lower:.2f}' if judged.final else ends
    if (perception := facts.nodes.get('perception')) is not None:
        words['perception'] = perception.implementation
    words['program'] = f'{facts.program}, seed {facts.seed}, run {facts.index}'
    for name, value in facts.scene.items():
        words[name.replace('_', ' ')] = _scene_words(value) + _UNITS.get(name, '')
    return {name: word for name, word in words.items() if word}


def _scene_words(value: Any) -> str:
    if isinstance(value, bool):
        return 'yes' if value else 'no'
    if isinstance(value, float):
        return f'{value:.1f}'.rstrip('0').rstrip('.')
    return str(value)

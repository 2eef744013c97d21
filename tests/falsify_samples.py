"""Searches without Scenic and without ROS: a toy program, and results by a formula."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from taxinet_ros.core.mtl import exact_intervals
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.verdict.judging import Judging
from taxinet_ros.core.verdict.outcome import Outcome, RunRequest, RunResult
from taxinet_ros.core.verdict.run_statistics import RunStatistics
from taxinet_ros.samplers.space import Dimension, Point, Space
from taxinet_ros.scenes.programs import find_program
from taxinet_ros.scenes.search_space import Choice, SearchSpace
from taxinet_ros.scenes.source import Refused, Rejected, program_text
from taxinet_ros.trials.engine import Engine
from taxinet_ros.trials.options import CampaignOptions
from taxinet_ros.trials.rates import failure_rate
from taxinet_ros.trials.record.row import WALL_CLOCK_COLUMNS, RunRow
from taxinet_ros.trials.record.table import read_table
from taxinet_ros.trials.search import Search
from taxinet_ros.trials.sequential import StopRule, decision

SPACE = SearchSpace(choices=tuple(
    Choice(dimension=Dimension(name=name), feeds=frozenset({name})) for name in ('x', 'y')
))


class ToySource:
    """Scenes of a program with two dimensions; points with both quantiles high are refused.

    Where the second is high the program draws what is no scenario.
    """

    sampler, notes, feedback = None, (), None

    def __init__(self, program: str, **others: Any) -> None:
        self.program = find_program(program)

    def __enter__(self) -> ToySource:
        return self

    def __exit__(self, *error: object) -> None:
        pass

    def search_space(self) -> SearchSpace:
        return SPACE

    def space(self) -> Space:
        return SPACE.dimensions

    @property
    def text(self) -> str:
        return program_text(self.program)

    @property
    def fixed_length(self) -> dict[str, str]:
        return {}

    def scene(self, index: int, point: Point | None = None, attempt: int = 0) -> Scenario:
        x, y = point or (0.5, 0.5)
        assert x is not None
        assert y is not None
        if min(x, y) > 0.6:
            raise Refused(f'toy: scene {index}: the point does not meet the requirements', 1)
        if y > 0.88:
            raise Rejected(f'toy: scene {index}: distance_m is 2601')
        return Scenario(cross_track_m=10 * x - 5, distance_m=2000 * y, duration_s=1.0)


_OF_CAMPAIGN = ('seed', 'perception', 'overrides', 'workers', 'resume', 'cluster')


def options(out: Path, *, runs: int = 20, sampler: str = 'ce', **changes: Any) -> Search:
    """A search of the toy program; ``ce`` learns early, so a wrong order of results shows."""
    campaign = {
        'program': 'nominal', 'runs': runs, 'seed': 3, 'perception': 'truth', 'out': out,
        **{key: changes.pop(key) for key in _OF_CAMPAIGN if key in changes},
        **({'judging': Judging(specs=changes.pop('specs'))} if 'specs' in changes else {}),
    }
    own = {'every': '1'} if sampler == 'ce' else {}
    return Search(CampaignOptions(**campaign), **{
        'sampler': sampler, 'sampler_options': own, **changes,
    })


def result(request: RunRequest, outcome: Outcome | None = None) -> RunResult:
    """What a run gives: a failure to the right, far from the threshold."""
    scenario = request.scenario
    rho = math.hypot(scenario.cross_track_m + 4, scenario.distance_m / 500 - 3) - 2
    outcome = outcome or (Outcome.PASS if rho > 0 else Outcome.FAIL)
    judged = outcome.judged
    return RunResult(
        outcome=outcome, last_seq=10, wall_s=1.0,
        statistics=RunStatistics(max_cross_track_m=abs(scenario.cross_track_m)) if judged else None,
        robustness=exact_intervals({'phi_eventually': rho} if judged else {}),
        kind='' if judged else 'test',
    )


Pick = Callable[[list[RunRequest]], RunRequest]


def first(under_way: list[RunRequest]) -> RunRequest:
    return under_way[0]


def last(under_way: list[RunRequest]) -> RunRequest:
    return under_way[-1]


def answers(
    search: Engine[Search], workers: int, pick: Pick = first,
    judge: Callable[[RunRequest], RunResult] = result,
) -> Iterator[RunRequest]:
    """Drive a search as so many workers would, one answer at a time."""
    under_way: list[RunRequest] = []
    while True:
        while len(under_way) < workers and (request := search.next()) is not None:
            (search.options.out / request.run_id).mkdir()
            under_way.append(request)
        if not under_way:
            return
        request = pick(under_way)
        under_way.remove(request)
        search.take(request, judge(request))
        yield request


@contextlib.contextmanager
def searching(chosen: Search) -> Iterator[Engine[Search]]:
    """A search on the toy program; ``Search`` has been given :class:`ToySource` already."""
    with Engine(chosen, ('perception',)) as search:
        yield search


def finish(
    chosen: Search, workers: int = 1, pick: Pick = first,
    judge: Callable[[RunRequest], RunResult] = result,
) -> Engine[Search]:
    """Run a search to its end."""
    with searching(chosen) as search:
        for _ in answers(search, workers, pick, judge):
            pass
    return search


def same_table(one: Path, other: Path) -> None:
    """See that two tables are equal but for the clock."""
    tables = [read_table(folder).drop(columns=list(WALL_CLOCK_COLUMNS)) for folder in (one, other)]
    assert len(tables[0]) > 0
    pd.testing.assert_frame_equal(*tables)


def is_met(rule: StopRule, rows: Sequence[RunRow]) -> bool:
    """Whether the runs from 0 on meet a stop rule, by a walk over all of them."""
    if rule.test is not None:
        bad = [rule.test.is_bad(row) for row in rows if row.outcome.judged and row.from_program]
        bad = bad[:bad.index(None)] if None in bad else bad
        ends = (decision(rule.test, sum(bad[:runs]), runs) for runs in range(1, len(bad) + 1))
        return any(ends)
    if rule.kind == 'failures':
        return sum(row.outcome is Outcome.FAIL for row in rows) >= rule.value
    found = failure_rate(rows, 0).rate
    return found is not None and (found.high - found.low) / 2 <= rule.value

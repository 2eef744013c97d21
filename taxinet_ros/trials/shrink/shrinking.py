"""Shrinking of a failed run: a campaign whose scenes :mod:`.algorithm` chooses.

Its folder is a campaign folder. The next run depends only on the results, so a resumed shrinking
takes those of earlier sessions by their scenes. Runs without a verdict are repeated under their old
numbers, so the table equals that of an uninterrupted one.
"""

from __future__ import annotations

import contextlib
import json
from collections.abc import Iterable, Mapping, Sequence
from contextlib import AbstractContextManager
from typing import Any

from taxinet_ros.core.perception.perception import check_perception
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.verdict.outcome import Outcome
from taxinet_ros.trials.engine import Proposer
from taxinet_ros.trials.record.content import CampaignContent
from taxinet_ros.trials.record.facts import facts_of_runs
from taxinet_ros.trials.record.row import RunRow
from taxinet_ros.trials.shrink.algorithm import Point, ShrinkSearch
from taxinet_ros.trials.shrink.options import PROGRAM, STEPS, ShrinkOptions


class Shrinking(Proposer):
    """Proposes the scenes that a failed run is shrunk with.

    Attributes:
        options: options of the shrinking.
        search: search state.
        judged: the judged run of each point asked for.
    """

    patience, runs = 1, None

    def __init__(self, options: ShrinkOptions) -> None:
        """Create it; nothing is written."""
        self.options = options
        self.campaign = options.campaign
        self.source: AbstractContextManager[None] = contextlib.nullcontext()
        self.search = ShrinkSearch(
            [one.axis for one in options.space.moving], most=options.campaign.runs,
            rule=options.space.possible,
        )
        self.judged: dict[Point, RunRow] = {}
        self._points: dict[int, Point] = {}
        self._numbers: dict[str, int] = {}
        self._broken_before: dict[str, int] = {}
        self._undone: list[int] = []
        self._next = 0

    def prepare(self) -> dict[str, Any]:
        """See :class:`.Proposer`."""
        space, perception = self.options.space, self.campaign.perception
        return facts_of_runs(self.campaign, {
            'program': PROGRAM,
            'shrinks': self.options.run.run_id,
            'original': space.original.to_human(),
            'nominal': space.nominal.to_human(),
            'parameters': [one.key for one in space.parameters],
            'steps': STEPS,
            'perception_sha256': check_perception(perception, graph=True),
        })

    def resume(self, content: CampaignContent) -> tuple[Iterable[RunRow], Mapping[str, Any]]:
        """See :class:`.Proposer`."""
        self._next = content.begun
        done = [row for row in content.rows if row.outcome.judged]
        self._numbers = {_key(row.scene): row.index for row in done}
        self._undone = sorted(set(range(self._next)) - {row.index for row in done})
        self._broken_before = {
            _key(row.scene): row.retries + (row.outcome is Outcome.INFRA_ERROR)
            for row in content.rows if not row.outcome.judged
        }
        return done, {}

    def stop_reason(self, rows: Sequence[RunRow]) -> str:
        """See :class:`.Proposer`."""
        return self.search.state.end.value

    def propose(self) -> int | None:
        """The number of the most urgent point not in flight, or of one that may be needed later."""
        under_way = set(self._points.values()) - self.judged.keys()
        wanted = self.search.wanted(len(under_way) + 1)
        point = next((point for point in wanted if point not in under_way), None)
        if point is None:
            return None
        index = self._numbers.get(_key(self.options.space.scenario(point).to_human()))
        if index is None and self._undone:
            index = self._undone.pop(0)
        elif index is None:
            index, self._next = self._next, self._next + 1
        self._points[index] = point
        return index

    def scene(self, index: int) -> Scenario:
        """See :class:`.Proposer`."""
        return self.options.space.scenario(self._points[index])

    def completed(self, row: RunRow) -> RunRow:
        """See :class:`.Proposer`."""
        return row.with_choice(
            sampler=PROGRAM, point={}, weight=None,
            retries=self._broken_before.get(_key(row.scene), 0),
        )

    def take(self, row: RunRow) -> None:
        """See :class:`.Proposer`."""
        if row.outcome.judged:
            point = self._points[row.index]
            self.judged[point] = row
            self.search.tell(point, row.rho[self.options.headline])


def _key(scene: Mapping[str, Any]) -> str:
    """Key of a scene in human units."""
    return json.dumps(scene)

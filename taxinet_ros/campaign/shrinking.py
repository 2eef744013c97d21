"""The shrinking of a failed run on disk: a campaign whose scenes are chosen by :mod:`.shrink`.

Its folder is a campaign's (:mod:`.campaign`). What comes next depends on the answers only, so a
resumed shrinking finds those that it has in its ledger and goes on where it was. Runs that have no
verdict are done anew under their old numbers, so that the table is that of an undisturbed one.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from types import TracebackType
from typing import Any, Self

from taxinet_ros import __version__
from taxinet_ros.campaign.facts import (
    FACTS_NAME,
    LEDGER_NAME,
    STACKS,
    other_stack,
    stacks_in,
    this_sitting,
)
from taxinet_ros.campaign.ledger import read_ledger
from taxinet_ros.campaign.put_aside import put_aside
from taxinet_ros.campaign.record import Record, check_resumable
from taxinet_ros.campaign.requests import finished_row, run_request
from taxinet_ros.campaign.row import RunRow
from taxinet_ros.campaign.shrink import Point, Shrink
from taxinet_ros.campaign.shrink_options import PROGRAM, ShrinkOptions
from taxinet_ros.campaign.shrink_space import STEPS
from taxinet_ros.core.controller import check_controller
from taxinet_ros.core.errors import UsageError
from taxinet_ros.core.mtl import parse_spec
from taxinet_ros.core.outcome import Outcome, RunRequest, RunResult
from taxinet_ros.core.perception import check_perception
from taxinet_ros.core.scenario import HUMAN_KEYS

_FREE = frozenset({'runs', STACKS})
"""Facts that may differ when a shrinking is resumed: more runs may be asked for."""


class Shrinking:
    """Asks for runs and takes their answers; a context manager.

    Attributes:
        options: what to do.
        search: what is known of which point.
        rows: one row per run that is done, those of before included, by the order in which they
            were needed or ended.
        broken: the run that the bench broke for good; None while it can go on.
        interrupted: whether :meth:`interrupt` was called.
    """

    def __init__(
        self, options: ShrinkOptions, participants: tuple[str, ...],
        on_row: Callable[[RunRow], None] = lambda row: None,
    ) -> None:
        """Nothing is written before the ``with``.

        Args:
            options: what to do.
            participants: node names that take part in every run.
            on_row: called with each new row as soon as it is on disk; not with those of before.
        """
        self.options = options
        self.search = Shrink(
            [one.axis for one in options.space.moving], most=options.campaign.runs,
            rule=options.space.possible,
        )
        self.rows: list[RunRow] = []
        self.broken: RunRow | None = None
        self.interrupted = False
        self.warning = ''
        self.controller_sha256 = ''
        self._participants = participants
        self._on_row = on_row
        self._campaign = options.campaign
        self._earlier: dict[str, RunRow] = {}
        self._by_point: dict[Point, RunRow] = {}
        self._under_way: dict[int, Point] = {}
        self._again: list[RunRequest] = []
        self._retried: set[int] = set()
        self._broken_before: dict[str, int] = {}
        self._undone: list[int] = []
        self._next = 0
        self._stacks: dict[str, dict[str, str]] = {}

    def __enter__(self) -> Self:
        """Make the folder, or see that it holds this shrinking.

        Raises:
            UsageError: the folder cannot be used, or what it holds is something else.
        """
        out, facts = self._campaign.out, self._facts()
        self.controller_sha256 = str(facts['controller_sha256'])
        if self.options.resume:
            check_resumable(out)
        names = [parse_spec(text).name for text in self._campaign.specs]
        self._record = Record(out, names, resume=self.options.resume)
        try:
            self._read_earlier(facts)
            facts[STACKS] = {**self._stacks, **facts[STACKS]}
            self._record.facts(facts)
        except BaseException:
            self._record.close()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Write the table of what there is, whatever happened."""
        self._record.__exit__(kind, error, trace)

    def next(self) -> RunRequest | None:
        """A run to begin now; None where there is none before another run has ended, or at all."""
        if self.interrupted or self.broken is not None:
            return None
        if self._again:
            return self._again.pop()
        while (point := self._point()) is not None:
            row = self._earlier.get(self._key(point))
            if row is None:
                return self._begun(point)
            self._remember(point, row)
        return None

    def take(self, request: RunRequest, result: RunResult) -> None:
        """Keep one answer. A run that the bench broke gets a second chance; then the bench is."""
        index = request.index
        infra = result.outcome is Outcome.INFRA_ERROR
        if infra and index not in self._retried:
            self._retried.add(index)
            self._put_down(request)
            self._again.append(request)
            return
        key = self._key(self._under_way[index])
        row = finished_row(self._campaign, request, result).chosen(
            sampler=PROGRAM, point={}, weight=None,
            retries=self._broken_before.get(key, 0) + (index in self._retried),
        )
        point = self._under_way.pop(index)
        if row.outcome.judged:
            self._remember(point, row)
        elif row.outcome is Outcome.INTERRUPTED:
            self.interrupted = True
        else:
            self.broken = row
        try:
            self._record.result(row)
        finally:
            self._on_row(row)

    def interrupt(self) -> None:
        """Ask for no more runs, not for second chances either. A signal handler may call it."""
        self.interrupted = True

    def row(self, point: Point) -> RunRow | None:
        """The judged run of a point, if there is one."""
        return self._by_point.get(point)

    def _point(self) -> Point | None:
        """The most urgent point that nobody is at, or one that may become so."""
        under_way = set(self._under_way.values())
        wanted = self.search.wanted(len(under_way) + 1)
        return next((point for point in wanted if point not in under_way), None)

    def _begun(self, point: Point) -> RunRequest:
        if self._undone:
            index = self._undone.pop(0)
        else:
            index, self._next = self._next, self._next + 1
        scenario = self.options.space.scenario(point)
        request = run_request(self._campaign, index, scenario, self._participants)
        self._put_down(request)
        self._under_way[index] = point
        return request

    def _put_down(self, request: RunRequest) -> None:
        put_aside(self._campaign.out / request.run_id)
        self._record.intent(request.index, request.run_id)

    def _remember(self, point: Point, row: RunRow) -> None:
        self.rows.append(row)
        self._by_point[point] = row
        self.search.tell(point, row.rho[self.options.headline])

    def _key(self, point: Point) -> str:
        return json.dumps(self.options.space.scenario(point).to_human())

    def _read_earlier(self, facts: dict[str, Any]) -> None:
        out = self._campaign.out
        content = read_ledger(out / LEDGER_NAME)
        before, now = {'timing': '', **content.campaign}, json.loads(json.dumps(facts))
        for name in now:
            if content.campaign and name not in _FREE and before.get(name) != now[name]:
                raise UsageError(
                    f'--resume: {out / FACTS_NAME} has another {name}; repeat what was typed '
                    'before, or name another --out'
                )
        self._record.rows.update({row.index: row for row in content.rows})
        self._stacks = stacks_in(before)
        self.warning = other_stack(before, str(out)) if content.rows else ''
        self._next = 1 + max((*content.unfinished, *self._record.rows), default=-1)
        self._earlier = {_scene(row): row for row in content.rows if row.outcome.judged}
        undone = [row for row in content.rows if not row.outcome.judged]
        self._undone = sorted([*content.unfinished, *(row.index for row in undone)])
        self._broken_before = {
            _scene(row): row.retries + (row.outcome is Outcome.INFRA_ERROR) for row in undone
        }

    def _facts(self) -> dict[str, Any]:
        options, campaign = self.options, self._campaign
        specs = [parse_spec(text) for text in campaign.specs]
        return {
            'taxinet_ros_version': __version__,
            STACKS: this_sitting(),
            'program': PROGRAM,
            'shrinks': options.run.run_id,
            'original': options.space.original.to_human(),
            'nominal': options.space.nominal.to_human(),
            'parameters': [one.key for one in options.space.parameters],
            'steps': STEPS,
            'runs': campaign.runs,
            'seed': campaign.seed,
            'perception': campaign.perception,
            'perception_sha256': check_perception(campaign.perception, graph=True),
            'controller': campaign.controller,
            'controller_sha256': check_controller(
                campaign.controller, campaign.gains, graph=True
            ),
            'overrides': {},
            'gains': dict(campaign.gains),
            'specs': {spec.name: str(spec.formula) for spec in specs},
            'processes': False,
            'images': campaign.images,
            'timing': campaign.timing.words,
        }


def _scene(row: RunRow) -> str:
    """The scene of a run, as :meth:`Shrinking._key` has that of a point."""
    return json.dumps({key: getattr(row, key) for key in HUMAN_KEYS})

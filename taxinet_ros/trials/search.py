"""A search: a sampler chooses scenes and learns from their results.

A search's folder is a campaign folder (:mod:`.campaign`). The sequence of scenes depends neither on
the order of the results nor on the number of resumptions.
"""

from __future__ import annotations

import json
import time
from collections.abc import Iterable, Mapping
from types import MappingProxyType
from typing import Any

from taxinet_ros.core.perception.perception import check_perception
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.verdict.judge import SpecCheck
from taxinet_ros.core.verdict.judging import StopOn
from taxinet_ros.core.verdict.outcome import Outcome, RunResult
from taxinet_ros.errors import UsageError
from taxinet_ros.samplers.covering import Covering
from taxinet_ros.samplers.registry import (
    SAMPLERS,
    check_sampler,
    drawn_share,
    make_covering_sampler,
    make_sampler,
)
from taxinet_ros.samplers.sampler import (
    LAG,
    MOST_LAG,
    Lagged,
    Probabilities,
    Sampler,
    split_options,
)
from taxinet_ros.samplers.space import Point, Space
from taxinet_ros.samplers.splitting import NAME, particles_for
from taxinet_ros.scenes.program_sampler import ProgramSampler
from taxinet_ros.scenes.search_space import SearchSpace
from taxinet_ros.scenes.source import (
    Refused,
    Rejected,
    SceneSource,
    accepted_scene,
    first_scene,
    some_scenes,
)
from taxinet_ros.scenes.values import REJECTION_FEEDBACK
from taxinet_ros.trials.engine import Proposer, with_workers
from taxinet_ros.trials.objective import Objective, parse_objective
from taxinet_ros.trials.odd.odd_file import Odd, find_odd, read_odd
from taxinet_ros.trials.options import CampaignOptions
from taxinet_ros.trials.record.content import CampaignContent
from taxinet_ros.trials.record.facts import (
    OBJECTIVE,
    ODD,
    UNTIL,
    campaign_facts,
    extension_facts,
    read_facts,
)
from taxinet_ros.trials.record.resumption import (
    UNKNOWN_TO_SAMPLER,
    facts_of_graph,
    unfinished_search,
)
from taxinet_ros.trials.record.row import RunRow
from taxinet_ros.trials.sequential import MAX_OFF_RUNWAY, StopCount, StopRule, parse_stop_rule
from taxinet_ros.trials.stress import check_likelihood

PATIENCE = 3
"""Number of consecutive infrastructure errors in one session that end the search."""
COVERAGE = 'coverage'
"""The sampler that takes an operational design domain."""
DEFAULT_SAMPLER = 'active'
"""Sampler to use if neither the user nor the program names one."""
LEAST_PARTICLES = 20
"""Fewest particles of an island; with fewer, one region of failures would be all it keeps."""


class Search(Proposer):
    """Proposes the scenes that a sampler chooses.

    Attributes:
        sampler, sampler_options: as given; once prepared, the program's own if none was given.
        stop, budget_s, lag, odd, objective: as given.
        notes: notes on the origin of the sampler and on likely mistakes in the program.
        check: result of checking the requirements, once prepared.
        covering: the sampler that covers ``odd``, or None.
    """

    source: SceneSource
    patience = PATIENCE

    def __init__(
        self, campaign: CampaignOptions, *, sampler: str = '',
        sampler_options: Mapping[str, str] = MappingProxyType({}), stop: StopRule | None = None,
        budget_s: float | None = None, lag: int = LAG, odd: Odd | None = None,
        objective: Objective | None = None,
    ) -> None:
        """Create it; nothing is started.

        Args:
            campaign: options of the campaign; ``runs`` is the maximum number of its runs.
            sampler: word of the sampler that chooses the scenes; '' for the program's own, if it
                names one, else :data:`DEFAULT_SAMPLER`.
            sampler_options: its options as text, by name.
            stop: stop before all runs are done, or None.
            budget_s: wall-clock time after which no run is started [s], or None.
            lag: number of runs that may be in flight where scenes depend on results: each is
                chosen by the results of all but the last ``lag - 1``.
            odd: the operational design domain that the sampler ``coverage`` covers, or None.
            objective: what the sampler minimises; None for the headline's robustness.

        Raises:
            UsageError: there is no such program.
        """
        self.campaign, self.runs = campaign, campaign.runs
        self.sampler, self.sampler_options = sampler, sampler_options
        self.stop, self.budget_s, self.lag, self.odd = stop, budget_s, lag, odd
        self.objective = objective
        self.notes: tuple[str, ...] = ()
        self.check: SpecCheck
        self.covering: Covering | None = None
        self.source = SceneSource(
            campaign.program, seed=campaign.seed, overrides=campaign.overrides,
            laid_over=campaign.laid_over,
        )
        self._points: dict[int, Point] = {}
        self._refused: dict[int, int] = {}
        self._begun = 0
        self._repeated: Mapping[int, RunRow] = {}
        self._unknown: frozenset[int] = frozenset()
        self._started_s = 0.0
        self._count = None if stop is None else StopCount(stop)
        self._uncounted: dict[int, RunRow] = {}
        self._next_counted = 0

    @property
    def space(self) -> SearchSpace:
        """The search space; only within the engine's ``with``."""
        return self.source.search_space()

    def ended_sampler(self) -> Sampler:
        """The sampler with all results, after the last run; only within the engine's ``with``."""
        return self._sampler.ended()

    def learned(self) -> Probabilities:
        """The sampler's failure histograms; empty if it has none."""
        return self._sampler.learned()

    # Proposing ---------------------------------------------------------------------------------

    def stop_reason(self) -> str:
        """See :class:`.Proposer`. Uses the results that the next run depends on.

        So it is independent of the workers.
        """
        if not self._sampler.ready or len(self._points) < self._begun:
            return ''
        if self._count is not None and self.stop is not None:
            while self._next_counted < self._sampler.due:
                self._count.take(self._uncounted.pop(self._next_counted))
                self._next_counted += 1
            if self._count.is_met:
                return self.stop.reached
        if self.budget_s is not None and time.monotonic() - self._started_s > self.budget_s:
            return f'the budget of {self.budget_s / 60:g} min is spent'
        return ''

    def propose(self) -> int | None:
        """See :class:`.Proposer`."""
        if not self._sampler.ready:
            return None
        index, self._points[index] = self._sampler.next()
        return index

    def scene(self, index: int) -> Scenario:
        """The scene at the first of the sampler's points that meets the program's requirements."""
        try:
            scenario, self._refused[index] = accepted_scene(
                self.source, index, self._points[index], lambda: self._again(index)
            )
        except Rejected as error:
            self._refused[index] = error.refused
            raise
        return scenario

    def replay(self, row: RunRow) -> None:
        """See :class:`.Proposer`."""
        for _ in range(row.refused):
            self._again(row.index)
        if row.point != self.space.named(self._points[row.index]):
            raise UsageError(
                f'resume: the sampler chose another point for run {row.index} than before; was a '
                'library updated meanwhile? Name another folder'
            )

    def _again(self, index: int) -> Point:
        self._points[index] = point = self._sampler.again(self.source.feedback)
        return point

    # Learning ----------------------------------------------------------------------------------

    def completed(self, row: RunRow) -> RunRow:
        """See :class:`.Proposer`."""
        index, before = row.index, self._repeated.get(row.index)
        broken = before is not None and before.outcome is Outcome.INFRA_ERROR
        return row.with_choice(
            sampler=self.sampler, point=self.space.named(self._points[index]),
            weight=self._weight(index), drawn=self._sampler.drawn(index),
            refused=self._refused[index], retries=(before.retries if before else 0) + broken,
        )

    def _weight(self, index: int) -> float | None:
        """Density of the program's distribution over the sampler's at a run's point, if known.

        With soft requirements, the density of accepted points is unknown unless the sampler draws
        from the program's distribution: it depends on the probabilities that points of the sampler
        and of the program meet this run's requirements.
        """
        weight = self._sampler.weight(index)
        return None if self.space.soft and weight != 1 else weight

    def take(self, row: RunRow) -> None:
        """See :class:`.Proposer`."""
        if row.outcome is Outcome.INTERRUPTED:
            return
        known = None
        if row.index not in self._unknown and row.outcome.judged:
            known = row.robustness_for_sampler(self.campaign.judging.headline) \
                if self.objective is None else self.objective.value(row.robustness)
        if row.outcome is Outcome.REJECTED and self._sampler.hears_refusals:
            known = self.source.feedback
        self._sampler.tell(row.index, known)
        if self._count is not None:
            self._uncounted[row.index] = row

    def hear(self, facts: Mapping[str, Any], result: RunResult) -> Mapping[str, Any]:
        """See :class:`.Proposer`."""
        return facts_of_graph(self.campaign.out, facts, result)

    # Beginning ---------------------------------------------------------------------------------

    def prepare(self) -> dict[str, Any]:
        """See :class:`.Proposer`."""
        source = self.source
        whose = self._settle_sampler(source.sampler)
        if self.objective is not None:
            self.objective.check(self.sampler)
        check_likelihood(self.sampler, source.search_space())
        self.notes = (*source.notes, *([whose] if whose else []))
        self._sampler = self._make_sampler(source.space())
        if source.feedback is not None and not self._sampler.hears_refusals:
            self.notes += (f'{REJECTION_FEEDBACK} has no effect on {self.sampler}, which does '
                           'not learn from refused points',)
        learns = SAMPLERS[self.sampler].learns
        if learns or self.stop is not None or not self.campaign.cluster:
            self._sampler.set_lag(self.lag)
        else:  # workers here are no more than the lag in any case
            self._sampler.ignore_results()
        if self.stop is not None and self.stop.needs_draws and not drawn_share(
            self.sampler, self.sampler_options
        ):
            raise UsageError(
                f'until {self.stop}: no rate is known with {self.sampler}, which chooses '
                'all of its runs; add the sampler option floor=0.3, or use failures=K'
            )
        self.check = self.campaign.check(
            first_scene(source), lambda: source.search_space().drawn,
            some_scenes(source, self.campaign.runs),
        )
        return self._facts()

    def resume(self, content: CampaignContent) -> tuple[Mapping[int, RunRow], Mapping[str, Any]]:
        """See :class:`.Proposer`."""
        lag, runs = self._recorded_lag, self.campaign.runs
        self._unknown, self._repeated = unfinished_search(content, lag)
        self._started_s = time.monotonic()
        self._begun = content.begun
        if self._begun > runs:
            raise UsageError(
                f'runs {runs}: {self._begun} were started in {self.campaign.out}; use at least '
                'that number'
            )
        done = content.only(content.by_index.keys() - self._repeated.keys())
        unknown = sorted(self._unknown)
        return done, {UNKNOWN_TO_SAMPLER: unknown} if unknown else {}

    def _settle_sampler(self, asked: ProgramSampler | None) -> str:
        """Choose the sampler of the program or the default, if none is asked for; its origin."""
        if self.sampler:
            return f'sampler {self.sampler}, as asked; not the {asked.said} of {asked.place}' \
                if asked is not None else ''
        self.sampler = asked.word if asked is not None else DEFAULT_SAMPLER
        values = {**(asked.options if asked is not None else {}), **self.sampler_options}
        check_sampler(self.sampler, values)
        self.sampler_options = values
        if asked is None:
            return ''
        shown = ''.join(f' {name}={value}' for name, value in values.items())
        return f'sampler {self.sampler}{shown}, by {asked.said} of {asked.place}'

    def _make_sampler(self, space: Space) -> Lagged:
        campaign, odd = self.campaign, self.odd
        names: dict[str, Any] = dict(self.sampler_options)
        if odd is None:
            return make_sampler(self.sampler, space, campaign.seed, campaign.runs, **names)
        strength = int(check_sampler(self.sampler, names)['strength'])
        if strength > len(odd.parameters):
            raise UsageError(
                f'sampler option strength={strength}: the ODD {odd.name} has only '
                f'{len(odd.parameters)} parameters'
            )

        def cells(point: Point) -> tuple[int, ...] | None:
            # What the point leaves open is drawn as for scene 0, so that a resumed search agrees.
            try:
                scene = self.source.scene(0, point).to_human()
            except (Refused, Rejected):
                return None
            return odd.inside(scene)

        sampler, self.covering = make_covering_sampler(
            space, campaign.seed, odd.feasible(strength), cells, **names
        )
        return sampler

    @property
    def _recorded_lag(self) -> int:
        # A sampler in batches waits for whole ones, whatever the lag.
        return 1 if SAMPLERS[self.sampler].batched else self.lag

    def _facts(self) -> dict[str, Any]:
        campaign = self.campaign
        facts = campaign_facts(campaign, self.source.program, self.source.text)
        return {
            **facts,
            **extension_facts(facts, samplers=self.sampler),
            'first_runs': campaign.runs,
            'warnings': list(self.check.warnings),
            'perception_sha256': (
                '' if campaign.standing_graph
                else check_perception(campaign.perception, graph=True)
            ),
            'sampler': self.sampler,
            'sampler_options': dict(self.sampler_options),
            'sampler_lag': self._recorded_lag,
            'dimensions': [dimension.name for dimension in self.source.space()],
            # Only the grid depends on the number of runs; the others can be extended.
            'grid_runs': campaign.runs if self.sampler == 'grid' else None,
            **({OBJECTIVE: self.objective.text} if self.objective is not None else {}),
            **({ODD: json.loads(self.odd.text)} if self.odd is not None else {}),
            **({UNTIL: [str(self.stop)]} if self.stop is not None else {}),
        }


def make_search(
    campaign: CampaignOptions, *, sampler: str | None = None, sampler_options: Iterable[str] = (),
    workers: int = 1, until: str | None = None, budget_min: float | None = None, lag: int = LAG,
    cluster: str | None = None, odd: str | None = None, objective: str | None = None,
) -> Search:
    """Check what a user asks for.

    Args:
        campaign: validated campaign options, but for what makes the runs.
        sampler: word of the sampler; None for the program's own or the default.
        sampler_options: ``key=value`` texts.
        workers: number of runs at a time.
        until: a stop rule as text, or None.
        budget_min: wall-clock time [min], or None.
        lag: see :class:`Search`.
        cluster: a Dask cluster as for :func:`.pool.check_cluster`, or None.
        odd: name or file of an operational design domain, or None.
        objective: as for :func:`.parse_objective`, or None.

    Raises:
        UsageError: one line on the first error.
    """
    if not 1 <= lag <= MOST_LAG:
        raise UsageError(f'lag {lag}: needs to be within 1..{MOST_LAG}')
    campaign = with_workers(campaign, workers, cluster, lag)
    if budget_min is not None and not budget_min > 0:
        raise UsageError(f'budget {budget_min:g}: needs to be above 0 minutes')
    stop = parse_stop_rule(until) if until else None
    if (
        stop is not None and stop.kind == MAX_OFF_RUNWAY
        and campaign.judging.stop_on is not StopOn.NEVER
    ):
        raise UsageError(
            f'until {until}: not with stop_on {campaign.judging.stop_on}: of a run that was '
            'stopped it is unknown whether it would have left the runway'
        )
    options = split_options(sampler_options)
    if sampler is not None:
        check_sampler(sampler, options)
    if odd is not None and sampler != COVERAGE:
        raise UsageError(
            f'odd {odd}: has an effect on sampler {COVERAGE} only; to measure the coverage of '
            f'any search: taxinet odd {odd} CAMPAIGN'
        )
    if odd is not None and 'cells' in options:
        raise UsageError('sampler option cells: the cells are those of the ODD; leave it out')
    return Search(
        campaign, sampler=sampler or '', sampler_options=options, stop=stop,
        budget_s=None if budget_min is None else 60 * budget_min, lag=lag,
        odd=None if odd is None else read_odd(find_odd(odd)),
        objective=None if objective is None else parse_objective(
            objective, campaign.judging.names
        ),
    )


def make_estimate(
    campaign: CampaignOptions, *, floor: float, islands: int, workers: int = 1
) -> Search:
    """The search that estimates a rare failure's probability.

    Args:
        campaign: validated campaign options; its runs are the most to spend.
        floor: least probability that the runs have to suffice for.
        islands: independent populations at first; to resume, those recorded.
        workers: number of runs at a time.

    Raises:
        UsageError: one line on the first error.
    """
    if not 1e-12 <= floor <= 0.5:
        raise UsageError(f'down_to {floor:g}: needs to be within 1e-12..0.5, as in 1e-6')
    if not 4 <= islands <= 100:
        raise UsageError(f'islands {islands}: needs to be within 4..100')
    runs = campaign.runs
    if campaign.resume and (before := read_facts(campaign.out)) is not None:
        first = before.get('first_runs')
        runs = first if isinstance(first, int) else runs
    particles = particles_for(runs, islands, floor)
    if particles < LEAST_PARTICLES:
        needed = runs
        while particles_for(needed, islands, floor) < LEAST_PARTICLES:
            needed += 100
        raise UsageError(
            f'runs {runs}: too few to look for {floor:g} on {islands} islands; use '
            f'{needed} runs, or a greater down_to'
        )
    return make_search(
        campaign, sampler=NAME, workers=workers, sampler_options=[
            f'draws={runs // 2}', f'particles={particles}', f'islands={islands}',
            f'floor={floor!r}',
        ],
    )

"""Options of a search: campaign, sampler, workers, and stop rules.

With a stop rule the number of runs depends on the results, so the intervals are those valid at any
number of runs (:mod:`taxinet_ros.trials.rates`).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

from taxinet_ros.core.user_code import EXTERNAL
from taxinet_ros.core.verdict.judging import StopOn
from taxinet_ros.core.verdict.outcome import Outcome
from taxinet_ros.core.world import find_world
from taxinet_ros.errors import UsageError
from taxinet_ros.samplers.registry import check_sampler
from taxinet_ros.samplers.sampler import LAG, MOST_LAG, split_options
from taxinet_ros.samplers.splitting import NAME, particles_for
from taxinet_ros.scenes.program_sampler import ProgramSampler
from taxinet_ros.trials.cluster.connection import check_cluster
from taxinet_ros.trials.odd.odd_file import Odd, find_odd, read_odd
from taxinet_ros.trials.options import CampaignOptions
from taxinet_ros.trials.rates import failure_rate
from taxinet_ros.trials.record.facts import read_facts
from taxinet_ros.trials.record.row import RunRow
from taxinet_ros.trials.sequential import (
    MAX_OFF_RUNWAY,
    MIN_SATISFACTION,
    SequentialTest,
    course,
    parse_test,
)

LEAST_PARTICLES = 20
"""Fewest particles of an island; with fewer, one region of failures would be all it keeps."""
FAILURES = 'failures'
HALF_WIDTH = 'half-width'


@dataclass(frozen=True, kw_only=True, slots=True)
class StopRule:
    """A rule of ``--until``.

    Attributes:
        kind: ``failures``; ``half-width`` of the 95 % interval of the failure rate; or the
            criterion of a sequential test.
        value: number of failures, the half width as a fraction, or the test's threshold.
        test: the sequential test, or None.
    """

    kind: str
    value: float
    test: SequentialTest | None = None

    def __str__(self) -> str:
        return f'{self.kind}={self.value:g}' if self.test is None else str(self.test)

    @property
    def reached(self) -> str:
        """Text for a search that this rule ended."""
        return f'{self} reached' if self.test is None else f'{self} decided'

    @property
    def needs_draws(self) -> bool:
        """Whether it can only be met by runs that the program itself draws."""
        return self.kind != FAILURES

    def is_met(self, rows: Sequence[RunRow]) -> bool:
        """Whether these runs meet the rule."""
        if self.test is not None:
            return course(rows, self.test).decision is not None
        if self.kind == FAILURES:
            return sum(row.outcome is Outcome.FAIL for row in rows) >= self.value
        found = failure_rate(rows, 0).rate
        return found is not None and (found.high - found.low) / 2 <= self.value


def parse_stop_rule(text: str) -> StopRule:
    """Parse ``failures=K``, ``half-width=W``, or a sequential test (:func:`.parse_test`).

    Raises:
        UsageError: it is none of them.
    """
    kind, _, number = (part.strip() for part in text.partition('='))
    if kind in (MIN_SATISFACTION, MAX_OFF_RUNWAY):
        test = parse_test(text)
        return StopRule(kind=kind, value=test.shown(test.limit), test=test)
    try:
        value = float(number)
    except ValueError:
        value = math.nan
    whole = kind == FAILURES and value >= 1 and value.is_integer()
    if not whole and not (kind == HALF_WIDTH and 0 < value < 0.5):
        raise UsageError(
            f'--until {text}: expected {FAILURES}=K (1, 2, …), {HALF_WIDTH}=W (0…0.5), '
            f'{MIN_SATISFACTION}=SHARE or {MAX_OFF_RUNWAY}=SHARE'
        )
    return StopRule(kind=kind, value=value)


COVERAGE = 'coverage'
"""The sampler that takes an operational design domain."""
DEFAULT_SAMPLER = 'active'
"""Sampler to use if neither the user nor the program names one."""


@dataclass(frozen=True, kw_only=True)
class SearchOptions:
    """Options of one search.

    Attributes:
        campaign: program, judging, perception and output folder.
        sampler: word of the sampler that chooses the scenes; '' for the program's own, if it names
            one, else :data:`DEFAULT_SAMPLER`.
        sampler_options: its options as text, by name.
        stop: stop before all runs are done, or None.
        budget_s: wall-clock time after which no run is started [s], or None.
        lag: number of runs that may be in flight where scenes depend on results: each is chosen by
            the results of all but the last ``lag - 1``.
        odd: the operational design domain that the sampler ``coverage`` covers, or None.
    """

    campaign: CampaignOptions
    sampler: str
    sampler_options: Mapping[str, str] = field(default_factory=dict)
    stop: StopRule | None = None
    budget_s: float | None = None
    lag: int = LAG
    odd: Odd | None = None


def make_search_options(
    campaign: CampaignOptions, *, sampler: str | None = None, sampler_options: Iterable[str] = (),
    workers: int = 1, until: str | None = None, budget_min: float | None = None, lag: int = LAG,
    cluster: str | None = None, odd: str | None = None,
) -> SearchOptions:
    """Check the command-line arguments.

    Args:
        campaign: validated campaign options, but for what makes the runs.
        sampler: word of the sampler; None for the program's own or the default.
        sampler_options: ``key=value`` texts.
        workers: number of runs at a time.
        until: a stop rule as text, or None.
        budget_min: wall-clock time [min], or None.
        lag: see :class:`SearchOptions`.
        cluster: a Dask cluster as for :func:`.connection.check_cluster`, or None.
        odd: name or file of an operational design domain, or None.

    Raises:
        UsageError: one line on the first error.
    """
    if not 1 <= lag <= MOST_LAG:
        raise UsageError(f'--lag {lag}: needs to be within 1..{MOST_LAG}')
    campaign = with_workers(campaign, workers, cluster, lag)
    if budget_min is not None and not budget_min > 0:
        raise UsageError(f'--budget {budget_min:g}: needs to be above 0 minutes')
    stop = parse_stop_rule(until) if until else None
    if (
        stop is not None and stop.kind == MAX_OFF_RUNWAY
        and campaign.judging.stop_on is not StopOn.NEVER
    ):
        raise UsageError(
            f'--until {until}: not with --stop-on {campaign.judging.stop_on}: of a run that was '
            'stopped it is unknown whether it would have left the runway'
        )
    options = split_options(sampler_options)
    if sampler is not None:
        check_sampler(sampler, options)
    if odd is not None and sampler != COVERAGE:
        raise UsageError(
            f'--odd {odd}: has an effect on --sampler {COVERAGE} only; to measure the coverage of '
            'any search: taxinet odd coverage'
        )
    if odd is not None and 'cells' in options:
        raise UsageError('--sampler-option cells: the cells are those of the ODD; leave it out')
    return SearchOptions(
        campaign=campaign, sampler=sampler or '', sampler_options=options,
        stop=stop, budget_s=None if budget_min is None else 60 * budget_min, lag=lag,
        odd=None if odd is None else read_odd(find_odd(odd)),
    )


def with_workers(
    campaign: CampaignOptions, workers: int, cluster: str | None, lag: int = LAG
) -> CampaignOptions:
    """The campaign with what makes its runs: worker processes here, or a cluster.

    Args:
        campaign: the campaign.
        workers: number of worker processes.
        cluster: a Dask cluster as for :func:`.connection.check_cluster`, or None.
        lag: number of runs that may be in flight.

    Raises:
        UsageError: too many workers, no cluster, or runs that a cluster cannot make.
    """
    if cluster is None:
        if not 1 <= workers <= lag:
            raise UsageError(f'--workers {workers}: needs to be within 1..{lag}')
        return replace(campaign, workers=workers)
    if workers != 1:
        raise UsageError(
            f'--workers {workers}: not with --cluster, whose own workers are used; leave it out'
        )
    for role, word in (('perception', campaign.perception), ('controller', campaign.controller)):
        if word in (EXTERNAL, ''):
            raise UsageError(
                f'--cluster: not with a {role} that you start yourself, which the workers do not '
                'see; use --workers, or give its command'
            )
    if again := find_world(campaign.world).again_words:
        raise UsageError(f'--cluster: {again}, so workers would not give the same runs')
    return replace(campaign, cluster=check_cluster(cluster))


def make_estimate_options(
    campaign: CampaignOptions, *, floor: float, islands: int, workers: int = 1
) -> SearchOptions:
    """Options of an estimate of a rare failure's probability.

    Args:
        campaign: validated campaign options; its runs are the most to spend.
        floor: least probability that the runs have to suffice for.
        islands: independent populations at first; to resume, those recorded.
        workers: number of runs at a time.

    Raises:
        UsageError: one line on the first error.
    """
    if not 1e-12 <= floor <= 0.5:
        raise UsageError(f'--down-to {floor:g}: needs to be within 1e-12..0.5, as in 1e-6')
    if not 4 <= islands <= 100:
        raise UsageError(f'--islands {islands}: needs to be within 4..100')
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
            f'--runs {runs}: too few to look for {floor:g} on {islands} islands; use '
            f'--runs {needed}, or a greater --down-to'
        )
    return make_search_options(
        campaign, sampler=NAME, workers=workers, sampler_options=[
            f'draws={runs // 2}', f'particles={particles}', f'islands={islands}',
            f'floor={floor!r}',
        ],
    )


def with_sampler(
    options: SearchOptions, asked: ProgramSampler | None
) -> tuple[SearchOptions, str]:
    """The options with the resolved sampler, and a line on its origin.

    Args:
        options: options given by the user.
        asked: the program's request, or None.

    Returns:
        The options, and a line to print; '' if the program requests none.

    Raises:
        UsageError: the sampler does not have an option.
    """
    if options.sampler:
        line = f'sampler {options.sampler}, as asked; not the {asked.said} of {asked.place}' \
            if asked is not None else ''
        return options, line
    word = asked.word if asked is not None else DEFAULT_SAMPLER
    values = {**(asked.options if asked is not None else {}), **options.sampler_options}
    check_sampler(word, values)
    if asked is None:
        return replace(options, sampler=word), ''
    shown = ''.join(f' {name}={value}' for name, value in values.items())
    return (
        replace(options, sampler=word, sampler_options=values),
        f'sampler {word}{shown}, by {asked.said} of {asked.place}',
    )

"""Localise faults: rerun a campaign's failed runs with the truth instead of the network.

Trials run in worker processes, each with a substitute for the network, and are kept in the folder:
the same command continues after an interrupt, also with more runs or other substitutions.
"""

from __future__ import annotations

import dataclasses
import functools
import itertools
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

from taxinet_ros.core.assurance.switch import check_controller
from taxinet_ros.core.perception.perception import check_perception
from taxinet_ros.core.perception.substituted import (
    AS_RECORDED,
    TRUTH,
    TRUTH_CTE,
    TRUTH_HEADING,
    parse_substitution,
)
from taxinet_ros.core.system import System, digest_of
from taxinet_ros.core.types import rate_of
from taxinet_ros.core.user_code import is_node_elsewhere
from taxinet_ros.core.verdict.examined import Examined
from taxinet_ros.errors import UsageError
from taxinet_ros.trials.options import DEFAULT_ROOT
from taxinet_ros.trials.past_runs.recorded_campaign import (
    RecordedCampaign,
    check_unchanged,
    open_failed_campaign,
    spread_evenly,
)
from taxinet_ros.trials.past_runs.shared_scenes import Scene, system_of, trials_digest
from taxinet_ros.trials.past_runs.trials import Trial, TrialRecord
from taxinet_ros.trials.record.row import RunRow
from taxinet_ros.trials.worker_pool import Task

DEFAULT_WORDS = (TRUTH, TRUTH_HEADING, TRUTH_CTE)
MOST_WORKERS = 64
Trials = Mapping[tuple[str, str], Trial]
"""Trials by run and name of the substitution."""


@dataclass(frozen=True, kw_only=True)
class LocalizeOptions:
    """Options of a fault localisation.

    Attributes:
        campaign: campaign with the failed runs.
        examined: the requirement to look into.
        rows: rows of the runs to analyse that violate it; it is their headline.
        words: names of the substitutions, the control first.
        perception: word or file of the network.
        workers: number of processes.
        out: folder.
    """

    campaign: RecordedCampaign
    examined: Examined
    rows: tuple[RunRow, ...]
    words: tuple[str, ...]
    perception: str
    workers: int
    out: Path

    @property
    def wanted(self) -> int:
        """Total number of trials."""
        return len(self.rows) * len(self.words)

    @property
    def system(self) -> System:
        """The campaign's system."""
        return dataclasses.replace(system_of(self.campaign), perception=self.perception)


def make_localize_options(
    campaign: Path, *, runs: int | None, words: Iterable[str], workers: int, out: Path | None,
    perception: str | None, spec: str | None = None,
) -> LocalizeOptions:
    """Check the command-line arguments.

    Args:
        campaign: the campaign's folder.
        runs: maximum number of failed runs to analyse, spread over all; None for all.
        words: names of substitutions; :data:`DEFAULT_WORDS` if empty.
        workers: number of processes.
        out: folder; if None, one below ``bags/`` named after the campaign.
        perception: the network's file if it was moved; None for the campaign's.
        spec: name of the requirement to look into; None to choose it.

    Raises:
        UsageError: one line on the first error.
    """
    if not 1 <= workers <= MOST_WORKERS:
        raise UsageError(f'workers {workers}: needs to be within 1..{MOST_WORKERS}')
    if runs is not None and runs < 1:
        raise UsageError(f'runs {runs}: needs to be 1 or more')
    found = open_failed_campaign(campaign)
    examined = found.examine(spec)
    if not examined.failed:
        raise UsageError(
            f'{campaign}: none of its {examined.judged} judged runs violates {examined.spec}')
    rows = spread_evenly([
        row.about(examined.spec) for row in found.counterexamples
        if row.robustness[examined.spec].failed
    ], runs)
    periods_s = {1 / rate_of(row.period_ns) for row in rows}
    chosen = [parse_substitution(word, periods_s).word for word in words] or DEFAULT_WORDS
    system = system_of(found)
    if why := system.not_again:  # which reports a missing or changed package, too
        raise UsageError(
            f'{campaign}: {why}, so trials cannot localise the fault; use runs in lockstep'
        )
    if not found.judging.specs:
        raise UsageError(f'{campaign}: its record does not have the formulas')
    check_unchanged(
        'controller', system.controller, lambda: check_controller(system.controller, system.gains),
        found.facts.get('controller_sha256', ''), 'put the file back as it was',
    )
    return LocalizeOptions(
        campaign=found, examined=examined, rows=rows,
        words=tuple(dict.fromkeys((AS_RECORDED, *chosen))),
        perception=_network(found, perception), workers=workers,
        out=out or DEFAULT_ROOT / f'{campaign.resolve().name}-localize',
    )


def localize(
    options: LocalizeOptions, on_trial: Callable[[int], None], interrupted: Callable[[], bool],
) -> dict[tuple[str, str], Trial]:
    """Run the missing trials.

    Args:
        options: options of the localisation.
        on_trial: called with the number of completed trials, first with the earlier ones.
        interrupted: returns whether to start no more trials.

    Returns:
        The requested trials that are complete, judged by the requirement looked into.

    Raises:
        UsageError: the folder cannot be used, or contains trials of another campaign.
        InfraError: worker processes end one after the other.
    """
    system, judging = options.system, options.campaign.judging
    rows, spec = {row.run_id: row for row in options.rows}, options.examined.spec

    @functools.cache
    def scene(run_id: str) -> Scene:
        scenario, exact = options.campaign.scenario(rows[run_id])
        return Scene(row=rows[run_id], scenario=scenario, exact=exact)

    def task(run_id: str, word: str) -> Task:
        return scene(run_id).task(system, judging, word)

    names = {
        f'{word} {row.run_id} {digest_of(row.scene)}': (row.run_id, word)
        for row in options.rows for word in options.words
    }
    facts = ('taxinet_ros_version', 'program', 'program_sha256', 'seed', 'specs')
    settings = {
        **{name: options.campaign.facts.get(name) for name in facts},
        'perception_sha256': options.campaign.counterexamples[0].fingerprint,
        'system': trials_digest(system, judging),
    }
    with TrialRecord(options.out, settings, 'contains trials of another campaign or network') as (
        record
    ):
        # Those of older versions have the headline only.
        record.done = {
            key: trial for key, trial in record.done.items()
            if len(trial.others) == len(judging.specs) - 1
        }
        done = itertools.count(sum(key in record.done for key in names))
        on_trial(next(done))
        found = record.make(
            {key: functools.partial(task, *name) for key, name in names.items()}, options.workers,
            lambda: on_trial(next(done)), interrupted,
        )
        return {names[key]: trial.about(spec) for key, trial in found.items()}


def _network(campaign: RecordedCampaign, given: str | None) -> str:
    """The network used by the campaign."""
    first = campaign.counterexamples[0]
    asked = str(campaign.facts.get('perception', ''))
    word = given or (asked if is_node_elsewhere(asked) else first.perception) or asked
    check_unchanged(
        'perception', word, lambda: check_perception(word), first.fingerprint,
        f'name the file that {campaign.folder} was run with as perception',
    )
    return word

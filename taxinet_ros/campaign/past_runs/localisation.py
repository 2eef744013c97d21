"""Localise faults: rerun a campaign's failed runs with the truth instead of the network.

Trials run in worker processes, each with a substitute for the network. The folder contains
``trials.jsonl``, append-only and flushed to disk after every trial: finished trials are never
repeated, so the same command continues after an interrupt, also with more runs or other
substitutions.
"""

from __future__ import annotations

import contextlib
import itertools
import json
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Self

import cv2
from threadpoolctl import threadpool_limits

from taxinet_ros.campaign.options import DEFAULT_ROOT
from taxinet_ros.campaign.past_runs.recorded_campaign import (
    RecordedCampaign,
    open_failed_campaign,
    spread_evenly,
)
from taxinet_ros.campaign.record.facts import recorded_world
from taxinet_ros.campaign.record.row import RunRow
from taxinet_ros.core.assurance.switch import check_controller, make_controller
from taxinet_ros.core.loop import run_closed_loop
from taxinet_ros.core.motion.controller import STEERING, Controller, SteeringGains
from taxinet_ros.core.mtl import RobustnessInterval
from taxinet_ros.core.pacing.timing import NOT_REPRODUCIBLE, is_free, parse_timing
from taxinet_ros.core.perception.perception import Perception, check_perception, make_perception
from taxinet_ros.core.perception.substituted import (
    AS_RECORDED,
    TRUTH,
    TRUTH_CTE,
    TRUTH_HEADING,
    parse_substitution,
    substituted,
)
from taxinet_ros.core.provenance import Provenance, known, provenance
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.user_code import UserCodeError, is_node_elsewhere
from taxinet_ros.core.verdict.judge import Judgement
from taxinet_ros.core.verdict.judging import Judging
from taxinet_ros.core.verdict.outcome import Outcome, outcome_of
from taxinet_ros.core.world import find_world
from taxinet_ros.errors import InfraError, UsageError
from taxinet_ros.files.atomic import make_folder, sync_folder
from taxinet_ros.files.journal import Journal, damaged_line
from taxinet_ros.processes.pool import process_pool
from taxinet_ros.registry import KMWH


@dataclass(frozen=True, kw_only=True, slots=True)
class TrialSetup:
    """Settings common to all trials.

    Attributes:
        perception: word or file of the network.
        judging: judging options of their verdicts.
        gains: steering gains that differ from the defaults.
        controller: name of the controller.
        timing: when answers take effect, in words.
        world: name of their world.
        world_sha256: required hash of the package that provides it, or ''.
    """

    perception: str
    judging: Judging
    gains: Mapping[str, float]
    controller: str = STEERING
    timing: str = ''
    world: str = KMWH
    world_sha256: str = ''


@dataclass(frozen=True, kw_only=True, slots=True)
class Task:
    """One trial to run.

    Attributes:
        run_id: the counterexample.
        scenario: its scene.
        word: word of the substitution.
        seed: seed of its noise: seed and index of the run, which also determine drawn latencies.
        exact: whether the scene is bit-exact.
        gains: steering gains in place of the setup's, or None.
    """

    run_id: str
    scenario: Scenario
    word: str
    seed: tuple[int, int]
    exact: bool = True
    gains: Mapping[str, float] | None = None


@dataclass(frozen=True, kw_only=True, slots=True)
class Trial:
    """Result of one trial.

    Attributes:
        run_id: the counterexample.
        word: word of the substitution.
        passed: whether all formulas were satisfied; None if the run could not be judged.
        detail: reason why it could not be judged.
        exact: whether its scene was bit-exact, so that it must reproduce the recorded result.
        robustness: robustness of the headline; exact unless the run was stopped early.
        max_cross_track_m, settle_time_s, left_runway: statistics of the path, see
            :class:`~taxinet_ros.core.verdict.run_statistics.RunStatistics`; None if unknown.
    """

    run_id: str
    word: str
    passed: bool | None
    detail: str = ''
    exact: bool = True
    robustness: RobustnessInterval | None = None
    max_cross_track_m: float | None = None
    settle_time_s: float | None = None
    left_runway: bool | None = None

    def to_json(self) -> dict[str, Any]:
        """Plain values; the inverse of :meth:`from_json`."""
        values = asdict(self)
        values['rho_lower'], values['rho_upper'] = values.pop('robustness') or (None, None)
        return values

    @classmethod
    def from_json(cls, values: Mapping[str, Any]) -> Self:
        """Create from the values of :meth:`to_json`.

        Raises:
            KeyError, TypeError: a field is missing or unknown.
        """
        columns = dict(values)
        ends = columns.pop('rho_lower'), columns.pop('rho_upper')
        return cls(**columns, robustness=None if None in ends else RobustnessInterval(*ends))


def run_trials(tasks: Iterable[Task], bench: TrialSetup, workers: int) -> Iterator[Trial]:
    """Run trials in worker processes; yield them as they finish.

    ``tasks`` is read only as fast as trials can run, so it may end on an interrupt; trials in
    flight are still completed.

    Raises:
        InfraError: a worker process died.
    """
    waiting = iter(tasks)
    with process_pool(workers, 'trial worker', _start_worker, bench) as pool:
        under_way: set[Future[Trial]] = set()
        while True:
            # One more than the workers, so that none is idle.
            for task in itertools.islice(waiting, workers + 1 - len(under_way)):
                under_way.add(pool.submit(_trial, task))
            if not under_way:
                return
            done, under_way = wait(under_way, return_when=FIRST_COMPLETED)
            yield from (future.result() for future in done)


@contextlib.contextmanager
def trial_pool(
    bench: TrialSetup, workers: int
) -> Iterator[Callable[[Sequence[Task]], list[Trial]]]:
    """Context of a function that runs some trials in worker processes, all of them at once.

    Raises:
        InfraError: a worker process died.
    """
    with process_pool(workers, 'trial worker', _start_worker, bench) as pool:
        yield lambda tasks: [future.result() for future in [pool.submit(_trial, t) for t in tasks]]


_worker: list[tuple[TrialSetup, Perception, Controller]] = []
"""State of a worker process: setup, network and controller."""


def _start_worker(bench: TrialSetup) -> None:
    cv2.setNumThreads(1)  # the workers share the cores
    threadpool_limits(limits=1)
    controller = make_controller(bench.controller, SteeringGains(**bench.gains))
    _worker.append((bench, make_perception(bench.perception), controller))


def _trial(task: Task) -> Trial:
    return make_trial(task, *_worker[0])


def make_trial(
    task: Task, bench: TrialSetup, network: Perception, controller: Controller | None = None
) -> Trial:
    """Run one scene in this process; loads the bench's controller if none is given."""
    if controller is None or task.gains is not None:
        gains = bench.gains if task.gains is None else task.gains
        controller = make_controller(bench.controller, SteeringGains(**gains))
    perception = substituted(parse_substitution(task.word), network, task.seed)
    try:
        judged = run_closed_loop(
            task.scenario, perception, specs=bench.judging.parsed_specs, controller=controller,
            stop_on=bench.judging.stop_on, assumptions=bench.judging.assumptions,
            timing=parse_timing(bench.timing), draws=task.seed,
            make_world=find_world(bench.world, bench.world_sha256).make,
        )
    except (InfraError, UserCodeError) as error:
        return _unjudged(task, str(error))
    return _judged(task, judged)


def _judged(task: Task, judged: Judgement) -> Trial:
    stopped, statistics = judged.stopped_early, judged.statistics
    outcome = outcome_of(judged)
    if not outcome.judged:
        return _unjudged(task, 'a sample could not be judged')
    settled = not stopped and not math.isnan(statistics.settle_time_s)
    return Trial(
        run_id=task.run_id, word=task.word, passed=outcome is Outcome.PASS, exact=task.exact,
        robustness=judged.readings[0].interval,
        max_cross_track_m=statistics.max_cross_track_m,
        settle_time_s=statistics.settle_time_s if settled else None,
        # After an early stop it is unknown whether the run would have left the runway.
        left_runway=statistics.left_runway or (None if stopped else False),
    )


def _unjudged(task: Task, detail: str) -> Trial:
    return Trial(
        run_id=task.run_id, word=task.word, passed=None, detail=detail, exact=task.exact
    )


TRIALS_NAME = 'trials.jsonl'
DEFAULT_WORDS = (TRUTH, TRUTH_HEADING, TRUTH_CTE)
MOST_WORKERS = 64
Trials = Mapping[tuple[str, str], Trial]
"""Trials by run and name of the substitution."""


@dataclass(frozen=True, kw_only=True)
class LocalizeOptions:
    """Options of a fault localisation.

    Attributes:
        campaign: campaign with the failed runs.
        rows: rows of the failed runs to analyse.
        words: names of the substitutions, the control first.
        perception: word or file of the network.
        controller: name of the controller.
        workers: number of processes.
        out: folder.
    """

    campaign: RecordedCampaign
    rows: tuple[RunRow, ...]
    words: tuple[str, ...]
    perception: str
    controller: str
    workers: int
    out: Path

    @property
    def wanted(self) -> int:
        """Total number of trials."""
        return len(self.rows) * len(self.words)


def make_localize_options(
    campaign: Path, *, runs: int | None, words: Iterable[str], workers: int, out: Path | None,
    perception: str | None,
) -> LocalizeOptions:
    """Check the command-line arguments.

    Args:
        campaign: the campaign's folder.
        runs: maximum number of failed runs to analyse, spread over all; None for all.
        words: names of substitutions; :data:`DEFAULT_WORDS` if empty.
        workers: number of processes.
        out: folder; if None, one below ``bags/`` named after the campaign.
        perception: the network's file if it was moved; None for the campaign's.

    Raises:
        UsageError: one line on the first error.
    """
    if not 1 <= workers <= MOST_WORKERS:
        raise UsageError(f'--workers {workers}: needs to be within 1..{MOST_WORKERS}')
    if runs is not None and runs < 1:
        raise UsageError(f'--runs {runs}: needs to be 1 or more')
    chosen = [parse_substitution(word).word for word in words] or DEFAULT_WORDS
    found = open_failed_campaign(campaign)
    if is_free(found.timing):
        raise UsageError(
            f'{campaign}: free runs: {NOT_REPRODUCIBLE}, so trials cannot localise the fault; use '
            'a campaign with --latency'
        )
    # Which reports a missing or changed package.
    if again := find_world(*recorded_world(found.facts)).again_words:
        raise UsageError(f'{campaign}: {again}, so trials cannot localise the fault')
    if not found.judging.specs:
        raise UsageError(f'{campaign}: its ledger does not record the formulas')
    return LocalizeOptions(
        campaign=found, rows=spread_evenly(found.counterexamples, runs),
        words=tuple(dict.fromkeys((AS_RECORDED, *chosen))),
        perception=_network(found, perception), controller=_controller(found), workers=workers,
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
        The requested trials that are complete.

    Raises:
        UsageError: the folder cannot be used, or contains trials of another campaign.
        InfraError: a worker process died.
    """
    journal = _open(options)
    try:
        done = _earlier(options, journal)
        wanted = {(row.run_id, word) for row in options.rows for word in options.words}
        kept = {key: trial for key, trial in done.items() if key in wanted}
        on_trial(len(kept))
        tasks = _tasks(options, kept, interrupted)
        world, package = recorded_world(options.campaign.facts)
        bench = TrialSetup(
            perception=options.perception, judging=options.campaign.judging,
            gains=dict(options.campaign.gains), controller=options.controller,
            timing=options.campaign.timing, world=world, world_sha256=package,
        )
        for trial in run_trials(tasks, bench, options.workers):
            _append(journal, {'event': 'trial', 'trial': trial.to_json()})
            kept[trial.run_id, trial.word] = trial
            on_trial(len(kept))
        return kept
    finally:
        journal.close()


def _tasks(
    options: LocalizeOptions, done: Trials, interrupted: Callable[[], bool]
) -> Iterator[Task]:
    for row in options.rows:
        missing = [word for word in options.words if (row.run_id, word) not in done]
        if not missing:
            continue
        scenario, exact = options.campaign.scenario(row)
        for word in missing:
            if interrupted():
                return
            yield Task(
                run_id=row.run_id, scenario=scenario, word=word, seed=(row.seed, row.index),
                exact=exact,
            )


def _network(campaign: RecordedCampaign, given: str | None) -> str:
    """The network used by the campaign.

    Raises:
        UsageError: it cannot be found, or has changed.
    """
    first = campaign.counterexamples[0]
    recorded = first.fingerprint
    asked = str(campaign.facts.get('perception', ''))
    word = given or (asked if is_node_elsewhere(asked) else first.perception) or asked
    mend = f'name the file that {campaign.folder} was run with: --perception FILE'
    try:
        found = check_perception(word)
    except UsageError as error:
        raise UsageError(f'{error}; {mend}') from error
    if found != recorded:
        what = f'sha256 {found[:12]}…' if found else 'the truth'
        before = f'sha256 {recorded[:12]}…' if recorded else 'the truth'
        raise UsageError(f'perception {word} is {what}, the runs had {before}; {mend}')
    return str(word)


def _controller(campaign: RecordedCampaign) -> str:
    """The campaign's controller.

    Raises:
        UsageError: it cannot be called here, or has changed.
    """
    word = str(campaign.facts.get('controller', STEERING))
    found = check_controller(word, campaign.gains)
    if found != (before := campaign.facts.get('controller_sha256', '')):
        raise UsageError(
            f'controller {word} is sha256 {found[:12]}…, the runs had {before[:12]}…; put the file '
            'back as it was'
        )
    return word


def _facts(options: LocalizeOptions) -> dict[str, Any]:
    """Facts that trials depend on besides run and substitution."""
    campaign = options.campaign
    names = ('taxinet_ros_version', 'program', 'program_sha256', 'seed', 'specs', 'gains')
    world = recorded_world(campaign.facts)
    facts = {
        **{name: campaign.facts.get(name) for name in names},
        **{name: campaign.facts.get(name, []) for name in ('bounds', 'rates')},
        'stop_on': campaign.judging.stop_on.value,
        **({'timing': campaign.timing} if campaign.timing else {}),
        **({} if options.controller == STEERING else {
            'controller_sha256': campaign.facts.get('controller_sha256')
        }),
        **({} if world[0] == KMWH else {'world': world}),
        'perception_sha256': campaign.counterexamples[0].fingerprint,
    }
    return dict(json.loads(json.dumps(facts)))


def _open(options: LocalizeOptions) -> Journal:
    path = options.out / TRIALS_NAME
    try:
        if options.out.is_dir() and not path.exists() and any(options.out.iterdir()):
            raise UsageError(f'--out {options.out}: contains something else; choose another folder')
        make_folder(options.out)
        journal = Journal(path)
        sync_folder(options.out)
    except BlockingIOError as error:
        raise UsageError(f'{path}: in use by another taxinet localize') from error
    except OSError as error:
        raise UsageError(f'--out {options.out}: cannot be used: {error.strerror}') from error
    return journal


def _earlier(options: LocalizeOptions, journal: Journal) -> dict[tuple[str, str], Trial]:
    """The earlier trials; a new journal gets its header."""
    path, facts = options.out / TRIALS_NAME, _facts(options)
    if not journal.events:
        _begin_sitting(options, journal, facts)
        return {}
    before: Provenance = {}
    trials: dict[tuple[str, str], Trial] = {}
    for number, event in enumerate(journal.events, start=1):
        try:
            if event['event'] == 'trial':
                trial = Trial.from_json(event['trial'])
                if trial.passed is not None:  # unjudged trials are repeated
                    trials[trial.run_id, trial.word] = trial
            elif event['facts'] != facts:
                raise UsageError(
                    f'--out {options.out}: contains trials of another campaign or network; choose '
                    'another folder'
                )
            else:
                before = known(event.get('provenance'))
        except (ValueError, KeyError, TypeError) as error:
            raise damaged_line(path, number, str(error)) from error
    if before != provenance():
        _begin_sitting(options, journal, facts)
    return trials


def _begin_sitting(
    options: LocalizeOptions, journal: Journal, facts: Mapping[str, Any]
) -> None:
    """Record the facts and the machine of the following trials."""
    made_on = dict(provenance())
    _append(journal, {'event': 'localize', 'facts': facts, 'provenance': made_on})


def _append(journal: Journal, event: Mapping[str, Any]) -> None:
    journal.append(event)
    journal.sync()

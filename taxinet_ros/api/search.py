"""Falsification from Python: closed-loop runs in worker processes, without ROS."""

from __future__ import annotations

import contextlib
import dataclasses
import datetime
import os
import sys
import time
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path

from taxinet_ros.analysis.search.learned import write_learned
from taxinet_ros.analysis.search.rare import estimate_of, unfinished_words, write_estimate
from taxinet_ros.api.campaign import Campaign, open_campaign
from taxinet_ros.api.run import CALLER, spec_texts, text_list
from taxinet_ros.arguments import (
    FINITE,
    FLAG,
    FROM_0,
    FROM_1,
    MAPPING,
    NONE,
    PATH,
    TEXTS,
    WORD,
    takes,
)
from taxinet_ros.core.assurance.switch import check_controller
from taxinet_ros.core.motion.controller import STEERING
from taxinet_ros.core.mtl.specs import Spec
from taxinet_ros.core.perception.perception import check_perception
from taxinet_ros.core.verdict.outcome import Outcome
from taxinet_ros.errors import UsageError
from taxinet_ros.registry import KMWH
from taxinet_ros.samplers.sampler import LAG
from taxinet_ros.samplers.splitting import RareEstimate
from taxinet_ros.trials.campaign import exit_code
from taxinet_ros.trials.cluster.pool import ClusterPool, campaign_cluster
from taxinet_ros.trials.engine import Engine, run_search
from taxinet_ros.trials.loop_worker import loop_worker_command
from taxinet_ros.trials.options import LOOP, make_options
from taxinet_ros.trials.record.facts import recorded_system
from taxinet_ros.trials.record.row import RunRow
from taxinet_ros.trials.requirements import DEFAULT_SPECS
from taxinet_ros.trials.search import Search, make_estimate, make_search
from taxinet_ros.trials.worker_pool import WorkerPool


@takes(
    program=PATH, runs=FROM_1, seed=FROM_0, sampler=NONE | WORD, sampler_options=NONE | MAPPING,
    perception=WORD, controller=WORD, settings=NONE | MAPPING, stop_on=WORD, bounds=TEXTS,
    rates=TEXTS, latency=TEXTS, world=WORD, until=NONE | WORD, workers=FROM_1,
    cluster=NONE | WORD, lag=FROM_1, out=NONE | PATH, resume=FLAG, odd=NONE | PATH,
    objective=NONE | WORD,
    progress=NONE | FLAG,
)
def falsify(
    program: str | os.PathLike[str], *, runs: int = 100, seed: int = 0, sampler: str | None = None,
    sampler_options: Mapping[str, object] | None = None, perception: str = 'taxinet',
    controller: str = STEERING, specs: str | Spec | Sequence[str | Spec] = DEFAULT_SPECS,
    settings: Mapping[str, object] | None = None, stop_on: str = 'never',
    bounds: str | Sequence[str] = (), rates: str | Sequence[str] = (),
    latency: str | Sequence[str] = (), world: str = KMWH, until: str | None = None,
    workers: int = 1, cluster: str | None = None, lag: int = LAG,
    out: str | os.PathLike[str] | None = None, resume: bool = False,
    odd: str | os.PathLike[str] | None = None, objective: str | None = None,
    progress: bool | None = None,
) -> Campaign:
    """Search a Scenic program for scenes that fail, as ``taxinet falsify`` does, without ROS.

    Scenes, robustness and rates equal those of the command; no bags are recorded. After Ctrl-C the
    folder holds the finished runs, and ``resume=True`` continues.

    Args:
        program: word of a shipped Scenic program (``s_falsif``, ...) or path of one.
        runs: maximum number of runs.
        seed: seed of the scenes.
        sampler: ``active``, ``ce``, ``random``, ...; None for the program's own choice, else
            ``active``.
        sampler_options: options of the sampler by name.
        perception: a word or file as for ``tx.load_perception``.
        controller: ``steering`` or ``FILE.py:NAME``.
        specs: as for ``tx.run``; the sampler tries to violate the first, the headline.
        settings: scenario values that override drawn ones, in the units of Scenic programs, or
            ``steering.<gain>``.
        stop_on: as for ``tx.run``.
        bounds: as for ``tx.run``.
        rates: as for ``tx.run``.
        latency: as for ``tx.run``.
        world: as for ``tx.run``.
        until: ``failures=K``, ``half-width=W`` of the failure rate's interval, or a sequential
            test, ``min-satisfaction=SHARE`` or ``max-off-runway=SHARE``; None: all runs.
        workers: number of processes; results do not depend on it.
        cluster: a Dask cluster that makes the runs instead, with the same results:
            ``tcp://HOST:PORT`` or ``tls://HOST:PORT`` of its scheduler, a scheduler file, or
            ``local:N``.
        lag: number of runs that may be in flight where scenes depend on results.
        out: folder of the campaign, new or empty; None for a new one below ``bags/``.
        resume: continue the campaign in ``out``.
        odd: with the sampler ``coverage``, the operational design domain whose cells it covers:
            name of a shipped one, or a YAML file.
        objective: what the sampler minimises instead of the first of ``specs``: a rulebook, the
            most important first, such as ``no_collision > on_runway, usable``.
        progress: whether to say on one line of standard error how far it is; None: in a terminal or
            a notebook.

    Returns:
        The campaign: rows, counterexamples, rates.

    Raises:
        UsageError: bad input, in one line; or no scene could be run.
    """
    check_perception(perception)  # rejects those that need a ROS graph
    check_controller(controller)
    options = make_options(
        program=os.fspath(program), runs=runs, seed=seed, perception=perception,
        settings=_texts(settings), specs=spec_texts(specs),
        out=None if out is None else Path(out), images='none', resume=resume,
        stop_on=stop_on, controller=controller, bounds=text_list(bounds), rates=text_list(rates),
        latency=text_list(latency), world=world,
    )
    search = Engine(make_search(
        dataclasses.replace(options, bags=False, engine=LOOP), sampler=sampler,
        sampler_options=_texts(sampler_options), workers=workers, until=until, lag=lag,
        cluster=cluster, odd=None if odd is None else os.fspath(odd),
        objective=objective,
    ), participants=(), on_row=_progress(progress, lambda: search))
    with _opened(search) as led:
        _execute(search, led)
        write_learned(search)
    exit_code(search.summary)  # raises if no scene could be run
    return open_campaign(options.out)


@takes(
    program=PATH, down_to=FINITE, runs=FROM_1, islands=FROM_1, seed=FROM_0,
    perception=WORD, controller=WORD, settings=NONE | MAPPING, bounds=TEXTS, rates=TEXTS,
    latency=TEXTS, world=WORD, workers=FROM_1, out=NONE | PATH, resume=FLAG,
    progress=NONE | FLAG,
)
def estimate(
    program: str | os.PathLike[str], *, down_to: float = 1e-5,
    runs: int = 4000, islands: int = 8, seed: int = 0, perception: str = 'taxinet',
    controller: str = STEERING, specs: str | Spec | Sequence[str | Spec] = DEFAULT_SPECS,
    settings: Mapping[str, object] | None = None, bounds: str | Sequence[str] = (),
    rates: str | Sequence[str] = (), latency: str | Sequence[str] = (), world: str = KMWH,
    workers: int = 1, out: str | os.PathLike[str] | None = None, resume: bool = False,
    progress: bool | None = None,
) -> RareEstimate:
    """Estimate the probability that a scene of a program fails, as ``taxinet estimate`` does.

    Args:
        program: as for ``tx.falsify``.
        down_to: least probability that the runs have to suffice for.
        runs: maximum number of runs.
        islands: independent populations, 4 or more; their mean gives the lower end.
        seed: seed of the scenes.
        perception: as for ``tx.falsify``.
        controller: as for ``tx.falsify``.
        specs: as for ``tx.run``; the first, the headline, is the failure.
        settings: as for ``tx.falsify``.
        bounds: as for ``tx.run``.
        rates: as for ``tx.run``.
        latency: as for ``tx.run``.
        world: as for ``tx.run``.
        workers: number of processes; results do not depend on it.
        out: folder of the campaign, new or empty; None for a new one below ``bags/``.
        resume: continue the estimate in ``out``.
        progress: as for ``tx.falsify``.

    Returns:
        ``.low`` and ``.high`` (95 %), ``.state`` (``estimated``, or ``unclear`` for a wide
        interval), ``.probability`` (of what was found), ``.plain``, ``.runs``, ``.curve``.

    Raises:
        UsageError: bad input, in one line; no scene could be run; or it ended before its draws
            did, so there is no interval yet, and ``resume=True`` continues.
    """
    check_perception(perception)
    check_controller(controller)
    options = make_options(
        program=os.fspath(program), runs=runs, seed=seed, perception=perception,
        settings=_texts(settings), specs=spec_texts(specs),
        out=None if out is None else Path(out), images='none', resume=resume,
        controller=controller, bounds=text_list(bounds), rates=text_list(rates),
        latency=text_list(latency), world=world,
    )
    search = Engine(make_estimate(
        dataclasses.replace(options, bags=False, engine=LOOP),
        floor=down_to, islands=islands, workers=workers,
    ), participants=(), on_row=_progress(progress, lambda: search))
    with _opened(search) as led:
        _execute(search, led)
        if words := unfinished_words(search):
            raise UsageError(words)
        found = estimate_of(search)
        write_estimate(found, search)
    exit_code(search.summary)
    return found


def _progress(asked: bool | None, search: Callable[[], Engine[Search]]) -> Callable[[RunRow], None]:
    """A function to call with each row, which rewrites one line, also in a notebook."""
    if not (sys.stderr.isatty() or 'ipykernel' in sys.modules if asked is None else asked):
        return lambda row: None
    began, ended = time.monotonic(), 0

    def show(row: RunRow) -> None:
        nonlocal ended
        ended += 1
        found, runs = search().summary, search().options.runs
        left = round((time.monotonic() - began) / ended * (runs - len(found)))
        line = f'{len(found)} of {runs} runs, {found.outcomes[Outcome.FAIL]} failed, about '
        line += f'{datetime.timedelta(seconds=left)} left '
        print(f'\r{line}', end='' if len(found) < runs else '\n', file=sys.stderr, flush=True)

    return show


@contextlib.contextmanager
def _opened(search: Engine[Search]) -> Iterator[ClusterPool | None]:
    """Context of an open search and of its cluster, if it has one."""
    with contextlib.ExitStack() as opened:
        led = None
        if where := search.options.cluster:
            led = opened.enter_context(campaign_cluster(
                search.options, where, tell=lambda line: warnings.warn(line, stacklevel=2)
            ))
        opened.enter_context(search)
        for line in (*filter(None, [search.book.warning]), *search.proposer.check.warnings):
            warnings.warn(line, stacklevel=CALLER + 2)
        yield led


def _execute(search: Engine[Search], led: ClusterPool | None) -> None:
    """Execute the runs of an open search on its workers."""
    options, facts = search.options, search.book.facts
    command = loop_worker_command(
        recorded_system(options, facts), options.bag_folder, options.images
    )
    with (
        WorkerPool(command, options.workers, options.out / 'logs') if led is None else
        led.making(command, facts, search.book.add_machine)
    ) as pool:
        run_search(search, pool)


def _texts(values: Mapping[str, object] | None) -> list[str]:
    return [f'{name}={value}' for name, value in (values or {}).items()]

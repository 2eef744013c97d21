"""Improvement loop: falsify, retrain on failures, evaluate, keep if better.

The paper performed one round and left further rounds to future work (its conclusion). Here each
round searches for failures of the best network so far, trains it further on places along the
failed runs mixed with pictures of the whole world, runs both networks on scenes that neither has
seen, and keeps the new one only if :mod:`.acceptance` finds it better.

The folder contains the folder of every stage, the record with the decision of each round and its
reason, and ``best.safetensors`` with its card.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from taxinet_ros.analysis.causes.region import Region, part_of
from taxinet_ros.core.perception.weights import card_path, load_model
from taxinet_ros.core.verdict.outcome import Outcome
from taxinet_ros.files.atomic import make_atomically
from taxinet_ros.files.plain_values import plain
from taxinet_ros.files.sealed_json import read_sealed
from taxinet_ros.study.improve.acceptance import Decision, decide
from taxinet_ros.study.improve.options import COMMAND, FALSIFY, JUDGE, TRAIN, ImproveOptions
from taxinet_ros.study.stages.record import read_options
from taxinet_ros.study.stages.stage import Stage, analysis_stage, campaign_stage, training_stage
from taxinet_ros.trials.past_runs.recorded_campaign import open_campaign
from taxinet_ros.trials.record.row import RunRow
from taxinet_ros.trials.record.table import PARQUET_NAME

START = 'start.safetensors'
"""The initial network, copied so that the folder contains everything the loop depends on."""
BEST = 'best.safetensors'
RunStages = Callable[[Sequence[Stage]], None]
"""Runs the unfinished ones of some stages; raises :class:`.StoppedError` if one is not done."""


@dataclass(frozen=True, kw_only=True)
class Round:
    """Result of a round.

    Attributes:
        number: number of the round, from 1.
        incumbent: sha256 of the incumbent's weights.
        searched, failed: number of judged and of failed runs of the search.
        causes: display text of the causes of its failures.
        clusters: display text of the groups of similar failures.
        candidate: sha256 of the candidate's weights; '' if there was no failure.
        decision: decision on the candidate; None if there was no failure.
    """

    number: int
    incumbent: str
    searched: int
    failed: int
    causes: tuple[str, ...] = ()
    clusters: tuple[str, ...] = ()
    candidate: str = ''
    decision: Decision | None = None

    def to_json(self) -> dict[str, Any]:
        """Plain values for the record, with None for numbers that are not finite."""
        values = plain(self)
        return {'round': values.pop('number'), **values}

    def lines(self, rounds: int) -> list[str]:
        """What is printed of its findings and decision; ``rounds``: most rounds of the loop."""
        lines = [
            f'round {self.number} of {rounds}: {self.failed} of {self.searched} runs of the '
            'search failed'
        ]
        lines += [f'  cause: {words}' for words in self.causes]
        lines += [f'  cluster: {words}' for words in self.clusters]
        if self.decision is None:
            return [*lines, '  no failures to learn from; a larger --budget may find more']
        return [*lines, *self.decision.lines()]


def resumed(out: Path, workers: int) -> ImproveOptions:
    """The options of the loop in a folder, to go on with.

    Raises:
        UsageError: there is none.
    """
    values = read_options(out, COMMAND, '--resume')
    options = ImproveOptions(**{**values, 'add': tuple(values['add']), 'workers': workers})
    start = out / START
    return replace(options, start=str(start)) if start.exists() else options


def improve_network(
    out: Path, options: ImproveOptions, run_stages: RunStages
) -> Iterator[Round]:
    """Yield rounds until all are done or no run fails; then write the best network.

    Finished stages are kept, so the same call continues an interrupted loop.

    Args:
        out: folder of the loop.
        options: options of the loop.
        run_stages: runs stages.

    Raises:
        UsageError: a network, program or folder cannot be used.
        StoppedError: a stage was interrupted or broke.
    """
    incumbent = START
    _copy(options.start_path, out / START)
    for number in range(1, options.rounds + 1):
        done = _round(out, options, number, incumbent, run_stages)
        yield done
        if done.decision is None:
            break
        if done.decision.accepted:
            incumbent = _candidate(number)
    _copy(out / incumbent, out / BEST)


def _round(
    out: Path, options: ImproveOptions, number: int, incumbent: str, run_stages: RunStages
) -> Round:
    def judged(what: str) -> Sequence[RunRow]:
        return open_campaign(out / _name(number, what)).judged

    run_stages([_search(options, number, incumbent)])
    found = judged('falsify')
    failed = sum(row.outcome is Outcome.FAIL for row in found)
    before = load_model(out / incumbent).fingerprint
    if not failed:
        return Round(number=number, incumbent=before, searched=len(found), failed=0)
    run_stages(_rest(options, number, incumbent))
    analysis = read_sealed(out / _name(number, 'analyze') / 'analysis.json').values
    return Round(
        number=number, incumbent=before, searched=len(found), failed=failed,
        causes=_words(analysis['causes']), clusters=_words(analysis['clusters']),
        candidate=load_model(out / _candidate(number)).fingerprint,
        decision=decide(
            judged('incumbent'), judged('candidate'), options.alpha, margin=options.margin,
            place_margin=options.place_margin, causes=_regions(analysis['causes']),
        ),
    )


def _search(options: ImproveOptions, number: int, incumbent: str) -> Stage:
    """Stage that searches for failures of the incumbent."""
    return _campaign(
        options, _name(number, 'falsify'), incumbent, options.seed_of(number, FALSIFY),
        options.sampler,
    )


def _rest(options: ImproveOptions, number: int, incumbent: str) -> tuple[Stage, ...]:
    """Stages that group the failures, train on them, and run both networks on unseen scenes."""
    seed = options.seed_of(number, JUDGE)
    campaigns = [_name(one, 'falsify') for one in range(1, number + 1)]
    return (
        analysis_stage(_name(number, 'analyze'), campaigns[-1]),
        training_stage(
            _candidate(number), options.base, learning_rate=options.learning_rate,
            start=incumbent, varied=options.varied, add=options.add,
            add_runs=[f'{campaign}={options.counterexamples}' for campaign in campaigns],
            images=options.images, validation=options.validation, epochs=options.epochs,
            seed=options.seed_of(number, TRAIN), workers=options.workers,
            inputs=(incumbent, *(f'{campaign}/{PARQUET_NAME}' for campaign in campaigns)),
            programs=[text.rpartition('=')[0] for text in options.add],
        ),
        _campaign(options, _name(number, 'incumbent'), incumbent, seed),
        _campaign(options, _name(number, 'candidate'), _candidate(number), seed),
    )


def _campaign(
    options: ImproveOptions, name: str, weights: str, seed: int, sampler: str = 'random'
) -> Stage:
    return campaign_stage(
        name, options.program, sampler=sampler, seed=seed, runs=options.runs,
        workers=options.workers, weights=weights,
    )


def _name(number: int, what: str) -> str:
    return f'round-{number}-{what}'


def _candidate(number: int) -> str:
    """Weights file that a round trains."""
    return f'{_name(number, "train")}/candidate.safetensors'


def _words(entries: Sequence[Mapping[str, Any]]) -> tuple[str, ...]:
    return tuple(str(entry['words']) for entry in entries)


def _regions(causes: Sequence[Mapping[str, Any]]) -> list[Region]:
    return [Region(parts=tuple(map(part_of, cause['region']))) for cause in causes]


def _copy(weights: Path, to: Path) -> None:
    """Check and copy a weights file and its card, the card first, as on saving."""
    load_model(weights)
    for one, other in ((card_path(weights), card_path(to)), (weights, to)):
        if not other.exists() or other.read_bytes() != one.read_bytes():
            make_atomically(other, partial(shutil.copyfile, one))

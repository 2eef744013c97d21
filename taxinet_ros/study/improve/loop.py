"""Improvement loop: falsify, retrain on failures, evaluate, keep if better.

The paper performed one round and left further rounds to future work (its conclusion). Here each
round searches for failures of the best network so far, trains it further on places along the
failed runs mixed with pictures of the whole world, runs both networks on scenes that neither has
seen, and keeps the new one only if :mod:`.acceptance` finds it better.

The folder contains the folder of every stage, the record with the decision of each round and its
reason, and ``best.safetensors`` with its card.
"""

from __future__ import annotations

import math
import shutil
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Self

from taxinet_ros import registry
from taxinet_ros.analysis.causes.region import Region, part_of
from taxinet_ros.core.perception.weights import card_path, load_model, weights_path
from taxinet_ros.core.verdict.outcome import Outcome
from taxinet_ros.errors import UsageError
from taxinet_ros.files.atomic import make_atomically
from taxinet_ros.files.plain_values import plain
from taxinet_ros.files.sealed_json import read_sealed
from taxinet_ros.samplers.registry import SAMPLERS
from taxinet_ros.scenes.programs import find_program, known_programs
from taxinet_ros.study.improve.acceptance import Decision, decide
from taxinet_ros.study.stages.run import read_options
from taxinet_ros.study.stages.stage import Stage, analysis_stage, campaign_stage, training_stage
from taxinet_ros.training.data.portions import parse_portion
from taxinet_ros.trials.past_runs.recorded_campaign import open_campaign
from taxinet_ros.trials.record.row import RunRow
from taxinet_ros.trials.record.table import PARQUET_NAME

_LIMITS: dict[str, tuple[float, float]] = {
    'rounds': (1, 100), 'budget': (6, 10_000_000), 'images': (1, 1_000_000),
    'validation': (1, 1_000_000), 'counterexamples': (1, 1_000_000), 'epochs': (1, 10_000),
    'learning_rate': (1e-8, 1.0), 'alpha': (1e-6, 0.5), 'margin': (1e-4, 0.5),
    'place_margin': (1e-4, 0.5), 'seed': (0, 10**12), 'workers': (1, 64),
}

COMMAND = 'improve'
"""The command, by which a record names its study."""
FALSIFY, TRAIN, JUDGE = range(3)
"""Purposes of a seed."""


@dataclass(frozen=True, kw_only=True, slots=True)
class ImproveOptions:
    """Options of the improvement loop; checked on construction.

    Attributes:
        program: Scenic program on which the network is improved.
        start: word or weights file of the initial network.
        rounds: maximum number of rounds.
        budget: runs of all rounds together; one third each for searching failures and for judging
            the old and the new network.
        base: program whose pictures are learned with the counterexamples, to prevent forgetting.
        images: number of pictures of that program in every round.
        validation: number of held-out pictures, to choose the epoch.
        counterexamples: pictures along failed runs, per round so far.
        add: further pictures as ``PROGRAM=COUNT``.
        epochs, learning_rate: values for every training.
        varied: whether the look of the rendered world varies.
        sampler: sampler of the search for failures.
        alpha: probability, in each round, of accepting a network that is no better, or worse by a
            margin.
        margin: tolerated increase of the failure rate over all scenes.
        place_margin: the same in a part of them.
        seed: base seed; the seeds of different purposes never coincide.
        workers: number of processes; results do not depend on it.

    Raises:
        UsageError: a number is out of range, or a word is not known.
    """

    program: str = 's_falsif'
    start: str = 'taxinet'
    rounds: int = 3
    budget: int = 3600
    base: str = 'training_full'
    images: int = 12_000
    validation: int = 1_500
    counterexamples: int = 4_000
    add: tuple[str, ...] = ()
    epochs: int = 8
    learning_rate: float = 1e-3
    varied: bool = False
    sampler: str = 'ce'
    alpha: float = 0.05
    margin: float = 0.01
    place_margin: float = 0.05
    seed: int = 1
    workers: int = 2

    def __post_init__(self) -> None:
        for name, (low, high) in _LIMITS.items():
            value = getattr(self, name)
            if not (math.isfinite(value) and low <= value <= high):
                raise UsageError(f'improve: {name} is {value:g}, outside {low:g}..{high:g}')
        if self.sampler not in SAMPLERS:
            known = registry.known(registry.SAMPLERS)
            raise UsageError(f'improve: sampler {self.sampler!r} is unknown; known: {known}')
        if self.runs < 2:
            raise UsageError(
                f'improve: budget {self.budget} leaves {self.runs} runs for each of the three '
                f'campaigns of {self.rounds} rounds; ask for more runs or fewer rounds'
            )

    @property
    def runs(self) -> int:
        """Runs of each of the three campaigns of a round."""
        return self.budget // (3 * self.rounds)

    def checked(self) -> Self:
        """The same with absolute program paths, since the stages run in another folder.

        Raises:
            UsageError: a program or the network cannot be used.
        """
        load_model(self.start_path)
        added = [parse_portion(text, 'program') for text in self.add]
        return replace(
            self, program=_absolute_program(self.program), base=_absolute_program(self.base),
            add=tuple(str(replace(one, name=_absolute_program(one.name))) for one in added),
        )

    @property
    def start_path(self) -> Path:
        """The initial weights file."""
        return weights_path(self.start)

    def seed_of(self, number: int, purpose: int) -> int:
        """Seed for one purpose in a round."""
        return 100_000 * (self.seed + 1) + 10 * number + purpose


def _absolute_program(program: str) -> str:
    """A program's word, or its path made absolute."""
    path = find_program(program)
    return program if program in known_programs() else str(path.resolve())


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
        candidate: sha256 of the candidate's weights; '' if there was no failure.
        decision: decision on the candidate; None if there was no failure.
    """

    number: int
    incumbent: str
    searched: int
    failed: int
    causes: tuple[str, ...] = ()
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
        if self.decision is None:
            return [*lines, '  no failures to learn from; a larger budget may find more']
        return [*lines, *self.decision.lines()]


def resumed(out: Path, workers: int) -> ImproveOptions:
    """The options of the loop in a folder, to go on with.

    Raises:
        UsageError: there is none.
    """
    values = read_options(out, COMMAND, 'resume')
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

    run_stages([_campaign(
        options, _name(number, 'falsify'), incumbent, options.seed_of(number, FALSIFY),
        options.sampler,
    )])
    found = judged('falsify')
    failed = sum(row.outcome is Outcome.FAIL for row in found)
    before = load_model(out / incumbent).fingerprint
    if not failed:
        return Round(number=number, incumbent=before, searched=len(found), failed=0)
    run_stages(_rest(options, number, incumbent))
    analysis = read_sealed(out / _name(number, 'analyze') / 'analysis.json').values
    return Round(
        number=number, incumbent=before, searched=len(found), failed=failed,
        causes=tuple(str(cause['words']) for cause in analysis['causes']),
        candidate=load_model(out / _candidate(number)).fingerprint,
        decision=decide(
            judged('incumbent'), judged('candidate'), options.alpha, margin=options.margin,
            place_margin=options.place_margin, causes=[
                Region(parts=tuple(map(part_of, cause['region']))) for cause in analysis['causes']
            ],
        ),
    )


def _rest(options: ImproveOptions, number: int, incumbent: str) -> tuple[Stage, ...]:
    """Stages that find the causes, train on them, and run both networks on unseen scenes."""
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


def _copy(weights: Path, to: Path) -> None:
    """Check and copy a weights file and its card, the card first, as on saving."""
    load_model(weights)
    for one, other in ((card_path(weights), card_path(to)), (weights, to)):
        if not other.exists() or other.read_bytes() != one.read_bytes():
            make_atomically(other, partial(shutil.copyfile, one))

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
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from taxinet_ros.analysis.causes.region import Region, part_of
from taxinet_ros.campaign.past_runs.recorded_campaign import open_campaign
from taxinet_ros.campaign.record.row import RunRow
from taxinet_ros.campaign.record.table import PARQUET_NAME
from taxinet_ros.core.perception.weights import card_path, load_model
from taxinet_ros.core.verdict.outcome import Outcome
from taxinet_ros.errors import ExitCode
from taxinet_ros.files.atomic import make_atomically
from taxinet_ros.files.sealed_json import read_sealed
from taxinet_ros.study.improve.acceptance import Decision, decide
from taxinet_ros.study.improve.options import FALSIFY, JUDGE, TRAIN, ImproveOptions
from taxinet_ros.study.stages.stage import Stage, analysis_stage, campaign_stage, training_stage

START = 'start.safetensors'
"""The initial network, copied so that the folder contains everything the loop depends on."""


def falsify_name(number: int) -> str:
    """Folder of the campaign that searches for failures in a round."""
    return f'round-{number}-falsify'


def incumbent_name(number: int) -> str:
    """Folder of the incumbent's runs on the evaluation scenes."""
    return f'round-{number}-incumbent'


def candidate_name(number: int) -> str:
    """Folder of the candidate's runs on the same scenes."""
    return f'round-{number}-candidate'


def analyze_name(number: int) -> str:
    """Folder of the analysis of the failures."""
    return f'round-{number}-analyze'


def candidate_weights(number: int) -> str:
    """Weights file that a round trains."""
    return f'round-{number}-train/candidate.safetensors'


def search_stage(options: ImproveOptions, number: int, incumbent: str) -> Stage:
    """Stage that searches for failures of the incumbent."""
    return _campaign(
        options, falsify_name(number), incumbent, options.sampler,
        options.seed_of(number, FALSIFY),
    )


def round_stages(
    options: ImproveOptions, number: int, incumbent: str, campaigns: Sequence[str]
) -> tuple[Stage, ...]:
    """Stages that group the failures, train on them, and run both networks on unseen scenes.

    Args:
        options: options of the loop.
        number: number of the round, from 1.
        incumbent: weights file of the best network so far.
        campaigns: folders with failed runs, this round's last.
    """
    seed = options.seed_of(number, JUDGE)
    return (
        analysis_stage(analyze_name(number), falsify_name(number)),
        _training(options, number, incumbent, campaigns),
        _campaign(options, incumbent_name(number), incumbent, 'random', seed),
        _campaign(options, candidate_name(number), candidate_weights(number), 'random', seed),
    )


def _campaign(
    options: ImproveOptions, name: str, weights: str, sampler: str, seed: int
) -> Stage:
    return campaign_stage(
        name, options.program, sampler=sampler, seed=seed, runs=options.runs,
        workers=options.workers, weights=weights,
    )


def _training(
    options: ImproveOptions, number: int, incumbent: str, campaigns: Sequence[str]
) -> Stage:
    return training_stage(
        candidate_weights(number), options.base, learning_rate=options.learning_rate,
        start=incumbent, varied=options.varied, add=options.add,
        add_runs=[f'{campaign}={options.counterexamples}' for campaign in campaigns],
        images=options.images, validation=options.validation,
        epochs=options.epochs, seed=options.seed_of(number, TRAIN), workers=options.workers,
        inputs=(incumbent, *(f'{campaign}/{PARQUET_NAME}' for campaign in campaigns)),
        programs=[text.rpartition('=')[0] for text in options.add],
    )


BEST = 'best.safetensors'
RunStages = Callable[[Sequence[Stage]], int]
"""Runs the unfinished ones of some stages and returns their exit code."""


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
        """Plain values for the record."""
        return {
            'round': self.number, 'incumbent': self.incumbent, 'searched': self.searched,
            'failed': self.failed, 'causes': list(self.causes), 'clusters': list(self.clusters),
            'candidate': self.candidate,
            'decision': None if self.decision is None else self.decision.to_json(),
        }


class Improvement:
    """The loop; finished stages are kept, so the same call continues an interrupted loop."""

    def __init__(
        self, out: Path, options: ImproveOptions, run_stages: RunStages,
        on_round: Callable[[Round], None],
    ) -> None:
        """Prepare the loop; nothing is started yet.

        Args:
            out: folder of the loop.
            options: options of the loop.
            run_stages: runs stages.
            on_round: called with each finished round.
        """
        self._out = out
        self._options = options
        self._run_stages = run_stages
        self._on_round = on_round
        self._incumbent = START

    def run(self) -> int:
        """Run rounds until all are done or no run fails.

        Returns:
            Exit code: 0 if done, else that of the stage that stopped.

        Raises:
            UsageError: a network, program or folder cannot be used.
        """
        _copy(self._options.start_path, self._out / START)
        for number in range(1, self._options.rounds + 1):
            code, done = self._round(number)
            if done is None:
                return code
            self._on_round(done)
            if done.decision is None:
                break
            if done.decision.accepted:
                self._incumbent = candidate_weights(number)
        _copy(self._out / self._incumbent, self._out / BEST)
        return ExitCode.OK

    def _round(self, number: int) -> tuple[int, Round | None]:
        """Perform a round; return its exit code, and the round unless a stage stopped it."""
        options, incumbent = self._options, self._incumbent
        if code := self._run_stages([search_stage(options, number, incumbent)]):
            return code, None
        found = self._judged(falsify_name(number))
        failed = sum(row.outcome is Outcome.FAIL for row in found)
        fingerprint = load_model(self._out / incumbent).fingerprint
        if not failed:
            return 0, Round(number=number, incumbent=fingerprint, searched=len(found), failed=0)
        campaigns = [
            falsify_name(earlier) for earlier in range(1, number + 1)
        ]
        if code := self._run_stages(round_stages(options, number, incumbent, campaigns)):
            return code, None
        analysis = self._analysis(number)
        return 0, Round(
            number=number, incumbent=fingerprint, searched=len(found), failed=failed,
            causes=_words(analysis['causes']), clusters=_words(analysis['clusters']),
            candidate=load_model(self._out / candidate_weights(number)).fingerprint,
            decision=decide(
                self._judged(incumbent_name(number)), self._judged(candidate_name(number)),
                options.alpha, margin=options.margin, place_margin=options.place_margin,
                causes=_regions(analysis['causes']),
            ),
        )

    def _judged(self, campaign: str) -> Sequence[RunRow]:
        return open_campaign(self._out / campaign).judged

    def _analysis(self, number: int) -> Mapping[str, Any]:
        path = self._out / analyze_name(number) / 'analysis.json'
        return read_sealed(path).values


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

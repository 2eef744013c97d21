"""Falsify, learn from the failures, judge, and keep what is better: the paper's loop, repeated.

The paper went round it once and left further rounds to future work (its conclusion). Here each
round looks for failures of the best network so far, trains it further on places along the failed
runs among pictures of the whole world, runs both networks on scenes that neither has seen, and
keeps the new one only where :mod:`.acceptance` finds it better.

The folder holds every stage's own folder, ``stages.jsonl``, ``rounds.jsonl`` with what each round
decided and why, and ``best.safetensors`` with its card.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from taxinet_ros.analysis.failure_region import Region, part_of
from taxinet_ros.bag.layout import write_whole
from taxinet_ros.campaign.facts import LEDGER_NAME
from taxinet_ros.campaign.ledger import read_ledger
from taxinet_ros.campaign.row import RunRow
from taxinet_ros.campaign.sealed_json import read_sealed
from taxinet_ros.core.errors import UsageError
from taxinet_ros.core.outcome import Outcome
from taxinet_ros.core.weights import card_path, load_model
from taxinet_ros.study.acceptance import Decision, decide
from taxinet_ros.study.improve_options import ImproveOptions
from taxinet_ros.study.improve_stages import (
    START,
    analyze_name,
    candidate_name,
    candidate_weights,
    falsify_name,
    incumbent_name,
    round_stages,
    search_stage,
)
from taxinet_ros.study.round_ledger import RoundLedger
from taxinet_ros.study.stage import Stage

BEST = 'best.safetensors'

RunStages = Callable[[Sequence[Stage]], int]
"""Does what is not done of some stages; their exit code."""


@dataclass(frozen=True, kw_only=True)
class Round:
    """What came of a round.

    Attributes:
        number: from 1.
        incumbent: sha256 of the weights that it began with.
        searched, failed: runs of the search that were judged, and those of them that failed.
        causes: what its failures have in common, in words.
        clusters: groups of failures that are alike, in words.
        candidate: sha256 of the weights that it trained; '' where there was no failure.
        decision: on them; None where there was no failure.
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
        """Plain values for the ledger."""
        return {
            'round': self.number, 'incumbent': self.incumbent, 'searched': self.searched,
            'failed': self.failed, 'causes': list(self.causes), 'clusters': list(self.clusters),
            'candidate': self.candidate,
            'decision': None if self.decision is None else self.decision.to_json(),
        }


class Improvement:
    """The loop. What is done is not done again, so the same call goes on where one stopped."""

    def __init__(
        self, out: Path, options: ImproveOptions, ledger: RoundLedger, run_stages: RunStages,
        on_round: Callable[[Round], None],
    ) -> None:
        """Nothing is started yet.

        Args:
            out: folder of the loop.
            options: what to do.
            ledger: of the rounds.
            run_stages: runs a round's commands.
            on_round: called with each round that is over.
        """
        self._out = out
        self._options = options
        self._ledger = ledger
        self._run_stages = run_stages
        self._on_round = on_round
        self._incumbent = START

    def run(self) -> int:
        """Go round until the rounds are over, or no run fails any more.

        Returns:
            Exit code: 0 done, else that of the stage that stopped.

        Raises:
            UsageError: a network, program or folder cannot be used.
        """
        _copy(self._options.start_path, self._out / START)
        for number in range(1, self._options.rounds + 1):
            code, done = self._round(number)
            if done is None:
                return code
            self._ledger.write(done.to_json())
            self._on_round(done)
            if done.decision is None:
                break
            if done.decision.accepted:
                self._incumbent = candidate_weights(number)
        _copy(self._out / self._incumbent, self._out / BEST)
        return 0

    def _round(self, number: int) -> tuple[int, Round | None]:
        """One round, or the exit code of the stage that stopped it."""
        options, incumbent = self._options, self._incumbent
        if code := self._run_stages([search_stage(options, number, incumbent)]):
            return code, None
        found = self._judged(falsify_name(number))
        failed = sum(row.outcome is Outcome.FAIL for row in found)
        sha256 = load_model(self._out / incumbent).card.weights_sha256
        if not failed:
            return 0, Round(number=number, incumbent=sha256, searched=len(found), failed=0)
        campaigns = [
            falsify_name(earlier) for earlier in range(1, number + 1)
        ]
        if code := self._run_stages(round_stages(options, number, incumbent, campaigns)):
            return code, None
        analysis = self._analysis(number)
        return 0, Round(
            number=number, incumbent=sha256, searched=len(found), failed=failed,
            causes=_words(analysis['causes']), clusters=_words(analysis['clusters']),
            candidate=load_model(self._out / candidate_weights(number)).card.weights_sha256,
            decision=decide(
                self._judged(incumbent_name(number)), self._judged(candidate_name(number)),
                options.alpha, margin=options.margin, place_margin=options.place_margin,
                causes=_regions(analysis['causes']),
            ),
        )

    def _judged(self, campaign: str) -> list[RunRow]:
        rows = read_ledger(self._out / campaign / LEDGER_NAME).rows
        return [row for row in rows if row.outcome.judged]

    def _analysis(self, number: int) -> Mapping[str, Any]:
        path = self._out / analyze_name(number) / 'analysis.json'
        return read_sealed(path).values


def _words(entries: Sequence[Mapping[str, Any]]) -> tuple[str, ...]:
    return tuple(str(entry['words']) for entry in entries)


def _regions(causes: Sequence[Mapping[str, Any]]) -> list[Region]:
    return [Region(parts=tuple(map(part_of, cause['region']))) for cause in causes]


def _copy(weights: Path, to: Path) -> None:
    """Copy a weights file and its card, checked; the card first, as when they are saved."""
    load_model(weights)
    try:
        for one, other in ((card_path(weights), card_path(to)), (weights, to)):
            if not other.exists() or other.read_bytes() != one.read_bytes():
                write_whole(other, partial(shutil.copyfile, one))
    except OSError as error:
        raise UsageError(f'{to}: cannot be written ({error.strerror})') from error

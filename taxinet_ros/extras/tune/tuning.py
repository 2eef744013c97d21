"""Parameter synthesis: steering gains that satisfy a requirement by the largest worst-case margin.

Robustness rho says by how much a run satisfies its requirement, so gains are sought that maximise
the least rho over scenes (as VerifAI's parameter synthesis; Dreossi et al., CAV 2019, section 3).
Optuna's tree of Parzen estimators proposes gains. Candidates race: each is driven through the
scenes in the order of the least rho seen in them so far, and is dropped at the first scene in which
it is no better than the best candidate is at its worst, as it cannot win any more. Which runs count
depends on their results only, not on the number of workers.

The best of many is flattered by the scenes it was chosen on. So it is judged, beside the initial
gains, on scenes that the search has not seen.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from taxinet_ros.analysis.experiment.pairs import (
    PairedRates,
    PairedShift,
    paired_rates,
    paired_shift,
)
from taxinet_ros.core.motion.controller import GAIN_RANGES, STEERING, SteeringGains, typed_gain
from taxinet_ros.core.perception.perception import check_perception
from taxinet_ros.core.system import System
from taxinet_ros.errors import InfraError, InfraKind, UsageError
from taxinet_ros.files.plain_values import plain
from taxinet_ros.samplers.optuna_study import SEEDS, new_study, quiet
from taxinet_ros.trials.past_runs.shared_scenes import Scene, SceneSet, trials_digest
from taxinet_ros.trials.past_runs.trials import Trial, TrialRecord

if TYPE_CHECKING:
    from optuna import Trial as Proposal
    from optuna.distributions import BaseDistribution

GAIN_PREFIX = 'steering.'
SIGNIFICANT = 0.05
_STARTUP = 10
"""Number of proposals drawn at random before results are learned from."""
_USUAL = ('cte_gain_rad_per_m', 'max_intercept_rad', 'heading_gain')
"""Gains that are varied unless others are named."""
_FACTOR = 4.0
"""Their ranges reach from the default divided by this to the default times this."""

Gains = Mapping[str, float]
Ranges = Mapping[str, tuple[float, float]]
"""Gains to vary, and the range of each, both ends included."""


def varied_gains(texts: Iterable[str]) -> Ranges:
    """Read ``steering.GAIN=LOW:HIGH`` texts, with units; the usual gains if there are none.

    Raises:
        UsageError: a gain is unknown or named twice, or its range is empty or not allowed.
    """
    found: dict[str, tuple[float, float]] = {}
    for text in texts:
        key, equals, values = text.partition('=')
        low, colon, high = values.partition(':')
        if not equals or not colon or not key.startswith(GAIN_PREFIX):
            raise UsageError(f'vary {text}: expected steering.GAIN=LOW:HIGH')
        name = key.removeprefix(GAIN_PREFIX)
        try:
            ends = typed_gain(name, low), typed_gain(name, high)
        except UsageError as error:
            raise UsageError(f'vary {text}: {error}') from None
        valid = GAIN_RANGES[name]
        if name in found:
            raise UsageError(f'vary {text}: {name} is named twice')
        if not valid.low <= ends[0] < ends[1] <= valid.high:
            raise UsageError(
                f'vary {text}: expected LOW below HIGH, both within '
                f'{valid.low:g}..{valid.high:g} {valid.unit}'
            )
        found[name] = ends
    return found or {name: _usual(name) for name in _USUAL}


def _usual(name: str) -> tuple[float, float]:
    usual, valid = getattr(SteeringGains(), name), GAIN_RANGES[name]
    return max(valid.low, usual / _FACTOR), min(valid.high, usual * _FACTOR)


@dataclass(frozen=True, kw_only=True)
class TuneOptions:
    """What to tune, and on what.

    Attributes:
        learning: scenes of the search.
        unseen: scenes on which its result is judged; none of those of the search.
        perception: word or file of the perception.
        varied: gains to vary, with their ranges.
        start: initial gains that differ from the defaults; they are the first candidate.
        candidates: number of candidates, with the first.
        seed: seed of the proposals.
        workers: number of processes; results do not depend on it.
    """

    learning: SceneSet
    unseen: SceneSet
    perception: str
    varied: Ranges
    start: Gains = field(default_factory=dict)
    candidates: int = 50
    seed: int = 0
    workers: int = 1

    def check(self) -> None:
        """Check that a search is possible.

        Raises:
            UsageError: it is not.
        """
        check_perception(self.perception)
        if (controller := self.system.controller) != STEERING:
            raise UsageError(
                f'{self.learning.source}: its controller is {controller}, which has '
                'no steering gains'
            )
        seen = {scene.scenario.recorded_text for scene in self.learning.scenes}
        for scene in self.unseen.scenes:
            if scene.scenario.recorded_text in seen:
                raise UsageError(
                    f'{self.unseen.source}: scene {scene.row.run_id} is one of the search; judge '
                    'on others'
                )
        SteeringGains(**self.start)

    @property
    def system(self) -> System:
        """The system without gains, which each candidate has its own of."""
        return dataclasses.replace(self.learning.system_with(self.perception), gains={})


@dataclass(frozen=True, kw_only=True, slots=True)
class Candidate:
    """One candidate of the search.

    Attributes:
        gains: its gains that differ from the defaults.
        worst: least rho of its counted runs; an upper bound of its worst case if it was dropped.
            None if a run could not be judged.
        scene: name of the scene of that run.
        runs: number of runs that counted.
        dropped: whether it was dropped before its last scene.
        best: whether it was the best so far.
        detail: why a run could not be judged, or ''.
    """

    gains: Gains
    worst: float | None
    scene: str
    runs: int
    dropped: bool
    best: bool
    detail: str = ''


Evaluate = Callable[[Gains, Sequence[int]], Sequence[Trial]]
"""Runs scenes, by number, with gains; results in the same order."""


class Race:
    """The search over candidates; pure, apart from what ``evaluate`` does.

    Attributes:
        candidates: those so far.
    """

    def __init__(self, scenes: int, evaluate: Evaluate, *, at_once: int = 1) -> None:
        """Start it.

        Args:
            scenes: number of scenes.
            evaluate: runs scenes.
            at_once: number of scenes to run at once; does not change any result.
        """
        self.candidates: list[Candidate] = []
        self._evaluate, self._at_once = evaluate, at_once
        self._least = [math.inf] * scenes
        self._best: Candidate | None = None

    @property
    def best(self) -> Candidate:
        """The candidate with the largest least rho."""
        assert self._best is not None
        return self._best

    def enter(self, gains: Gains) -> Candidate:
        """Drive a candidate through the scenes, the hardest first, until it cannot win."""
        limit = -math.inf if self._best is None else self._best.worst
        assert limit is not None
        worst, where, runs, detail = math.inf, '', 0, ''
        for number, trial in self._trials(gains):
            runs += 1
            if trial.robustness is None:
                detail = trial.detail
                break
            rho = trial.robustness.lower
            self._least[number] = min(self._least[number], rho)
            if rho < worst:
                worst, where = rho, trial.run_id
            if worst <= limit:
                break
        known = None if detail else worst
        won = known is not None and (self._best is None or known > limit)
        found = Candidate(
            gains=dict(gains), worst=known, scene=where, runs=runs, best=won, detail=detail,
            dropped=runs < len(self._least),
        )
        self.candidates.append(found)
        if won:
            self._best = found
        return found

    def _trials(self, gains: Gains) -> Iterator[tuple[int, Trial]]:
        order = sorted(range(len(self._least)), key=lambda number: (self._least[number], number))
        for first in range(0, len(order), self._at_once):
            batch = order[first:first + self._at_once]
            yield from zip(batch, self._evaluate(gains, batch), strict=True)


class Proposals:
    """Optuna's tree of Parzen estimators over gains, which it maximises by minimising ``-rho``."""

    def __init__(self, varied: Ranges, start: Gains, seed: int) -> None:
        """Proposals that learn from results, the initial gains first."""
        from optuna.distributions import FloatDistribution
        from optuna.samplers import TPESampler

        self._start, self._asked = dict(start), 0
        self._ranges: dict[str, BaseDistribution] = {
            name: FloatDistribution(low, high) for name, (low, high) in varied.items()
        }
        self._varied = varied
        self._open: Proposal | None = None
        with quiet():
            self._study = new_study(
                TPESampler(seed=seed % SEEDS, multivariate=True, n_startup_trials=_STARTUP)
            )

    def ask(self) -> Gains:
        """The next gains; the initial ones first."""
        self._asked += 1
        if self._asked == 1:
            return self._start
        with quiet():
            self._open = self._study.ask(self._ranges)
        return {**self._start, **self._open.params}

    def tell(self, found: Candidate) -> None:
        """Learn from the result of the gains asked for last."""
        from optuna.trial import TrialState, create_trial

        with quiet():
            if self._open is not None:
                if found.worst is None:
                    self._study.tell(self._open, state=TrialState.FAIL)
                else:
                    self._study.tell(self._open, -found.worst)
                self._open = None
                return
            usual = SteeringGains()
            values = {
                name: float(found.gains.get(name, getattr(usual, name))) for name in self._ranges
            }
            inside = all(low <= values[name] <= high for name, (low, high) in self._varied.items())
            if found.worst is not None and inside:
                self._study.add_trial(create_trial(
                    params=values, distributions=self._ranges, value=-found.worst,
                ))


@dataclass(frozen=True, kw_only=True)
class Tuned:
    """Result of a search.

    Attributes:
        candidates: all candidates, the initial gains first.
        found: the best one.
        scenes: number of scenes of the search.
        before, after: rho in the unseen scenes by name, with the initial and with the found gains;
            empty if the initial gains are the best.
        satisfied, rho: paired comparison of the two, the initial gains first.
        unjudged: names of unseen scenes in which a run could not be judged.
    """

    candidates: tuple[Candidate, ...]
    found: Candidate
    scenes: int
    before: Mapping[str, float]
    after: Mapping[str, float]
    satisfied: PairedRates
    rho: PairedShift
    unjudged: tuple[str, ...] = ()

    @property
    def start(self) -> Candidate:
        """The initial gains."""
        return self.candidates[0]

    @property
    def runs(self) -> int:
        """Number of runs of the search that counted."""
        return sum(one.runs for one in self.candidates)

    @property
    def verdict(self) -> str:
        """``better``, ``worse``, ``unclear``, or ``same`` if no candidate won.

        By McNemar's exact test of the unseen scenes that satisfy the requirement; where it tells
        nothing, by the interval of the change of rho, unless the two contradict each other.
        """
        if self.found is self.start:
            return 'same'
        rates = self.satisfied
        if self.unjudged or not rates.pairs:
            return 'unclear'
        if rates.p_value < SIGNIFICANT:
            return 'better' if rates.only_second > rates.only_first else 'worse'
        if self.rho.change.low > 0 and rates.only_second >= rates.only_first:
            return 'better'
        if self.rho.change.high < 0 and rates.only_first >= rates.only_second:
            return 'worse'
        return 'unclear'


class Tuning(TrialRecord):
    """A search whose runs are kept in a folder, so that the same command continues it."""

    def __init__(self, options: TuneOptions, out: Path) -> None:
        """Open or create the record in ``out``.

        Raises:
            UsageError: bad options, or the folder contains something else.
        """
        options.check()
        super().__init__(
            out, {'system': trials_digest(options.system, options.learning.judging)},
            'has runs of another perception, requirement or world',
        )
        self.options = options

    def run(
        self, on_candidate: Callable[[Candidate], None] = lambda candidate: None,
        on_run: Callable[[], None] = lambda: None,
        interrupted: Callable[[], bool] = lambda: False,
    ) -> Tuned | None:
        """Search, then judge what was found; None if interrupted.

        Args:
            on_candidate: called with every candidate.
            on_run: called after every run.
            interrupted: whether to start no more runs.

        Raises:
            InfraError: the initial gains cannot be judged, or worker processes end one after the
                other.
        """
        options = self.options

        def run(scenes: SceneSet, gains: Gains, numbers: Sequence[int]) -> list[Trial]:
            system = dataclasses.replace(options.system, gains=dict(gains))
            wanted = {_key(gains, one): one for one in map(scenes.scenes.__getitem__, numbers)}
            found = self.make({
                key: partial(scene.task, system, options.learning.judging)
                for key, scene in wanted.items()
            }, options.workers, on_run, interrupted)
            if interrupted() or len(found) < len(wanted):
                raise _InterruptedError
            return [found[_key(gains, scenes.scenes[number])] for number in numbers]

        try:
            return self._search(run, on_candidate)
        except _InterruptedError:
            return None

    def _search(
        self, run: Callable[[SceneSet, Gains, Sequence[int]], list[Trial]],
        on_candidate: Callable[[Candidate], None],
    ) -> Tuned:
        options = self.options
        race = Race(
            len(options.learning.scenes),
            lambda gains, numbers: run(options.learning, gains, numbers), at_once=options.workers,
        )
        asked = Proposals(options.varied, options.start, options.seed)
        for number in range(options.candidates):
            found = race.enter(asked.ask())
            if number == 0 and found.worst is None:
                raise InfraError(
                    InfraKind.SIM, 'the initial gains', -1, f'cannot be judged: {found.detail}'
                )
            asked.tell(found)
            on_candidate(found)
        return self._judged(race, run)

    def _judged(
        self, race: Race, run: Callable[[SceneSet, Gains, Sequence[int]], list[Trial]]
    ) -> Tuned:
        unseen, chosen = self.options.unseen, (race.candidates[0], race.best)
        trials: list[list[Trial]] = [[], []]
        if chosen[0] is not chosen[1]:
            for one, into in zip(chosen, trials, strict=True):
                for first in range(0, len(unseen.scenes), self.options.workers):
                    last = min(first + self.options.workers, len(unseen.scenes))
                    into += run(unseen, one.gains, range(first, last))
        pairs = list(zip(*trials, strict=True))
        judged = [(one, other) for one, other in pairs if _known(one) and _known(other)]
        before, after = ([_rho(pair[which]) for pair in judged] for which in (0, 1))
        names = [one.run_id for one, _ in judged]
        return Tuned(
            candidates=tuple(race.candidates), found=race.best, scenes=len(race._least),
            before=dict(zip(names, before, strict=True)),
            after=dict(zip(names, after, strict=True)),
            satisfied=paired_rates(
                [bool(one.passed) for one, _ in judged], [bool(other.passed) for _, other in judged]
            ),
            rho=paired_shift(before, after),
            unjudged=tuple(
                one.run_id for one, other in pairs if not (_known(one) and _known(other))
            ),
        )


class _InterruptedError(Exception):
    """The search is to end."""


def _known(trial: Trial) -> bool:
    return trial.passed is not None and trial.robustness is not None


def _rho(trial: Trial) -> float:
    assert trial.robustness is not None
    return trial.robustness.lower


def _key(gains: Gains, scene: Scene) -> str:
    """Key of a run: its gains, and a digest of its scenario."""
    text = ' '.join(f'{name}={gains[name]!r}' for name in sorted(gains))
    return f'{text} {scene.scenario.digest}'


def tuned_json(tuned: Tuned, options: TuneOptions) -> dict[str, Any]:
    """Plain values of a result."""
    return plain({
        'program': options.learning.source, 'perception': options.perception,
        'spec': options.learning.judging.headline, 'seed': options.seed,
        'varied': options.varied,
        'scenes': tuned.scenes, 'runs': tuned.runs, 'verdict': tuned.verdict,
        'start': _candidate_json(tuned.start), 'found': _candidate_json(tuned.found),
        'candidates': [_candidate_json(one) for one in tuned.candidates],
        'unseen': {
            'scenes': len(tuned.before), 'unjudged': list(tuned.unjudged),
            'satisfied_before': tuned.satisfied.first, 'satisfied_after': tuned.satisfied.second,
            'only_before': tuned.satisfied.only_first, 'only_after': tuned.satisfied.only_second,
            'p_value': tuned.satisfied.p_value,
            'worst_before': min(tuned.before.values(), default=None),
            'worst_after': min(tuned.after.values(), default=None),
            'rho_change': list(tuned.rho.change),
        },
    })


def _candidate_json(one: Candidate) -> dict[str, Any]:
    return {
        'gains': dict(one.gains), 'worst_rho': one.worst, 'scene': one.scene, 'runs': one.runs,
        'dropped': one.dropped, 'best': one.best, **({'detail': one.detail} if one.detail else {}),
    }

"""Judge a monitor in the closed loop: the same scenes without it, and with each of its fallbacks.

Every scene is driven once with a monitor beside it, which changes nothing, and once more for each
fallback if the monitor raised an alarm; without one, the run with it is the same run. The monitor
beside goes on after its alarm, so the same runs tell what other thresholds would have done.
"""

from __future__ import annotations

import dataclasses
import functools
import itertools
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from taxinet_ros.analysis.runs.campaign import ConfidenceInterval
from taxinet_ros.core.assurance.monitor import RuntimeMonitor, Seen, make_monitor
from taxinet_ros.core.assurance.switch import (
    WATCH,
    Alarm,
    alarm_of,
    check_controller,
    monitored,
)
from taxinet_ros.core.control_step import rolling_on
from taxinet_ros.core.loop import Step
from taxinet_ros.core.mtl.specs import CENTRELINE_TOLERANCE_M
from taxinet_ros.core.perception.perception import check_perception, make_perception
from taxinet_ros.core.provenance import provenance
from taxinet_ros.core.scenario import Scenario
from taxinet_ros.core.system import System
from taxinet_ros.core.types import NS_PER_S
from taxinet_ros.core.verdict.judging import Judging
from taxinet_ros.errors import InfraError, InfraKind, UsageError
from taxinet_ros.extras.assurance.calibrate import REQUIREMENT
from taxinet_ros.files.atomic import write_atomically
from taxinet_ros.files.plain_values import plain
from taxinet_ros.files.record import RECORD_NAME
from taxinet_ros.files.sealed_json import write_sealed
from taxinet_ros.scenes.overrides import scenes_words
from taxinet_ros.training.data.dataset import draw_scenes
from taxinet_ros.trials.past_runs import trials as kept
from taxinet_ros.trials.past_runs.trials import TrialRecord, check_trials_folder
from taxinet_ros.trials.rates import Rate, rate, share_bounds
from taxinet_ros.trials.worker_pool import Task

WITHOUT = 'without'
"""What a run without monitor is called."""
REACH_S = 10.0
"""Time within which the requirement lets the aircraft reach the line."""
TRIALS_NAME, ALARMS_NAME, RESULT_NAME = 'trials.csv', 'alarms.csv', 'assurance.json'
FACTORS = tuple(2.0 ** (half / 2) for half in range(-5, 7))
"""Multiples of all thresholds for which the first alarm is noted too."""
BRAKING_S = 2.0
"""An alarm that comes this long before the aircraft leaves the runway lets it stop before [s]."""
WANTED_RATIO = 10.0
"""How many times less often a monitored aircraft should leave the runway."""
_ALARM_NAMES = ('scene', *(f'{factor:.4g}' for factor in FACTORS))
Progress = Callable[[str, int, int], None]
Floats = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class JudgeOptions:
    """Options of a judgement.

    Attributes:
        program: scenes.
        perception: word or file.
        runs: number of scenes.
        seed: of the scenes.
        workers: processes; same results.
        out: a new folder, or one of an earlier judgement.
        controller, monitor: words.
        fallbacks: words, each driven.
        overrides: values that replace drawn ones of the scenes.

    Raises:
        UsageError: a word is unknown, or the folder has something else.
    """

    program: str
    perception: str
    runs: int
    seed: int
    workers: int
    out: Path
    controller: str
    monitor: str
    fallbacks: tuple[str, ...]
    overrides: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        check_perception(self.perception)
        check_controller(self.controller)
        if len(set(self.fallbacks)) != len(self.fallbacks) or WATCH in self.fallbacks:
            raise UsageError(
                f'fallback: each once, and without {WATCH}, which is driven in any case'
            )
        for word in self.words.values():
            check_controller(word)
        check_trials_folder(self.out)

    @property
    def fingerprints(self) -> Mapping[str, str]:
        """Fingerprints of the perception, and of the controllers by fallback."""
        controllers = {name: check_controller(word) for name, word in self.words.items()}
        return {**controllers, 'perception': check_perception(self.perception)}

    @property
    def words(self) -> Mapping[str, str]:
        """Words of the controllers, by fallback; that which only watches first."""
        return {
            fallback: monitored(self.controller, self.monitor, fallback)
            for fallback in (WATCH, *self.fallbacks)
        }


@dataclass(frozen=True, kw_only=True, slots=True)
class Trial:
    """One run of a scene.

    Attributes:
        scene: number of the scene.
        fallback: :data:`WITHOUT`, or the fallback.
        satisfied: whether it satisfies the requirement.
        rho_m: robustness [m].
        left_runway: whether it left the runway.
        duration_s: length of the run [s].
        due_s: until when an alarm is in time [s]: when a failed run leaves the 1.5 m for the
            stretch that violates the requirement; 10 s if it never was within them; NaN if it is
            satisfied.
        reached: whether it was within the 1.5 m in the first 10 s; a failed run that was not never
            left them.
        off_s: when it leaves the runway [s]; NaN if it does not.
        alarm_s: when the monitor first raises an alarm [s]; NaN if never.
        reason: the check that did.
    """

    scene: int
    fallback: str
    satisfied: bool
    rho_m: float
    left_runway: bool
    duration_s: float
    due_s: float
    reached: bool
    off_s: float
    alarm_s: float
    reason: str


def due_s(times_s: Sequence[float], cte_m: Sequence[float]) -> float:
    """Until when an alarm is in time: see :attr:`Trial.due_s`.

    Args:
        times_s: of the steps, from 0.
        cte_m: true cross-track errors.

    Returns:
        NaN if the error stays within the tolerance from 10 s on.
    """
    outside = [abs(cte) > CENTRELINE_TOLERANCE_M for cte in cte_m]
    for step, (time_s, out) in enumerate(zip(times_s, outside, strict=True)):
        if not out or time_s < REACH_S:
            continue
        while step > 0 and outside[step - 1]:
            step -= 1
        return times_s[step] if step else REACH_S
    return math.nan


def reached(times_s: Sequence[float], cte_m: Sequence[float]) -> bool:
    """Whether a run is within the tolerance in its first 10 s. Arguments as of :func:`due_s`."""
    return any(
        abs(cte) <= CENTRELINE_TOLERANCE_M
        for time_s, cte in zip(times_s, cte_m, strict=True) if time_s <= REACH_S
    )


class Beside:
    """Looks on at a run: where the aircraft is, and what a monitor beside it says.

    The monitor goes on after its first alarm, until the aircraft leaves the runway.
    """

    def __init__(self, scene: Scenario, monitor: str) -> None:
        """Begin a run; ``monitor``: its word, or '' for none."""
        self._monitor = _monitor(monitor) if monitor else None
        if self._monitor is not None:
            self._monitor.begin(scene)
        self._before, self._half_width_m = rolling_on(scene.speed_mps), scene.line.half_width_m
        self._period_ns = scene.period_ns
        self._times_s: list[float] = []
        self._cte_m: list[float] = []
        self._off_s = math.nan
        self._alarm: Alarm | None = None
        self._alarms_s = np.full(len(FACTORS), math.nan)

    def take(self, step: Step) -> None:
        """Look at a step of the run."""
        now = step.observation
        time_s, cte_m = now.stamp_ns / NS_PER_S, now.on_track.cte_m
        self._times_s.append(time_s)
        self._cte_m.append(cte_m)
        if math.isnan(self._off_s) and abs(cte_m) > self._half_width_m:
            self._off_s = time_s
        if self._monitor is None or not (
            math.isnan(self._off_s) and np.isnan(self._alarms_s).any()
        ):
            return
        assert now.image is not None
        scores = self._monitor.scores(
            Seen(image=now.image, estimate=step.estimate, command=self._before)
        )
        self._before = step.command
        if self._alarm is None:
            self._alarm = alarm_of(scores, now.seq, self._period_ns)
        raised = np.isnan(self._alarms_s) & (max(scores.values()) >= np.array(FACTORS))
        self._alarms_s[raised] = time_s

    def values(self) -> dict[str, Any]:
        """Columns of a :class:`Trial`, and the first alarms; null is NaN."""
        alarm = self._alarm
        return plain({
            'duration_s': self._times_s[-1], 'due_s': due_s(self._times_s, self._cte_m),
            'reached': reached(self._times_s, self._cte_m), 'off_s': self._off_s,
            'alarm_s': math.nan if alarm is None else alarm.at_s,
            'reason': '' if alarm is None else alarm.reason,
            'alarms_s': self._alarms_s,
        })


@functools.lru_cache(maxsize=1)
def _monitor(word: str) -> RuntimeMonitor:
    return make_monitor(word)


@dataclass(frozen=True, kw_only=True)
class FalseAlarms:
    """Alarms in satisfied runs.

    Attributes:
        false_alarms: number of these runs with an alarm.
        false_share: their share.
        settled_alarms: of these, those after :data:`REACH_S`, by when the aircraft is on the line.
        false_per_h: these per hour of satisfied runs after :data:`REACH_S` and until the alarm.
    """

    false_alarms: int
    false_share: Rate
    settled_alarms: int
    false_per_h: ConfidenceInterval


@dataclass(frozen=True, kw_only=True)
class Judged(FalseAlarms):
    """How a monitor fares.

    Attributes:
        runs: number of scenes.
        satisfied, off: shares without monitor.
        failed: number of failed runs without monitor.
        in_time, late, missed: of these, those with an alarm in time, later, or never.
        left: the same three counts of the failed runs that were within the 1.5 m before.
        lead_s: quantiles 10, 50 and 90 % over these of the time from the alarm until it is due;
            negative is late, minus infinity without alarm.
        unreached: failed runs that were not, and so never left them.
        unreached_alarm_s: the same quantiles of their alarms since the start; infinity: none.
        off_missed: runs that leave the runway without an alarm before.
        off_lead_s: as ``lead_s``, before leaving the runway, over all runs that do.
        reasons: alarms by check.
        with_fallback: by fallback.
        trade: alarms and false alarms by multiple of the thresholds.
        unjudged: scenes that are left out, as a run of theirs could not be judged, and why.
    """

    runs: int
    satisfied: Rate
    off: Rate
    rho_m: tuple[float, float, float]
    failed: int
    in_time: int
    late: int
    missed: int
    left: tuple[int, int, int]
    lead_s: tuple[float, float, float]
    unreached: int
    unreached_alarm_s: tuple[float, float, float]
    off_missed: int
    off_lead_s: tuple[float, float, float]
    reasons: Mapping[str, int]
    with_fallback: Mapping[str, Guarded]
    trade: tuple[Trade, ...]
    unjudged: tuple[str, ...] = ()


@dataclass(frozen=True, kw_only=True)
class Trade(FalseAlarms):
    """What the runs without a fallback tell of other thresholds.

    Attributes:
        factor: multiple of all thresholds.
        off_seen: runs that leave the runway with an alarm :data:`BRAKING_S` before, or earlier.
        off: runs that leave the runway.
    """

    factor: float
    off_seen: int
    off: int


@dataclass(frozen=True, kw_only=True)
class Guarded:
    """The same scenes with a fallback.

    Attributes:
        satisfied, off: shares.
        rho_m: quantiles 10, 50 and 90 % of the robustness [m].
        fixed, broken: scenes satisfied only with it, and only without it.
        off_ratio: how many times less often the aircraft leaves the runway; the interval is that of
            two Clopper-Pearson bounds of 97.5 % each, so it holds however the runs depend.
    """

    satisfied: Rate
    off: Rate
    rho_m: tuple[float, float, float]
    fixed: int
    broken: int
    off_ratio: ConfidenceInterval


def summarize(trials: Sequence[Trial], alarms_s: Mapping[int, Floats]) -> Judged:
    """Summarize the runs of all scenes.

    Args:
        trials: for each scene one :data:`WITHOUT`, and one for each fallback.
        alarms_s: by scene, see :class:`Beside`.

    Raises:
        KeyError: a scene has no alarms.
    """
    plain = [one for one in trials if one.fallback == WITHOUT]
    failed = [one for one in plain if not one.satisfied]
    passed = [one for one in plain if one.satisfied]
    lost = [one for one in plain if one.left_runway]
    left = [one for one in failed if one.reached]
    unreached = [one for one in failed if not one.reached]
    in_time, late, missed = _in_time_late_missed(failed)
    reasons: dict[str, int] = {}
    for one in plain:
        if one.reason:
            reasons[one.reason] = reasons.get(one.reason, 0) + 1
    others = dict.fromkeys(one.fallback for one in trials if one.fallback != WITHOUT)
    return Judged(
        runs=len(plain), satisfied=rate(len(passed), len(plain)), off=rate(len(lost), len(plain)),
        rho_m=_quantiles([one.rho_m for one in plain]),
        failed=len(failed), in_time=in_time, late=late, missed=missed,
        **_false_alarms(passed, [one.alarm_s for one in passed]),
        left=_in_time_late_missed(left),
        lead_s=_quantiles([one.due_s - _raised_s(one) for one in left]),
        unreached=len(unreached),
        unreached_alarm_s=_quantiles([_raised_s(one) for one in unreached]),
        off_missed=sum(_raised_s(one) > one.off_s for one in lost),
        off_lead_s=_quantiles([one.off_s - _raised_s(one) for one in lost]),
        reasons=dict(sorted(reasons.items())),
        with_fallback={
            name: _guarded(plain, [one for one in trials if one.fallback == name])
            for name in others
        },
        trade=trade_of(plain, [alarms_s[one.scene] for one in plain]),
    )


def _raised_s(one: Trial) -> float:
    return math.inf if math.isnan(one.alarm_s) else one.alarm_s


def _in_time_late_missed(failed: Sequence[Trial]) -> tuple[int, int, int]:
    in_time = sum(_raised_s(one) <= one.due_s for one in failed)
    missed = sum(math.isnan(one.alarm_s) for one in failed)
    return in_time, len(failed) - in_time - missed, missed


def _false_alarms(passed: Sequence[Trial], alarms_s: Sequence[float]) -> dict[str, Any]:
    """Alarms in satisfied runs: how many, their share, and per hour once the aircraft settled."""
    ends_s = [
        one.duration_s if math.isnan(time_s) else time_s
        for one, time_s in zip(passed, alarms_s, strict=True)
    ]
    count = sum(not math.isnan(time_s) for time_s in alarms_s)
    settled = sum(time_s > REACH_S for time_s in alarms_s)
    hours = sum(max(end_s - REACH_S, 0.0) for end_s in ends_s) / 3600
    return {
        'false_alarms': count, 'false_share': rate(count, len(passed)),
        'settled_alarms': settled, 'false_per_h': per_hour(settled, hours),
    }


def trade_of(plain: Sequence[Trial], alarms_s: Sequence[Floats]) -> tuple[Trade, ...]:
    """Alarms and false alarms by multiple of the thresholds.

    Args:
        plain: the runs without a fallback.
        alarms_s: of each, see :class:`Beside`.
    """
    lost = [number for number, one in enumerate(plain) if one.left_runway]
    good = [number for number, one in enumerate(plain) if one.satisfied]
    found = []
    for which, factor in enumerate(FACTORS):
        times_s = [float(one[which]) for one in alarms_s]
        found.append(Trade(
            **_false_alarms(
                [plain[number] for number in good], [times_s[number] for number in good]
            ),
            factor=factor, off=len(lost),
            off_seen=sum(times_s[one] <= plain[one].off_s - BRAKING_S for one in lost),
        ))
    return tuple(found)


def _guarded(plain: Sequence[Trial], guarded: Sequence[Trial]) -> Guarded:
    pairs = list(zip(plain, guarded, strict=True))
    lost = sum(one.left_runway for one in guarded)
    return Guarded(
        satisfied=rate(sum(one.satisfied for one in guarded), len(guarded)),
        off=rate(lost, len(guarded)), rho_m=_quantiles([one.rho_m for one in guarded]),
        fixed=sum(now.satisfied and not before.satisfied for before, now in pairs),
        broken=sum(before.satisfied and not now.satisfied for before, now in pairs),
        off_ratio=off_ratio(sum(one.left_runway for one in plain), lost, len(plain)),
    )


def off_ratio(before: int, after: int, runs: int) -> ConfidenceInterval:
    """Ratio of two shares of the same number of runs, with its 95 % interval.

    Each share has its one-sided Clopper-Pearson bound of 97.5 %, so by Bonferroni the interval
    holds for dependent runs too.

    Args:
        before: hits of the first.
        after: hits of the second.
        runs: runs of each.
    """
    low_before, high_before = share_bounds(before, runs - before, 0.0125)
    low_after, high_after = share_bounds(after, runs - after, 0.0125)
    value = before / after if after else (math.inf if before else math.nan)
    return ConfidenceInterval(
        value=value, low=low_before / high_after,
        high=high_before / low_after if low_after else math.inf,
    )


def per_hour(count: int, hours: float) -> ConfidenceInterval:
    """Rate of a Poisson process with its exact 95 % interval (Garwood, Biometrika 28, 1936)."""
    if hours <= 0:
        return ConfidenceInterval(value=math.nan, low=0.0, high=math.inf)
    from scipy.special import gammaincinv

    low = float(gammaincinv(count, 0.025)) if count else 0.0
    high = float(gammaincinv(count + 1, 0.975))
    return ConfidenceInterval(value=count / hours, low=low / hours, high=high / hours)


def _quantiles(values: Sequence[float]) -> tuple[float, float, float]:
    """10, 50 and 90 %; infinite where one of the values that it lies between is."""
    if not values:
        return math.nan, math.nan, math.nan
    shares = (0.1, 0.5, 0.9)
    with np.errstate(invalid='ignore'):  # infinite from infinite
        found = np.quantile(values, shares)
    for method in ('lower', 'higher'):
        beside = np.quantile(values, shares, method=method)
        found = np.where(np.isinf(beside), beside, found)
    low, middle, high = found
    return float(low), float(middle), float(high)


def judge(options: JudgeOptions, progress: Progress) -> Judged:
    """Make all runs that are not made yet, and write their table and the summary.

    Args:
        options: what to judge.
        progress: called with the stage, the runs done and their number.

    Raises:
        UsageError: the perception sees no pictures, the program cannot be used, or the folder has
            runs of other options.
        InfraError: no scene could be judged.
    """
    if not make_perception(options.perception).needs_image:
        raise UsageError(f'{options.perception}: sees no picture, so there is nothing to monitor')
    scenes = draw_scenes(
        options.program, seed=options.seed, images=options.runs, overrides=options.overrides)
    driven, broken = _drive(options, scenes, progress)
    if not driven:
        raise InfraError(InfraKind.SIM, 'judge', -1, f'no scene could be judged: {broken[0]}')
    trials = [trial for one, _ in driven for trial in one]
    judged = dataclasses.replace(
        summarize(trials, {one[0].scene: alarms_s for one, alarms_s in driven}), unjudged=broken
    )
    write_atomically(options.out / TRIALS_NAME, trials_csv(trials))
    write_atomically(options.out / ALARMS_NAME, alarms_csv(driven))
    write_sealed(
        options.out / RESULT_NAME, plain_result(options, judged),
        [options.out / name for name in (TRIALS_NAME, ALARMS_NAME, RECORD_NAME)],
    )
    return judged


Driven = tuple[tuple[Trial, ...], Floats]
"""All runs of a scene, that without a fallback first, and the first alarms of that one."""


def _drive(
    options: JudgeOptions, scenes: Sequence[Scenario], progress: Progress
) -> tuple[list[Driven], tuple[str, ...]]:
    """Runs of all scenes, and why some scenes have none; those in the record are taken from it."""
    settings = {
        'requirement': REQUIREMENT, 'fingerprints': dict(options.fingerprints),
        'monitor': options.monitor, 'fallbacks': list(options.fallbacks),
    }
    numbers, words = range(len(scenes)), {WITHOUT: options.controller, **options.words}

    def key(number: int, fallback: str) -> str:
        return f'{number:06} {scenes[number].digest} {fallback}'

    def task(number: int, fallback: str) -> Task:
        return Task(
            run_id=f'{number:06}-{fallback}', index=number, program='', seed=options.seed,
            scenario=scenes[number], judging=Judging(specs=(REQUIREMENT,)), participants=(),
            system=System(perception=options.perception, controller=words[fallback]),
            observer=f'{__name__}:{Beside.__name__}',
            observed=options.monitor if fallback == WITHOUT else '',
        )

    other = 'has runs of another perception, controller, monitor or fallback'
    with TrialRecord(options.out, settings, other) as record:
        def made(stage: str, runs: Sequence[tuple[int, str]]) -> dict[str, kept.Trial]:
            wanted = {key(*run): functools.partial(task, *run) for run in runs}
            done = itertools.count(1 + sum(name in record.done for name in wanted))
            return record.make(
                wanted, options.workers, lambda: progress(stage, next(done), len(wanted))
            )

        found = made('scenes', [(number, WITHOUT) for number in numbers])
        alarmed = [
            number for number in numbers
            if found[key(number, WITHOUT)].seen.get('alarm_s') is not None
        ]
        found |= made('fallbacks', [
            (number, fallback) for fallback in options.fallbacks for number in alarmed
        ])
    driven: list[Driven] = []
    broken: list[str] = []
    for number in numbers:
        without = found[key(number, WITHOUT)]
        runs = {
            fallback: found.get(key(number, fallback), without)
            for fallback in (WITHOUT, *options.fallbacks)
        }
        if all(one.judged for one in runs.values()):
            driven.append(_driven(number, runs))
        else:
            broken.append(next(
                f'scene {number}, {name}: {one.detail}' for name, one in runs.items()
                if not one.judged
            ))
    return driven, tuple(broken)


def _driven(number: int, runs: Mapping[str, kept.Trial]) -> Driven:
    """The rows of a scene. Until the alarm its runs are one, so that is the same in all."""
    seen = {
        fallback: {name: _known(value) for name, value in one.seen.items()}
        for fallback, one in runs.items()
    }
    alarm = {name: seen[WITHOUT][name] for name in ('alarm_s', 'reason')}
    trials = tuple(
        Trial(
            scene=number, fallback=fallback, satisfied=bool(one.passed),
            rho_m=one.robustness.lower if one.robustness else math.nan,
            left_runway=bool(one.left_runway), **alarm, **{
                name: seen[fallback][name] for name in ('duration_s', 'due_s', 'reached', 'off_s')
            },
        ) for fallback, one in runs.items()
    )
    return trials, np.array([_known(time_s) for time_s in seen[WITHOUT]['alarms_s']])


def _known(value: Any) -> Any:
    return math.nan if value is None else value


def trials_csv(trials: Sequence[Trial]) -> str:
    """The runs as a table; an empty field is NaN."""
    return pd.DataFrame(trials).to_csv(index=False)


def alarms_csv(driven: Iterable[Driven]) -> str:
    """Time of the first alarm of each scene without a fallback, by multiple of the thresholds."""
    rows = [(trials[0].scene, *alarms_s) for trials, alarms_s in driven]
    return pd.DataFrame(rows, columns=_ALARM_NAMES).to_csv(index=False)


def plain_result(options: JudgeOptions, judged: Judged) -> dict[str, Any]:
    """Options, results and provenance for JSON; null is not known, not bounded, or no alarm."""
    return plain({
        'options': {
            **plain(options), 'fingerprints': options.fingerprints,
            'program': scenes_words(options.program, options.overrides),
        },
        'judged': judged, 'stack': provenance(),
    })

"""Lower bound on the final robustness of a run in progress, calibrated on a campaign.

What is seen of a run so far (:class:`Progress`) is compared with the runs of a campaign, whose ends
are known (:mod:`.conformal`). The bound's confidence is that of runs *drawn like the campaign's*:
the same program, overrides, network, controller, timing, requirement and world, and drawn by the
program itself. Everything of this kind is in the file of a forecast, and compared with a run or
campaign that it is asked about (:meth:`Forecast.outside`). Whoever asks about another population
is told that there is no guarantee, and why.

The monitor's own interval is certain, so a bound is never below its lower end, nor above its upper
one.
"""

from __future__ import annotations

import json
import math
import os
from collections import deque
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from taxinet_ros.arguments import PATH, takes
from taxinet_ros.bag.errors import BagError
from taxinet_ros.bag.run.recording import Recording, open_recording
from taxinet_ros.core.control_step import CONTROL_PERIOD_NS
from taxinet_ros.core.motion.controller import STEERING
from taxinet_ros.core.mtl.interval import lower_column, upper_column
from taxinet_ros.core.scenario_fields import CONTROL_RATE
from taxinet_ros.core.types import NS_PER_S
from taxinet_ros.errors import UsageError
from taxinet_ros.extras.forecast.conformal import DIGITS, ConformalModel, Floats, fit
from taxinet_ros.files.sealed_json import read_sealed, write_sealed
from taxinet_ros.trials.past_runs.recorded_campaign import RecordedCampaign
from taxinet_ros.trials.rates import Rate, rate, sample_size_was_fixed
from taxinet_ros.trials.record.facts import recorded_rules, recorded_world
from taxinet_ros.trials.record.row import SIMPLY_DRAWN, RunRow

FORMAT = 1
STEP_S = CONTROL_PERIOD_NS / NS_PER_S
_WINDOW = 11
"""Control steps that the latest estimates and the drift are taken from: one second."""
_FARTHEST = 1e3
"""Robustness and errors beyond this are as good as this [m]."""

FEATURES = (
    'cte_m', 'abs_cte_m', 'drift_mps', 'heading_rad', 'distance_m', 'error_m', 'error_spread_m',
    'unusable_share', 'largest_cte_m', 'rho_upper', 'rho_lower',
)
"""What is compared: where the aircraft is and where it drifts, the estimates' errors in the last
second, the farthest it has been, and the monitor's interval."""


class Sample(NamedTuple):
    """One control step as monitors see it; units as in the columns of a trace."""

    cte_m: float
    he_rad: float
    distance_m: float
    est_cte_m: float
    rho_lower: float
    rho_upper: float


class Progress:
    """What is known of a run so far, from one control step to the next."""

    def __init__(self) -> None:
        """Begin at the start of a run."""
        self.steps = 0
        self._recent: deque[Sample] = deque(maxlen=_WINDOW)
        self._largest_m = 0.0

    def add(self, sample: Sample) -> None:
        """Add the next control step.

        Raises:
            UsageError: the true state is no number.
        """
        if not all(map(math.isfinite, (sample.cte_m, sample.he_rad, sample.distance_m))):
            raise UsageError(f'forecast: step {self.steps}: no true state: {sample}')
        if not sample.rho_lower <= sample.rho_upper:
            raise UsageError(f'forecast: step {self.steps}: no interval of robustness: {sample}')
        self._recent.append(sample)
        self._largest_m = max(self._largest_m, abs(sample.cte_m))
        self.steps += 1

    @property
    def latest(self) -> Sample:
        """The latest control step."""
        return self._recent[-1]

    def features(self) -> Floats:
        """The values of :data:`FEATURES`, (F,)."""
        now, first = self._recent[-1], self._recent[0]
        errors = [
            _within(one.est_cte_m - one.cte_m) for one in self._recent
            if math.isfinite(one.est_cte_m)
        ]
        mean = math.fsum(errors) / len(errors) if errors else 0.0
        spread = math.fsum((one - mean) ** 2 for one in errors) / len(errors) if errors else 0.0
        elapsed_s = (len(self._recent) - 1) * STEP_S
        drift = (now.cte_m - first.cte_m) / elapsed_s if elapsed_s else 0.0
        return np.array([
            _within(now.cte_m), min(abs(now.cte_m), _FARTHEST), _within(drift), now.he_rad,
            now.distance_m, mean, math.sqrt(spread), 1 - len(errors) / len(self._recent),
            min(self._largest_m, _FARTHEST), _compressed(now.rho_upper),
            _compressed(now.rho_lower),
        ]).round(DIGITS)


def _within(value: float) -> float:
    return max(-_FARTHEST, min(value, _FARTHEST))


def _compressed(value: float) -> float:
    return math.asinh(_within(value))


class Bound(NamedTuple):
    """Bounds on the final robustness at a moment.

    Attributes:
        t_s: simulated time [s].
        lower: the conformal bound, with the confidence asked for; -inf if nothing is known.
        certain_lower, certain_upper: the monitor's interval, which holds for certain.
    """

    t_s: float
    lower: float
    certain_lower: float
    certain_upper: float


class LiveForecast:
    """The bound on one run, updated at each control step; see :meth:`Forecast.watch`."""

    def __init__(self, forecast: Forecast, confidence: float) -> None:
        self._forecast, self._margin = forecast, forecast.model.margin(confidence)
        self._progress = Progress()
        self._lower = -math.inf

    def update(
        self, *, cte_m: float, he_rad: float, distance_m: float, est_cte_m: float,
        rho_lower: float, rho_upper: float,
    ) -> Bound:
        """Take the next control step, from the first one on and without gaps, and answer.

        The conformal bound is new at each of the forecast's moments, and holds between them.

        Args:
            cte_m: true cross-track error [m], left positive.
            he_rad: true heading error [rad], left positive.
            distance_m: distance along the track [m].
            est_cte_m: the perception's estimate [m]; NaN if there is none.
            rho_lower: lower end of the monitor's interval.
            rho_upper: upper end.

        Raises:
            UsageError: the true state is no number, or the run is longer than those calibrated on.
        """
        sample = Sample(cte_m, he_rad, distance_m, est_cte_m, rho_lower, rho_upper)
        step, forecast = self._progress.steps, self._forecast
        if step > forecast.last_step:
            raise UsageError(
                f'forecast: step {step} is after the end of the runs calibrated on, '
                f'{forecast.last_step * STEP_S:g} s'
            )
        self._progress.add(sample)
        moment, rest = divmod(step, forecast.every_steps)
        if rest == 0:
            features = self._progress.features()[None, :]
            found = float(forecast.model.bounds(features, moment, self._margin)[0])
            # The bounds of all moments hold together, so the greatest of them does.
            self._lower = max(found, self._lower)
        lower = max(min(self._lower, rho_upper), rho_lower)
        return Bound(round(step * STEP_S, 9), lower, rho_lower, rho_upper)


@dataclass(frozen=True, kw_only=True, eq=False)
class Forecast:
    """A calibrated forecast of final robustness.

    Attributes:
        spec: name of the requirement.
        every_steps: control steps between two moments.
        last_step: last control step of the runs.
        population: what calibration runs have in common, by name.
        runs: names and seeds of the runs that trained and calibrated it.
        seed: seed of their campaign.
        model: the predictor.
    """

    spec: str
    every_steps: int
    last_step: int
    population: Mapping[str, str]
    runs: frozenset[str]
    seed: int
    model: ConformalModel = field(repr=False)

    def watch(self, *, confidence: float = 0.9) -> LiveForecast:
        """Begin to watch a run, for :meth:`LiveForecast.update` at each control step.

        Args:
            confidence: that all bounds of the run hold together.

        Raises:
            UsageError: too few calibration runs.
        """
        return LiveForecast(self, confidence)

    def bounds_of(
        self, recording: Recording, *, confidence: float = 0.9, until_s: float | None = None,
    ) -> list[Bound]:
        """Bounds at each control step of a recorded run, or of what there is of one.

        Args:
            recording: the run; its bag may be incomplete.
            confidence: see :meth:`watch`.
            until_s: only the run up to here [s]; None: all of it.

        Raises:
            UsageError: it has no such requirement, or is longer than those calibrated on.
            BagError: it cannot be read.
        """
        live = self.watch(confidence=confidence)
        found = []
        for step, sample in enumerate(samples_of(recording, self.spec)):
            if until_s is not None and step * STEP_S > until_s + 1e-9:
                break
            found.append(live.update(**sample._asdict()))
        return found

    def outside(self, population: Mapping[str, str]) -> list[str]:
        """Why runs are outside the guarantee: in what they differ from those calibrated on."""
        found = []
        for name, own in self.population.items():
            other = population.get(name)
            if other is None:
                found.append(f'{name} unknown, calibrated on {_short(own)}')
            elif other != own:
                found.append(f'{name} {_short(other)}, calibrated on {_short(own)}')
        return found


def _short(text: str) -> str:
    return text if len(text) <= 60 else f'{text[:57]}…'


# Runs -------------------------------------------------------------------------------------------


def samples_of(recording: Recording, spec: str) -> Iterator[Sample]:
    """Control steps of a recorded run, from the first one on.

    Raises:
        UsageError: the run has no such requirement or another control rate, or a step is missing.
        BagError: it cannot be read.
    """
    columns, path = recording.columns, recording.path
    if recording.period_ns != CONTROL_PERIOD_NS:
        raise UsageError(
            f'{path}: its {CONTROL_RATE.key} is {NS_PER_S / recording.period_ns:g}, a forecast '
            f'needs the usual {CONTROL_RATE.absent:g}'
        )
    names = ('cte_m', 'he_rad', 'distance_m', 'est_cte_m', lower_column(spec), upper_column(spec))
    for name in names[4:]:
        if name not in columns:
            raise UsageError(
                f'{path}: its monitor did not judge {spec}, which the forecast is about'
            )
    chosen = np.stack([np.asarray(columns[name], dtype=np.float64) for name in names], axis=1)
    for step, (seq, values) in enumerate(zip(columns['seq'].tolist(), chosen, strict=True)):
        if seq != step:
            raise UsageError(f'{path}: control step {step} is missing, so the run is unknown')
        if np.isnan(values[4:]).any():
            return  # an unfinished bag may end between the truth and the monitor's answer
        yield Sample(*map(float, values))


def population_of_campaign(
    facts: Mapping[str, Any], spec: str, duration_s: float
) -> dict[str, str]:
    """What a campaign's runs have in common, as text by name."""
    formulas = facts.get('specs', {})
    if spec not in formulas:
        raise UsageError(f'spec {spec}: the campaign judged {", ".join(formulas) or "nothing"}')
    laid_over = {**facts.get('laid_over', {}), **facts.get('overrides', {})}
    fingerprint = str(facts.get('perception_sha256', ''))[:16]
    controller, controller_sha256 = (
        str(facts.get(name) or usual)
        for name, usual in (('controller', STEERING), ('controller_sha256', ''))
    )
    assumed = [*facts.get('bounds', ()), *facts.get('rates', ())]
    return {
        'program': f'{facts.get("program", "")} {str(facts.get("program_sha256", ""))[:16]}',
        'settings': _words(laid_over),
        # A network is its weights, wherever its file is and whatever it is called.
        'perception': f'sha256 {fingerprint}' if fingerprint else str(facts.get('perception', '')),
        'controller': f'{controller} {controller_sha256[:16]}'.strip(),
        'gains': _words(facts.get('gains', {})),
        'timing': str(facts.get('timing', '')) or 'at once',
        'world': ' '.join(filter(None, recorded_world(facts))), 'requirement': formulas[spec],
        'assumptions': ' '.join(assumed) or 'none', 'duration': f'{duration_s:g} s',
    }


def _words(values: Mapping[str, Any]) -> str:
    return ' '.join(f'{name}={values[name]}' for name in sorted(values)) or 'none'


@dataclass(frozen=True, kw_only=True, eq=False)
class Runs:
    """Judged runs of a campaign that the program itself drew, with all moments of each.

    Attributes:
        rows: their rows.
        features: (R, T, F).
        outcomes: final robustness, (R,).
        certain: the monitor's interval at each moment, (R, T, 2).
        population: what they have in common.
        left_out: judged runs that a sampler chose, and runs without a verdict.
    """

    rows: tuple[RunRow, ...]
    features: Floats
    outcomes: Floats
    certain: Floats
    population: Mapping[str, str]
    left_out: tuple[int, int]


def read_forecast_runs(
    campaign: RecordedCampaign, spec: str, every_steps: int, on_run: Any = None
) -> Runs:
    """Read a campaign's runs from their bags; frames are not needed."""
    folder = campaign.folder
    rows = [row for row in campaign.judged if row.from_program]
    chosen = len(campaign.judged) - len(rows)
    if not rows:
        raise UsageError(
            f'{folder}: the program itself drew none of its {chosen} judged runs; take a campaign '
            'of sampler random'
        )
    lengths = {row.duration_s for row in rows}
    if len(lengths) > 1:
        raise UsageError(f'{folder}: its runs differ in length, so their moments do not compare')
    if early := sum(bool(row.stopped_early) for row in rows):
        raise UsageError(
            f'{folder}: {early} of {len(rows)} runs were stopped before their end, so their final '
            'robustness is unknown; run it without stop_on'
        )
    duration_s = rows[0].duration_s
    if duration_s is None or spec not in rows[0].rho:
        raise UsageError(f'{folder}: no final robustness of {spec} is recorded')
    last_step = round(duration_s / STEP_S)
    features, certain = [], []
    for number, row in enumerate(rows, 1):
        bag = campaign.bag(row)
        if bag is None:
            raise UsageError(
                f'{folder}: run {row.index} has no bag here; the course of every run is needed'
            )
        moments, ends = _moments(bag, spec, every_steps, last_step)
        features.append(moments)
        certain.append(ends)
        if on_run is not None:
            on_run(number, len(rows))
    return Runs(
        rows=tuple(rows), features=np.array(features), certain=np.array(certain),
        outcomes=np.array([row.rho[spec] for row in rows]),
        population=population_of_campaign(campaign.facts, spec, duration_s),
        left_out=(chosen, len(campaign.rows) - len(campaign.judged)),
    )


def _moments(
    bag: Path, spec: str, every_steps: int, last_step: int
) -> tuple[list[Floats], list[tuple[float, float]]]:
    progress, features, certain = Progress(), [], []
    try:
        for step, sample in enumerate(samples_of(open_recording(bag), spec)):
            progress.add(sample)
            if step % every_steps == 0:
                features.append(progress.features())
                certain.append((sample.rho_lower, sample.rho_upper))
    except BagError as error:
        raise UsageError(f'{error}; the course of every run is needed') from error
    if progress.steps != last_step + 1:
        raise UsageError(
            f'{bag}: has {progress.steps} of {last_step + 1} control steps; the course of every '
            'run is needed'
        )
    return features, certain


# Calibrating and checking -----------------------------------------------------------------------


def calibrate(
    campaign: RecordedCampaign, *, spec: str | None = None, every_s: float = 1.0,
    on_run: Any = None,
) -> Forecast:
    """Train and calibrate on a campaign's runs."""
    steps = every_s / STEP_S
    every_steps = round(steps) if math.isfinite(steps) else 0
    if not 1 <= every_steps <= 10_000 or abs(steps - every_steps) > 1e-6:
        raise UsageError(f'every {every_s:g}: needs to be a multiple of {STEP_S:g} s')
    outcomes = {row.index: row.outcome for row in campaign.rows}
    if not sample_size_was_fixed(outcomes, campaign.planned_runs):
        rules = ' and '.join(recorded_rules(campaign.facts))
        how = f'may have ended by the rule {rules}' if rules else 'has another number than planned'
        raise UsageError(
            f'{campaign.folder}: its number of runs {how}, so it may depend on their results; a '
            'guarantee needs a number fixed beforehand: finish it, or calibrate on another'
        )
    asked = spec or campaign.judging.headline
    runs = read_forecast_runs(campaign, asked, every_steps, on_run)
    return Forecast(
        spec=asked, every_steps=every_steps,
        last_step=round((runs.rows[0].duration_s or 0.0) / STEP_S), population=runs.population,
        runs=frozenset(row.run_id for row in runs.rows),
        seed=int(campaign.facts.get('seed', 0)), model=fit(runs.features, runs.outcomes),
    )


class Coverage(NamedTuple):
    """How often bounds held on runs that were not calibrated on.

    Attributes:
        confidence: what was promised.
        held: share of runs whose bounds held at all moments.
        held_if_failed: share of the violated runs for which they held, which nothing promises.
        cleared_s: median time at which a run that passes has a bound above 0 [s]; None if most
            never have one before their end.
        wrongly_cleared: share of the violated runs whose bound was above 0 at some moment.
    """

    confidence: float
    held: Rate
    held_if_failed: Rate
    cleared_s: float | None
    wrongly_cleared: Rate


def bounds_at_moments(forecast: Forecast, runs: Runs, confidence: float) -> Floats:
    """Bounds of runs at all moments, (R, T)."""
    margin = forecast.model.margin(confidence)
    found = np.maximum.accumulate(np.stack([
        forecast.model.bounds(runs.features[:, moment], moment, margin)
        for moment in range(runs.features.shape[1])
    ], axis=1), axis=1)
    return np.asarray(np.maximum(np.minimum(found, runs.certain[..., 1]), runs.certain[..., 0]))


def coverage(forecast: Forecast, runs: Runs, confidence: float) -> Coverage:
    """Measure the coverage on other runs.

    Raises:
        UsageError: too few calibration runs for this confidence.
    """
    bounds = bounds_at_moments(forecast, runs, confidence)
    held = np.asarray(np.greater_equal(runs.outcomes[:, None], bounds).all(axis=1))
    above: NDArray[np.bool_] = np.greater(bounds, 0.0)
    failed = runs.outcomes <= 0  # of this requirement; a run may violate another
    when = np.where(above.any(axis=1), above.argmax(axis=1), 10**9)[~failed]
    middle = float(np.median(when)) if len(when) else math.inf
    return Coverage(
        confidence=confidence, held=rate(int(held.sum()), len(held)),
        held_if_failed=rate(int(held[failed].sum()), int(failed.sum())),
        cleared_s=middle * forecast.every_steps * STEP_S if middle < bounds.shape[1] else None,
        wrongly_cleared=rate(int(above[failed].any(axis=1).sum()), int(failed.sum())),
    )


def outside_of_campaign(forecast: Forecast, campaign: RecordedCampaign, runs: Runs) -> list[str]:
    """Why a campaign's runs are outside the guarantee; empty if they are not."""
    found = forecast.outside(runs.population)
    if not found and int(campaign.facts.get('seed', 0)) == forecast.seed:
        same = sum(row.run_id in forecast.runs for row in runs.rows)
        if same:
            found.append(f'{same} of these runs were calibrated on: take another seed')
    return found


def outside_of_run(
    forecast: Forecast, recording: Recording, campaign: RecordedCampaign | None
) -> list[str]:
    """Why a run is outside the guarantee; empty if it is not."""
    if campaign is None:
        return ['no campaign beside it, so its program, and whether this drew it, are unknown']
    run = recording.run.request
    found = forecast.outside(
        population_of_campaign(campaign.facts, forecast.spec, run.scenario.duration_s)
    )
    row = next((row for row in campaign.rows if row.run_id == run.run_id), None)
    sampler = str(campaign.facts.get('sampler', ''))
    if not (row.from_program if row is not None else sampler in SIMPLY_DRAWN):
        found.append(f'chosen by the sampler {sampler}, not drawn by the program itself')
    if run.run_id in forecast.runs and run.seed == forecast.seed:
        found.append('this run was used for the calibration')
    return found


# The file ---------------------------------------------------------------------------------------


def write_forecast(path: Path, forecast: Forecast) -> None:
    """Write a forecast as a sealed JSON file.

    Raises:
        OSError: it cannot be written.
    """
    model = forecast.model
    write_sealed(path, {
        'taxinet_forecast': FORMAT, 'spec': forecast.spec, 'seed': forecast.seed,
        'every_steps': forecast.every_steps, 'last_step': forecast.last_step,
        'population': dict(forecast.population), 'runs': sorted(forecast.runs),
        'features': list(FEATURES), 'neighbours': model.neighbours, 'scale': model.scale,
        'widths': model.widths.tolist(), 'outcomes': json.dumps(model.outcomes.tolist()),
        'training': json.dumps(model.features.tolist()),
        'excesses': json.dumps(model.excesses.tolist()),
    })


@takes(path=PATH)
def load_forecast(path: str | os.PathLike[str]) -> Forecast:
    """Load a forecast that ``taxinet forecast calibrate`` has written.

    ``.watch()`` gives an object whose ``.update(…)`` takes one control step after the other and
    answers with the bound; ``.bounds_of(recording)`` takes a recorded run.

    Args:
        path: the file.

    Raises:
        UsageError: there is none, or it is damaged or of another version.
    """
    return read_forecast(Path(path))


def read_forecast(path: Path) -> Forecast:
    """Read a forecast.

    Raises:
        UsageError: there is none, or it is damaged or of another version.
    """
    try:
        values = read_sealed(path).values
    except OSError as error:
        raise UsageError(f'{path}: {error.strerror}') from error
    if values.get('taxinet_forecast') != FORMAT or values.get('features') != list(FEATURES):
        raise UsageError(
            f'{path}: not a forecast of this version; make one with taxinet forecast calibrate'
        )
    try:
        arrays = {
            name: np.array(json.loads(values[name]), dtype=np.float64)
            for name in ('training', 'outcomes', 'excesses')
        }
        forecast = Forecast(
            spec=str(values['spec']), every_steps=int(values['every_steps']),
            last_step=int(values['last_step']), seed=int(values['seed']),
            population={str(name): str(text) for name, text in values['population'].items()},
            runs=frozenset(map(str, values['runs'])),
            model=ConformalModel(
                features=arrays['training'], outcomes=arrays['outcomes'],
                excesses=arrays['excesses'], neighbours=int(values['neighbours']),
                scale=float(values['scale']), widths=np.array(values['widths'], dtype=np.float64),
            ),
        )
        if forecast.every_steps < 1 or forecast.model.features.shape[1:] != (
            forecast.last_step // forecast.every_steps + 1, len(FEATURES)
        ):
            raise ValueError('its moments do not match its runs')
        return forecast
    except (LookupError, TypeError, ValueError, AttributeError) as error:
        raise UsageError(f'{path}: damaged ({error}); make it again') from error

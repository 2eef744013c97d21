"""The verdict of a recorded run made once more, from the truth in its bag."""

from __future__ import annotations

from typing import Any

from taxinet_ros.bag.check_run import PERIOD_NS, Interval, RunRecord, last_seq
from taxinet_ros.bag.findings import Finding, ranges
from taxinet_ros.bag.message_values import HeldCommand, assumptions_of, sample_of, scenario_of
from taxinet_ros.bag.run_samples import same_bits
from taxinet_ros.bag.run_topics import COMMAND, ESTIMATE, ODOMETRY, TRUTH, VERDICT
from taxinet_ros.core.errors import UsageError
from taxinet_ros.core.loop import MAX_GAP_NS
from taxinet_ros.core.mtl import Monitor, parse_spec
from taxinet_ros.core.outcome import Outcome
from taxinet_ros.core.run_statistics import EstimateWatch
from taxinet_ros.core.world import last_step


def verdict_findings(record: RunRecord) -> tuple[int, list[Finding]]:
    """Judge the recorded samples and compare.

    Returns:
        Number of steps judged, and what differs from what was recorded.
    """
    try:
        monitors = _monitors(record.scenario)
    except (UsageError, AttributeError, TypeError, ValueError, OverflowError) as error:
        return 0, [Finding(where='/scenario', what=f'cannot be judged: {error}')]
    readings: dict[str, Interval] = {}
    differing: dict[str, list[int]] = {name: [] for name in monitors}
    steps = 0
    watch = EstimateWatch(last_seq(record) * PERIOD_NS, PERIOD_NS)
    commands = HeldCommand(free=record.free)
    while steps <= last_seq(record) and (
        sample := _sample(record, steps, commands)
    ) is not None:
        sample |= watch.signals(steps * PERIOD_NS, sample)
        for name, monitor in monitors.items():
            reading = monitor.push(steps * PERIOD_NS, sample)
            readings[name] = Interval(reading.lower, reading.upper)
            told = record.robustness.get(steps, {}).get(name)
            if told is not None and not same_bits(told, readings[name]):
                differing[name].append(steps)
        steps += 1
    found = [
        Finding(where=f'step {ranges(wrong)}', what=f'{name}: another interval was recorded')
        for name, wrong in differing.items() if wrong
    ]
    if steps == last_seq(record) + 1:
        found += _verdict_troubles(record, readings)
    else:
        found.append(Finding(where=f'step {steps}', what='no samples from here on'))
    return steps, found


def _monitors(scenario: Any) -> dict[str, Monitor]:
    horizon_ns = last_step(scenario_of(scenario)) * PERIOD_NS
    specs = [parse_spec(text) for text in scenario.specs]
    vouched = assumptions_of(scenario)
    return {
        spec.name: Monitor(
            spec, horizon_ns, vouched.bounds, vouched.rates, max_gap_ns=MAX_GAP_NS
        ) for spec in specs
    }


def _sample(record: RunRecord, step: int, commands: HeldCommand) -> dict[str, float] | None:
    odometry, truth, estimate, command = (
        record.values.get(topic, {}).get(step) for topic in (ODOMETRY, TRUTH, ESTIMATE, COMMAND)
    )
    if odometry is None or truth is None:
        return None
    command = commands.at(command)
    if not record.free and (estimate is None or command is None):
        return None
    try:
        return sample_of(truth, odometry, estimate, command)
    except (AttributeError, TypeError, ValueError):
        return None


def _verdict_troubles(record: RunRecord, readings: dict[str, Interval]) -> list[Finding]:
    """What the run's judgement says against the one made here."""
    verdict = next(iter(record.once.get(VERDICT, ())), None)
    if verdict is None:
        return []
    found = []
    for spec in verdict.specs:
        here = readings.get(str(spec.spec))
        told = Interval(float(spec.rho_lower), float(spec.rho_upper))
        if here is None or not same_bits(told, here):
            text = f'{spec.spec}: recorded {_words(told)}, from the truth {_words(here)}'
            found.append(Finding(where=VERDICT, what=text))
    outcome = record.ending.outcome if record.ending is not None else ''
    satisfied = all(interval.lower > 0 for interval in readings.values())
    if outcome in (Outcome.PASS, Outcome.FAIL) and satisfied is not (outcome == Outcome.PASS):
        found.append(Finding(where='run_status', what=f'{outcome}, but the truth says otherwise'))
    return found


def _words(interval: Interval | None) -> str:
    return 'nothing' if interval is None else f'[{interval.lower:g}, {interval.upper:g}]'

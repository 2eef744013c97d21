"""Facts of a recorded run: request (sufficient for a rerun) and outcome.

An incomplete bag is read as far as it goes.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

from taxinet_ros.bag.description import words_beside
from taxinet_ros.bag.errors import BagCorrupt, BagEmpty, BagError, BagForeign
from taxinet_ros.bag.layout import is_run_name
from taxinet_ros.bag.reader import BagInfo
from taxinet_ros.bag.run.message_values import scenario_of
from taxinet_ros.bag.run.topics import (
    NODE_STATUS,
    ROBUSTNESS,
    RUN_STATUS,
    SCENARIO,
    SIMULATOR,
    VERDICT,
)
from taxinet_ros.bag.writer import FORK_METADATA, FREE_RUN_METADATA, RUN_METADATA
from taxinet_ros.core.control_step import CONTROL_PERIOD_NS
from taxinet_ros.core.motion.controller import is_steering_law, parse_gains
from taxinet_ros.core.mtl import RobustnessInterval
from taxinet_ros.core.pacing.free_run import FreeRunAccount
from taxinet_ros.core.pacing.timing import AT_ONCE, Timing, parse_timing
from taxinet_ros.core.provenance import NAMES, Provenance
from taxinet_ros.core.verdict.judging import Judging
from taxinet_ros.core.verdict.outcome import RunRequest
from taxinet_ros.errors import UsageError

if TYPE_CHECKING:
    from taxinet_ros.bag.run.recording import Recording

@dataclass(frozen=True, kw_only=True)
class RecordedRun:
    """Request and participants of a recorded run.

    Attributes:
        request: the run request.
        perception: name of the perception, e.g. ``taxinet``; '' if unknown.
        fingerprint: SHA-256 of its weights, or ''.
        gains: steering gains that differ from the defaults.
        controller: description reported by a controller other than the steering law; else ''.
        controller_fingerprint: SHA-256 reported by it, or ''.
        world, world_fingerprint: name (with the camera that took its pictures, if that is not its
            own) and SHA-256 of a world or camera from a package; '' for the simulated one.
        timing: timing of the answers.
        fork: what a forked run was forked from, as :attr:`taxinet_ros.core.fork.Fork.text`; else
            ''.
    """

    request: RunRequest
    perception: str
    fingerprint: str
    gains: Mapping[str, float]
    controller: str = ''
    controller_fingerprint: str = ''
    world: str = ''
    world_fingerprint: str = ''
    timing: Timing = AT_ONCE
    fork: str = ''


def recorded_run(recording: Recording) -> RecordedRun:
    """See :attr:`.recording.Recording.run`."""
    path = recording.path
    scenario, reports = _head(recording)
    if scenario is None:
        recording.check_damage()
        raise BagEmpty(
            f'{path}: no message on /scenario, so its run is unknown; recordings of others: '
            'docs/recordings.md', path=path)
    try:
        eyes, law = reports.get('perception'), reports.get('steering_controller')
        world = reports.get(SIMULATOR)
        words = law.implementation if law else ''
        ours = is_steering_law(words)
        return RecordedRun(
            request=_request(scenario),
            perception=eyes.implementation if eyes else '',
            fingerprint=eyes.fingerprint if eyes else '',
            gains=parse_gains(words) if ours else {},
            controller='' if ours else words,
            controller_fingerprint=law.fingerprint if law else '',
            timing=parse_timing(world.implementation) if world else AT_ONCE,
            world=world.detail.partition(' of ')[0] if world else '',
            world_fingerprint=world.fingerprint if world else '',
            fork=recording.metadata.get(FORK_METADATA, {}).get('fork', ''),
        )
    except (AttributeError, TypeError, ValueError) as error:
        raise BagForeign(f'{path}: /scenario or /node_status: {error}', path=path) from error
    except UsageError as error:
        raise UsageError(f'{path}: {error}') from error


def _head(recording: Recording) -> tuple[Any, dict[str, Any]]:
    """The scenario message, or None, and the report of each node that was ready, by its name."""
    scenario, reports = None, dict[str, Any]()
    for topic, _, message in recording.messages((SCENARIO, NODE_STATUS)):
        if topic == SCENARIO:
            scenario = message
        else:
            reports.setdefault(str(getattr(message, 'node', '')), message)
    return scenario, reports


def recorded_period_ns(recording: Recording) -> int:
    """See :attr:`.recording.Recording.period_ns`."""
    try:
        return next((
            scenario_of(message).period_ns for _, _, message in recording.messages((SCENARIO,))
        ), CONTROL_PERIOD_NS)
    except (BagError, AttributeError, TypeError, ValueError, UsageError):
        return CONTROL_PERIOD_NS


def _request(message: Any) -> RunRequest:
    if not is_run_name(message.run_id):
        raise ValueError(f'run_id {message.run_id!r} is not a valid folder name')
    return RunRequest(
        run_id=message.run_id, index=int(message.index), program=message.program,
        seed=int(message.seed), scenario=scenario_of(message),
        judging=Judging.from_message(message), participants=tuple(message.participants),
    )


_NOT_ENDED = SimpleNamespace(outcome='', kind='', who='', detail='')
_NO_FIGURES = frozenset({'header', 'run_id', 'specs', 'complete', 'satisfied'})


@dataclass(frozen=True, kw_only=True)
class NodeFacts:
    """Facts reported by a node.

    Attributes:
        implementation: name of the implementation, e.g. ``taxinet``; or the changed gains.
        fingerprint: SHA-256 of its weights or package, or ''.
        origin: ``NAME of PACKAGE VERSION`` if a package provided it (for the simulator: its
            world), or ''.
    """

    implementation: str
    fingerprint: str
    origin: str = ''


@dataclass(frozen=True, kw_only=True)
class RecordedRobustness:
    """The newest recorded robustness of one formula.

    Attributes:
        formula: the formula, fully parenthesised.
        interval: robustness interval.
        final: the run reached its horizon, so both bounds are rho.
    """

    formula: str
    interval: RobustnessInterval
    final: bool


@dataclass(frozen=True, kw_only=True)
class RunFacts:
    """Facts of a run recorded in its bag.

    Attributes:
        run_id, program, seed, index: identification of the request.
        scene: the scenario in user-facing units, see :meth:`Scenario.to_human`.
        specs: requested formulas.
        nodes: facts by node name.
        outcome: one of the five outcomes, or '' if the bag ends before.
        kind, who, detail: details of an outcome that is not a judgement.
        steps: number of control steps with a robustness.
        judged: robustness by formula name.
        figures: other fields of the verdict by name (statistics of the run).
    """

    run_id: str
    program: str
    seed: int
    index: int
    scene: Mapping[str, Any]
    specs: tuple[str, ...]
    nodes: Mapping[str, NodeFacts]
    outcome: str
    kind: str
    who: str
    detail: str
    steps: int
    judged: Mapping[str, RecordedRobustness]
    figures: Mapping[str, float | bool]


def run_facts(recording: Recording) -> RunFacts | None:
    """See :attr:`.recording.Recording.facts`."""
    scenario, reports = _head(recording)
    if scenario is None:
        return None
    told = {topic: message for topic, _, message in recording.messages((RUN_STATUS, VERDICT))}
    readings = [message for _, _, message in recording.messages((ROBUSTNESS,))]
    verdict, ended = told.get(VERDICT), told.get(RUN_STATUS, _NOT_ENDED)
    try:
        readings += verdict.specs if verdict else []
        return RunFacts(
            run_id=str(scenario.run_id), program=str(scenario.program), seed=int(scenario.seed),
            index=int(scenario.index), scene=scenario_of(scenario).to_human(),
            specs=tuple(map(str, scenario.specs)),
            nodes={node: NodeFacts(
                implementation=str(report.implementation), fingerprint=str(report.fingerprint),
                origin=str(report.detail),
            ) for node, report in reports.items()},
            outcome=str(ended.outcome), kind=str(ended.kind), who=str(ended.who),
            detail=str(ended.detail),
            steps=max((int(reading.seq) for reading in readings), default=-1) + 1,
            judged={str(reading.spec): _judged(reading) for reading in readings},
            figures=_figures(verdict) if verdict else {},
        )
    except (AttributeError, TypeError, ValueError, OverflowError, UsageError) as error:
        text = f'{recording.path}: facts of the run: {error}'
        raise BagCorrupt(text, path=recording.path) from error


def _judged(reading: Any) -> RecordedRobustness:
    return RecordedRobustness(
        formula=str(reading.formula), final=bool(reading.final),
        interval=RobustnessInterval.of_message(reading),
    )


def made_on(info: BagInfo) -> Provenance:
    """Processor, libraries and code with which a bag was recorded; empty if unknown."""
    words = info.metadata.get(RUN_METADATA, {})
    if 'processor' not in words:
        return {}
    told = {
        **words, **words_beside(info.path, words),
        'taxinet_ros': words.get('taxinet_ros_version', ''),
    }
    return {name: told[name] for name in NAMES if told.get(name)}


def free_account(info: BagInfo) -> FreeRunAccount | None:
    """Timing record of a free run; None for other runs, or if the bag ends before it.

    Raises:
        BagForeign: an invalid record.
    """
    told = info.metadata.get(FREE_RUN_METADATA)
    if told is None:
        return None
    try:
        return FreeRunAccount.from_words(told)
    except (KeyError, ValueError) as error:
        text = f'{info.path}: metadata {FREE_RUN_METADATA}: {error}'
        raise BagForeign(text, path=info.path) from error


def _figures(verdict: Any) -> dict[str, float | bool]:
    values = {name: value for name, value in vars(verdict).items() if name not in _NO_FIGURES}
    return {name: value for name, value in values.items() if isinstance(value, bool | int | float)}

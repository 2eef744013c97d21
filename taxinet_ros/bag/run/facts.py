"""Facts of a recorded run: request (sufficient for a rerun) and outcome.

An incomplete bag is read as far as it goes.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from taxinet_ros.bag.cdr.decode import decode
from taxinet_ros.bag.description import words_beside
from taxinet_ros.bag.errors import BagCorrupt, BagEmpty, BagForeign, several_runs
from taxinet_ros.bag.layout import is_run_name
from taxinet_ros.bag.reader import BagInfo, decode_of
from taxinet_ros.bag.run.message_values import scenario_of
from taxinet_ros.bag.run.topics import (
    NODE_READY,
    NODE_STATUS,
    ROBUSTNESS,
    RUN_ENDED,
    RUN_STATUS,
    SCENARIO,
    SIMULATOR,
    VERDICT,
)
from taxinet_ros.bag.storage.reader import StoredMessage
from taxinet_ros.bag.writer import FORK_METADATA, FREE_RUN_METADATA, RUN_METADATA
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
    scenario: Any = None
    kinds: dict[str, Any] = {}
    for count, (topic, stored) in enumerate(recording.messages((SCENARIO, NODE_STATUS))):
        message = decode_of(path, stored, count)
        if topic == NODE_STATUS:
            kinds.setdefault(message.node, message)
        elif scenario is None:
            scenario = message
        else:
            raise several_runs(path, scenario.run_id, message.run_id)
    if scenario is None:
        for error in recording.damaged_places:
            raise error
    if scenario is None:
        raise BagEmpty(f'{path}: no message on /scenario, so its run is unknown', path=path)
    try:
        eyes, law = kinds.get('perception'), kinds.get('steering_controller')
        world = kinds.get(SIMULATOR)
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


def _request(message: Any) -> RunRequest:
    if not is_run_name(message.run_id):
        raise ValueError(f'run_id {message.run_id!r} is not a valid folder name')
    return RunRequest(
        run_id=message.run_id, index=int(message.index), program=message.program,
        seed=int(message.seed), scenario=scenario_of(message),
        judging=Judging.from_message(message), participants=tuple(message.participants),
    )


_FACT_TOPICS = (SCENARIO, NODE_STATUS, RUN_STATUS, VERDICT, ROBUSTNESS)
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
    told = _FactsReader(recording.path)
    for relative, stored in recording.messages(_FACT_TOPICS):
        told.note(relative, stored)
    return told.facts()


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


@dataclass
class _FactsReader:
    """Collects facts from the messages of a run."""

    path: Path
    scenario: dict[str, Any] | None = None
    nodes: dict[str, NodeFacts] = field(default_factory=dict)
    ending: dict[str, str] = field(default_factory=dict)
    judged: dict[str, RecordedRobustness] = field(default_factory=dict)
    figures: dict[str, float | bool] = field(default_factory=dict)
    last_seq: int = -1

    def note(self, relative: str, stored: StoredMessage) -> None:
        """Process a message."""
        message = decode(stored.topic, stored.cdr)
        try:
            self._note(relative, message)
        except (AttributeError, TypeError, ValueError, OverflowError, UsageError) as error:
            text = f'{self.path}: topic {stored.topic.name}: {error}'
            raise BagCorrupt(text, path=self.path) from error

    def _note(self, relative: str, message: Any) -> None:
        if relative == SCENARIO:
            before, self.scenario = self.scenario, _scenario(message)
            if before is not None:
                raise several_runs(self.path, before['run_id'], self.scenario['run_id'])
        elif relative == NODE_STATUS:
            if message.state == NODE_READY:
                self.nodes[str(message.node)] = NodeFacts(
                    implementation=str(message.implementation),
                    fingerprint=str(message.fingerprint), origin=str(message.detail),
                )
        elif relative == RUN_STATUS:
            if message.state == RUN_ENDED:
                words = ('outcome', 'kind', 'who', 'detail')
                self.ending = {word: str(getattr(message, word)) for word in words}
        elif relative == VERDICT:
            for spec in message.specs:
                self._judge(spec)
            self.figures = _figures(message)
        else:
            self._judge(message)

    def facts(self) -> RunFacts | None:
        """Facts collected so far, or None without a scenario."""
        if self.scenario is None:
            return None
        told = self.ending.get
        return RunFacts(
            **self.scenario, nodes=self.nodes, outcome=told('outcome', ''), kind=told('kind', ''),
            who=told('who', ''), detail=told('detail', ''), steps=self.last_seq + 1,
            judged=self.judged, figures=self.figures,
        )

    def _judge(self, robustness: Any) -> None:
        self.last_seq = max(self.last_seq, int(robustness.seq))
        self.judged[str(robustness.spec)] = RecordedRobustness(
            formula=str(robustness.formula), interval=RobustnessInterval(
                float(robustness.rho_lower), float(robustness.rho_upper)
            ), final=bool(robustness.final),
        )


def _scenario(message: Any) -> dict[str, Any]:
    scenario = scenario_of(message)
    return {
        'run_id': str(message.run_id), 'program': str(message.program), 'seed': int(message.seed),
        'index': int(message.index), 'scene': scenario.to_human(),
        'specs': tuple(map(str, message.specs)),
    }


def _figures(verdict: Any) -> dict[str, float | bool]:
    values = {name: value for name, value in vars(verdict).items() if name not in _NO_FIGURES}
    return {name: value for name, value in values.items() if isinstance(value, bool | int | float)}

"""What a run was and what came of it, as its bag tells: also one that ends before it tells all."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from taxinet_ros.bag.decode import decode
from taxinet_ros.bag.description import words_beside
from taxinet_ros.bag.errors import BagCorrupt, BagForeign, several_runs
from taxinet_ros.bag.message_values import scenario_of
from taxinet_ros.bag.reader import BagInfo, StoredMessage, stored_messages
from taxinet_ros.bag.run_topics import (
    NODE_STATUS,
    ROBUSTNESS,
    RUN_STATUS,
    SCENARIO,
    VERDICT,
    is_topic,
)
from taxinet_ros.bag.runs import Recording, run_messages
from taxinet_ros.bag.writer import FREE_RUN_METADATA, RUN_METADATA
from taxinet_ros.core.errors import UsageError
from taxinet_ros.core.free_run import FreeRunAccount
from taxinet_ros.core.provenance import NAMES, Provenance

_READY = 0
_ENDED = 2
_TOLD = (SCENARIO, NODE_STATUS, RUN_STATUS, VERDICT, ROBUSTNESS)
_NO_FIGURES = frozenset({'header', 'run_id', 'specs', 'complete', 'satisfied'})


@dataclass(frozen=True, kw_only=True)
class NodeFacts:
    """What one node said of itself.

    Attributes:
        implementation: which of the exchangeable kinds it was, e.g. ``taxinet``; gains in words.
        fingerprint: sha256 of its weights, or ''.
    """

    implementation: str
    fingerprint: str


@dataclass(frozen=True, kw_only=True)
class Judged:
    """The newest of what the monitor said of one formula.

    Attributes:
        formula: fully parenthesised.
        lower, upper: ends of the robust satisfaction interval.
        final: the run reached its horizon, so both ends are rho.
    """

    formula: str
    lower: float
    upper: float
    final: bool


@dataclass(frozen=True, kw_only=True)
class RunFacts:
    """A run as its bag tells of it.

    Attributes:
        run_id, program, seed, index: who asked for it.
        scene: the scenario in the units people read, as :meth:`Scenario.to_human` spells them.
        specs: formulas to judge by, as asked for.
        nodes: by node name.
        outcome: one of the five, or '' where the bag ends before.
        kind, who, detail: of an outcome that is no judgement.
        steps: control steps with a robustness.
        judged: by name of the formula.
        figures: further fields of the verdict by name: the run in a few figures.
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
    judged: Mapping[str, Judged]
    figures: Mapping[str, float | bool]


def read_facts(path: Path) -> RunFacts | None:
    """Read what a bag tells of its run; damage is passed over.

    Returns:
        The facts, or None where the bag holds no scenario of ours, as those of others.

    Raises:
        BagEmpty, BagForeign, UsageError: as ``reader.read_messages``.
        BagCorrupt: a message that tells of the run is not what its topic says.
    """
    told = _Told()
    for stored in stored_messages(path, _tells, on_damage=lambda error: None):
        _note(told, path, stored)
    return told.facts()


def read_all_facts(recording: Recording) -> dict[str, RunFacts | None]:
    """What a recording tells of each of its runs, by their names; errors as :func:`read_facts`."""
    told = [_Told() for _ in recording.runs]
    for number, stored in run_messages(recording, lambda run, topic: topic in _TOLD):
        _note(told[number], recording.path, stored)
    return {run.name: one.facts() for run, one in zip(recording.runs, told, strict=True)}


def made_on(info: BagInfo) -> Provenance:
    """Processor, libraries and code that a bag was recorded with; empty where it does not tell."""
    words = info.metadata.get(RUN_METADATA, {})
    if 'processor' not in words:
        return {}
    told = {
        **words, **words_beside(info.path, words),
        'taxinet_ros': words.get('taxinet_ros_version', ''),
    }
    return {name: told[name] for name in NAMES if told.get(name)}


def free_account(info: BagInfo) -> FreeRunAccount | None:
    """How a free run went; None where the bag is of none, or ends before it tells.

    Raises:
        BagForeign: what it tells is no such account.
    """
    told = info.metadata.get(FREE_RUN_METADATA)
    if told is None:
        return None
    try:
        return FreeRunAccount.from_words(told)
    except (KeyError, ValueError) as error:
        text = f'{info.path}: metadata {FREE_RUN_METADATA}: {error}'
        raise BagForeign(text, path=info.path) from error


def _note(told: _Told, path: Path, stored: StoredMessage) -> None:
    message = decode(stored.topic, stored.cdr)
    try:
        told.note(path, stored, message)
    except (AttributeError, TypeError, ValueError, OverflowError, UsageError) as error:
        text = f'{path}: topic {stored.topic.name}: {error}'
        raise BagCorrupt(text, path=path) from error


def _tells(topic: str) -> bool:
    return any(is_topic(topic, relative) for relative in _TOLD)


@dataclass
class _Told:
    """What the messages have told so far."""

    scenario: dict[str, Any] | None = None
    nodes: dict[str, NodeFacts] = field(default_factory=dict)
    ending: dict[str, str] = field(default_factory=dict)
    judged: dict[str, Judged] = field(default_factory=dict)
    figures: dict[str, float | bool] = field(default_factory=dict)
    last_seq: int = -1

    def note(self, path: Path, stored: StoredMessage, message: Any) -> None:
        """Take in a message of the bag at ``path``."""
        name = stored.topic.name
        if is_topic(name, SCENARIO):
            before, self.scenario = self.scenario, _scenario(message)
            if before is not None:
                raise several_runs(path, before['run_id'], self.scenario['run_id'])
        elif is_topic(name, NODE_STATUS):
            if message.state == _READY:
                self.nodes[str(message.node)] = NodeFacts(
                    implementation=str(message.implementation),
                    fingerprint=str(message.fingerprint),
                )
        elif is_topic(name, RUN_STATUS):
            if message.state == _ENDED:
                words = ('outcome', 'kind', 'who', 'detail')
                self.ending = {word: str(getattr(message, word)) for word in words}
        elif is_topic(name, VERDICT):
            for spec in message.specs:
                self._judge(spec)
            self.figures = _figures(message)
        else:
            self._judge(message)

    def facts(self) -> RunFacts | None:
        """All of it."""
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
        self.judged[str(robustness.spec)] = Judged(
            formula=str(robustness.formula), lower=float(robustness.rho_lower),
            upper=float(robustness.rho_upper), final=bool(robustness.final),
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

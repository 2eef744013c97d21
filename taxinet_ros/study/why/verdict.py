"""Whose fault failures are, how sure that is, what to do, and the page that says it.

Evidence comes from the stages of :mod:`.plan`: trials with perfect estimates (the paper's method of
error analysis), causes found in the table, changed pictures of the worst runs, and experiments on
fresh scenes that were not selected by any outcome.
"""

from __future__ import annotations

import enum
import math
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from taxinet_ros.analysis.report.parts import Cell, Column, Report, Section, Table
from taxinet_ros.analysis.report.text import (
    decimals,
    environment,
    fill_report,
    p_words,
    sentences,
)
from taxinet_ros.analysis.runs.campaign import holm
from taxinet_ros.core.perception.onnx.network import ONNX_SUFFIX
from taxinet_ros.core.perception.weights import SUFFIX
from taxinet_ros.core.provenance import provenance
from taxinet_ros.core.renderer import OURS
from taxinet_ros.core.world import world_and_camera
from taxinet_ros.files.plain_values import plain
from taxinet_ros.registry import KMWH
from taxinet_ros.study.why.plan import MOST_CAUSES, confirm_name, explain_name
from taxinet_ros.trials.past_runs.recorded_campaign import open_campaign
from taxinet_ros.trials.rates import Rate, rate
from taxinet_ros.trials.record.facts import is_campaign
from taxinet_ros.trials.run_command import RunSettings

_FOLDER = Path(__file__).parent
_SIGNIFICANT = 0.05


class Fault(enum.StrEnum):
    """What is at fault."""

    NETWORK = 'network'
    """Failed runs pass with perfect estimates."""
    CONTROLLER = 'controller'
    """They fail with perfect estimates too: controller, aircraft, or wind and faults."""
    REQUIREMENT = 'requirement'
    """They were violated at their first sample, or no run can satisfy the formula."""
    SEVERAL = 'several'
    """Some are of one kind and some of another."""
    UNCLEAR = 'unclear'
    """Too little could be done to say."""
    BENCH = 'bench'
    """No run was judged: the test bench broke."""
    NOTHING = 'nothing failed'


@dataclass(frozen=True, kw_only=True, slots=True)
class Blames:
    """Failed runs that were driven again with perfect estimates, by what is at fault.

    Attributes:
        network: those that then pass.
        controller: those that fail then too, but could have been saved when they began.
        requirement: those that fail too and were violated at their first sample.
        unknown: those not reproduced, or not judged; in no share.
    """

    network: int = 0
    controller: int = 0
    requirement: int = 0
    unknown: int = 0

    @property
    def counted(self) -> int:
        """Number of runs that say something."""
        return self.network + self.controller + self.requirement

    def share(self, number: int) -> Rate:
        """Share of the counted runs with its 95 % Clopper-Pearson interval."""
        return rate(number, self.counted)


@dataclass(frozen=True, kw_only=True, slots=True)
class Paired:
    """Comparison of an arm of an experiment with the recorded one, on the same fresh scenes.

    Attributes:
        words: what differs, such as ``without the crossing``.
        scenes: number of scenes judged in both.
        before, after: numbers of them that satisfy the formula.
        difference, low, high: satisfied share with the change minus that without, with its 95 %
            interval, -1..1.
        p: of McNemar's exact test; :func:`adjusted` for all arms of all experiments.
    """

    words: str
    scenes: int
    before: int
    after: int
    difference: float
    low: float
    high: float
    p: float

    @property
    def better(self) -> bool:
        """Whether significantly more runs satisfy the formula with the change."""
        return self.p < _SIGNIFICANT and self.difference > 0

    def sentence(self) -> str:
        """Display text."""
        change = (
            f'still {self.after}' if self.after == self.before
            else f'{self.after} instead of {self.before}'
        )
        value, low, high = (
            decimals(100 * share, 0, '+') for share in (self.difference, self.low, self.high))
        return (
            f'{self.words}, {change} of {self.scenes} fresh scenes are satisfied: {value} points '
            f'({low} to {high}, {p_words(self.p)})'
        )


@dataclass(frozen=True, kw_only=True, slots=True)
class CauseEvidence:
    """What is known of one cause.

    Attributes:
        rank: 1 for the cause found first; 0 if it is all failures, as no cause was found.
        words: the region, or what the scenes have in common.
        inside: failure rate in it as text, and elsewhere; '' if there is no region.
        run_id: its worst run; '' if there is none to look at.
        bag: folder of that run's bag.
        explained: first sentence of its explanation; '' if there is none.
        blamed: change of the scene that removes the error, such as ``without the crossing``; ''.
        removed: share of the error that it removes, 0..1.
        without: the experiment's arm with that change; None if it was not made.
        truth: the arm with perfect estimates.
        fresh: failures and scenes of the recorded arm: the cause's rate on fresh scenes.
        program: Scenic program of its scenes; None if there is none.
    """

    rank: int
    words: str
    inside: str = ''
    run_id: str = ''
    bag: Path | None = None
    explained: str = ''
    blamed: str = ''
    removed: float = 0.0
    without: Paired | None = None
    truth: Paired | None = None
    fresh: tuple[int, int] | None = None
    program: Path | None = None

    @property
    def confirmed(self) -> bool | None:
        """Whether removing what is blamed helps on fresh scenes; None if not tested."""
        return None if self.without is None else self.without.better


def adjusted(causes: Sequence[CauseEvidence]) -> tuple[CauseEvidence, ...]:
    """The causes with p values corrected for all that was tested (Holm).

    So the probability of confirming any cause by chance is at most 5 %, however many were tested.
    """
    tested = [one for cause in causes for one in (cause.without, cause.truth) if one is not None]
    p = iter(holm([one.p for one in tested]))

    def corrected(one: Paired | None) -> Paired | None:
        return None if one is None else replace(one, p=next(p))

    return tuple(replace(cause, without=corrected(cause.without), truth=corrected(cause.truth))
                 for cause in causes)


@dataclass(frozen=True, kw_only=True)
class Evidence:
    """All that was found out.

    Attributes:
        subject: campaign or run, as text.
        network, controller: words of both.
        spec, formula: name and text of the requirement.
        judged, failed: numbers of runs.
        others: number of runs without a verdict by outcome, infrastructure errors by kind.
        rate: failure rate of the program as text, or why there is none.
        searched: sampler that chose the scenes by earlier outcomes; ''.
        blames: trials with perfect estimates; None if there are none.
        causes: causes, the most significant first.
        unsatisfiable: why no run can satisfy the formula; ''.
        shrunk: what of the worst run matters, one sentence each.
        troubles: why a stage was not done, by its name.
        scenes: program of scenes like those of the runs, with everything of the scenes that
            decided them; None if there is none.
        base: program of the whole world as the runs' aircraft and camera see it; None for the
            shipped one, which has the usual ones.
        settings: everything else that decided the runs, with the requirement examined; None if it
            is not known.
        seed: one that gives scenes which the runs did not have.
        single: whether the subject is one run.
        outside: how its scenes are outside what the network was trained in; ''.
        elsewhere: the shipped network that was trained for such scenes, then; ''.
        chosen: why another requirement than the headline is looked into, in words; ''.
        also: sentence on the other requirements that are violated; ''.
        features: on which it depends whether runs fail, although no cause was found; ''.
    """

    subject: str
    network: str
    controller: str
    spec: str
    formula: str = ''
    judged: int
    failed: int
    others: Mapping[str, int] = field(default_factory=dict)
    rate: str = ''
    searched: str = ''
    blames: Blames | None = None
    causes: tuple[CauseEvidence, ...] = ()
    unsatisfiable: str = ''
    shrunk: tuple[str, ...] = ()
    troubles: Mapping[str, str] = field(default_factory=dict)
    scenes: Path | None = None
    base: Path | None = None
    settings: RunSettings | None = None
    seed: int = 0
    single: bool = False
    outside: str = ''
    elsewhere: str = ''
    chosen: str = ''
    also: str = ''
    features: str = ''


@dataclass(frozen=True, kw_only=True, slots=True)
class Verdict:
    """The verdict: what is at fault, and three sentences: whose fault, in what, how sure.

    A fourth one names other requirements that are violated, if there are any.
    """

    fault: Fault
    sentences: tuple[str, ...]


def fault_of(evidence: Evidence) -> Fault:
    """What is at fault; unclear unless at least half of the runs examined say so."""
    if not evidence.judged:
        return Fault.BENCH
    if not evidence.failed:
        return Fault.NOTHING
    if evidence.unsatisfiable:
        return Fault.REQUIREMENT
    blames = evidence.blames
    if blames is None or blames.counted == 0 or blames.unknown > blames.counted:
        return Fault.UNCLEAR
    found = {
        Fault.NETWORK: blames.network, Fault.CONTROLLER: blames.controller,
        Fault.REQUIREMENT: blames.requirement,
    }
    kinds = [fault for fault, number in found.items() if number]
    return kinds[0] if len(kinds) == 1 else Fault.SEVERAL


def judge(evidence: Evidence) -> Verdict:
    """The verdict on the evidence; its sentences are those of ``verdict.j2``."""
    fault = fault_of(evidence)
    values = {'e': evidence, 'b': evidence.blames or Blames(), 'fault': fault.value}
    whose, where, sure = (
        ' '.join(sentences(_FOLDER / 'verdict.j2', block, **values))
        for block in ('whose', 'where', 'sure'))
    # Said first: no other cause need be looked for before.
    outside = f'The network {evidence.outside}. ' if evidence.outside and evidence.failed else ''
    chosen = f'{evidence.chosen[0].upper()}{evidence.chosen[1:]}. ' if evidence.chosen else ''
    also = (f'{evidence.also}.',) if evidence.also else ()
    return Verdict(fault=fault, sentences=(f'{chosen}{outside}{whose}', where, sure, *also))


TRAINED, ADDED, FURTHER = 'training_full', 2400, 4000
"""Base program, pictures per cause and pictures along failed runs of the suggested training, as in
``taxinet improve``."""


def actions(
    evidence: Evidence, fault: Fault, *, campaign: Path | None, kept_bags: bool
) -> tuple[Section, ...]:
    """What to do about it, the most useful first: why, and the commands, if there are any.

    Args:
        evidence: what was found out.
        fault: what is at fault.
        campaign: folder of the campaign; None for a single run.
        kept_bags: whether some failed run has its bag, along whose path pictures can be taken.
    """
    can_train = trainable(evidence.network)
    network = Path(evidence.network)
    fixed = f'{network.stem if can_train or network.suffix == ONNX_SUFFIX else "fixed"}-fixed'
    fixed += ONNX_SUFFIX if network.suffix == ONNX_SUFFIX else SUFFIX
    programs = [cause.program for cause in evidence.causes if cause.program is not None]
    of_causes = bool(programs)
    if not programs and evidence.scenes is not None:
        programs = [evidence.scenes]
    train = ['train', str(evidence.base or TRAINED), '--start', evidence.network]
    for path in programs:
        train += ['--add', f'{path}={ADDED}']
    if campaign is not None and kept_bags:
        train += ['--add-runs', f'{campaign}={FURTHER}']
    world, camera = world_and_camera(evidence.settings.world if evidence.settings else KMWH)
    found = fill_report(_FOLDER / 'todo.j2', {
        'e': evidence, 'b': evidence.blames or Blames(), 'fault': fault.value,
        'command': _line, 'campaign': campaign, 'kept_bags': kept_bags, 'programs': programs,
        'causes': of_causes, 'world': world, 'our_world': KMWH, 'camera': camera,
        'our_camera': OURS, 'added': ADDED,
        'trainable': can_train, 'fixed': fixed, 'train': _line(
            *train, '--epochs', '8', '--learning-rate', '0.001', '--out', fixed),
        'bag': next((cause.bag for cause in evidence.causes if cause.bag is not None), None),
    }, {})
    return tuple(
        replace(section, name=f'todo-{number}',
                heading=f'Step {number}' if number > 1 else 'What to do')
        for number, section in enumerate(found.sections, 1)
    )


def todo_of(evidence: Evidence, verdict: Verdict, path: Path, kind: str) -> tuple[Section, ...]:
    """What to do; paths below the current folder are as one would type them.

    Args:
        evidence: the evidence.
        verdict: the verdict on it.
        path: the subject.
        kind: ``campaign`` or ``run``.
    """
    folder = path if kind == 'campaign' else path.parent
    campaign = open_campaign(folder) if is_campaign(folder) else None
    kept = campaign is not None and any(map(campaign.bag, campaign.counterexamples))
    here = f'{Path.cwd()}/'
    return tuple(
        replace(one, commands=tuple(line.replace(here, '') for line in one.commands))
        for one in actions(
            evidence, verdict.fault, campaign=None if campaign is None else folder, kept_bags=kept)
    )


def trainable(network: str) -> bool:
    """Whether ``taxinet train --start`` takes a network: shipped, or weights of its format."""
    return network.endswith('.safetensors') or not any(sign in network for sign in './: ')


def _line(*words: Any) -> str:
    return shlex.join(['taxinet', *map(str, words)])


_NOT_DONE = {
    'causes': 'No cause can be named:', 'localize': 'Whose fault it is was not examined:',
    'explain': 'The pictures were not examined:', 'shrink': 'The run was not shrunk:',
    'confirm': 'No experiment was made:',
}
environment(_FOLDER).filters.update(
    interval=lambda share: f'95 % interval {100 * share.low:.0f}–{100 * share.high:.0f} %',
    stage=lambda stage: _NOT_DONE.get(stage.partition('-')[0], f'{stage} was not done:'),
)


_PAGE = Path(__file__).with_name('page.j2')
JSON_NAME, PAGE_NAME = 'why.json', 'why.html'
_STAGE_PAGES = {
    'analyze/report.html': 'analysis of all runs',
    'localize/localize.html': 'network or controller', 'shrink/shrink.html': 'shrunk run',
}


def why_report(
    evidence: Evidence, verdict: Verdict, todo: Sequence[Section], out: Path
) -> Report:
    """The page.

    Args:
        evidence: what was found out.
        verdict: the verdict on it.
        todo: what to do.
        out: folder of the page, with the folders of the stages.
    """
    causes = evidence.causes[:MOST_CAUSES]
    bags = {cause.run_id: cause.bag for cause in causes if cause.bag is not None}
    tested = _tested(evidence)
    links: dict[int | str, list[tuple[str, str]]] = {
        cause.rank: _links(out, {
            f'{explain_name(cause.rank)}/explain.html': 'explanation of this run',
            f'{confirm_name(cause.rank)}/experiment.html': 'the experiment',
        }) for cause in causes
    }
    report = fill_report(
        _PAGE, {
            'e': evidence, 'verdict': verdict, 'most': MOST_CAUSES, 'rate': rate,
            'subject': Path(evidence.subject).name, 'tested': bool(tested.rows),
            'links': {**links, 'stages': _links(out, _STAGE_PAGES)},
        },
        {'sure': (tested,), 'others': (Table(
            name='others', title='Runs without a verdict', caption='',
            columns=(Column(name='outcome', title='outcome'), Column(name='runs', title='runs')),
            rows=tuple(evidence.others.items()),
        ),)},
        runs=bags, worst=next(iter(bags), ''),
        worst_words='The run' if evidence.single else (
            'The worst run of the first cause' if causes and causes[0].rank else 'The worst run'),
    )
    return replace(report, sections=(*todo, *report.sections))


def _tested(evidence: Evidence) -> Table:
    rows: list[tuple[Cell, ...]] = []
    if evidence.blames is not None:
        for words, number in (
            ('failed runs that pass with perfect estimates (network)', evidence.blames.network),
            ('failed runs that fail with them too (controller)', evidence.blames.controller),
            ('failed runs violated at their first sample (requirement)',
             evidence.blames.requirement),
        ):
            share = evidence.blames.share(number)
            rows.append((words, number, evidence.blames.counted, *(
                None if math.isnan(value) else 100 * value for value in share), None))
    for cause in evidence.causes:
        for paired in (cause.without, cause.truth):
            if paired is not None:
                rows.append(_paired_row(cause, paired, evidence))
    return Table(
        name='sure', title='Trials and experiments',
        caption='Shares with exact 95 % intervals (Clopper and Pearson); changes of the '
        "satisfied share on the same scenes with Newcombe's interval, p of McNemar's exact "
        'test after Holm.',
        columns=(
            Column(name='what', title='what'), Column(name='number', title='number'),
            Column(name='of', title='of'), Column(name='value', title='share or change [%]',
                                                  decimals=0),
            Column(name='low', title='from [%]', decimals=0),
            Column(name='high', title='to [%]', decimals=0), Column(name='p', title='p'),
        ), rows=tuple(rows),
    )


def _paired_row(cause: CauseEvidence, paired: Paired, evidence: Evidence) -> tuple[Cell, ...]:
    where = f'cause {cause.rank}' if cause.rank else 'near it' if evidence.single else 'all scenes'
    return (
        f'{where}: satisfied {paired.words} (as recorded: {paired.before})', paired.after,
        paired.scenes, 100 * paired.difference, 100 * paired.low, 100 * paired.high,
        p_words(paired.p).removeprefix('p ').removeprefix('= '),
    )


def _links(out: Path, pages: Mapping[str, str]) -> list[tuple[str, str]]:
    """Words and path of those of the pages that are there."""
    return [(words, path) for path, words in pages.items() if (out / path).is_file()]


def why_json(evidence: Evidence, verdict: Verdict, todo: Sequence[Section]) -> dict[str, Any]:
    """Everything as plain values."""
    return plain({
        'verdict': verdict.fault.value, 'sentences': list(verdict.sentences),
        'subject': evidence.subject, 'network': evidence.network,
        'controller': evidence.controller, 'spec': evidence.spec, 'judged': evidence.judged,
        'failed': evidence.failed, 'without_verdict': dict(evidence.others),
        'rate': evidence.rate, 'searched': evidence.searched,
        'blames': evidence.blames,
        'causes': [
            {**plain(cause), 'confirmed': cause.confirmed} for cause in evidence.causes
        ],
        'shrunk': list(evidence.shrunk), 'unsatisfiable': evidence.unsatisfiable,
        'not_done': dict(evidence.troubles),
        'to_do': [
            {'words': ' '.join(one.sentences), 'commands': list(one.commands)} for one in todo
        ],
        'made_on': dict(provenance()),
    })

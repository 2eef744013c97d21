"""Whose fault failures are, how sure that is, and what to do: pure functions of the evidence.

Evidence comes from the stages of :mod:`.plan`: trials with perfect estimates (the paper's method of
error analysis), causes found in the table, changed pictures of the worst runs, and experiments on
fresh scenes that were not selected by any outcome.
"""

from __future__ import annotations

import enum
import shlex
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from taxinet_ros.analysis.runs.campaign import holm
from taxinet_ros.campaign.rates import Rate, rate
from taxinet_ros.campaign.run_command import RunSettings
from taxinet_ros.core.renderer import OURS
from taxinet_ros.core.world import world_and_camera
from taxinet_ros.registry import KMWH

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
        return (
            f'{self.words}, {change} of {self.scenes} fresh scenes '
            f'are satisfied: {_points(self.difference)} points '
            f'({_points(self.low)} to {_points(self.high)}, p {p_words(self.p)})'
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
        subject: campaign, run or table, as text.
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


@dataclass(frozen=True, kw_only=True, slots=True)
class Verdict:
    """The verdict: what is at fault, and three sentences: whose fault, in what, how sure."""

    fault: Fault
    sentences: tuple[str, str, str]


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
    """The verdict on the evidence."""
    fault = fault_of(evidence)
    # Said first: no other cause need be looked for before.
    outside = f'{evidence.outside}. ' if evidence.outside and evidence.failed else ''
    return Verdict(fault=fault, sentences=(
        f'{outside}{_whose(evidence, fault)}', _where(evidence, fault), _how_sure(evidence, fault),
    ))


def _whose(evidence: Evidence, fault: Fault) -> str:
    blames, spec = evidence.blames or Blames(), evidence.spec
    one = blames.counted == 1
    counted = 'the failed run, driven again' if one else (
        f'all {blames.counted} failed runs driven again')

    def shares(number: int) -> str:
        # One run is no sample: it has no interval that says anything.
        return '' if evidence.single else f' ({_range(blames.share(number))})'

    match fault:
        case Fault.BENCH:
            return (
                f'No run was judged ({_counts(evidence.others)}), so nothing can be said of '
                'network, controller or requirement: the test bench is at fault.'
            )
        case Fault.NOTHING:
            them = 'The one judged run' if evidence.judged == 1 else (
                f'All {evidence.judged:,} judged runs')
            satisfy = 'satisfies' if evidence.judged == 1 else 'satisfy'
            return f'{them} {satisfy} {spec}: nothing failed.'
        case Fault.REQUIREMENT if evidence.unsatisfiable:
            return (
                f'The requirement {spec} is at fault: {evidence.unsatisfiable}. No network and no '
                'controller can satisfy it.'
            )
        case Fault.REQUIREMENT:
            return (
                f'The requirement {spec}, or the start of the scenes, is at fault: {counted}'
                f'{shares(blames.requirement)} {"was" if one else "were"} violated at the first '
                'sample, before anything could be done.'
            )
        case Fault.NETWORK:
            return (
                f'The network {evidence.network} is at fault in the failures examined, not the '
                f'controller: {counted} with perfect estimates{"," if one else ""} '
                f'{"satisfies" if one else "satisfy"} {spec}{shares(blames.network)}.'
            )
        case Fault.CONTROLLER:
            return (
                f'The controller {evidence.controller} is at fault, or what it cannot resist '
                f'(aircraft, wind, faults): {counted} with perfect estimates'
                f'{"," if one else ""} {"violates" if one else "violate"} {spec} too'
                f'{shares(blames.controller)}, so a better network would not help.'
            )
        case Fault.SEVERAL:
            parts = [
                f'{number} {words} ({_range(blames.share(number))})' for number, words in (
                    (blames.network, f'satisfy {spec} then: the network {evidence.network}'),
                    (blames.controller, f'violate it too: the controller {evidence.controller}'),
                    (blames.requirement, 'were violated at their first sample: the requirement or '
                     'the start'),
                ) if number
            ]
            return (
                f'There are several faults. Of {blames.counted} failed runs driven again with '
                'perfect estimates '
                f'{"; ".join(parts)}.'
            )
        case Fault.UNCLEAR:
            return f'Whose fault it is, is unclear: {_why_unclear(evidence)}.'


def _why_unclear(evidence: Evidence) -> str:
    blames = evidence.blames
    if blames is not None and blames.unknown:
        return (
            f'{blames.unknown} of {blames.unknown + blames.counted} failed runs were not '
            'reproduced when driven again, probably as they come from another machine or version'
        )
    return evidence.troubles.get('localize', 'no failed run could be driven again')


def _where(evidence: Evidence, fault: Fault) -> str:
    if fault is Fault.BENCH:
        return 'There is no failure to examine.'
    if fault is Fault.NOTHING:
        return f'{_capital(evidence.rate)}.' if evidence.rate else 'There is nothing to explain.'
    found = [cause for cause in evidence.causes if cause.rank]
    worst = next((cause for cause in evidence.causes if cause.blamed), None)
    explained = '' if worst is None else (
        f'{worst.blamed}, {100 * worst.removed:.0f} % of its error disappears'
    )
    if evidence.single:
        if explained:
            return f'In the pictures of this run: {explained}.'
        if evidence.shrunk:
            return evidence.shrunk[0]
        return 'What in the scene matters could not be found.'
    if not found:
        text = _capital(
            evidence.troubles.get('causes') or 'no cause that the failures share was found')
        return f'{text}; in the worst run, {explained}.' if explained else f'{text}.'
    first = found[0]
    others = len(found) - 1
    more = f'; {others} more {"cause is" if others == 1 else "causes are"} below' if others else ''
    inside = f' ({first.inside})' if first.inside else ''
    text = f'Where runs fail most: {first.words}{inside}{more}'
    where = '' if worst is None or worst.rank == first.rank else f' of cause {worst.rank}'
    return f'{text}; in the worst run{where}, {explained}.' if explained else f'{text}.'


def _how_sure(evidence: Evidence, fault: Fault) -> str:
    if fault is Fault.BENCH:
        return 'A campaign without a verdict says nothing about safety.'
    if fault is Fault.NOTHING:
        return 'That no run failed does not mean that none can.'
    if fault is Fault.REQUIREMENT and evidence.unsatisfiable:
        return 'This follows from the formula and the ranges of its signals, without any run.'
    if fault is Fault.REQUIREMENT:
        return (
            'This needs no experiment: after their first sample, no continuation whatever could '
            'have satisfied the formula.'
        )
    tested = [cause for cause in evidence.causes if cause.without is not None]
    confirmed = [cause for cause in tested if cause.confirmed]
    if confirmed and confirmed[0].without is not None:
        more = '' if len(tested) == 1 else (
            f'; {len(confirmed)} of the {len(tested)} causes tested are confirmed')
        return f'Confirmed by an experiment: {confirmed[0].without.sentence()}{more}.'
    if tested and tested[0].without is not None:
        return f'Not confirmed by an experiment: {tested[0].without.sentence()}.'
    truths = [cause.truth for cause in evidence.causes if cause.truth is not None]
    if truths:
        word = 'Confirmed by an experiment' if truths[0].better else 'In an experiment'
        return f'{word}: {truths[0].sentence()}; what in the scene does it was not tested.'
    why = evidence.troubles.get('confirm')
    return f'No experiment confirms it{f": {why}" if why else ""}.'


@dataclass(frozen=True, kw_only=True, slots=True)
class Action:
    """Something to do: why, and the commands; none if it cannot be said as one."""

    words: str
    commands: tuple[str, ...] = ()


TRAINED, ADDED, FURTHER = 'training_full', 2400, 4000
"""Base program, pictures per cause and pictures along failed runs of the suggested training, as in
``taxinet improve``."""


def actions(
    evidence: Evidence, fault: Fault, *, campaign: Path | None, kept_bags: bool, scale: int = 1,
) -> Iterator[Action]:
    """What to do about it, the most useful first.

    Args:
        evidence: what was found out.
        fault: what is at fault.
        campaign: folder of the campaign; None for a single run or a table.
        kept_bags: whether some failed run has its bag, along whose path pictures can be taken.
        scale: divisor of the suggested numbers of pictures.
    """
    where = str(campaign) if campaign is not None else evidence.subject
    match fault:
        case Fault.BENCH:
            yield Action(
                words='Find what broke: the table names kind and node of every run, and the '
                'folder logs/ has their output. Then run the campaign again.',
                commands=(_line('doctor', where),),
            )
        case Fault.NOTHING:
            if evidence.settings is not None and not evidence.settings.graph_only:
                yield Action(
                    words='Search harder, by a sampler that seeks failures:',
                    commands=(evidence.settings.command(
                        str(evidence.scenes), '--runs', '1000', '--workers', '2', '--engine',
                        'loop', verb='falsify',
                    ),),
                )
        case Fault.REQUIREMENT:
            yield _requirement(evidence)
        case Fault.UNCLEAR:
            for stage, why in evidence.troubles.items():
                yield Action(words=f'{_capital(stage)} was not done: {why}.')
    blames = evidence.blames or Blames()
    if fault is Fault.NETWORK or (fault is Fault.SEVERAL and blames.network):
        yield from _training(evidence, campaign, kept_bags=kept_bags, scale=scale)
    if fault is Fault.CONTROLLER or (fault is Fault.SEVERAL and blames.controller):
        yield from _controller(evidence)
    if fault is Fault.SEVERAL and blames.requirement:
        yield _requirement(evidence)


def _training(
    evidence: Evidence, campaign: Path | None, *, kept_bags: bool, scale: int
) -> Iterator[Action]:
    name = Path(evidence.network).stem if trainable(evidence.network) else 'mended'
    mended = f'{name}-mended.safetensors'
    programs = [cause.program for cause in evidence.causes if cause.program is not None]
    if not programs and evidence.scenes is not None:
        programs = [evidence.scenes]
    world, camera = world_and_camera(evidence.settings.world if evidence.settings else KMWH)
    if world != KMWH:
        yield Action(
            words=f'taxinet train renders pictures of our own world, not of world {world}: take '
            'labelled pictures there, and train with them (taxinet train --data).'
        )
        return
    if camera != OURS or not trainable(evidence.network):
        seen = [] if camera == OURS else ['--camera', camera]
        why = f'taxinet train renders its own pictures, not those of camera {camera}' if seen else (
            f'{evidence.network} is not trained by taxinet train')
        yield Action(
            words=f'{why}. Render labelled pictures of the scenes in which it fails, train it on '
            'them with your own tools, and compare:',
            commands=tuple(
                _line('dataset', str(path), '--count', str(ADDED // scale), *seen, '--out',
                      f'pictures-{path.stem}') for path in programs
            ),
        )
        return
    words = ['train', str(evidence.base or TRAINED), '--start', evidence.network]
    for path in programs:
        words += ['--add', f'{path}={max(ADDED // scale, 1)}']
    if campaign is not None and kept_bags:
        words += ['--add-runs', f'{campaign}={max(FURTHER // scale, 1)}']
    if scale > 1:
        words += ['--images', str(12_000 // scale), '--validation', str(1500 // scale)]
    words += ['--epochs', '8', '--learning-rate', '0.001', '--out', mended]
    kept = '' if kept_bags or campaign is None else (
        ' The bags of the failed runs are gone, so pictures along their paths cannot be added.')
    yield Action(
        words='Train the network further on the scenes in which it fails, mixed with the whole '
        f'world so that nothing is unlearned.{kept}', commands=(_line(*words),),
    )
    if programs and evidence.settings is not None:
        yield Action(
            words='Then see on fresh scenes what got better and what got worse:',
            commands=(evidence.settings.compare_command(
                mended, str(programs[0]), '--seed', str(evidence.seed)),),
        )


def _controller(evidence: Evidence) -> Iterator[Action]:
    bag = next((cause.bag for cause in evidence.causes if cause.bag is not None), None)
    if bag is None:
        yield Action(words=f'Change the controller {evidence.controller} or its gains.')
        return
    commands = [_line('run', '--from', str(bag), '--perception', 'truth')]
    if evidence.controller == 'steering':
        commands.append(_line(
            'fork', str(bag), '--at', '0', '--perception', 'truth', '--sweep',
            'steering.heading_gain=0.4:3:0.2',
        ))
    yield Action(
        words=f'Look at a run with perfect estimates, and change {evidence.controller}, its gains, '
        'or what it has to resist. --add-runs would train a network that is not at fault.',
        commands=tuple(commands),
    )


def _requirement(evidence: Evidence) -> Action:
    text = f'{evidence.spec}={evidence.formula}' if evidence.formula else evidence.spec
    words = 'Change the requirement, or let the scenes start where it holds.'
    commands = [_line('spec', text)]
    inner = evidence.formula.removeprefix('always(')
    if inner != evidence.formula and not evidence.unsatisfiable:
        words += ' To give the aircraft ten seconds to reach its line:'
        commands.append(_line('spec', f'settled=eventually[0:10](always({inner})'))
    return Action(words=words, commands=tuple(commands))


def trainable(network: str) -> bool:
    """Whether ``taxinet train --start`` takes a network: shipped, or weights of its format."""
    return network.endswith('.safetensors') or not any(sign in network for sign in './: ')


def _points(share: float) -> str:
    return f'{100 * share:+.0f}'.replace('-', '−')


def p_words(p: float) -> str:
    """Display text of a p value."""
    return '< 0.001' if p < 0.001 else f'= {p:.3f}'


def _line(*words: str) -> str:
    return shlex.join(['taxinet', *words])


def _range(share: Rate) -> str:
    return f'95 % interval {100 * share.low:.0f}–{100 * share.high:.0f} %'


def _counts(others: Mapping[str, int]) -> str:
    return ', '.join(f'{number} {word}' for word, number in others.items()) or 'none was made'


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]

"""The page of ``taxinet why``: verdict, what to do, causes with their worst runs, how sure."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure, FigureBase
from numpy.typing import NDArray

from taxinet_ros.analysis.report.parts import (
    Cell,
    Column,
    Link,
    Picture,
    Report,
    Section,
    Table,
    Theme,
    style_axes,
)
from taxinet_ros.analysis.report.values import plain_values
from taxinet_ros.bag.errors import BagError
from taxinet_ros.bag.run.recording import Recording, open_recording
from taxinet_ros.campaign.rates import rate
from taxinet_ros.core.camera.camera import Camera
from taxinet_ros.core.control_step import CONTROL_PERIOD_NS
from taxinet_ros.core.mtl.specs import CENTRELINE_TOLERANCE_M
from taxinet_ros.core.provenance import provenance
from taxinet_ros.core.renderer import OURS
from taxinet_ros.core.scenario import Scenario, scenario_from_human
from taxinet_ros.core.types import NS_PER_S
from taxinet_ros.core.world import world_and_camera
from taxinet_ros.errors import InfraError, UsageError
from taxinet_ros.registry import KMWH
from taxinet_ros.study.why.plan import MOST_CAUSES, Change, confirm_name, explain_name
from taxinet_ros.study.why.verdict import (
    Action,
    CauseEvidence,
    Evidence,
    Fault,
    Paired,
    Verdict,
    p_words,
)

JSON_NAME, PAGE_NAME = 'why.json', 'why.html'
_STAGE_PAGES = {
    'analyze/report.html': 'analysis of all runs',
    'localize/localize.html': 'network or controller', 'shrink/shrink.html': 'shrunk run',
}


@dataclass(frozen=True, kw_only=True, eq=False)
class WorstRun:
    """What the picture of a cause's worst run shows.

    Attributes:
        run_id: the run.
        columns: its trace, see :mod:`taxinet_ros.core.trace`.
        half_width_m: half width of its runway [m].
        at_s: moment of the frames [s]: at which the estimate misleads most.
        frames: frames, (H, W, 3) uint8 RGB, by what they show; empty if there are none.
    """

    run_id: str
    columns: Mapping[str, NDArray[Any]]
    half_width_m: float
    at_s: float
    frames: Mapping[str, NDArray[np.uint8]]


def worst_run(cause: CauseEvidence, change: Change | None, folder: Path) -> WorstRun | None:
    """The worst run of a cause from its bag; frames that it lacks are rendered again.

    Args:
        cause: the cause.
        change: of the scene, shown beside the frame; None for none.
        folder: folder of its explanation.
    """
    if cause.bag is None:
        return None
    try:
        recording = open_recording(cause.bag)
        columns = recording.columns
    except (BagError, UsageError):
        return None  # the section says that there is no picture
    seq = _moment(folder)
    return WorstRun(
        run_id=cause.run_id, columns=columns, at_s=seq * CONTROL_PERIOD_NS / NS_PER_S,
        half_width_m=recording.scenario.line.half_width_m,
        frames=_frames(recording, seq, change),
    )


def _moment(folder: Path) -> int:
    """Control step at which the estimate misleads most, 0 if that is unknown."""
    path = folder / 'explain.json'
    if not path.is_file():
        return 0
    moments = json.loads(path.read_text(encoding='utf-8'))['moments']
    return int(max(moments, key=lambda one: abs(one['misled_rad'] or 0.0))['seq'])


def _frames(
    recording: Recording, seq: int, change: Change | None
) -> dict[str, NDArray[np.uint8]]:
    found: dict[str, NDArray[np.uint8]] = {}
    try:
        for now in recording.observations(lambda step: step == seq):
            if now.seq != seq:
                continue
            if now.image is not None:
                found['as recorded'] = now.image
            if change is not None and _ours(recording):
                changed = Camera(_changed(recording.scenario, change))
                found[change.words] = changed.render(now.state, seq * CONTROL_PERIOD_NS)
            break
    except (BagError, UsageError, InfraError):
        for frame in recording.frames(lambda step: step == seq, render=False):
            found['as recorded'] = np.ascontiguousarray(frame.image)
    return found


def _ours(recording: Recording) -> bool:
    return world_and_camera(recording.run.world or KMWH) == (KMWH, OURS)


def _changed(scenario: Scenario, change: Change) -> Scenario:
    return scenario_from_human({**scenario.to_human(), **change.values})


def worst_picture(worst: WorstRun, rank: int) -> Picture:
    """Frames at the worst moment, and the path of the run."""
    frames = ', '.join(worst.frames)
    return Picture(
        name=f'worst-{rank}', title=f'The worst run: {worst.run_id}',
        caption=(f'The camera at {worst.at_s:.1f} s, {frames}. ' if frames else
                 'The frames of this run cannot be rendered again. ')
        + 'Below: true and estimated distance from the line; the band is the tolerance of 1.5 m, '
        'the lines are the edges of the pavement.',
        draw=partial(_draw_worst, worst), size_in=(8.4, 5.4 if frames else 2.9),
    )


def _draw_worst(worst: WorstRun, figure: Figure, theme: Theme) -> None:
    below: FigureBase = figure
    if worst.frames:
        above, below = np.asarray(figure.subfigures(2, 1, height_ratios=(2.5, 2.9)))
        grid = np.atleast_1d(above.subplots(1, len(worst.frames)))
        for axes, (words, image) in zip(grid, worst.frames.items(), strict=True):
            axes.imshow(image)
            axes.set_title(words, fontsize=10)
            axes.set_axis_off()
    axes = below.subplots()
    columns, edge = worst.columns, worst.half_width_m
    time = columns['t_ns'].astype(np.float64) / NS_PER_S
    axes.axhspan(-CENTRELINE_TOLERANCE_M, CENTRELINE_TOLERANCE_M, color=theme.faint, zorder=0)
    for side in (-edge, edge):
        axes.axhline(side, color=theme.ink, linewidth=1.0)
    axes.plot(time, columns['cte_m'], color=theme.failed, linewidth=1.8, label='true')
    axes.plot(time, columns['est_cte_m'], color=theme.passed, linewidth=1.2, linestyle='--',
              label='estimated')
    if worst.at_s > 0:
        axes.axvline(worst.at_s, color=theme.ink, linestyle=':', linewidth=1.0)
    axes.set_ylim(-edge - 4, edge + 4)
    axes.set_xlabel('time [s]')
    axes.set_ylabel('from the line [m],\nleft is up')
    axes.margins(x=0.01)
    axes.legend(loc='upper right', fontsize=8, ncols=2)
    style_axes(axes, grid='none')


def why_report(
    evidence: Evidence, verdict: Verdict, todo: Sequence[Action],
    worst: Mapping[int, WorstRun], out: Path,
) -> Report:
    """The page.

    Args:
        evidence: what was found out.
        verdict: the verdict on it.
        todo: what to do.
        worst: worst runs by rank of their cause.
        out: folder of the page, with the folders of the stages.
    """
    bags = {
        cause.run_id: cause.bag for cause in evidence.causes[:MOST_CAUSES] if cause.bag is not None
    }
    return Report(
        title=f'Why {Path(evidence.subject).name} failed' if evidence.failed else
        f'{Path(evidence.subject).name}: {verdict.fault}',
        facts=_facts(evidence), summary=verdict.sentences,
        sections=(
            *_todo(todo), *_causes(evidence, worst, out), *_sure(evidence, verdict.fault),
            *_others(evidence), *_stages(evidence, out),
        ),
        runs=bags, worst=next(iter(bags), ''),
        worst_words='The run' if evidence.single else 'The worst run of the first cause',
    )


def _facts(evidence: Evidence) -> dict[str, str]:
    formula = f' = {evidence.formula}' if evidence.formula else ''
    facts = {
        'network': evidence.network, 'controller': evidence.controller,
        'requirement': f'{evidence.spec}{formula}',
        'failed': f'{evidence.failed:,} of {evidence.judged:,} judged',
        'rate': '' if evidence.single else evidence.rate,
        'scenes chosen by': evidence.searched,
    }
    return {name: text for name, text in facts.items() if text}


def _todo(todo: Sequence[Action]) -> Iterator[Section]:
    for number, action in enumerate(todo):
        yield Section(
            name=f'todo-{number + 1}', heading='What to do' if not number else 'And then',
            sentences=(action.words,), commands=action.commands,
        )


def _causes(
    evidence: Evidence, worst: Mapping[int, WorstRun], out: Path
) -> Iterator[Section]:
    for cause in evidence.causes[:MOST_CAUSES]:
        pages = {
            f'{explain_name(cause.rank)}/explain.html': 'explanation of this run',
            f'{confirm_name(cause.rank)}/experiment.html': 'the experiment',
        }
        heading = f'Cause {cause.rank}: {cause.words}' if cause.rank else (
            'The run' if evidence.single else 'The failures')
        yield Section(
            name=f'cause-{cause.rank}', heading=heading,
            sentences=tuple(_cause_sentences(cause, evidence)), links=_links(pages, out),
            pictures=() if cause.rank not in worst else (
                worst_picture(worst[cause.rank], cause.rank),),
        )
    more = evidence.causes[MOST_CAUSES:]
    if more:
        yield Section(
            name='more', heading='More causes',
            sentences=tuple(f'{cause.rank}: {cause.words} ({cause.inside}).' for cause in more),
        )


def _cause_sentences(cause: CauseEvidence, evidence: Evidence) -> Iterator[str]:
    if cause.inside:
        yield f'Fail: {cause.inside}.'
    if cause.run_id and not evidence.single:
        yield f'The worst run is {cause.run_id}.' + (
            '' if cause.bag else ' Its bag is gone, so there is no picture of it.')
    if cause.explained:
        yield cause.explained
    if cause.rank in (0, 1):
        yield from evidence.shrunk
    if cause.fresh is not None and cause.fresh[1]:
        failed, scenes = cause.fresh
        share = rate(failed, scenes)
        yield (
            f'On {scenes} fresh scenes of it {failed} fail: {100 * share.rate:.0f} % '
            f'({100 * share.low:.0f}–{100 * share.high:.0f} %). No outcome selected these scenes.'
        )
    for paired in (cause.without, cause.truth):
        if paired is not None:
            text = paired.sentence()
            yield f'{text[:1].upper()}{text[1:]}.'


def _sure(evidence: Evidence, fault: Fault) -> Iterator[Section]:
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
    if not rows:
        return
    notes = []
    if evidence.blames is not None and evidence.blames.unknown:
        notes.append(
            f'{evidence.blames.unknown} failed runs were not reproduced or judged when driven '
            'again, and are not counted.'
        )
    if evidence.searched:
        notes.append(
            f'The sampler {evidence.searched} chose scenes by earlier outcomes, so shares of the '
            'failed runs are those of the ones it found, not of the program. The experiments ran '
            'on fresh scenes drawn by the program.'
        )
    yield Section(
        name='sure', heading='How sure', sentences=tuple(notes),
        tables=(Table(
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
        ),),
    )


def _paired_row(cause: CauseEvidence, paired: Paired, evidence: Evidence) -> tuple[Cell, ...]:
    where = f'cause {cause.rank}' if cause.rank else 'near it' if evidence.single else 'all scenes'
    return (
        f'{where}: satisfied {paired.words}, before {paired.before}', paired.after, paired.scenes,
        100 * paired.difference, 100 * paired.low, 100 * paired.high,
        p_words(paired.p).removeprefix('= '),
    )


def _others(evidence: Evidence) -> Iterator[Section]:
    if not evidence.others:
        return
    yield Section(
        name='others', heading='Runs without a verdict',
        sentences=('They are in no rate and in no cause.',),
        tables=(Table(
            name='others', title='Runs without a verdict', caption='',
            columns=(Column(name='outcome', title='outcome'), Column(name='runs', title='runs')),
            rows=tuple(evidence.others.items()),
        ),),
    )


def _stages(evidence: Evidence, out: Path) -> Iterator[Section]:
    sentences = tuple(
        f'{stage} was not done: {why}.' for stage, why in evidence.troubles.items()
    )
    pages = _links(_STAGE_PAGES, out)
    if sentences or pages:
        yield Section(
            name='stages', heading='All evidence', sentences=sentences, links=pages,
        )


def _links(pages: Mapping[str, str], out: Path) -> tuple[Link, ...]:
    return tuple(
        Link(words=words, path=path) for path, words in pages.items() if (out / path).is_file()
    )


def why_json(evidence: Evidence, verdict: Verdict, todo: Sequence[Action]) -> dict[str, Any]:
    """Everything as plain values."""
    return plain_values({
        'verdict': verdict.fault.value, 'sentences': list(verdict.sentences),
        'subject': evidence.subject, 'network': evidence.network,
        'controller': evidence.controller, 'spec': evidence.spec, 'judged': evidence.judged,
        'failed': evidence.failed, 'without_verdict': dict(evidence.others),
        'rate': evidence.rate, 'searched': evidence.searched,
        'blames': None if evidence.blames is None else asdict(evidence.blames),
        'causes': [_cause_json(cause) for cause in evidence.causes],
        'shrunk': list(evidence.shrunk), 'unsatisfiable': evidence.unsatisfiable,
        'not_done': dict(evidence.troubles),
        'to_do': [{'words': one.words, 'commands': list(one.commands)} for one in todo],
        'made_on': dict(provenance()),
    })


def _cause_json(cause: CauseEvidence) -> dict[str, Any]:
    values = asdict(cause)
    for name in ('bag', 'program'):
        values[name] = None if values[name] is None else str(values[name])
    return {**values, 'confirmed': cause.confirmed}

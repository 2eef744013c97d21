"""The page of an investigation: verdict, what to do, causes, how sure."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from taxinet_ros.analysis.report.parts import Cell, Column, Link, Report, Section, Table
from taxinet_ros.analysis.report.values import plain_values
from taxinet_ros.core.provenance import provenance
from taxinet_ros.study.why.plan import MOST_CAUSES, confirm_name, explain_name
from taxinet_ros.study.why.verdict import (
    Action,
    CauseEvidence,
    Evidence,
    Paired,
    Verdict,
    p_words,
)
from taxinet_ros.trials.rates import rate

JSON_NAME, PAGE_NAME = 'why.json', 'why.html'
_STAGE_PAGES = {
    'analyze/report.html': 'analysis of all runs',
    'localize/localize.html': 'network or controller', 'shrink/shrink.html': 'shrunk run',
}


def why_report(
    evidence: Evidence, verdict: Verdict, todo: Sequence[Action], out: Path
) -> Report:
    """The page.

    Args:
        evidence: what was found out.
        verdict: the verdict on it.
        todo: what to do.
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
            *_todo(todo), *_causes(evidence, out), *_sure(evidence),
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


def _causes(evidence: Evidence, out: Path) -> Iterator[Section]:
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
            '' if cause.bag else ' Its bag is gone, so it is not shown.')
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


def _sure(evidence: Evidence) -> Iterator[Section]:
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

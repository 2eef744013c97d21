"""The page of an investigation: verdict, what to do, causes, how sure."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from taxinet_ros.analysis.report.parts import Cell, Column, Report, Section, Table
from taxinet_ros.analysis.report.text import fill_report, p_words
from taxinet_ros.core.provenance import provenance
from taxinet_ros.files.plain_values import plain
from taxinet_ros.study.why.plan import MOST_CAUSES, confirm_name, explain_name
from taxinet_ros.study.why.verdict import (
    CauseEvidence,
    Evidence,
    Paired,
    Verdict,
)
from taxinet_ros.trials.rates import rate

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
        {'sure': (tested,), 'others': (_others(evidence),)},
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
        f'{where}: satisfied {paired.words}, before {paired.before}', paired.after, paired.scenes,
        100 * paired.difference, 100 * paired.low, 100 * paired.high,
        p_words(paired.p).removeprefix('p ').removeprefix('= '),
    )


def _others(evidence: Evidence) -> Table:
    return Table(
        name='others', title='Runs without a verdict', caption='',
        columns=(Column(name='outcome', title='outcome'), Column(name='runs', title='runs')),
        rows=tuple(evidence.others.items()),
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

"""Report on a run's network failure as HTML and JSON."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from shlex import quote
from typing import Any

from taxinet_ros.analysis.explain.counterfactual import LEAST_SHARE
from taxinet_ros.analysis.explain.explain import (
    Explanation,
    effect_words,
    error_words,
    moment_words,
)
from taxinet_ros.analysis.explain.pictures import (
    clause_picture,
    error_picture,
    factor_picture,
    scene_picture,
)
from taxinet_ros.analysis.explain.track import Moment
from taxinet_ros.analysis.one_run.judged import clauses_json
from taxinet_ros.analysis.report.page import write_report
from taxinet_ros.analysis.report.parts import Cell, Column, Picture, Report, Table
from taxinet_ros.analysis.report.text import environment, fill_report
from taxinet_ros.core.mtl.specs import CENTRELINE_TOLERANCE_M
from taxinet_ros.core.provenance import provenance
from taxinet_ros.core.scenario_fields import along_words, clock_words
from taxinet_ros.core.types import TrackingError
from taxinet_ros.core.world import world_and_camera
from taxinet_ros.files.atomic import write_atomically
from taxinet_ros.files.plain_values import json_text, plain
from taxinet_ros.registry import KMWH

JSON_NAME, PAGE_NAME = 'explain.json', 'explain.html'
TEXT = Path(__file__).with_name('page.j2')
environment(TEXT.parent).filters.update(
    error=error_words, effect=effect_words, moment=moment_words, along=along_words,
    clock=clock_words, degrees=math.degrees,
)
_HARDLY_RAD = math.radians(2.0)
"""Equivalent of half a metre of cross-track error in the steering law."""
_ESTIMATE = (
    Column(name='estimated_cte_m', title='sees CTE [m]', decimals=2),
    Column(name='estimated_he_deg', title='sees HE [°]', decimals=1),
    Column(name='cte_error_m', title='CTE error [m]', decimals=2),
    Column(name='he_error_deg', title='HE error [°]', decimals=1),
    Column(name='misled_deg', title='misled [°]', decimals=1),
)


def explain_report(found: Explanation) -> Report:
    """Report on an explanation."""
    run_id = found.run.request.run_id
    worst = found.moments[found.worst]
    return fill_report(
        TEXT, {
            'f': found, 'w': worst, 'hardly_rad': _HARDLY_RAD, 'least': LEAST_SHARE,
            'misled_deg': math.degrees(abs(worst.misled_rad)), 'outcome': found.outcome,
            'scene': found.run.request.scenario.to_human(),
            'camera': world_and_camera(found.run.world or KMWH)[1],
            'chosen': found.examined.chosen if found.examined else '',
            'also': found.examined.also(f'taxinet explain {quote(str(found.bag))}')
            if found.examined else '',
            'tolerance_m': CENTRELINE_TOLERANCE_M,
        },
        _figures(found), runs={run_id: found.bag}, worst=run_id, worst_words='The run',
    )


def _figures(found: Explanation) -> dict[str, Sequence[Picture | Table]]:
    figures: dict[str, Sequence[Picture | Table]] = {
        'errors': (error_picture(found), _moment_table(found)),
    }
    if found.clauses is not None:
        figures['requirement'] = (clause_picture(found.clauses),)
    scenes = tuple(scene_picture(found, number) for number in range(len(found.moments)))
    figures['scenes'] = (
        (factor_picture(found), *scenes, _factor_table(found)) if found.effects else scenes
    )
    return figures


def write_explanation(found: Explanation, out: Path) -> tuple[Path, dict[str, Any]]:
    """Write images, JSON and page; return the page's path and the values of the JSON."""
    values = explain_json(found)
    write_atomically(out / JSON_NAME, json_text(values) + '\n')
    write_report(explain_report(found), out / PAGE_NAME)
    return out / PAGE_NAME, values


def explain_json(found: Explanation) -> dict[str, Any]:
    """The findings as plain values, without NaN."""
    cte_m, he_rad = found.track.greatest_change
    blamed = found.blamed
    return plain({
        'run_id': found.run.request.run_id, 'perception': found.perception,
        'fingerprint': found.fingerprint, 'recorded_perception': found.run.perception,
        'made_on': dict(provenance()),
        'recomputed': {
            'cte_m': cte_m, 'he_rad': he_rad, 'equal': cte_m == he_rad == 0,
        },
        'steps_on_runway': found.track.steps_on_runway,
        'blamed': None if blamed is None else blamed.factor.name,
        'taken_again': None if found.again is None else {
            'removed': found.again.removed,
            'pictures_changed': [outcome.changed for outcome in found.again.outcomes],
        },
        'not_changed': list(found.hidden),
        'factors': [
            {'name': effect.factor.name, 'words': effect.factor.words,
             'removed': effect.removed, 'picture_changed': effect.changed}
            for effect in found.effects
        ],
        'reruns': [
            {'name': rerun.name, 'words': rerun.words, 'outcome': rerun.outcome,
             'rho': None if rerun.robustness is None else rerun.robustness.lower}
            for rerun in found.reruns
        ],
        **clauses_json(found.clauses),
        'moments': [_moment_json(found, number) for number in range(len(found.moments))],
        'sentences': list(explain_report(found).summary),
    })


def _moment_table(found: Explanation) -> Table:
    return Table(
        name='explain-moments', title='The moments', caption='Left positive.',
        columns=(
            Column(name='t_s', title='time [s]', decimals=1),
            Column(name='x_m', title='along the track [m]', decimals=0),
            Column(name='cte_m', title='true CTE [m]', decimals=2),
            Column(name='he_deg', title='true HE [°]', decimals=1), *_ESTIMATE,
        ),
        rows=tuple(
            (m.t_s, m.x_m, m.truth.cte_m, math.degrees(m.truth.he_rad),
             *_cells(m, m.estimate, m.misled_rad))
            for m in found.moments
        ),
    )


def _factor_table(found: Explanation) -> Table:
    rows: list[tuple[Cell, ...]] = []
    for number, m in enumerate(found.moments):
        rows.append((m.t_s, 'as recorded', *_cells(m, m.estimate, m.misled_rad), None, None))
        for effect in found.effects:
            outcome = effect.outcomes[number]
            rows.append((
                m.t_s, effect.factor.words, *_cells(m, outcome.estimate, outcome.misled_rad),
                math.degrees(abs(outcome.misled_rad) - abs(m.misled_rad)), 100 * outcome.changed,
            ))
    return Table(
        name='explain-factors', title='What the network sees in other scenes',
        caption='Errors are estimate less truth; misled is what they do to the heading that the '
                'steering law asks for.',
        columns=(
            Column(name='t_s', title='time [s]', decimals=1),
            Column(name='scene', title='scene'), *_ESTIMATE,
            Column(name='change_of_error_deg', title='change of |misled| [°]', decimals=1),
            Column(name='picture_changed_percent', title='picture changed [%]', decimals=1),
        ),
        rows=tuple(rows),
    )


def _cells(moment: Moment, estimate: TrackingError, misled_rad: float) -> tuple[Cell, ...]:
    if not estimate.usable:
        return (None,) * len(_ESTIMATE)
    truth = moment.truth
    return (
        estimate.cte_m, math.degrees(estimate.he_rad), estimate.cte_m - truth.cte_m,
        math.degrees(estimate.he_rad - truth.he_rad), math.degrees(misled_rad),
    )


def _moment_json(found: Explanation, number: int) -> dict[str, Any]:
    m = found.moments[number]
    return {
        't_s': m.t_s, 'seq': m.seq, 'x_m': m.x_m, 'truth': _error_json(m.truth),
        'estimate': _error_json(m.estimate), 'misled_rad': m.misled_rad,
        'scenes': {
            effect.factor.name: {
                'estimate': _error_json(effect.outcomes[number].estimate),
                'misled_rad': effect.outcomes[number].misled_rad,
                'picture_changed': effect.outcomes[number].changed,
            } for effect in found.effects
        },
    }


def _error_json(error: TrackingError) -> dict[str, float] | None:
    return {'cte_m': error.cte_m, 'he_rad': error.he_rad} if error.usable else None

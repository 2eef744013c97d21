"""The findings of a score as a page, a table of frames and JSON."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import astuple
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from taxinet_ros.analysis.report.page import write_report
from taxinet_ros.analysis.report.parts import (
    Cell,
    Column,
    Picture,
    Report,
    Table,
    Theme,
    style_axes,
)
from taxinet_ros.analysis.report.text import fill_report
from taxinet_ros.core.mtl.interval import rho_text
from taxinet_ros.core.provenance import provenance
from taxinet_ros.core.scenario_fields import CATALOGUES
from taxinet_ros.files.atomic import make_folder, write_atomically, write_parquet
from taxinet_ros.files.plain_values import json_text, plain
from taxinet_ros.recordings.estimates import names_topic
from taxinet_ros.recordings.frames import ENDS
from taxinet_ros.recordings.score import (
    NOTABLE_LATENCY_S,
    QUANTITIES,
    Score,
    Slice,
    relative_errors,
    row_pictures,
)
from taxinet_ros.recordings.score import Picture as Pixels

FRAMES_NAME, JSON_NAME, PAGE_NAME = 'frames.parquet', 'score.json', 'score.html'
TEXT = Path(__file__).with_name('page.j2')
_COLUMNS = 4


def score_report(found: Score) -> Report:
    """Report on a score."""
    networks, at = [shown_name(word) for word in found.networks], found.table.to_dict('index')
    pairs = [(pair[number], f'{at[row][f"{which}est_cte_m"]:+.1f} m')
             for number, which in enumerate(('', 'rendered_')) for row, pair in found.pairs.items()]
    figures: dict[str, Sequence[Picture | Table]] = {
        'errors': (slice_table(found.slices, networks, 'score-errors'),),
        'path': tuple(_path_picture(found, quantity) for quantity in QUANTITIES),
        'worst': tuple(_worst_frames(found)),
        'rendered': (
            _grid('score-rendered', 'Recorded (above) and rendered (below)', 'The same poses; '
                  'above each the estimated cross-track error.', pairs, len(found.pairs)),
            slice_table(found.gap, ('recorded', 'rendered'), 'score-gap')) if found.gap else (),
        'requirements': (_verdict_table(found),),
    }
    errors = [
        found.table.loc[found.scored, [f'{column}{end}' for _, _, column in QUANTITIES.values()]]
        for end in ENDS[:len(networks)]
    ]
    return fill_report(TEXT, {
        's': found, 'e': found.slices[0].errors, 'networks': networks,
        'comparison': found.slices[0].better, 'notable': NOTABLE_LATENCY_S,
        'means': [one.mean().tolist() for one in errors],
        'spreads': [one.std(ddof=0).tolist() for one in errors],
        'names': {name: words for name, (words, _, _) in QUANTITIES.items()},
        'judged': judged_words(found), 'worst': any(found.worst),
    }, figures)


def shown_name(word: str) -> str:
    """A topic or name; of a file its name, as where that lies says nothing on other machines."""
    path = Path(word)
    return path.name if path.is_absolute() and not names_topic(word) else word


def judged_words(found: Score) -> dict[str, str]:
    """By requirement: how many stretches satisfy it, and the least robustness."""
    words = {}
    for spec in dict.fromkeys(one.spec for one in found.verdicts):
        own = [one for one in found.verdicts if one.spec == spec]
        counts = Counter(one.verdict for one in own)
        text = ', '.join(f'{count} {verdict}' for verdict, count in counts.items())
        decided = [one.lower for one in own if one.verdict != 'UNCLEAR']
        least = f', least rho {rho_text(min(decided))}' if decided else ''
        words[spec] = (f'{text} of {len(own)} stretch{"es" if len(own) > 1 else ""}{least}: '
                       f'{own[0].words}')
    return words


def score_json(found: Score, report: Report) -> dict[str, Any]:
    """The findings as plain values, without NaN."""
    first = found.slices[0].errors
    return plain({
        'frames': first['cte'][0].frames, 'cte_mae_m': first['cte'][0].value,
        'heading_mae_deg': first['heading'][0].value,
        'counts': found.counts, 'frames_alike': found.alike,
        'networks': found.networks, 'place': found.setup.place.reference,
        'track': found.setup.track.name, 'image': found.setup.image,
        'truth': found.setup.source.topic, 'heading': found.setup.source.heading,
        'bags': [str(one.recording.path) for one in found.bags],
        'latency': found.latency, 'latency_applied_s': found.applied_s, 'slices': found.slices,
        'start': None if found.start is None else {
            **found.start.to_human(),
            # Whole documents, as no record beside it resolves references.
            **{key: getattr(found.start, key) for key in CATALOGUES},
        },
        'verdicts': found.verdicts, 'alarms': found.alarms, 'mirrored': dict(found.mirrored),
        'notes': found.notes, 'made_on': dict(provenance()), 'sentences': list(report.summary),
    })


def write_score(found: Score, out: Path) -> tuple[Report, dict[str, Any]]:
    """Write the table of frames, JSON and page; return the report and the values of the JSON.

    Raises:
        OSError: a file cannot be written.
    """
    make_folder(out)
    write_parquet(out / FRAMES_NAME, found.table)
    report = score_report(found)
    values = score_json(found, report)
    write_atomically(out / JSON_NAME, json_text(values) + '\n')
    write_report(report, out / PAGE_NAME)
    return report, values


def slice_table(slices: Sequence[Slice], names: Sequence[str], name: str) -> Table:
    """Table of errors by what the frames show.

    Args:
        slices: the errors.
        names: of the networks, or of whatever is compared.
        name: of the table.
    """
    columns = [Column(name='by', title='by'), Column(name='part', title='part'),
               Column(name='frames', title='frames')]
    for number, word in enumerate(names, start=1):
        for quantity, (words, unit, _) in QUANTITIES.items():
            title = f'{words} [{unit}], {word}'
            columns += [
                Column(name=f'{quantity}_mae_{unit}_{number}', title=title, decimals=2),
                Column(name=f'{quantity}_low_{number}', title='from', decimals=2),
                Column(name=f'{quantity}_high_{number}', title='to', decimals=2),
            ]
    rows: list[tuple[Cell, ...]] = []
    for one in slices:
        means = [means[number] for number in range(len(names)) for means in one.errors.values()]
        numbers = [number for mean in means for number in mean[:3]]
        rows.append((one.kind, one.name, means[0].frames, *numbers))
    return Table(
        name=name, title='Mean absolute errors', columns=tuple(columns), rows=tuple(rows),
        caption='Without interval: fewer than five independent blocks.')


def _verdict_table(found: Score) -> Table:
    return Table(
        name='score-requirements', title='Requirements', caption='Each uninterrupted stretch is '
        'judged from its beginning to its end.', columns=(
            Column(name='bag', title='bag'), Column(name='start_s', title='from [s]', decimals=1),
            Column(name='duration_s', title='for [s]', decimals=1),
            Column(name='requirement', title='requirement'),
            Column(name='verdict', title='verdict'),
            Column(name='rho', title='rho, at least', decimals=2),
        ), rows=tuple((Path(one.bag).name, *astuple(one)[1:6]) for one in found.verdicts))


def _worst_frames(found: Score) -> Iterator[Picture | Table]:
    """Pictures and table of the worst frames of each network."""
    pictures = dict(row_pictures(found, sorted({row for rows in found.worst for row in rows})))
    for word, end, rows in zip(found.networks, ENDS, found.worst, strict=False):
        title = f'Worst frames of {shown_name(word)}'
        worst_in = relative_errors(found.table, end).loc[list(rows)].idxmax(axis=1)
        captions = [(pictures[row], _worst_words(found, row, end, str(worst_in[row])))
                    for row in rows if row in pictures]
        if captions:
            yield _grid(
                f'score-frames{end}', title, 'Above each: time, and what is furthest off for this '
                'network, true and estimated.', captions, _COLUMNS)
        names = ('t_s', 'distance_m', 'cte_m', f'est_cte_m{end}', 'heading_error_deg',
                 f'est_heading_error_deg{end}', 'brightness')
        yield Table(
            name=f'score-worst{end}', title=title, caption='Left positive.',
            columns=(Column(name='bag', title='bag'), *(
                Column(name=name, title=name.removesuffix(end).replace('_', ' '), decimals=2)
                for name in names)),
            rows=tuple((Path(bag).name, *numbers) for bag, *numbers in found.table.loc[
                list(rows), ['bag', *names]].itertuples(index=False)))


def _worst_words(found: Score, row: int, end: str, quantity: str) -> str:
    """Time, and the quantity that made a frame one of the worst, true and estimated."""
    words, unit, _ = QUANTITIES[quantity]
    name = {'cte': 'cte_m', 'heading': 'heading_error_deg'}[quantity]
    at: Any = found.table.loc[row]
    return f'{at["t_s"]:.1f} s: {words} {at[name]:+.1f}, {at[f"est_{name}{end}"]:+.1f} {unit}'


def _path_picture(found: Score, quantity: str) -> Picture:
    words, unit, _ = QUANTITIES[quantity]
    return Picture(
        name=f'score-{quantity}', title=f'{words[:1].upper()}{words[1:]} error of the aircraft, '
        'and as estimated', draw=partial(_draw_path, found, quantity),
        caption=f'In {unit}, left positive, by time; only frames that are compared.')


def _draw_path(found: Score, quantity: str, figure: Figure, theme: Theme) -> None:
    axes = figure.subplots()
    kept = found.table[found.scored]
    name = 'cte_m' if quantity == 'cte' else 'heading_error_deg'
    starts = np.concatenate([[0.0], np.cumsum([
        float(part['t_s'].max()) + 1 for _, part in found.table.groupby('bag', sort=False)])])
    begun = dict(zip(dict.fromkeys(found.table['bag']), starts, strict=False))
    t_s = kept['t_s'] + kept['bag'].map(begun)
    axes.plot(t_s, kept[name], color=theme.ink, linewidth=1.6, label='truth')
    for number, word in enumerate(found.networks):
        axes.plot(t_s, kept[f'est_{name}{ENDS[number]}'], '.', markersize=2.5,
                  label=shown_name(word), color=(theme.failed, theme.passed)[number])
    axes.set_xlabel('time [s]')
    axes.set_ylabel(f'{QUANTITIES[quantity][0]} error [{QUANTITIES[quantity][1]}]')
    style_axes(axes)
    figure.legend(loc='outside upper center', ncols=3, frameon=False, fontsize=9)


def _grid(
    name: str, title: str, caption: str, pictures: Sequence[tuple[Pixels, str]], columns: int
) -> Picture:
    """Pictures, each below its words."""
    rows = math.ceil(len(pictures) / columns)
    return Picture(name=name, title=title, caption=caption, size_in=(9.0, 1.5 * rows),
                   draw=partial(_draw_grid, pictures, rows, columns))


def _draw_grid(
    pictures: Sequence[tuple[Pixels, str]], rows: int, columns: int, figure: Figure, theme: Theme
) -> None:
    grid = figure.subplots(rows, columns, squeeze=False)
    for axes in grid.flat:
        axes.set_axis_off()
    for axes, (pixels, words) in zip(grid.flat, pictures, strict=False):
        axes.imshow(pixels)
        axes.set_title(words, fontsize=8, color=theme.ink)

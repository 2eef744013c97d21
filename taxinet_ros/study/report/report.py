"""Report of a case study, side by side with the paper: page, tables, pictures and JSON."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Hashable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd

from taxinet_ros.analysis.experiment.arms import paired_arms
from taxinet_ros.analysis.experiment.report import arms_picture
from taxinet_ros.analysis.report.parts import Column, Picture, Report, Table
from taxinet_ros.analysis.report.text import fill_report
from taxinet_ros.core.provenance import provenance
from taxinet_ros.errors import UsageError
from taxinet_ros.files.atomic import write_atomically, write_parquet
from taxinet_ros.files.plain_values import plain
from taxinet_ros.study.report.claim import Claim, Verdict, p_words
from taxinet_ros.study.report.paper import PAPER_RUNS, judge_claims
from taxinet_ros.study.report.results import Results, read_results, read_tables
from taxinet_ros.study.report.tables import (
    LEARNED_COLUMNS,
    MORE_COLUMNS,
    NETWORK_COLUMNS,
    PAIR_COLUMNS,
    binned_columns,
    day_pictures,
    distances_frame,
    hours_frame,
    learned_frame,
    learned_picture,
    networks_frame,
    pairs_frame,
    rates_picture,
    runway_pictures,
    stages_frame,
    table_of,
)
from taxinet_ros.study.stages.config import StudyConfig, read_config, shipped_config
from taxinet_ros.study.stages.plan import COMMAND, PAPER_RULE, REPORT, read_study, stages
from taxinet_ros.study.stages.run import clock, read_stages, rough_duration
from taxinet_ros.trials.experiment import arm_rows, find_experiment, read_experiment
from taxinet_ros.trials.options import DEFAULT_ROOT, check_new, new_folder
from taxinet_ros.version import __version__

TEXT = Path(__file__).with_name('page.j2')
PAGE_NAME, JSON_NAME = 'case_study.html', 'case_study.json'
SCHEMA, VERSION = 'taxinet-case-study', 1


_LEAST_P = 0.0001


@dataclass(frozen=True, kw_only=True)
class StudyFindings:
    """Contents of a report.

    Attributes:
        config, out: configuration and folder of the study.
        results: results of its stages.
        claims: the paper's statements with verdicts.
        networks, hours, distances, pairs, learned: tables of :mod:`.tables`.
        stages: table of :func:`.tables.stages_frame`; empty if there are only tables.
    """

    config: StudyConfig
    out: Path
    results: Results
    claims: tuple[Claim, ...]
    networks: pd.DataFrame
    hours: pd.DataFrame
    distances: pd.DataFrame
    pairs: pd.DataFrame
    learned: pd.DataFrame
    stages: pd.DataFrame

    def frames(self) -> dict[str, pd.DataFrame]:
        """The tables by file name."""
        return {
            'networks': self.networks, 'rho_by_hour': self.hours,
            'rho_by_distance': self.distances, 'pairs': self.pairs, 'learned': self.learned,
            'stages': self.stages,
        }


def report_case_study(
    out: Path | None, *, config: Path | None = None, tables: Path | None = None
) -> list[str]:
    """Write the report of the stages done in a folder, or of tables into a new one.

    Args:
        out: folder of the study.
        config: configuration of the tables' study; None for the shipped one.
        tables: folder of the tables, or None.

    Returns:
        Lines to print, as of :func:`write_study_report`.

    Raises:
        UsageError: bad input.
    """
    if tables is not None:
        out = out or new_folder(DEFAULT_ROOT / COMMAND)
        check_new(out)
        return write_study_report(read_config(config or shipped_config()), out, tables)
    if out is None:
        raise UsageError('report_only: name the case study as out')
    return write_study_report(read_study(out, 'report_only'), out)


def write_study_report(
    config: StudyConfig, out: Path, tables: Path | None = None
) -> list[str]:
    """Write the report of the stages done so far, replacing an earlier one.

    Args:
        config: configuration of the study.
        out: folder of the study.
        tables: folder of tables to report instead of the contents of ``out``, or None.

    Returns:
        Lines to print: the summary, with ``tables`` every claim, and the path of the report.

    Raises:
        UsageError: no network has been evaluated, or a file of the study is damaged.
        OSError: a file cannot be written.
    """
    from taxinet_ros.analysis.report.page import write_report

    found = gather_findings(config, out, tables)
    folder = out / REPORT
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UsageError(f'{folder}: cannot be made: {error.strerror}') from error
    for name, frame in found.frames().items():
        write_parquet(folder / f'{name}.parquet', frame)
    report = study_report(found)
    write_report(report, folder / PAGE_NAME)
    text = json.dumps(study_values(found), indent=2, allow_nan=False, ensure_ascii=False)
    write_atomically(folder / JSON_NAME, text + '\n')
    claims = [f'{claim.name}: {claim.sentence()}' for claim in found.claims] if tables else []
    return [*report.summary, *claims, f'report: {folder / PAGE_NAME}']


def gather_findings(config: StudyConfig, out: Path, tables: Path | None = None) -> StudyFindings:
    """Collect the contents of the report; without stages if only tables are given.

    Raises:
        UsageError: no network has been evaluated, or a file of the study is damaged.
    """
    results = read_results(config, out) if tables is None else read_tables(config, tables)
    if not results.networks:
        raise UsageError(f'{out}: no network was evaluated yet, so there is nothing to report')
    found = [stage for stage in stages(config) if stage.name != REPORT and tables is None]
    if tables is not None:  # the planned number is the actual one, so no run is pending
        runs = min(len(network.table) + network.unjudged for network in results.networks.values())
        config = dataclasses.replace(config, runs=runs)
    return StudyFindings(
        config=config, out=out, results=results, claims=judge_claims(results),
        networks=networks_frame(results), hours=hours_frame(results),
        distances=distances_frame(results), pairs=pairs_frame(results),
        learned=learned_frame(results), stages=stages_frame(found, read_stages(out)),
    )


def study_report(found: StudyFindings) -> Report:
    """Report on the findings."""
    config, frame, networks = found.config, found.stages, found.results.networks.values()
    done = frame[frame['done']] if len(frame) else frame
    dates = sorted(date[:10] for date in done.get('date', ()) if date)
    asked = [(one.name, len(one.table) + one.unjudged) for one in networks]
    cores = done['cores'].dropna().unique() if len(done) else ()
    return fill_report(
        TEXT, {
            'f': found, 'c': config, 'lines': found.networks.to_dict('records'),
            'versions': sorted({str(one) for one in done.get('version', ()) if one}),
            'dates': list(dict.fromkeys(dates[:1] + dates[-1:])),
            'todo': frame[~frame['done']]['stage'].tolist() if len(frame) else [],
            'least': found.networks['runs'].min(), 'most': found.networks['runs'].max(),
            'paper_runs': PAPER_RUNS, 'paper_rule': PAPER_RULE, 'done': len(done),
            'verdicts': {
                verdict: sum(claim.verdict is verdict for claim in found.claims)
                for verdict in Verdict
            },
            'at_least': len(done) and done['at_least'].any(),
            'took': rough_duration(done['wall_s'].sum()) if len(done) else '',
            'cores': sorted(int(number) for number in cores),
            'under_way': {name: runs for name, runs in asked if runs < config.runs},
        },
        {
            'networks': (
                rates_picture(found.networks),
                table_of(
                    found.networks, 'networks_rates', 'How often they satisfy and leave the runway',
                    'Of all judged runs, with 95 % Clopper-Pearson intervals.', NETWORK_COLUMNS),
                table_of(
                    found.networks, 'networks_more', 'More on them',
                    'Medians over the runs; errors on the pictures held back, of the model cards, '
                    'each in its own world. Settled: within 1.5 m to the end.', MORE_COLUMNS),
            ),
            'claims': (_claims_table(found),),
            'day': (
                *day_pictures(found.results, found.hours),
                table_of(found.hours, 'hours', 'By the hour', 'Every network, every hour.',
                         binned_columns('h', 0)),
            ),
            'runway': (
                *runway_pictures(found.results, found.distances),
                table_of(found.distances, 'distances', 'By 100 m of runway',
                         'By where runs start; in 30 s they come some 150 m further.',
                         binned_columns('m', 0)),
            ),
            'debugging': tuple(_experiments(found)),
            'learned': () if found.learned.empty else (
                learned_picture(found.learned),
                table_of(found.learned, 'learned', 'Where on the runway', 'Shares in percent.',
                         LEARNED_COLUMNS),
            ),
            'pairs': (_pairs_table(found),), 'stages': _stage_tables(found),
        },
    )


def _claims_table(found: StudyFindings) -> Table:
    order = list(Verdict)
    claims = sorted(found.claims, key=lambda claim: order.index(claim.verdict))
    return Table(
        name='claims', title='Statements of the paper', caption='', columns=(
            Column(name='verdict', title='verdict'), Column(name='p', title='p'),
            Column(name='statement', title='the paper'),
            Column(name='evidence', title='our runs'),
        ),
        rows=tuple(
            (claim.verdict.value, p_words(claim.p_value), f'{claim.statement} ({claim.source})',
             claim.evidence) for claim in claims
        ),
    )


def _experiments(found: StudyFindings) -> Iterator[Picture]:
    for word in found.config.experiments:
        name = Path(word).stem
        if name in found.results.experiments:  # only in a study's folder, which has the arms
            experiment = read_experiment(find_experiment(word))
            rows = arm_rows(experiment, found.out / f'experiment-{name}')
            picture = arms_picture(paired_arms(experiment, rows))
            yield dataclasses.replace(
                picture, name=f'experiment_{name}', title=f'Experiment {name}: {picture.title}'
            )


def _pairs_table(found: StudyFindings) -> Table:
    names = [str(name) for name in found.pairs if str(name).endswith('_p')]
    frame = found.pairs.assign(**{name: found.pairs[name].map(
        lambda p: f'{p:.4f}' if p >= _LEAST_P else f'<{_LEAST_P:.4f}') for name in names})
    return table_of(
        frame, 'pairs', 'Differences', 'Of the second less the first in points, with 95 % '
        "intervals for pairs (Newcombe), and McNemar's exact test.", PAIR_COLUMNS)


def _stage_tables(found: StudyFindings) -> tuple[Table, ...]:
    lines = found.stages.to_dict('records')
    titles = ('stage', 'wall time', 'sittings', 'runs', 'cores', 'workers', 'date')
    return (
        Table(
            name='stages', title='Stages', caption='Wall time of all sittings, on a machine '
            'that may have been busy with other work.',
            columns=tuple(Column(name=title.replace(' ', '_'), title=title) for title in titles),
            rows=tuple(
                (line['stage'], _wall(line), line['sittings'] or None, line['runs'] or None,
                 line['cores'], line['workers'], str(line['date'])[:10] or None)
                for line in lines
            ),
        ),
        Table(
            name='commands', title='Commands',
            caption="Each can be run again by hand, in the study's folder.",
            columns=(Column(name='stage', title='stage'), Column(name='command', title='command')),
            rows=tuple((line['stage'], line['command']) for line in lines),
        ),
    )


def _wall(line: Mapping[Hashable, Any]) -> str:
    if line['skipped']:
        return 'nothing to do'
    if not line['done']:
        return 'not done'
    return ('at least ' if line['at_least'] else '') + clock(line['wall_s'])


def study_values(found: StudyFindings) -> dict[str, Any]:
    """The findings as plain values; shares are fractions, unknown values None."""
    return plain({
        'schema': SCHEMA, 'version': VERSION, 'taxinet_ros_version': __version__,
        'made_on': dict(provenance()),
        'config': dataclasses.asdict(found.config), 'summary': list(study_report(found).summary),
        'claims': [
            {
                'name': claim.name, 'statement': claim.statement, 'source': claim.source,
                'verdict': claim.verdict.name.lower(), 'p': claim.p_value,
                'evidence': claim.evidence,
            }
            for claim in found.claims
        ],
        **{name: _records(frame) for name, frame in found.frames().items()},
        'localized': _localized(found.results),
        'experiments': {
            name: values['comparisons'] for name, values in found.results.experiments.items()
        },
    })


def _localized(results: Results) -> dict[str, Any] | None:
    names = ('failed', 'judged', 'looked_into', 'counted', 'substitutions')
    found = results.localized
    return None if found is None else {name: found[name] for name in names}


def _records(frame: pd.DataFrame) -> list[dict[str, Any]]:
    """Rows of a table, with None for missing values."""
    return [
        {str(name): None if pd.isna(value) else value for name, value in line.items()}
        for line in frame.to_dict('records')
    ]

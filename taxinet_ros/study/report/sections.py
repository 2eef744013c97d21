"""Summary and sections of a study's report: sentences, pictures and tables.

All figures in the sentences are computed from the study's runs.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Hashable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd

from taxinet_ros.analysis.experiment.arms import paired_arms
from taxinet_ros.analysis.experiment.report import arms_picture
from taxinet_ros.analysis.report.parts import Column, Picture, Section, Table
from taxinet_ros.study.report.claim import Claim, Verdict, p_words
from taxinet_ros.study.report.figures import (
    day_pictures,
    learned_picture,
    rates_picture,
    runway_pictures,
)
from taxinet_ros.study.report.paper import PAPER_RUNS
from taxinet_ros.study.report.results import Results
from taxinet_ros.study.report.tables import (
    LEARNED_COLUMNS,
    MORE_COLUMNS,
    NETWORK_COLUMNS,
    PAIR_COLUMNS,
    binned_columns,
    table_of,
)
from taxinet_ros.study.stages.config import StudyConfig
from taxinet_ros.study.stages.plan import PAPER_RULE
from taxinet_ros.study.stages.progress import clock, rough_duration
from taxinet_ros.trials.experiment import arm_rows, find_experiment, read_experiment

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


def study_facts(found: StudyFindings) -> Mapping[str, str]:
    """Facts of the study."""
    config = found.config
    done = found.stages[found.stages['done']] if len(found.stages) else found.stages
    dates = sorted(date[:10] for date in done.get('date', ()) if date)
    versions = ', '.join(sorted({str(version) for version in done.get('version', ()) if version}))
    facts = {
        'program': config.program, 'scale': f'{config.scale:g}',
        'images': f'{config.images:,} and {config.validation:,} held back, per network',
        'epochs': str(config.epochs), 'version': versions,
        'seeds': f'training {config.training_seed}, evaluation {config.seed}, '
        f'learning {", ".join(map(str, config.learning_seeds))}',
        'dates': ' to '.join(dict.fromkeys(dates[:1] + dates[-1:])),
        'paper': 'Fremont, Chiu, Margineantu, Osipychev and Seshia, CAV 2020',
    }
    return {name: value for name, value in facts.items() if value}


def study_sections(found: StudyFindings) -> tuple[Section, ...]:
    """The evidence; empty sections are left out."""
    sections = (
        _networks(found), _claims(found), _day(found), _runway(found), _debugging(found),
        _learned(found), _pairs(found), _stages(found),
    )
    return tuple(
        section for section in sections
        if section.sentences or section.pictures or any(table.rows for table in section.tables)
    )


def _networks(found: StudyFindings) -> Section:
    return Section(
        name='networks', heading='The networks', sentences=(*_under_way(found), OTHER_WORLD),
        pictures=(rates_picture(found.networks),),
        tables=(
            table_of(
                found.networks, 'networks_rates', 'How often they satisfy and leave the runway',
                'Of all judged runs, with 95 % Clopper-Pearson intervals.', NETWORK_COLUMNS),
            table_of(found.networks, 'networks_more', 'More on them',
                     'Medians over the runs; errors on the pictures held back, of the model cards, '
                     'each in its own world. Settled: within 1.5 m to the end.', MORE_COLUMNS),
        ),
    )


def _under_way(found: StudyFindings) -> list[str]:
    """Names of unfinished campaigns, whose figures are not final."""
    asked = found.config.runs
    parts = [
        f'{network.name} {done:,} of {asked:,}'
        for network in found.results.networks.values()
        if (done := len(network.table) + network.unjudged) < asked
    ]
    return [f'Not all runs are done yet: {", ".join(parts)}.'] if parts else []


def _claims(found: StudyFindings) -> Section:
    order = {verdict: number for number, verdict in enumerate(Verdict)}
    claims = sorted(found.claims, key=lambda claim: order[claim.verdict])
    return Section(
        name='claims', heading='What the paper says, and what we see', sentences=(
            'Each is tested on our runs from both sides: in kind as in the paper if runs like ours '
            'were unlikely were the statement false, not as in the paper if they were unlikely '
            'were it true, else not clear from these runs. All tests of all statements are one '
            'family (Holm), and exact but those of ρ under two skies: so of studies whose number '
            'of runs was fixed beforehand any of these verdicts is wrong in at most 5 %. p is '
            'adjusted for that, the intervals beside it are 95 % each by itself.',
        ),
        tables=(Table(
            name='claims', title='Statements of the paper', caption='', columns=(
                Column(name='verdict', title='verdict'),
                Column(name='p', title='p'),
                Column(name='statement', title='the paper'),
                Column(name='evidence', title='our runs'),
            ),
            rows=tuple(
                (claim.verdict.value, p_words(claim.p_value),
                 f'{claim.statement} ({claim.source})', claim.evidence)
                for claim in claims
            ),
        ),),
    )


def _day(found: StudyFindings) -> Section:
    return Section(
        name='day', heading='Over the day (Fig. 4)',
        pictures=day_pictures(found.results, found.hours),
        tables=(table_of(found.hours, 'hours', 'By the hour', 'Every network, every hour.',
                         binned_columns('h', 0)),),
    )


def _runway(found: StudyFindings) -> Section:
    return Section(
        name='runway', heading='Along the runway (Fig. 6)',
        pictures=runway_pictures(found.results, found.distances),
        tables=(table_of(found.distances, 'distances', 'By 100 m of runway',
                         'By where runs start; in 30 s they come some 150 m further.',
                         binned_columns('m', 0)),),
    )


def _debugging(found: StudyFindings) -> Section:
    results = found.results
    causes = (results.analysis or {}).get('summary', ())
    blame = (results.localized or {}).get('sentences', ())
    sentences = [f'Causes: {words}' for words in causes]
    sentences += [f'Whose fault: {words}' for words in blame]
    for name, values in results.experiments.items():
        sentences += [f'Experiment {name}: {words}' for words in values['sentences']]
    return Section(
        name='debugging', heading='Why the original network fails (Fig. 7)',
        sentences=tuple(sentences), pictures=tuple(_experiments(found)),
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


def _learned(found: StudyFindings) -> Section:
    if found.learned.empty:
        return Section(name='learned', heading='')
    kinds = [
        f'{len(searches)} {"search" if len(searches) == 1 else "searches"} by {sampler} '
        f'({min(one.facts["runs_made"] for one in searches):,} runs each)'
        for sampler, searches in found.results.searches.items()
    ]
    return Section(
        name='learned', heading="Where the generic network's failures are, as learned",
        sentences=(
            f'{" and ".join(kinds)}, which differ in their seed: mean, least and greatest. '
            f'{PAPER_RULE} is the rule by which the paper learned; it goes for the likeliest '
            'failures and remembers some ten of them. ce estimates where all failures are, but a '
            'bin in which it has found none keeps a share of the program, by a constant of its '
            'own. So both are what a sampler goes by, not estimates; these are the failures among '
            'random runs, and those that ce found with their weights, with 95 % intervals.',
        ),
        pictures=(learned_picture(found.learned),),
        tables=(table_of(found.learned, 'learned', 'Where on the runway', 'Shares in percent.',
                         LEARNED_COLUMNS),),
    )


def _pairs(found: StudyFindings) -> Section:
    names = [str(name) for name in found.pairs if str(name).endswith('_p')]
    frame = found.pairs.assign(**{name: found.pairs[name].map(_pair_p_words) for name in names})
    return Section(
        name='pairs', heading='Networks on the same scenes',
        tables=(table_of(
            frame, 'pairs', 'Differences', 'Of the second less the first in points, with 95 % '
            "intervals for pairs (Newcombe), and McNemar's exact test.", PAIR_COLUMNS),),
    )


def _pair_p_words(value: float) -> str:
    return f'{value:.4f}' if value >= _LEAST_P else f'<{_LEAST_P:.4f}'


def _stages(found: StudyFindings) -> Section:
    if found.stages.empty:
        return Section(name='stages', heading='')
    lines = found.stages.to_dict('records')
    titles = ('stage', 'wall time', 'sittings', 'runs', 'cores', 'workers', 'date')
    return Section(
        name='stages', heading='What was done', tables=(
            Table(
                name='stages', title='Stages', caption='Wall time of all sittings, on a machine '
                'that may have been busy with other work.',
                columns=tuple(
                    Column(name=title.replace(' ', '_'), title=title) for title in titles),
                rows=tuple(
                    (line['stage'], _wall(line), line['sittings'] or None, line['runs'] or None,
                     line['cores'], line['workers'], str(line['date'])[:10] or None)
                    for line in lines
                ),
            ),
            Table(
                name='commands', title='Commands', caption="Each can be run again by hand, in the "
                "study's folder.",
                columns=(Column(name='stage', title='stage'),
                         Column(name='command', title='command')),
                rows=tuple((line['stage'], line['command']) for line in lines),
            ),
        ),
    )


def _wall(line: Mapping[Hashable, Any]) -> str:
    if line['skipped']:
        return 'nothing to do'
    if not line['done']:
        return 'not done'
    return ('at least ' if line['at_least'] else '') + clock(line['wall_s'])


OTHER_WORLD = (
    'Why figures differ: the pictures here come from our own renderer and not from X-Plane, the '
    'networks and the steering law are our own, and the original network was trained on a narrow '
    'world of our choosing, since what Boeing trained theirs on is not published. Nothing was '
    "tuned towards the paper's figures. What can be compared is the kind: which of two networks "
    'does better, and where they fail.'
)


def study_summary(found: StudyFindings) -> tuple[str, ...]:
    """The findings, the most important first."""
    return (*_incomplete(found), *_rates(found), *_counts(found), *_cost(found))


def percent(value: float, low: float, high: float) -> str:
    """A share with its interval, such as ``49.9 % (48.3-51.5)``."""
    return f'{100 * value:.1f} % ({100 * low:.1f}-{100 * high:.1f})'


def _incomplete(found: StudyFindings) -> Iterator[str]:
    if found.stages.empty:
        return
    todo = found.stages[~found.stages['done']]['stage'].tolist()
    if todo:
        done = len(found.stages) - len(todo)
        yield f'{done} of {len(found.stages)} stages are done; the next is {todo[0]}.'


def _rates(found: StudyFindings) -> Iterator[str]:
    frame = found.networks
    runs = frame['runs']
    many = f'{runs.min():,}' if runs.min() == runs.max() else f'{runs.min():,} to {runs.max():,}'
    yield (
        f'{len(frame)} {"network" if len(frame) == 1 else "networks"}, judged on {many} runs of '
        f'{frame["program"].iloc[0]}, seed {frame["seed"].iloc[0]}, the same scenes for each '
        '(95 % Clopper-Pearson intervals).'
    )
    if found.config.scale < 1 or runs.min() < PAPER_RUNS:
        yield (
            f"This is a smaller study than the paper's (scale {found.config.scale:g}, "
            f'{found.config.images:,} images a network; the paper has about {PAPER_RUNS:,} runs '
            'each): read the intervals, not the figures.'
        )
    for _, line in frame.iterrows():
        yield _network_sentence(line)


def _network_sentence(line: pd.Series[Any]) -> str:
    words = [
        f'satisfied {percent(*(line[f"satisfied{end}"] for end in ("", "_low", "_high")))}'
        + _paper_words(line['paper_satisfied']),
        f'off the runway {percent(*(line[f"off_runway{end}"] for end in ("", "_low", "_high")))}'
        + _paper_words(line['paper_off_runway']),
    ]
    broken = int(line['without_verdict'])
    runs = '1 run' if broken == 1 else f'{broken} runs'
    more = f' ({runs} without a verdict, in no rate)' if broken else ''
    return f'{line["network"]}: {", ".join(words)}{more}.'


def _paper_words(value: float) -> str:
    return '' if pd.isna(value) else f', the paper {100 * value:g} %'


def _counts(found: StudyFindings) -> Iterator[str]:
    if not found.claims:
        return
    counts = {
        verdict: sum(claim.verdict is verdict for claim in found.claims) for verdict in Verdict
    }
    words = ', '.join(f'{count} {verdict.value}' for verdict, count in counts.items())
    yield f'Of {len(found.claims)} statements of the paper: {words}.'


def _cost(found: StudyFindings) -> Iterator[str]:
    if found.stages.empty:
        return
    done = found.stages[found.stages['done']]
    if done.empty:
        return
    least = 'at least ' if done['at_least'].any() else ''
    cores = done['cores'].dropna().unique()
    on = f' on {"/".join(str(int(number)) for number in sorted(cores))} cores' if len(cores) else ''
    yield f'The stages that are done took {least}{rough_duration(done["wall_s"].sum())}{on}.'

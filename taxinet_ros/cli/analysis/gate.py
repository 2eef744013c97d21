"""``taxinet gate``: check a campaign against acceptance thresholds in continuous integration."""

from __future__ import annotations

import json
import math
import shlex
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from taxinet_ros.cli.checked import check_output, tell_doubts
from taxinet_ros.cli.options import JsonOption
from taxinet_ros.cli.show import line_console
from taxinet_ros.errors import ExitCode, UsageError
from taxinet_ros.version import __version__

if TYPE_CHECKING:
    from taxinet_ros.analysis.campaign.baseline import AgainstBaseline, Changed
    from taxinet_ros.analysis.gate import Criterion, GateOptions, GateResult, Look
    from taxinet_ros.trials.rates import Planned
    from taxinet_ros.trials.record.content import CampaignContent
    from taxinet_ros.trials.record.row import RunRow

INCONCLUSIVE_WORDS = {
    'pass': ExitCode.OK, 'fail': ExitCode.VIOLATED, 'report': ExitCode.INCOMPLETE,
}
"""Exit code of each ``--inconclusive`` word."""
_MOST_SCENES = 10
"""Maximum number of scenes that got worse on the screen; JUnit and JSON have all."""
_BOUNDS = {
    'any': 'one-sided; each holds at this confidence, however often the campaign is checked',
    'planned': 'one-sided; each holds at this confidence, for one look at the planned runs',
    'sequential': 'none: each decision holds at this confidence, whenever the campaign stops',
}
"""What the bounds are, by the value of a :class:`.Look`."""


def gate(
    campaign: Annotated[
        Path,
        typer.Argument(
            metavar='CAMPAIGN|NETWORK', help="a campaign's folder; with --baseline also a network, "
            'word or file, which is then driven through its scenes'
        ),
    ],
    min_satisfaction: Annotated[
        float | None,
        typer.Option(metavar='SHARE', help='minimum share of runs that satisfy their formulas'),
    ] = None,
    max_off_runway: Annotated[
        float | None, typer.Option(metavar='SHARE', help='maximum share of runs that leave the '
        'runway')
    ] = None,
    baseline: Annotated[
        Path | None,
        typer.Option(
            metavar='CAMPAIGN|TABLE', help='runs of the same scenes, which these must not be worse '
            'than'
        ),
    ] = None,
    margin: Annotated[
        float | None,
        typer.Option(
            metavar='SHARE', help='with --baseline: loss of satisfied scenes up to which it is no '
            'worse (default 0.05)'
        ),
    ] = None,
    max_infra: Annotated[
        int, typer.Option(help='maximum number of runs with an infrastructure error')
    ] = 0,
    confidence: Annotated[
        float,
        typer.Option(help='confidence of PASS and of FAIL, over all looks that are covered'),
    ] = 0.95,
    planned: Annotated[
        bool,
        typer.Option(
            '--planned', help='judge once, at exactly the planned number of runs, with the whole '
            'confidence (as taxinet plan counts)'
        ),
    ] = False,
    sequential: Annotated[
        bool,
        typer.Option(
            '--sequential', help='follow the runs in their order to the first decision of a '
            'sequential test, at which falsify --until stops'
        ),
    ] = False,
    design: Annotated[
        float | None,
        typer.Option(
            metavar='SHARE', help='with --sequential: the share that a good system has, better '
            'than the threshold; the test then takes the fewest runs for it'
        ),
    ] = None,
    inconclusive: Annotated[
        str,
        typer.Option(
            metavar='WORD', help='exit code for INCONCLUSIVE: report (3), pass (0) or fail (1)'
        ),
    ] = 'report',
    junit: Annotated[
        Path | None, typer.Option(
            metavar='FILE.xml', writable=True, dir_okay=False, help='JUnit XML file to write, one '
            'test case per criterion; the table of the runs is written beside it'
        )
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(help='folder for the runs of a NETWORK; finished runs in it are kept'),
    ] = None,
    workers: Annotated[
        int | None,
        typer.Option(min=1, help='of a NETWORK: worker processes; same results (default 2)'),
    ] = None,
    as_json: JsonOption = False,
) -> int:
    """Check a campaign against acceptance thresholds.

    PASS (exit code 0) only if the one-sided bound of each share clears its threshold, FAIL (1) if
    the whole interval of one violates it, else INCONCLUSIVE (3) with an estimate of the additional
    runs needed. Runs with an infrastructure error are excluded and counted separately.

    With --baseline, the scenes are paired with those of another campaign or table, which have to be
    the same: FAIL if satisfaction falls (McNemar's exact test), PASS if it falls by no more than
    the margin, else INCONCLUSIVE. A network in place of the campaign is driven through these scenes
    in the closed loop without ROS; after an interrupt, the same command continues.
    """
    from taxinet_ros.analysis.campaign.baseline import DEFAULT_MARGIN, against_baseline
    from taxinet_ros.analysis.gate import GateOptions, Verdict, gate_result, junit_xml
    from taxinet_ros.files.atomic import write_atomically
    from taxinet_ros.trials.record.facts import recorded_rules

    if margin is not None and baseline is None:
        raise UsageError('--margin: only with --baseline')
    if baseline is not None and margin is None:
        margin = DEFAULT_MARGIN
    options = GateOptions(
        min_satisfaction=min_satisfaction, max_off_runway=max_off_runway, max_infra=max_infra,
        confidence=confidence, look=_look(planned=planned, sequential=sequential),
        design=design, margin=margin,
    )
    if inconclusive not in INCONCLUSIVE_WORDS:
        known = ', '.join(INCONCLUSIVE_WORDS)
        raise UsageError(f'--inconclusive {inconclusive}: unknown; known: {known}')
    if junit is not None:
        _check_junit(junit, [path for path in (campaign, baseline) if path])
    judged = _judged(campaign, baseline, out, workers)
    if judged is None:
        return ExitCode.INTERRUPTED
    paired, criterion = None, None
    if baseline is not None and margin is not None:
        paired = against_baseline(judged.table(), judged.folder, baseline, again=judged.again)
        command = shlex.join(['taxinet', 'compare', str(baseline), judged.name])
        criterion = paired.criterion(margin, confidence, command)
    answer = gate_result(
        judged.rows, options, planned=judged.planned or 0, compared=criterion,
        rules=recorded_rules(judged.facts), folder=judged.name,
    )
    more = paired.notes if paired else ()
    answer = replace(answer, notes=(*answer.notes, *judged.notes, *more))
    table = _left_table(judged, junit)
    if junit is not None:
        document = junit_xml(
            judged.rows, answer, judged.folder, judged.facts, table=table,
            inconclusive_passes=inconclusive == 'pass', documents=junit.parent,
        )
        _write_documents(judged, junit)
        write_atomically(junit, document)
    if as_json:
        values = _json(answer, options)
        values['table'] = table and str(table)
        if paired is not None:
            values['baseline'] = _baseline_json(paired, options)
        print(json.dumps(values, indent=2, allow_nan=False))
    else:
        print(_words(answer, judged.folder, paired, table))
    codes = {Verdict.PASS: ExitCode.OK, Verdict.FAIL: ExitCode.VIOLATED}
    return codes.get(answer.verdict, INCONCLUSIVE_WORDS[inconclusive])


@dataclass(frozen=True, kw_only=True)
class _Judged:
    """Runs to be judged: a campaign's, or those of a network in a baseline's scenes."""

    folder: Path
    rows: Sequence[RunRow]
    facts: Mapping[str, Any]
    planned: Planned
    notes: tuple[str, ...]
    again: bool = False

    @property
    def name(self) -> str:
        """What commands call these runs: folder, or table."""
        from taxinet_ros.trials.record.table import PARQUET_NAME

        return str(self.folder / PARQUET_NAME if self.again else self.folder)

    def table(self) -> Any:
        """The runs' table, with its provenance."""
        from taxinet_ros.trials.record.facts import STACKS, recorded_stacks
        from taxinet_ros.trials.record.table import table

        frame = table(self.rows, tuple(self.facts.get('specs', {})))
        frame.attrs[STACKS] = recorded_stacks(self.facts)
        return frame


def _look(*, planned: bool, sequential: bool) -> Look:
    from taxinet_ros.analysis.gate import Look

    if planned and sequential:
        raise UsageError('gate: --planned and --sequential do not go together; leave one out')
    return Look.PLANNED if planned else Look.SEQUENTIAL if sequential else Look.ANY


def _check_junit(junit: Path, inputs: Sequence[Path]) -> None:
    """Check that the table beside the JUnit file can be written, and that its folder exists."""
    if not junit.parent.is_dir():
        raise UsageError(f'--junit {junit}: no such folder: {junit.parent}')
    beside = _beside(junit)
    check_output(f'--junit {junit}: {beside}', beside, inputs=inputs, own=['.parquet'])


def _write_documents(judged: _Judged, junit: Path) -> None:
    """Write the documents of the commands in the JUnit file beside it."""
    from taxinet_ros.analysis.gate import rerun_documents
    from taxinet_ros.files.atomic import write_atomically

    texts = rerun_documents(judged.rows, judged.facts)
    for name in texts:
        path = junit.parent / name
        check_output(f'--junit {junit}: {path}', path, own=[path.suffix])
    for name, text in texts.items():
        write_atomically(junit.parent / name, text)


def _judged(
    campaign: Path, baseline: Path | None, out: Path | None, workers: int | None
) -> _Judged | None:
    """The runs to judge; None if driving a network was interrupted."""
    from taxinet_ros.trials.past_runs.recorded_campaign import open_campaign

    if baseline is not None and not campaign.is_dir():
        return _driven(str(campaign), baseline, out, workers or 2)
    for option, given in (('--out', out), ('--workers', workers)):
        if given is not None:
            raise UsageError(
                f'{option}: only where a network is driven through the scenes of a --baseline; '
                f'{campaign} is not driven'
            )
    recorded = open_campaign(campaign)
    return _Judged(
        folder=campaign, rows=recorded.rows, facts=recorded.facts,
        planned=recorded.planned_runs, notes=tuple(_record_notes(recorded.content)),
    )


def _driven(network: str, baseline: Path, out: Path | None, workers: int) -> _Judged | None:
    """The network's runs in the baseline's scenes, finished ones kept in the folder."""
    from taxinet_ros.cli.progress import trial_bar
    from taxinet_ros.core.perception.perception import check_perception, network_doubts
    from taxinet_ros.files.atomic import write_parquet
    from taxinet_ros.trials.options import DEFAULT_ROOT
    from taxinet_ros.trials.past_runs.shared_scenes import SharedTrials, scenes_of
    from taxinet_ros.trials.record.table import PARQUET_NAME

    fingerprint = check_perception(network)
    scenes = scenes_of(baseline)
    system = scenes.system
    out = out or DEFAULT_ROOT / f'gate-{Path(network).stem.replace(":", "-")}'
    console = line_console(stderr=True)
    tell_doubts(network_doubts(network, (scene.scenario for scene in scenes.scenes)))
    with (
        SharedTrials(scenes, out) as trials,
        trial_bar(console, 'runs', len(scenes.scenes)) as (count, interrupted),
    ):
        done = trials.drive(network, workers=workers, on_trial=count, interrupted=interrupted)
        if len(done) < len(scenes.scenes) and interrupted():
            console.print('interrupted; the same command goes on')
            return None
        rows = tuple(trials.rows(network))
    rough = sum(not scene.exact for scene in scenes.scenes)
    notes = (
        f'{rough:,} of {len(scenes.scenes):,} scenes are known to nine decimals only, as the '
        'baseline has no bags; runs at the edge may come out otherwise for that alone',
    ) if rough else ()
    judged = _Judged(
        folder=out, rows=rows, notes=notes, again=True,
        planned=None if scenes.fixed else _planned(baseline, rows), facts={
            'taxinet_ros_version': __version__, 'baseline': str(baseline),
            'program': rows[0].program, 'seed': rows[0].seed, 'perception': network,
            'perception_sha256': fingerprint, 'controller': system.controller,
            'gains': dict(system.gains), 'timing': system.timing.words, 'world': system.world,
            **scenes.judging.facts(),
        },
    )
    write_parquet(out / PARQUET_NAME, judged.table())
    return judged


def _planned(baseline: Path, rows: Sequence[RunRow]) -> range:
    """The runs that the baseline planned, which are other ones than its runs."""
    from taxinet_ros.trials.past_runs.recorded_campaign import open_campaign
    from taxinet_ros.trials.record.facts import is_campaign

    if is_campaign(baseline) and (found := open_campaign(baseline).planned_runs):
        return found
    return range(max(row.index for row in rows) + 2)  # more than there are: the number was open


def _left_table(judged: _Judged, junit: Path | None) -> Path | None:
    """The table that ``taxinet analyze`` takes: the runs' own, or one beside the JUnit file.

    The folder of a campaign is only read, since the campaign may be running.
    """
    from taxinet_ros.files.atomic import write_parquet
    from taxinet_ros.trials.record.table import PARQUET_NAME

    own = judged.folder / PARQUET_NAME
    if junit is None or judged.again:
        return own if own.is_file() else None
    beside = _beside(junit)
    write_parquet(beside, judged.table())
    return beside


def _beside(junit: Path) -> Path:
    from taxinet_ros.trials.record.table import PARQUET_NAME

    return junit.with_name(f'{junit.stem}-{PARQUET_NAME}')


def _record_notes(content: CampaignContent) -> Iterator[str]:
    """Notes about the campaign's record."""
    from taxinet_ros.bag.check.findings import ranges
    from taxinet_ros.core.pacing.timing import is_free
    from taxinet_ros.core.provenance import differences
    from taxinet_ros.trials.record.facts import recorded_stacks

    if found := differences(*recorded_stacks(content.facts).values()):
        yield f'the runs were made on different machines or versions: {found}'
    if content.finished and content.unfinished:
        yield f'run {ranges(content.unfinished)}: started but has no result'
    for timing in sorted({row.timing for row in content.rows if row.timing}):
        again = ', so their verdicts are not reproducible' if is_free(timing) else ''
        yield f'timing of the runs: {timing}{again}'


def _words(
    answer: GateResult, folder: Path, paired: AgainstBaseline | None, table: Path | None
) -> str:
    from taxinet_ros.analysis.gate import Verdict

    counts = ', '.join(f'{n} {outcome}' for outcome, n in answer.counts.items() if n)
    lines = [f'{answer.verdict}: {folder} ({counts or "no run"})']
    lines += [f'  {one.verdict:<12} {one.name}: {one.sentence}' for one in answer.criteria]
    if paired is not None:
        lines += [f'  worse: {_changed_words(one)}' for one in paired.worse[:_MOST_SCENES]]
        if len(paired.worse) > _MOST_SCENES:
            lines.append(f'  and {len(paired.worse) - _MOST_SCENES:,} more that got worse')
    lines += [f'  note: {note}' for note in answer.notes]
    if table is not None:
        lines.append(f'  table: {table}')
    lines += [f'  next: {command}' for command in dict.fromkeys(
        one.next for one in answer.criteria if one.verdict is not Verdict.PASS and one.next)]
    return '\n'.join(lines)


def _changed_words(one: Changed) -> str:
    was = '' if one.baseline_run_id == one.run_id else f' ({one.baseline_run_id})'
    return f'{one.run_id}: rho {one.rho:+.3f}, baseline {one.baseline_rho:+.3f}{was}'


def _json(answer: GateResult, options: GateOptions) -> dict[str, Any]:
    from taxinet_ros.analysis.gate import Kind, Verdict
    from taxinet_ros.core.verdict.outcome import Outcome

    return {
        'verdict': answer.verdict.value,
        'confidence': options.confidence,
        'look': options.look.value,
        'bounds': _BOUNDS[options.look.value],
        'judged': answer.judged,
        'effective': answer.effective,
        'outcomes': {outcome.value: answer.counts[outcome] for outcome in Outcome},
        'criteria': [
            {
                'name': one.name, 'verdict': one.verdict.value, 'sentence': one.sentence,
                **({} if one.bounds is None else {
                    'loss' if one.kind is Kind.BASELINE else 'share':
                        None if math.isnan(one.bounds.share) else one.bounds.share,
                    'low': one.bounds.low, 'high': one.bounds.high,
                    'more_runs': one.more_runs,
                }),
                **_sequential_json(one),
                **({'next': one.next} if one.next and one.verdict is not Verdict.PASS else {}),
            }
            for one in answer.criteria
        ],
        'notes': list(answer.notes),
    }


def _baseline_json(paired: AgainstBaseline, options: GateOptions) -> dict[str, Any]:
    found, rates = paired.loss(options.confidence), paired.found.satisfied
    return {
        'margin': options.margin, 'tested': paired.found.tested, 'scenes': rates.pairs,
        'unknown': paired.unknown, 'satisfied': rates.second, 'satisfied_before': rates.first,
        'loss': found.share,
        'mcnemar_p_one_sided': found.p_value if paired.found.tested else None,
        **{name: [
            {key: _number(value) for key, value in one._asdict().items()} for one in some
        ] for name, some in (('worse', paired.worse), ('better', paired.better))},
    }


def _number(value: Any) -> Any:
    return _finite(value) if isinstance(value, float) else value


def _sequential_json(one: Criterion) -> dict[str, Any]:
    if one.course is None or one.test is None:
        return {}
    found, test = one.course, one.test
    return {'sequential': {
        'test': str(test), 'decision': found.decision and found.decision.value,
        'decided_by_run': found.index, 'runs': found.runs, 'bad': found.bad,
        'later_runs': found.later, 'log_evidence_needed': test.enough,
        'log_evidence_pass': _finite(test.log_pass(found.bad, found.runs - found.bad)),
        'log_evidence_fail': _finite(test.log_fail(found.bad, found.runs - found.bad)),
    }}


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None
